"""Prepare files for rosbags: their suffix, missing message definitions, and reads within the file.

Layouts: MCAP specification, and "Bag File Format, version 2.0" (ROS 1).
"""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from anisomap.errors import FileError, import_extra
from anisomap.files.paths import check_regular, read_small

EXTRA = "ros"

_MCAP, _ROS1 = b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n"

MAGICS = {_ROS1: ".bag", _MCAP: ".mcap", b"SQLite format 3\0": ".db3"}
"""Magic numbers, and the suffixes that rosbags expects."""

METADATA = "metadata.yaml"
"""The file that makes a folder a bag of ROS 2."""

_MAX_DEFINITION = 1 << 17  # thousands of fields; rosbags reads 0.2 MB/s


_HEADER_BYTES, _INDEX_AT = 4096, b"index_pos="  # of a bag of ROS 1, and its place in it


def prepare(path: Path) -> Path:
    """Return the path to open with rosbags, which needs a suffix, and a bag that was closed."""
    if path.is_dir():
        for each in path.iterdir():
            check_regular(each)
        return path
    with _BagFile(path) as file:
        start = file.read(_HEADER_BYTES)
        suffix = next((s for magic, s in MAGICS.items() if start.startswith(magic)), path.suffix)
        if suffix == ".mcap":
            file.seek(max(file.size - len(_MCAP), 0))
            _check_closed(path, file.read() == _MCAP, "mcap recover {0} -o whole.mcap")
        elif suffix == ".bag":
            _, _, after = start.partition(_INDEX_AT)
            index = int.from_bytes(after[:8], "little")
            _check_closed(path, 0 < index < file.size, "rosbag reindex {0}")
    opens = {"suffix": suffix, "open": lambda self, *_, **__: _BagFile(path)}
    opened: Path = type("BagPath", (type(path),), opens)(path)
    return opened


def _check_closed(path: Path, closed: bool, repair: str) -> None:
    if not closed:
        raise FileError(
            f"{path} was cut short or not closed by its recorder; repair it first: "
            f"{repair.format(path.name)}"
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


class _BagFile(io.BufferedReader):
    """A file that limits reads to its size, because Python allocates memory before it reads."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path, "r"))
        self.size = self.seek(0, io.SEEK_END)
        self.seek(0)

    def read(self, size: int | None = -1) -> bytes:
        """Read at most `size` bytes."""
        left = max(self.size - self.tell(), 0)
        return super().read(left if size is None or size < 0 else min(size, left))
