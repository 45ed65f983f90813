"""Files of named arrays (HDF5, MATLAB): which array is the recording, and what belongs to it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning
from anisomap.io.choice import Content, choose
from anisomap.io.parsing.columns import is_time, units_per_second
from anisomap.io.parsing.foreign import foreign
from anisomap.io.parsing.frames import increasing
from anisomap.io.stream import Block, ReadOptions, Stream, salvaged
from anisomap.recording import Scalar

_NUMBERS, _TEXT, _OF_ANY_LENGTH = "biuf", "SU", "O"
_POSITIONS = {"positions", "position", "xyz", "coordinates", "taxel_positions"}
_RATES = {"rate_hz", "fs", "sample_rate", "sampling_rate"}
_BLOCK_BYTES = 1 << 22


@dataclass(frozen=True)
class Dataset:
    """A named array in a file.

    Parameters
    ----------
    name : str
        Its name, with the groups that it lies in: ``"left/readings"``.
    shape : tuple of int
        Frames first, if it is a recording.
    dtype : str
        Its type, for people.
    kind : str
        The letter of numpy's `dtype.kind`.
    read : callable
        Given the first frame and the one behind the last, reads them.
    frames_at_once : int
        How many frames cost as much to read as one: those that are packed together.
    """

    name: str
    shape: tuple[int, ...]
    dtype: str
    kind: str
    read: Callable[[int, int], NDArray[Any]]
    frames_at_once: int = 1

    @property
    def key(self) -> str:
        """Its name without groups, in lower case."""
        return self.name.rpartition("/")[2].lower()

    @property
    def group(self) -> str:
        """The groups that it lies in."""
        return self.name.rpartition("/")[0]

    def whole(self) -> NDArray[Any]:
        """Read all of it."""
        return self.read(0, self.shape[0])


def contents_of(datasets: Sequence[Dataset]) -> tuple[Content, ...]:
    """List datasets, and tell which of them could be a recording."""
    return tuple(
        Content(each.name, f"{each.dtype}, {' x '.join(map(str, each.shape))}", _usable(each))
        for each in datasets
    )


def stream_of(
    path: Path,
    datasets: Sequence[Dataset],
    options: ReadOptions,
    metadata: Mapping[str, Scalar],
) -> Stream:
    """Make a stream of the dataset that is the recording.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    datasets : sequence of Dataset
        All that it holds. Beside the recording, those that are called like times, `positions`,
        `names` or a rate are used if their size is right.
    options : ReadOptions
        `select` names the dataset.
    metadata : mapping of str to scalar

    Returns
    -------
    Stream
        An array of more than two dimensions is taken as frames of a grid: all but the first are
        laid out in a row.
    """
    name = choose(path, contents_of(datasets), options.select, "dataset").name
    chosen = next(each for each in datasets if each.name == name)
    if not _usable(chosen):
        # Whoever names it gets to hear what is wrong with it.
        choose(path, contents_of([chosen]), "", "dataset")
    near = [each for each in datasets if each.group == chosen.group and each is not chosen]
    n_frames, n_sensors = chosen.shape[0], math.prod(chosen.shape[1:])
    with foreign(path):
        times = _times(path, near, n_frames)
        names = _names(path, near, n_sensors) or _grid_names(chosen.shape[1:])
        positions = _positions(near, n_sensors)
        rate_hz = _rate(near)
    return Stream(
        path,
        n_sensors,
        salvaged(_blocks(path, chosen, times), path),
        names=names,
        rate_hz=rate_hz,
        positions=positions,
        source=f"{path.name}:{chosen.name}",
        metadata=metadata,
    )


def _usable(dataset: Dataset) -> bool:
    fits = dataset.kind in _NUMBERS and len(dataset.shape) >= 2 and dataset.shape[0] > 1
    return fits and 0 not in dataset.shape and dataset.key not in _POSITIONS and not _flat(dataset)


def _flat(dataset: Dataset) -> bool:
    """Tell whether it is a list that MATLAB keeps as a table of one column: times, say."""
    return len(dataset.shape) == 2 and 1 in dataset.shape and is_time(dataset.key)


def _blocks(path: Path, dataset: Dataset, times: NDArray[np.float64] | None) -> Iterator[Block]:
    n_frames, frame = dataset.shape[0], dataset.shape[1:]
    step = max(1, _BLOCK_BYTES // (8 * math.prod(frame)))
    step = -(-step // dataset.frames_at_once) * dataset.frames_at_once
    for start in range(0, n_frames, step):
        stop = min(start + step, n_frames)
        with foreign(path):
            rows = dataset.read(start, stop).reshape(stop - start, -1)
        yield Block(rows, stop / n_frames, None if times is None else times[start:stop])


def _times(path: Path, near: Sequence[Dataset], n_frames: int) -> NDArray[np.float64] | None:
    for each in near:
        if math.prod(each.shape) == n_frames and each.kind in _NUMBERS and is_time(each.key):
            values = each.whole().astype(np.float64).ravel()
            return increasing(values / units_per_second(each.key, values), path)
    return None


def _names(path: Path, near: Sequence[Dataset], n_sensors: int) -> tuple[str, ...]:
    for each in near:
        if each.key != "names" or math.prod(each.shape) != n_sensors:
            continue
        if each.kind in _TEXT:
            values = each.whole().ravel().tolist()
            return tuple(v.decode() if isinstance(v, bytes) else v for v in values)
        if each.kind == _OF_ANY_LENGTH:
            # The HDF5 library can loop forever over such texts in a damaged file.
            warnings.warn(
                f"{path}: {each.name} holds texts of variable length, which are not read, so the "
                "sensors have no names; write texts of fixed length (numpy's type S)",
                AnisomapWarning,
                stacklevel=2,
            )
    return ()


def _grid_names(frame: tuple[int, ...]) -> tuple[str, ...]:
    if len(frame) < 2:
        return ()
    return tuple(".".join(map(str, index)) for index in np.ndindex(*frame))


def _positions(near: Sequence[Dataset], n_sensors: int) -> NDArray[np.float64] | None:
    for each in near:
        if each.key in _POSITIONS and each.kind in _NUMBERS and len(each.shape) == 2:
            values = each.whole().astype(np.float64)
            if values.shape[0] == n_sensors and values.shape[1] in (2, 3):
                return values
    return None


def _rate(near: Sequence[Dataset]) -> float | None:
    for each in near:
        if each.key in _RATES and math.prod(each.shape) == 1 and each.kind in _NUMBERS:
            value = float(each.whole().ravel()[0])
            return value if math.isfinite(value) and value > 0 else None
    return None
