"""True positions from a file of their own, for the sensors of a recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.parsing.naming import match_names
from anisomap.io.stream import Block, Stream
from anisomap.recording import Recording, default_names
from anisomap.sensor_map import SensorMap


def with_positions(stream: Stream, truth: SensorMap, file: Path) -> Stream:
    """Give the sensors of a stream their true positions.

    Parameters
    ----------
    stream : Stream
        If it lists events, the sensors that have a position and no event are added: they read 0.
    truth : SensorMap
        Positions by sensor name; see `anisomap.io.parsing.naming.match_names`.
    file : pathlib.Path
        The file of the positions, for messages.

    Returns
    -------
    Stream
        Positions are NaN for sensors that `truth` lacks.

    Raises
    ------
    FileError
        If no sensor has a position.
    """
    names = stream.names or default_names(stream.n_sensors)
    rows = _rows(names, truth, stream.path, file)
    positions = _positions(truth, rows)
    if not stream.silent_are_zero:
        return replace(stream, positions=positions, units=truth.units)
    known = set(rows)
    silent = [i for i in range(truth.n_sensors) if i not in known and truth.placed[i]]
    taken = set(names)
    silent = [i for i in silent if truth.names[i] not in taken]
    return replace(
        stream,
        n_sensors=len(names) + len(silent),
        blocks=_with_silent(stream.blocks, len(silent)),
        names=(*names, *(truth.names[i] for i in silent)),
        positions=np.vstack([positions, truth.positions[silent]]),
        units=truth.units,
    )


def with_recorded_positions(recording: Recording, truth: SensorMap, file: Path) -> Recording:
    """Give the sensors of a recording their true positions; see `with_positions`."""
    rows = _rows(recording.names, truth, Path(recording.source), file)
    return replace(recording, positions=_positions(truth, rows), units=truth.units)


def _rows(names: Sequence[str], truth: SensorMap, path: Path, file: Path) -> list[int | None]:
    rows = match_names(names, truth.names)
    if all(row is None or not truth.placed[row] for row in rows):
        raise FileError(
            f"{file} has no position for a sensor of {path}: its names are {truth.names[0]} ... "
            f"{truth.names[-1]}, those of the recording {names[0]} ... {names[-1]}"
        )
    return rows


def _positions(truth: SensorMap, rows: Sequence[int | None]) -> NDArray[np.float64]:
    unknown = np.full(truth.dimensions, np.nan)
    return np.array([unknown if row is None else truth.positions[row] for row in rows])


def _with_silent(blocks: Iterator[Block], n_silent: int) -> Iterator[Block]:
    for block in blocks:
        zeros = np.zeros((len(block.readings), n_silent), block.readings.dtype)
        yield replace(block, readings=np.hstack([block.readings, zeros]))
