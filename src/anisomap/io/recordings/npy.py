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
        shape, dtype = _header(path)
    if dtype.kind not in _NUMBERS:
        raise FileError(f"{path}: the array must hold numbers, got dtype {dtype}")
    if len(shape) != 2 or 0 in shape:
        raise FileError(f"{path}: the array must be frames x sensors (T, N), got shape {shape}")
    with library_errors(path):
        array = np.lib.format.open_memmap(path, mode="r")
    yield Stream(path, array.shape[1], _blocks(array), source=path.name)


def _header(path: Path) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Read shape and dtype, which memory-mapping does not report for an array of objects."""
    with path.open("rb") as stream:
        if np.lib.format.read_magic(stream) == (1, 0):
            shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
        else:
            shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
    return shape, dtype


def _blocks(array: NDArray[Any]) -> Iterator[Block]:
    n_frames = len(array)
    step = max(1, _BLOCK_BYTES // (array.shape[1] * array.itemsize))
    for start in range(0, n_frames, step):
        rows = np.array(array[start : start + step])
        yield Block(rows, min(start + step, n_frames) / n_frames)
