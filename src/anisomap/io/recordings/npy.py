"""NumPy array files (``.npy``) with an array of frames x sensors; nothing is unpickled."""

from __future__ import annotations

import math
import os
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import DamagedError, FileError, InputError, error_reason
from anisomap.files import open_regular
from anisomap.io.stream import BLOCK_BYTES, Block, ReadOptions, Stream, salvage

MAGIC = b"\x93NUMPY"
_NUMBERS = "biuf"


class Header(NamedTuple):
    """Shape, order and type of a stored array."""

    shape: tuple[int, ...]
    fortran_order: bool
    dtype: np.dtype[Any]


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open an array of shape (T, N).

    It is read, not memory-mapped, because the system kills a process that reads a mapped file
    after it was cut.
    """
    with open_regular(path) as stream:
        shape, _, dtype = header = read_header(stream, "the array")
        if dtype.kind not in _NUMBERS:
            raise FileError(f"{path}: the array must hold numbers, got dtype {dtype}")
        if len(shape) != 2 or min(shape) < 1:
            raise FileError(f"{path}: the array must be frames x sensors (T, N), got shape {shape}")
        needed = math.prod(shape) * dtype.itemsize
        held = os.fstat(stream.fileno()).st_size - stream.tell()
        if needed > held:
            raise DamagedError(
                f"{path} is cut short: its array needs {needed} bytes, but {held} follow the header"
            )
        blocks = salvage(_blocks(path, stream, header), path)
        yield Stream(path, shape[1], blocks, source=path.name)


def read_header(stream: IO[bytes], what: str) -> Header:
    """Read the header of an array, and leave the stream at its first value."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read = np.lib.format.read_array_header_1_0
            if np.lib.format.read_magic(stream) != (1, 0):
                read = np.lib.format.read_array_header_2_0
            shape, fortran_order, dtype = read(stream)
    except (OSError, EOFError, zlib.error, zipfile.BadZipFile):  # of what holds the array
        raise
    except Exception as error:  # numpy evaluates a literal; any error may result
        raise InputError(f"the header of {what} is damaged: {error_reason(error)}") from error
    # numpy accepts True for 1.
    return Header(tuple(int(length) for length in shape), fortran_order, dtype)


def _blocks(path: Path, stream: BufferedReader, header: Header) -> Iterator[Block]:
    (n_frames, n_sensors), fortran_order, dtype = header
    first = stream.tell()
    # In Fortran order, a block takes one read per sensor, so blocks are larger.
    n_bytes = BLOCK_BYTES << 2 if fortran_order else BLOCK_BYTES
    step = max(1, n_bytes // (n_sensors * dtype.itemsize))
    for start in range(0, n_frames, step):
        count = min(step, n_frames - start)
        if fortran_order:
            columns = np.empty((n_sensors, count), dtype)
            for sensor, column in enumerate(columns):
                stream.seek(first + (sensor * n_frames + start) * dtype.itemsize)
                _fill(path, stream, column)
            rows = columns.T
        else:
            rows = np.empty((count, n_sensors), dtype)
            _fill(path, stream, rows)
        yield Block(rows, (start + count) / n_frames)


def _fill(path: Path, stream: BufferedReader, values: NDArray[Any]) -> None:
    if stream.readinto(values.data.cast("B")) < values.nbytes:
        raise DamagedError(f"{path} was cut while it was read")
