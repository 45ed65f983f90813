"""Limit of memory for unpacked contents of a file, for declared and for actual sizes."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np

from anisomap.errors import FileError

MAX_RATIO = 1000
"""Maximum ratio of unpacked to packed bytes; binary readings of an iCub reached 610."""

FREE_BYTES = 1 << 27
"""Content up to this size is accepted at any ratio: readings without contact compress well."""

SENSOR_BYTES = 160
"""Memory per sensor in addition to readings: name (64), references in two tuples and a set (60),
and position (24)."""

_MOST_SHOWN = 10**18
"""Maximum number of bytes in messages: a declared size may have thousands of digits."""

_READING_BYTES = np.dtype(np.float32).itemsize


class Budget:
    """Maximum bytes of unpacked contents of a file, or of all files in a folder.

    path: The file or folder, whose size on disk determines the limit.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.size = size_on_disk(path)
        self.limit = max(FREE_BYTES, MAX_RATIO * self.size)
        self._spent = 0

    def check(self, n_bytes: float, what: str) -> None:
        """Reject content that is too large, before it is unpacked."""
        if n_bytes > self.limit:
            shown = min(n_bytes, _MOST_SHOWN)
            raise FileError(
                f"{self._path}: {what} expands to {shown:.0f} bytes, too much for {self.size} "
                "bytes on disk; it is damaged or a decompression bomb (if not, store it "
                "uncompressed)"
            )

    def spend(self, n_bytes: int, what: str) -> None:
        """Count unpacked bytes that are kept."""
        self._spent += n_bytes
        self.check(self._spent, what)


def bytes_kept(dtype: np.dtype[np.generic]) -> int:
    """Return the bytes per reading in memory: of float32 if it is exact, else of float64."""
    return _READING_BYTES if np.can_cast(dtype, np.float32) else np.dtype(np.float64).itemsize


def size_on_disk(path: Path) -> int:
    """Return the size of a file, or of all files in a folder, in bytes."""
    if not path.is_dir():
        return path.stat().st_size if path.is_file() else 0
    total = 0
    for file in path.rglob("*"):
        with suppress(OSError):  # files may disappear meanwhile
            total += file.stat().st_size if file.is_file() else 0
    return total
