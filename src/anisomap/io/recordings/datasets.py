"""Files of named arrays (HDF5, MATLAB): select the recording, its times, names and positions."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.budget import FREE_BYTES, Budget
from anisomap.errors import AnisomapWarning
from anisomap.io.choice import Content, choose
from anisomap.io.events.spike_trains import SpikeTrains, find_spike_trains, stream_spikes
from anisomap.io.parsing.columns import is_time, units_per_second
from anisomap.io.parsing.frames import increasing_times
from anisomap.io.parsing.libraries import library_errors
from anisomap.io.stream import BLOCK_BYTES, Block, ReadOptions, Stream, salvage
from anisomap.recording import Scalar

_NUMBERS, _TEXT, _VARIABLE_LENGTH = "biuf", "SU", "O"
_MICROMETRES = "epos"  # positions in the retinal wave repository, which defines their unit
_SPAN = "recordingtime"
_POSITIONS = {"positions", "position", "xyz", "coordinates", "taxel_positions", _MICROMETRES}
_RATES = {"rate_hz", "fs", "sample_rate", "sampling_rate"}


@dataclass(frozen=True)
class Dataset:
    """A named array in a file.

    Parameters
    ----------
    name : str
        Name with groups, such as ``"left/readings"``.
    shape : tuple of int
        The first axis of a recording is frames.
    dtype : str
        Data type, for display.
    kind : str
        As `numpy.dtype.kind`.
    read : callable
        ``read(start, stop)`` reads a range of frames.
    bytes_kept : int
        Bytes per value in memory.
    frames_at_once : int
        Number of frames per compressed chunk.
    """

    name: str
    shape: tuple[int, ...]
    dtype: str
    kind: str
    read: Callable[[int, int], NDArray[Any]]
    bytes_kept: int = 8
    frames_at_once: int = 1

    @property
    def key(self) -> str:
        """Name without groups, in lower case."""
        return self.name.rpartition("/")[2].lower()

    @property
    def group(self) -> str:
        """Groups that hold the dataset."""
        return self.name.rpartition("/")[0]

    def whole(self) -> NDArray[Any]:
        """Read the whole array."""
        return self.read(0, self.shape[0])


def contents_of(datasets: Sequence[Dataset]) -> tuple[Content, ...]:
    """List datasets, and whether they, or spike trains made of them, can be a recording."""
    trains = find_spike_trains(datasets)
    in_trains = {name for each in trains for name in each.members}
    # Vectors beside readings may be of any kind.
    readings = any(_usable(each) and each.name not in in_trains for each in datasets)
    return (
        *(
            Content(each.name, f"{each.n_units} spike trains", not readings or bool(each.index))
            for each in trains
        ),
        *(
            Content(
                each.name,
                f"{each.dtype}, {' x '.join(map(str, each.shape))}",
                _usable(each) and each.name not in in_trains,
            )
            for each in datasets
            if each.name not in {train.name for train in trains}
        ),
    )


def stream_of(
    path: Path,
    datasets: Sequence[Dataset],
    options: ReadOptions,
    metadata: Mapping[str, Scalar],
) -> Stream:
    """Create a stream of the selected or only possible recording.

    Parameters
    ----------
    path : pathlib.Path
    datasets : sequence of Dataset
        All datasets of the file. Those in the same group as the recording that are named as times,
        positions, names or rate are used if their shapes fit.
    options : ReadOptions
        `select` names the dataset.
    metadata : mapping of str to scalar

    Returns
    -------
    Stream
        With all dimensions but the first flattened.

    Raises
    ------
    ChoiceError
        If several datasets can be a recording and none is selected.
    FileError
        If no dataset can be a recording, or the selection does not match one.
    """
    name = choose(path, contents_of(datasets), options.select, "dataset").name
    for trains in find_spike_trains(datasets):
        if trains.name == name:
            stream = _stream_of_spikes(path, datasets, trains, options)
            return replace(stream, source=f"{path.name}:{name}")
    chosen = next(each for each in datasets if each.name == name)
    if not _usable(chosen):
        choose(path, contents_of([chosen]), "", "dataset")  # raises FileError
    near = [each for each in datasets if each.group == chosen.group and each is not chosen]
    n_frames, n_sensors = chosen.shape[0], math.prod(chosen.shape[1:])
    Budget(path).check_readings(n_frames, n_sensors, chosen.bytes_kept, f"dataset {chosen.name}")
    with library_errors(path):
        times = _times(path, near, n_frames)
        names = _names(path, near, n_sensors) or _grid_names(chosen.shape[1:])
        positions = _positions(near, n_sensors)
        rate_hz = _rate(near)
    return Stream(
        path,
        n_sensors,
        salvage(_blocks(path, chosen, times), path),
        names=names,
        rate_hz=rate_hz,
        positions=positions,
        source=f"{path.name}:{chosen.name}",
        metadata=metadata,
    )


def _stream_of_spikes(
    path: Path, datasets: Sequence[Dataset], trains: SpikeTrains, options: ReadOptions
) -> Stream:
    group = trains.times[0].group
    near = [each for each in datasets if each.group == group and each.name not in trains.members]
    micrometres = any(each.key == _MICROMETRES for each in near)
    with library_errors(path):
        names = _names(path, near, trains.n_units)
        positions = _positions(near, trains.n_units)
        stream = stream_spikes(
            path, trains, options.bin_s, names=names, positions=positions, span=_span(near)
        )
    return replace(stream, units="um" if micrometres and positions is not None else "")


def _usable(dataset: Dataset) -> bool:
    fits = dataset.kind in _NUMBERS and len(dataset.shape) >= 2 and dataset.shape[0] > 1
    return (
        fits
        and 0 not in dataset.shape
        and dataset.key not in _POSITIONS
        and not _is_time_vector(dataset)
    )


def _is_time_vector(dataset: Dataset) -> bool:
    """Return whether this is a vector of times, which MATLAB stores as a matrix."""
    return len(dataset.shape) == 2 and 1 in dataset.shape and is_time(dataset.key)


def _blocks(path: Path, dataset: Dataset, times: NDArray[np.float64] | None) -> Iterator[Block]:
    n_frames, frame = dataset.shape[0], dataset.shape[1:]
    step = max(1, BLOCK_BYTES // (8 * math.prod(frame)))
    step = -(-step // dataset.frames_at_once) * dataset.frames_at_once
    for start in range(0, n_frames, step):
        stop = min(start + step, n_frames)
        with library_errors(path):
            rows = dataset.read(start, stop).reshape(stop - start, -1)
        yield Block(rows, stop / n_frames, None if times is None else times[start:stop])


def _times(path: Path, near: Sequence[Dataset], n_frames: int) -> NDArray[np.float64] | None:
    for each in near:
        if math.prod(each.shape) == n_frames and each.kind in _NUMBERS and is_time(each.key):
            values = each.whole().astype(np.float64).ravel()
            return increasing_times(values / units_per_second(each.key, values), path)
    return None


def _names(path: Path, near: Sequence[Dataset], n_sensors: int) -> tuple[str, ...]:
    for each in near:
        if each.key != "names" or math.prod(each.shape) != n_sensors:
            continue
        if each.kind in _TEXT:
            Budget(path).check(n_sensors * each.bytes_kept, each.name, reachable=FREE_BYTES)
            values = each.whole().ravel().tolist()
            return tuple(v.decode() if isinstance(v, bytes) else v for v in values)
        if each.kind == _VARIABLE_LENGTH:
            # The HDF5 library can hang on variable-length strings in a damaged file.
            warnings.warn(
                f"{path}: {each.name} holds variable-length strings, which are not supported, so "
                "the sensors get default names; store fixed-length strings (numpy type S)",
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
            # R and MATLAB store matrices by columns.
            if values.shape[1] == n_sensors and values.shape[0] in (2, 3):
                return np.ascontiguousarray(values.T)
    return None


def _span(near: Sequence[Dataset]) -> tuple[float, float] | None:
    """Return the start and end of a recording of spikes, if the file gives them."""
    for each in near:
        if each.key == _SPAN and math.prod(each.shape) == 2 and each.kind in _NUMBERS:
            start, end = each.whole().astype(np.float64).ravel().tolist()
            return (start, end) if math.isfinite(start) and start < end < math.inf else None
    return None


def _rate(near: Sequence[Dataset]) -> float | None:
    for each in near:
        if each.key in _RATES and math.prod(each.shape) == 1 and each.kind in _NUMBERS:
            value = float(each.whole().ravel()[0])
            return value if math.isfinite(value) and value > 0 else None
    return None
