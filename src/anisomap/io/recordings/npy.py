"""NumPy array files (``.npy``) with an array of frames x sensors; nothing is unpickled."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.parsing.libraries import library_errors
from anisomap.io.stream import Block, ReadOptions, Stream

_MAGIC = b"\x93NUMPY"
_NUMBERS = "biuf"
_BLOCK_BYTES = 1 << 22


def recognises(path: Path, head: bytes) -> bool:
    """Recognise a NumPy array file by its magic number."""
    return head.startswith(_MAGIC)


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open an array of shape (T, N), memory-mapped."""
    with library_errors(path):
        array = np.lib.format.open_memmap(path, mode="r")
    if array.dtype.kind not in _NUMBERS:
        raise FileError(f"{path}: the array has dtype {array.dtype}; it must hold numbers")
    if array.ndim != 2 or 0 in array.shape:
        raise FileError(f"{path}: the array must be frames x sensors (T, N), got {array.shape}")
    yield Stream(path, array.shape[1], _blocks(array), source=path.name)


def _blocks(array: NDArray[Any]) -> Iterator[Block]:
    n_frames = len(array)
    step = max(1, _BLOCK_BYTES // (array.shape[1] * array.itemsize))
    for start in range(0, n_frames, step):
        rows = np.array(array[start : start + step])
        yield Block(rows, min(start + step, n_frames) / n_frames)
