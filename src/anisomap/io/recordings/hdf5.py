"""HDF5 files: any table of frames in them, chosen by its name."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.io.choice import Content
from anisomap.io.parsing.foreign import foreign, imported
from anisomap.io.parsing.source import check_unpacked
from anisomap.io.recordings.datasets import Dataset, contents_of, stream_of
from anisomap.io.stream import ReadOptions, Stream

EXTRA = "hdf5"

_MAGIC = b"\x89HDF\r\n\x1a\n"
_LARGEST_RATIO, _HEADERS = 1032, 1 << 12
_MOST_DATASETS = 1000


def recognises(path: Path, head: bytes) -> bool:
    """Tell HDF5 by its mark, which may stand behind 512, 1024, ... bytes of somebody else."""
    places = [0, *(512 << i for i in range(7))]
    return any(head[place : place + len(_MAGIC)] == _MAGIC for place in places)


def contents(path: Path, options: ReadOptions) -> tuple[Content, ...]:
    """List the datasets of a file."""
    with opened_datasets(path, EXTRA) as datasets:
        return contents_of(datasets)


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a recording in an HDF5 file.

    Parameters
    ----------
    path : pathlib.Path
    options : ReadOptions
        `select` names the dataset, with its groups or without.

    Yields
    ------
    Stream
        Times, positions, names and a rate come from datasets of the same group.

    Raises
    ------
    FileError
        If the file is damaged, or it is not clear which dataset is the recording.
    MissingExtraError
        If h5py is not installed.
    """
    with opened_datasets(path, EXTRA) as datasets:
        yield stream_of(path, datasets, options, {"format": "HDF5"})


@contextmanager
def opened_datasets(
    path: Path, extra: str, *, frames_last: bool = False
) -> Iterator[list[Dataset]]:
    """Open an HDF5 file, and list its datasets.

    Links to other files are not followed.

    Parameters
    ----------
    path : pathlib.Path
    extra : str
        The extra to name if h5py is not installed.
    frames_last : bool
        Whether arrays lie the other way round, as MATLAB writes them.
    """
    h5py = imported("h5py", "reading HDF5", extra)
    with foreign(path):
        file = h5py.File(path, "r")
    try:
        with foreign(path):
            found: list[Any] = []
            file.visititems(lambda _, item: _collect(found, item, h5py.Dataset))
            datasets = [_dataset(path, item, frames_last) for item in found]
        yield datasets
    finally:
        file.close()


def _collect(found: list[Any], item: Any, kind: type) -> bool | None:
    """Gather a dataset; tells to stop once there are too many to list."""
    name = item.name.lstrip("/")
    if isinstance(item, kind) and not name.startswith("#"):
        found.append(item)
    return True if len(found) > _MOST_DATASETS else None


def _dataset(path: Path, item: Any, frames_last: bool) -> Dataset:
    name = item.name.lstrip("/")
    shape = tuple(item.shape or ())
    chunks = tuple(item.chunks or ())
    if frames_last:
        shape, chunks = shape[::-1], chunks[::-1]

    def read(start: int, stop: int) -> NDArray[Any]:
        _check_size(path, item, name)
        if not shape:
            return np.asarray(item[()]).reshape(1)
        if not frames_last:
            return np.asarray(item[start:stop])
        return np.asarray(item[..., start:stop]).T

    return Dataset(
        name, shape or (1,), str(item.dtype), item.dtype.kind, read, chunks[0] if chunks else 1
    )


def _check_size(path: Path, item: Any, name: str) -> None:
    """Refuse what unpacks to far more than it takes, and what lies in another file."""
    if item.external or item.is_virtual:
        raise OSError(f"the dataset {name} lies in other files")
    packed = min(item.id.get_storage_size(), path.stat().st_size) + _HEADERS
    check_unpacked(path, f"the dataset {name}", packed, item.nbytes, largest_ratio=_LARGEST_RATIO)
