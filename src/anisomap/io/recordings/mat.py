"""MATLAB files of versions 4, 5 and 7.3; the latter are HDF5 with reversed axes."""

from __future__ import annotations

import functools
import math
import struct
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from anisomap.budget import DEFLATE_RATIO, Budget, bytes_kept
from anisomap.errors import FileError
from anisomap.files import open_regular
from anisomap.io.choice import Content, choose
from anisomap.io.events.matlab_lists import Lists, find_lists, stream_lists_of
from anisomap.io.parsing.libraries import library_errors
from anisomap.io.parsing.mat_elements import check_sizes, check_variable
from anisomap.io.parsing.source import quote
from anisomap.io.recordings.datasets import Dataset, contents_of, stream_of
from anisomap.io.recordings.hdf5 import open_datasets
from anisomap.io.stream import ReadOptions, Stream

EXTRA = "mat"

_MAGIC, _MAGIC_73 = b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file"
_NUMBERS = "iuf"
_HEADER_BYTES, _COMPRESSED = 128, 15  # of version 5
_CHUNK = 1 << 20
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
        lists = _lists(path)
        variables = {each.name.partition("/")[0] for each in lists}
        tables = [each for each in contents_of(datasets) if each.name not in variables]
        # Cell arrays beside readings may be of any kind.
        alone = not any(each.usable for each in tables)
        return (*(Content(each.name, each.summary, alone) for each in lists), *tables)


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open the variable `options.select`, or the only one of frames x sensors.

    Contacts and spikes may be in cell arrays, and in fields of structures (``torso/taxels``).
    """
    lists = _lists(path)
    if lists:
        name = choose(path, contents(path, options), options.select, "variable").name
        for each in lists:
            if each.name == name:
                stream = stream_lists_of(path, each, options.bin_s)
                yield replace(stream, source=f"{path.name}:{name}")
                return
        options = replace(options, select=name)
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


def _lists(path: Path) -> list[Lists]:
    """Find the contacts and spike trains in cell arrays and structures; none in version 7.3."""
    with open_regular(path) as stream:
        if not stream.read(len(_MAGIC)).startswith(_MAGIC):
            return []
    check_sizes(path, Budget(path))
    with library_errors(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        names = [name for name, _, kind in scipy.io.whosmat(path) if kind in ("cell", "struct")]
    if not names:
        return []
    _check_unpacked(path)
    with library_errors(path):
        return [
            found for name in names for found in find_lists(name, _reader(path, name)(None, None))
        ]


def _check_unpacked(path: Path) -> None:
    """Reject variables that expand too far: their headers do not give the size of a cell array."""
    budget = Budget(path)
    with open_regular(path) as stream, library_errors(path):
        order = "<" if stream.read(_HEADER_BYTES)[-2:] == b"IM" else ">"
        while len(tag := stream.read(8)) == 8:
            kind, n_bytes = struct.unpack(f"{order}II", tag)
            if kind != _COMPRESSED:
                stream.seek(n_bytes, 1)
                continue
            unpacker, left = zlib.decompressobj(), n_bytes
            while left and (packed := stream.read(min(left, _CHUNK))):
                left -= len(packed)
                while packed:
                    budget.spend(len(unpacker.decompress(packed, _CHUNK)), "its content")
                    packed = unpacker.unconsumed_tail


def _variables(path: Path) -> list[Dataset]:
    found, budget = [], Budget(path)
    check_sizes(path, budget)
    with library_errors(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        listed = scipy.io.whosmat(path)
    for name, shape, kind in listed:
        dtype = np.dtype(_TYPES.get(kind, "V"))
        size = math.prod(shape) * dtype.itemsize
        budget.check(size, f"variable {name}", reachable=DEFLATE_RATIO * budget.size)
        n_bytes = bytes_kept(dtype) if dtype.kind in _NUMBERS else dtype.itemsize
        found.append(Dataset(name, tuple(shape), kind, dtype.kind, _reader(path, name), n_bytes))
    return found


def _reader(path: Path, name: str) -> Any:
    @functools.cache
    def loaded() -> NDArray[Any]:
        check_variable(path, name)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = np.asarray(scipy.io.loadmat(path, variable_names=[name])[name])
        if np.iscomplexobj(found):  # which the listing does not tell
            raise FileError(f"{path}: variable {quote(name)} is complex; readings are real")
        return found

    return lambda start, stop: loaded()[start:stop]
