"""MATLAB files of versions 4, 5 and 7.3; the latter are HDF5 with reversed axes."""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from anisomap.budget import Budget, bytes_kept
from anisomap.files import open_regular
from anisomap.io.choice import Content
from anisomap.io.parsing.libraries import library_errors
from anisomap.io.recordings.datasets import Dataset, contents_of, stream_of
from anisomap.io.recordings.hdf5 import open_datasets
from anisomap.io.stream import ReadOptions, Stream

EXTRA = "mat"

_MAGIC, _MAGIC_73 = b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file"
_NUMBERS = "iuf"
_MAX_RATIO = 1032
_TYPES = {
    "double": "f8",
    "single": "f4",
    "logical": "u1",
    **{f"int{bits}": f"i{bits // 8}" for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": f"u{bits // 8}" for bits in (8, 16, 32, 64)},
}


def recognises(path: Path, head: bytes) -> bool:
    """Recognise versions 5 and 7.3 by their headers; version 4 has none, only its suffix."""
    return head.startswith((_MAGIC, _MAGIC_73))


def contents(path: Path, options: ReadOptions) -> tuple[Content, ...]:
    """List the variables of a file."""
    with _open(path) as datasets:
        return contents_of(datasets)


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open the variable `options.select`, or the only one of frames x sensors."""
    with _open(path) as datasets:
        yield stream_of(path, datasets, options, {"format": "MATLAB"})


@contextmanager
def _open(path: Path) -> Iterator[list[Dataset]]:
    with open_regular(path) as stream:
        is_73 = stream.read(len(_MAGIC_73)) == _MAGIC_73
    if is_73:
        with open_datasets(path, EXTRA, frames_last=True) as datasets:
            yield datasets
        return
    yield _variables(path)


def _variables(path: Path) -> list[Dataset]:
    with library_errors(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        listed = scipy.io.whosmat(path)
    found, budget = [], Budget(path)
    for name, shape, kind in listed:
        dtype = np.dtype(_TYPES.get(kind, "V"))
        size = math.prod(shape) * dtype.itemsize
        budget.check(size, f"variable {name}", reachable=_MAX_RATIO * budget.size)
        n_bytes = bytes_kept(dtype) if dtype.kind in _NUMBERS else dtype.itemsize
        found.append(Dataset(name, tuple(shape), kind, dtype.kind, _reader(path, name), n_bytes))
    return found


def _reader(path: Path, name: str) -> Any:
    @functools.cache
    def loaded() -> NDArray[Any]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = scipy.io.loadmat(path, variable_names=[name])
        return np.asarray(found[name])

    return lambda start, stop: loaded()[start:stop]
