"""What rosbags has to be told about files: their kind, missing definitions, missing ends."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

from anisomap.errors import AnisomapWarning, FileError
from anisomap.io.parsing.foreign import imported
from anisomap.io.parsing.source import check_unpacked
from anisomap.io.ros.repair import EXTRA, BagFile, repair_of, unpacked

MAGICS = {b"#ROSBAG V2.0\n": ".bag", b"\x89MCAP0\r\n": ".mcap", b"SQLite format 3\0": ".db3"}
"""The first bytes of bags, and the suffix by which rosbags knows them."""

_REPAIRED = (".bag", ".mcap")


def disguised(path: Path) -> Path:
    """Give a path that has the suffix rosbags expects, and opens as a file with an end.

    Parameters
    ----------
    path : pathlib.Path
        A bag, whatever its suffix; a folder is left as it is.
    """
    if path.is_dir():
        return path
    suffix = _kind(path)
    known: dict[str, Any] = {"suffix": suffix}
    if suffix in _REPAIRED:
        repair = repair_of(path, suffix)
        known["open"] = lambda self, *_, **__: BagFile(path, repair)
    named: Path = type("BagPath", (type(path),), known)(path)
    return named


def warn_of_missing_end(path: Path) -> None:
    """Warn of a bag that was cut off or never closed, and say how much of it is lost."""
    suffix = "" if path.is_dir() else _kind(path)
    repair = repair_of(path, suffix) if suffix in _REPAIRED else None
    if repair is None:
        return
    size = path.stat().st_size
    warnings.warn(
        f"{path} was cut off or never closed: its last {size - repair.end} of {size} bytes are "
        "no whole record, and lost; what follows in the original is lost, too",
        AnisomapWarning,
        stacklevel=2,
    )


def with_definitions(store: Any, files: Iterable[Path]) -> Any:
    """Teach a store of message types the definitions in files.

    Parameters
    ----------
    store : rosbags.typesys.store.Typestore
    files : iterable of pathlib.Path
        Each a ``.msg`` file in a folder ``package/msg``, or with the package in its name
        (``package.Name.msg``), as far as the store does not know the name already.
    """
    if not files:
        return store
    typesys = imported("rosbags.typesys", "reading bags", EXTRA)
    for file in files:
        try:
            text = file.read_text(encoding="utf-8")
        except OSError as error:
            raise FileError(f"cannot read {file}: {error.strerror or error}") from error
        store.register(typesys.get_types_from_msg(text, _type_name(file)))
    return store


def check_chunks(path: Path, reader: Any) -> None:
    """See to it that no chunk unpacks to far more than any recording does.

    MCAP says beforehand how much that will be; of a ROS 1 bag it is found out in unpacking.
    """
    for each in reader.readers:
        storage = getattr(each, "storage", None)
        for part in getattr(storage, "storages", [storage]):
            for chunk in getattr(part, "chunks", []):
                check_unpacked(path, "a chunk", chunk.compressed_size, chunk.uncompressed_size)
        if storage is None:
            for at, chunk in each.chunks.items():
                how = chunk.decompressor.__module__.partition(".")[0].removeprefix("_")
                bounded = partial(unpacked, path, compression=how)
                each.chunks[at] = chunk._replace(decompressor=bounded)


def _type_name(file: Path) -> str:
    package, _, name = file.stem.rpartition(".")
    if not package and file.parent.name == "msg":
        package = file.absolute().parent.parent.name
    if not package:
        raise FileError(
            f"{file} does not say which package it is of; "
            "keep it as PACKAGE/msg/NAME.msg, or call it PACKAGE.NAME.msg"
        )
    return f"{package}/msg/{name}"


def _kind(path: Path) -> str:
    with path.open("rb") as stream:
        start = stream.read(max(map(len, MAGICS)))
    return next((kind for magic, kind in MAGICS.items() if start.startswith(magic)), path.suffix)
