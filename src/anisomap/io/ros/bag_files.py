"""Prepare files for rosbags: their suffix, missing message definitions, and truncated files."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from anisomap.errors import AnisomapWarning, FileError, import_extra
from anisomap.files import check_regular, open_regular, read_small
from anisomap.io.ros.repair import EXTRA, BagFile, find_repair

MAGICS = {b"#ROSBAG V2.0\n": ".bag", b"\x89MCAP0\r\n": ".mcap", b"SQLite format 3\0": ".db3"}
"""Magic numbers, and the suffixes that rosbags expects."""

METADATA = "metadata.yaml"
"""The file that makes a folder a bag of ROS 2."""

_REPAIRABLE = (".bag", ".mcap")
_MAX_DEFINITION = 1 << 17  # thousands of fields; rosbags reads 0.2 MB/s


def rosbags_path(path: Path) -> Path:
    """Return the path to open with rosbags."""
    if path.is_dir():
        for each in path.iterdir():
            check_regular(each)
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
    """Register message definitions from files in a type store."""
    typesys = import_extra("rosbags.typesys", "reading bags", EXTRA)
    for file in files:
        text = read_small(file, _MAX_DEFINITION, "a message definition")
        store.register(typesys.get_types_from_msg(text, _type_name(file)))


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
