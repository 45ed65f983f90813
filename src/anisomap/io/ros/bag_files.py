"""Prepare files for rosbags: their suffix, missing message definitions, and truncated files."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from anisomap.errors import AnisomapWarning, FileError, import_extra
from anisomap.files import open_regular, read_small
from anisomap.io.parsing.source import library_errors
from anisomap.io.ros.repair import (
    EXTRA,
    MAX_MESSAGE,
    BagFile,
    check_chunk,
    check_chunks,
    decompress_chunk,
    decompress_file,
    find_repair,
)
from anisomap.memory import Budget

MAGICS = {b"#ROSBAG V2.0\n": ".bag", b"\x89MCAP0\r\n": ".mcap", b"SQLite format 3\0": ".db3"}
"""Magic numbers, and the suffixes that rosbags expects."""

METADATA = "metadata.yaml"
"""The file that makes a folder a bag of ROS 2."""

_REPAIRABLE = (".bag", ".mcap")
_WHOLE_FILES, _EACH_MESSAGE = "file", "message"
_MAX_METADATA = 1 << 20
_MAX_DEFINITION = 1 << 17  # thousands of fields; rosbags reads 0.2 MB/s
_SQLITE_LIMIT_LENGTH = 0


def rosbags_paths(path: Path, unpacked: ExitStack) -> list[Path]:
    """Return the paths to open with rosbags, after measuring what it would decompress."""
    budget = Budget(path)
    if not path.is_dir():
        return [_rosbags_path(path, budget)]
    mode, names = _storage(path)
    if mode == _WHOLE_FILES:
        target = Path(unpacked.enter_context(TemporaryDirectory()))
        paths = [target / Path(name).stem for name in names]
        for name, copy in zip(names, paths, strict=True):
            with open_regular(path / name) as packed, copy.open("xb") as stream:
                decompress_file(packed, path / name, stream)
        return [_rosbags_path(copy, budget) for copy in paths]
    for name in names:
        _rosbags_path(path / name, budget)
    return [path]


def _storage(folder: Path) -> tuple[str, list[str]]:
    """Return the mode of compression of a ROS 2 bag, and the names of its files."""
    yaml = import_extra("ruamel.yaml", "reading bags", EXTRA)
    text = read_small(folder / METADATA, _MAX_METADATA, "the metadata of a bag")
    with library_errors(folder / METADATA):
        information = yaml.YAML(typ="safe").load(text)["rosbag2_bagfile_information"]
        names = [Path(name).name for name in information["relative_file_paths"]]
        return str(information.get("compression_mode") or "").lower(), names


def _rosbags_path(path: Path, budget: Budget) -> Path:
    suffix = _kind(path)
    overrides: dict[str, Any] = {"suffix": suffix}
    if suffix == ".mcap":
        with open_regular(path) as file:
            check_chunks(path, file, budget)
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
    """Register message definitions from files in a type store."""
    typesys = import_extra("rosbags.typesys", "reading bags", EXTRA)
    for file in files:
        text = read_small(file, _MAX_DEFINITION, "a message definition")
        store.register(typesys.get_types_from_msg(text, _type_name(file)))


def limit_unpacking(path: Path, reader: Any) -> bool:
    """Make an open reader decompress within a budget."""
    budget, packed_messages = Budget(path), False
    for each in reader.readers:
        storage = getattr(each, "storage", None)
        if storage is None:
            _limit_ros1(path, each, budget)
            continue
        if storage.metadata.compression_mode == _EACH_MESSAGE:
            storage.metadata = storage.metadata._replace(compression_mode=None)
            packed_messages = True
        for part in getattr(storage, "storages", [storage]):
            if connection := getattr(part, "dbconn", None):
                # Columns of a database can be computed, with values of any size.
                connection.limit(_SQLITE_LIMIT_LENGTH, MAX_MESSAGE)
            for chunk in getattr(part, "chunks", []):
                budget.spend(chunk.uncompressed_size, "a chunk")
                part.bio.seek(chunk.chunk_start_offset + 49 + len(chunk.compression))
                packed = part.bio.read(min(chunk.compressed_size, budget.size))
                check_chunk(path, packed, chunk.compression, chunk.uncompressed_size)
    return packed_messages


def _limit_ros1(path: Path, reader: Any, budget: Budget) -> None:
    for at, chunk in reader.chunks.items():
        method = chunk.decompressor.__module__.partition(".")[0].removeprefix("_")
        bounded = partial(decompress_chunk, path, budget, compression=method)
        reader.chunks[at] = chunk._replace(decompressor=bounded)


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
    with open_regular(path) as stream:
        start = stream.read(max(map(len, MAGICS)))
    return next((kind for magic, kind in MAGICS.items() if start.startswith(magic)), path.suffix)
