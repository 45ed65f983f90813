"""HDF5 files: any numeric dataset of frames x sensors."""

from __future__ import annotations

import functools
import math
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.budget import DEFLATE_RATIO, Budget, bytes_kept
from anisomap.errors import FileError
from anisomap.extras import import_extra
from anisomap.files import check_regular
from anisomap.io.choice import Content
from anisomap.io.parsing.libraries import library_errors
from anisomap.io.recordings.datasets import Dataset, contents_of, stream_of
from anisomap.io.stream import ReadOptions, Stream

EXTRA = "hdf5"

_MAGIC = b"\x89HDF\r\n\x1a\n"
_NUMBERS = "biuf"
_DEFLATE, _SZIP, _N_BIT, _SCALE_OFFSET, _LZF = 1, 4, 5, 6, 32000
_DECLARING = {_N_BIT, _SCALE_OFFSET}  # filters that unpack as many values as they declare
_COMPRESSING = {_DEFLATE, _LZF, _SZIP, *_DECLARING}
_CHECKSUM, _CHECKSUM_BYTES = 3, 4  # Fletcher's, after each chunk
_STEP = 1 << 20
_HEADERS = 1 << 12
_MAX_DATASETS = 1000


def recognises(path: Path, head: bytes) -> bool:
    """Recognise HDF5 by its signature, which may follow a user block of 512, 1024, ... bytes."""
    offsets = [0, *(512 << i for i in range(7))]
    return any(head[offset : offset + len(_MAGIC)] == _MAGIC for offset in offsets)


def contents(path: Path, options: ReadOptions) -> tuple[Content, ...]:
    """List the datasets of a file."""
    with open_datasets(path, EXTRA) as datasets:
        return contents_of(datasets)


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open the dataset `options.select`, given with or without groups, or the only possible one."""
    with open_datasets(path, EXTRA) as datasets:
        yield stream_of(path, datasets, options, {"format": "HDF5"})


@contextmanager
def open_datasets(path: Path, extra: str, *, frames_last: bool = False) -> Iterator[list[Dataset]]:
    """Open an HDF5 file and list its datasets, without following links to other files.

    Parameters
    ----------
    path : pathlib.Path
    extra : str
        The extra to install if h5py is missing.
    frames_last : bool
        Whether the axes are reversed, as in MATLAB files.

    Yields
    ------
    list of Dataset

    Raises
    ------
    FileError
        If the file is damaged.
    MissingExtraError
        If h5py is not installed.
    """
    h5py = import_extra("h5py", "reading HDF5", extra)
    check_regular(path)
    with library_errors(path):
        file = h5py.File(path, "r")
    try:
        with library_errors(path):
            found: list[Any] = []
            file.visititems(lambda _, item: _collect(found, item, h5py.Dataset))
            datasets = [_dataset(path, item, frames_last) for item in found]
        yield datasets
    finally:
        file.close()


def _collect(found: list[Any], item: Any, kind: type) -> bool | None:
    """Append a dataset to `found`; return True to stop the traversal at `_MAX_DATASETS`."""
    name = item.name.lstrip("/")
    if isinstance(item, kind) and not name.startswith("#"):
        found.append(item)
    return True if len(found) > _MAX_DATASETS else None


def _dataset(path: Path, item: Any, frames_last: bool) -> Dataset:
    name = item.name.lstrip("/")
    shape = tuple(item.shape or ())
    chunks = tuple(item.chunks or ())
    if frames_last:
        shape, chunks = shape[::-1], chunks[::-1]

    @functools.cache
    def check() -> None:
        _check_size(path, item, name)
        if item.chunks:
            _check_chunks(path, item, name)

    def read(start: int, stop: int) -> NDArray[Any]:
        check()
        if not shape:
            return np.asarray(item[()]).reshape(1)
        if not frames_last:
            return np.asarray(item[start:stop])
        return np.asarray(item[..., start:stop]).T

    kind = item.dtype.kind
    n_bytes = bytes_kept(item.dtype) if kind in _NUMBERS else item.dtype.itemsize
    return Dataset(
        name, shape or (1,), str(item.dtype), kind, read, n_bytes, chunks[0] if chunks else 1
    )


def _check_size(path: Path, item: Any, name: str) -> None:
    """Reject decompression bombs and datasets stored in other files."""
    if item.external or item.is_virtual:
        raise OSError(f"dataset {name} is stored in other files, which are not opened")
    budget = Budget(path)
    packed = min(item.id.get_storage_size(), budget.size) + _HEADERS
    budget.check(item.nbytes, f"dataset {name}", reachable=DEFLATE_RATIO * packed)


def _check_chunks(path: Path, item: Any, name: str) -> None:
    """Refuse chunks that would expand to more than their size, since HDF5 has no limit.

    Raises
    ------
    FileError
        If a chunk expands to more than its size, or is compressed twice.
    """
    settings = item.id.get_create_plist()
    filters = [settings.get_filter(i) for i in range(settings.get_nfilters())]
    codes = [code for code, *_ in filters]
    first = next((i for i, code in enumerate(codes) if code in _COMPRESSING), len(codes))
    if set(codes[first + 1 :]) - {_CHECKSUM}:
        raise FileError(
            f"{path}: dataset {name} is compressed twice, or changed after it was compressed, "
            "which is not supported"
        )
    n_values = math.prod(item.chunks)
    limit = item.dtype.itemsize * n_values
    too_large = FileError(
        f"{path} is damaged: a chunk of dataset {name} expands to more than {limit} bytes"
    )
    if any(code in _DECLARING and values[2:3] != (n_values,) for code, _, values, _ in filters):
        raise too_large
    if not _SIZES.keys() & set(codes):
        return
    ratio, size_of = _SIZES[codes[first]]
    n_checked = _CHECKSUM_BYTES * codes[first:].count(_CHECKSUM)
    chunks: list[Any] = []
    item.id.chunk_iter(chunks.append)
    free = Budget(path).free
    for chunk in chunks:
        # HDF5 unpacks LZF again and again until its guess of the size is enough, which takes
        # quadratic time for a chunk that is larger than what it should unpack to.
        suspect = ratio * chunk.size >= free or chunk.size - n_checked > limit
        if suspect and not chunk.filter_mask:
            _, packed = item.id.read_direct_chunk(chunk.chunk_offset)
            if size_of(packed[: len(packed) - n_checked], limit) > limit:
                raise too_large


def _deflated_size(packed: bytes, limit: int) -> int:
    unpacker, n_bytes = zlib.decompressobj(), 0
    with suppress(zlib.error):  # which HDF5 reports
        while packed and n_bytes <= limit and not unpacker.eof:
            n_bytes += len(unpacker.decompress(packed, _STEP))
            packed = unpacker.unconsumed_tail
    return n_bytes


def _lzf_size(packed: bytes, limit: int) -> int:
    from anisomap.numerics.compiled.lzf import unpacked_size  # noqa: PLC0415

    return unpacked_size(np.frombuffer(packed, np.uint8), limit)


def _szip_size(packed: bytes, limit: int) -> int:
    """Return the size that a chunk declares, which HDF5 allocates and fills at most."""
    del limit
    return int.from_bytes(packed[:4], "little")


# How far each compression can expand, and the function that finds how far a chunk does. A
# reference of LZF has 3 bytes and unpacks to 264; SZIP has no limit.
_SIZES: Mapping[int, tuple[float, Callable[[bytes, int], int]]] = {
    _DEFLATE: (DEFLATE_RATIO, _deflated_size),
    _LZF: (88, _lzf_size),
    _SZIP: (math.inf, _szip_size),
}
