"""Several recordings of one skin: sensors are matched by name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.recording import Recording, default_names

_MAX_RATE_RATIO = 1.02  # of runs that are taken to have one frame rate; chosen by hand
_MAX_RUNS = 62  # membership of a sensor in runs is one bit of an int64


def as_runs(recording: Recording | ArrayLike | Sequence[Recording]) -> tuple[Recording, ...]:
    """Convert the `recording` argument of public functions to recordings of one skin.

    Parameters
    ----------
    recording : Recording, array_like of shape (T, N), or sequence of Recording
        Columns of a DataFrame give the names of the sensors.

    Returns
    -------
    tuple of Recording
        One recording; several only if some lack sensors that others have.

    Raises
    ------
    InputError
        If `recording` has another type or shape, or sensors cannot be matched between recordings.
    """
    if isinstance(recording, Recording):
        return (recording,)
    if isinstance(recording, Sequence) and any(isinstance(run, Recording) for run in recording):
        runs = tuple(recording)
        if not all(isinstance(run, Recording) for run in runs):
            raise InputError("a sequence of runs must consist of Recording objects only")
        return runs if sensors_differ(runs) else (join_runs(runs),)
    if isinstance(recording, str | Path):
        raise InputError(f"read the file first: anisomap.read({str(recording)!r})")
    try:
        readings = np.asarray(recording)
    except ValueError:
        readings = np.empty(())
    if readings.ndim != 2:
        raise InputError(
            "a recording must be a Recording, an array of shape (T, N) (frames x sensors), or a "
            f"sequence of Recording; got {type(recording).__name__}"
            + (f" of shape {readings.shape}" if isinstance(recording, np.ndarray) else "")
        )
    columns = getattr(recording, "columns", ())  # of a DataFrame
    return (Recording(readings, names=tuple(map(str, columns))),)


def join_runs(runs: Sequence[Recording]) -> Recording:
    """Concatenate recordings of one skin in time.

    Parameters
    ----------
    runs : sequence of Recording
        At least one. Order and number of sensors may differ between runs.

    Returns
    -------
    Recording
        All sensors, in order of appearance. Readings of sensors that a run lacks are NaN. It has
        no times, and a rate only if the runs agree on it.

    Raises
    ------
    InputError
        If sensors cannot be matched: runs share no name, or unnamed runs differ in size.
    """
    if not runs:
        raise InputError("no recording was given")
    if len(runs) == 1:
        return runs[0]
    _check_matching(runs)
    names = tuple(dict.fromkeys(name for run in runs for name in run.names))
    column = {name: i for i, name in enumerate(names)}
    dtype = np.result_type(*(run.readings.dtype for run in runs))
    readings = np.full((sum(run.n_frames for run in runs), len(names)), np.nan, dtype)
    start = 0
    for run in runs:
        where = [column[name] for name in run.names]
        readings[start : start + run.n_frames, where] = run.readings
        start += run.n_frames
    readings.setflags(write=False)
    rates = [run.rate_hz for run in runs if run.rate_hz is not None]
    agree = len(rates) == len(runs) and max(rates) <= _MAX_RATE_RATIO * min(rates)
    positions, units = _positions(runs, names)
    return Recording(
        readings,
        names=names,
        rate_hz=float(np.median(rates)) if agree else None,
        positions=positions,
        units=units,
        source=" + ".join(run.source for run in runs),
        metadata={"runs": len(runs)},
    )


def sensors_differ(runs: Sequence[Recording]) -> bool:
    """Return whether some runs lack sensors that others have."""
    return len({frozenset(run.names) for run in runs}) > 1


def select_sensors(runs: Sequence[Recording], names: Sequence[str]) -> list[Recording]:
    """Select sensors by name from each run; runs with none of them are left out."""
    kept = set(names)
    selected = []
    for run in runs:
        sensors = [i for i, name in enumerate(run.names) if name in kept]
        if len(sensors) == run.n_sensors:
            selected.append(run)
        elif sensors:
            selected.append(run.select(sensors))
    return selected


def _check_matching(runs: Sequence[Recording]) -> None:
    if len(runs) > _MAX_RUNS:
        raise InputError(f"at most {_MAX_RUNS} recordings can be joined, got {len(runs)}")
    unnamed = [run for run in runs if run.names == default_names(run.n_sensors)]
    sizes = {run.n_sensors for run in unnamed}
    if len(sizes) > 1:
        listed = ", ".join(f"{run.source or 'one'} has {run.n_sensors}" for run in unnamed)
        raise InputError(
            "recordings without sensor names must have the same number of sensors, but "
            f"{listed}; give names"
        )
    joined = {*runs[0].names}
    for run in runs[1:]:
        if joined.isdisjoint(run.names):
            raise InputError(
                f"{run.source or 'a recording'} shares no sensor name with the recordings before "
                f"it ({run.names[0]} ... and {runs[0].names[0]} ...); use the same names"
            )
        joined |= {*run.names}


def _positions(
    runs: Sequence[Recording], names: tuple[str, ...]
) -> tuple[NDArray[np.float64] | None, str]:
    """Return true positions if all sensors have one and the runs agree."""
    known: dict[str, NDArray[np.float64]] = {}
    for run in runs:
        if run.positions is None:
            continue
        for name, position in zip(run.names, run.positions, strict=True):
            if not np.array_equal(known.setdefault(name, position), position, equal_nan=True):
                return None, ""
    units = {run.units for run in runs if run.positions is not None}
    if len(known) < len(names) or len(units) != 1:
        return None, ""
    return np.array([known[name] for name in names]), units.pop()
