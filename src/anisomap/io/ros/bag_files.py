"""Prepare files for rosbags: their suffix, missing message definitions, and truncated files."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

from anisomap.errors import AnisomapWarning, FileError
from anisomap.io.parsing.libraries import import_extra
from anisomap.io.parsing.source import check_expansion
from anisomap.io.ros.repair import EXTRA, BagFile, decompress, find_repair

MAGICS = {b"#ROSBAG V2.0\n": ".bag", b"\x89MCAP0\r\n": ".mcap", b"SQLite format 3\0": ".db3"}
"""Magic numbers, and the suffixes that rosbags expects."""

_REPAIRABLE = (".bag", ".mcap")


def as_rosbags_path(path: Path) -> Path:
    """Return a path with the suffix that rosbags expects; opening it repairs a truncated file.

    Parameters
    ----------
    path : pathlib.Path
        A bag with any suffix, or a folder, which is returned unchanged.
    """
    if path.is_dir():
        return path
    suffix = _kind(path)
    overrides: dict[str, Any] = {"suffix": suffix}
    if suffix in _REPAIRABLE:
        repair = find_repair(path, suffix)
        overrides["open"] = lambda self, *_, **__: BagFile(path, repair)
    bag_path: Path = type("BagPath", (type(path),), overrides)(path)
    return bag_path


def warn_of_missing_end(path: Path) -> None:
    """Warn if a bag was truncated or not closed, with the number of lost bytes."""
    suffix = "" if path.is_dir() else _kind(path)
    repair = find_repair(path, suffix) if suffix in _REPAIRABLE else None
    if repair is None:
        return
    size = path.stat().st_size
    warnings.warn(
        f"{path} was truncated or not closed: read all complete records, dropped the last "
        f"{size - repair.end} of {size} bytes",
        AnisomapWarning,
        stacklevel=2,
    )


def register_definitions(store: Any, files: Iterable[Path]) -> None:
    """Register message definitions from files in a type store.

    Parameters
    ----------
    store : rosbags.typesys.store.Typestore
    files : iterable of pathlib.Path
        Each is a ``.msg`` file in a folder ``package/msg``, or is named ``package.Name.msg``.

    Raises
    ------
    FileError
        If a file cannot be read, or its package is unknown.
    """
    typesys = import_extra("rosbags.typesys", "reading bags", EXTRA)
    for file in files:
        try:
            text = file.read_text(encoding="utf-8")
        except OSError as error:
            raise FileError(f"cannot read {file}: {error.strerror or error}") from error
        store.register(typesys.get_types_from_msg(text, _type_name(file)))


def check_chunks(path: Path, reader: Any) -> None:
    """Reject decompression bombs, with a FileError.

    MCAP declares the size of each chunk; chunks of ROS 1 bags are checked while decompressing.
    """
    for each in reader.readers:
        storage = getattr(each, "storage", None)
        for part in getattr(storage, "storages", [storage]):
            for chunk in getattr(part, "chunks", []):
                check_expansion(path, "a chunk", chunk.compressed_size, chunk.uncompressed_size)
        if storage is None:
            for at, chunk in each.chunks.items():
                method = chunk.decompressor.__module__.partition(".")[0].removeprefix("_")
                bounded = partial(decompress, path, compression=method)
                each.chunks[at] = chunk._replace(decompressor=bounded)


def _type_name(file: Path) -> str:
    package, _, name = file.stem.rpartition(".")
    if not package and file.parent.name == "msg":
        package = file.absolute().parent.parent.name
    if not package:
        raise FileError(
            f"the package of {file} is unknown; name the file PACKAGE/msg/NAME.msg or "
            "PACKAGE.NAME.msg"
        )
    return f"{package}/msg/{name}"


def _kind(path: Path) -> str:
    with path.open("rb") as stream:
        start = stream.read(max(map(len, MAGICS)))
    return next((kind for magic, kind in MAGICS.items() if start.startswith(magic)), path.suffix)
