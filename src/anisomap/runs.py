"""Several recordings of one skin, and the one map that they make together.

Sensors are matched by name. Pairs that were never recorded together are unknown: shortest paths
bridge them where the method looks for any, and scaling gives them no weight.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, InputError
from anisomap.health import SensorHealth, assess
from anisomap.methods import (
    DEFAULT_METHOD,
    SIMILARITIES,
    MethodOptions,
    check_priors,
    find_method,
)
from anisomap.numerics.reliability.sampling_noise import sampling_variance
from anisomap.reconstruction import reconstruct
from anisomap.recording import Recording, default_names
from anisomap.sensor_map import SensorMap
from anisomap.wording import noun_and_items

_SILENT = ("dead", "stuck", "isolated")
_SAME_RATE = 0.02
_MOST_RUNS = 62  # of which sensors took part in is kept in the bits of a whole number


def join_runs(runs: Sequence[Recording]) -> Recording:
    """Put recordings of one skin one after the other.

    Parameters
    ----------
    runs : sequence of Recording
        At least one. Their sensors may stand in another order, and some may be missing.

    Returns
    -------
    Recording
        All sensors, in the order in which they come up. Sensors that a run lacks are NaN in its
        frames. It has no times, and a rate if the runs agree on one.

    Raises
    ------
    InputError
        If sensors cannot be matched: no name is shared, or runs without names differ in number.
    """
    if not runs:
        raise InputError("there is no recording to make a map of")
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
    agree = len(rates) == len(runs) and max(rates) <= (1 + _SAME_RATE) * min(rates)
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


def assess_runs(runs: Sequence[Recording]) -> tuple[SensorHealth, ...]:
    """Judge every sensor of several recordings by the run that tells most of it.

    That is the one in which it was touched most; but one in which it is merely silent, or alone,
    says less than any other.

    Parameters
    ----------
    runs : sequence of Recording

    Returns
    -------
    tuple of SensorHealth
        In the order of `join_runs`. Where all runs have all sensors, they are judged as one.
    """
    if not _some_missing(runs):
        return assess(join_runs(runs))
    best: dict[str, SensorHealth] = {}
    for run in runs:
        for sensor in assess(run):
            known = best.get(sensor.name)
            if known is None or _telling(sensor) > _telling(known):
                best[sensor.name] = sensor
    return tuple(best.values())


def reconstruct_runs(
    runs: Sequence[Recording],
    method: str = DEFAULT_METHOD,
    dimensions: int = 3,
    *,
    options: MethodOptions | None = None,
    exclude: Iterable[str | int] = (),
    drop: Iterable[str | int] = (),
    health: Sequence[SensorHealth] | None = None,
    judge: bool = True,
) -> SensorMap:
    """Make one map of several recordings of a skin.

    Parameters
    ----------
    runs : sequence of Recording
        Without missing readings (see `Recording.complete`); for the rest see `join_runs`.
    method, dimensions, options, exclude, drop, health, judge
        As for `anisomap.reconstruct`; indices count in the order of `join_runs`.

    Returns
    -------
    SensorMap
        The same as of one recording that holds all frames, where all runs have all sensors. Else
        every pair is compared over those runs that have both of its sensors.

    Raises
    ------
    InputError
        As `anisomap.reconstruct`, and if sensors cannot be matched.
    """
    joined, dropped = join_runs(runs), tuple(drop)
    judged = assess_runs(runs) if health is None else health
    if not _some_missing(runs):
        return reconstruct(
            joined,
            method,
            dimensions,
            options=options,
            exclude=exclude,
            drop=dropped,
            health=judged,
            judge=judge,
        )
    recipe, chosen = find_method(method), options or MethodOptions()
    check_priors(method, chosen, readings=False)
    for run in runs:
        run.complete()
    met = _met(runs, joined.names)
    similarity, noise = np.eye(len(met)), np.ones(met.shape)
    for together, readings, sensors in _groups(runs, joined.names, met):
        inside = np.ix_(sensors, sensors)
        asked = met[inside] == together
        alike = SIMILARITIES[recipe.similarity].compute(readings, chosen)
        similarity[inside] = np.where(asked, alike, similarity[inside])
        if recipe.refine is not None:
            noise[inside] = np.where(asked, sampling_variance(readings), noise[inside])
    strangers = tuple(_strangers(met, joined.names))
    for note in strangers:
        warnings.warn(note, AnisomapWarning, stacklevel=2)
    made = reconstruct(
        joined,
        method,
        dimensions,
        options=options,
        similarity=similarity,
        noise=noise,
        weights=(met > 0).astype(np.float64),
        exclude=exclude,
        drop=dropped,
        health=judged,
    )
    provenance = {**made.provenance, "runs": len(runs)}
    return replace(made, notes=(*strangers, *made.notes), provenance=provenance)


def _telling(sensor: SensorHealth) -> tuple[bool, int]:
    return sensor.status not in _SILENT, sensor.contacts


def _check_matching(runs: Sequence[Recording]) -> None:
    if len(runs) > _MOST_RUNS:
        raise InputError(f"{len(runs)} recordings are too many for one map; give {_MOST_RUNS}")
    unnamed = [run for run in runs if run.names == default_names(run.n_sensors)]
    sizes = {run.n_sensors for run in unnamed}
    if len(sizes) > 1:
        listed = ", ".join(f"{run.source or 'one'} has {run.n_sensors}" for run in unnamed)
        raise InputError(
            f"sensors without names can only be matched if all recordings have the same ones, but "
            f"{listed}; name them"
        )
    joined = {*runs[0].names}
    for run in runs[1:]:
        if joined.isdisjoint(run.names):
            raise InputError(
                f"{run.source or 'a recording'} shares no sensor with those before it: its are "
                f"named {run.names[0]} ..., theirs {runs[0].names[0]} ...; names must agree"
            )
        joined |= {*run.names}


def _some_missing(runs: Sequence[Recording]) -> bool:
    return len({frozenset(run.names) for run in runs}) > 1


def _positions(
    runs: Sequence[Recording], names: tuple[str, ...]
) -> tuple[NDArray[np.float64] | None, str]:
    """Give true positions if every sensor has one, and the runs do not contradict each other."""
    known: dict[str, NDArray[np.float64]] = {}
    for run in runs:
        if run.positions is None:
            continue
        for name, position in zip(run.names, run.positions, strict=True):
            if not np.array_equal(known.setdefault(name, position), position):
                return None, ""
    units = {run.units for run in runs if run.positions is not None}
    if len(known) < len(names) or len(units) != 1:
        return None, ""
    return np.array([known[name] for name in names]), units.pop()


def _met(runs: Sequence[Recording], names: tuple[str, ...]) -> NDArray[np.int64]:
    """Tell in which runs each pair was recorded together: a bit a run, shape (N, N)."""
    taken = np.zeros(len(names), dtype=np.int64)
    column = {name: i for i, name in enumerate(names)}
    for bit, run in enumerate(runs):
        taken[[column[name] for name in run.names]] |= 1 << bit
    return taken[:, None] & taken


def _groups(
    runs: Sequence[Recording], names: tuple[str, ...], met: NDArray[np.int64]
) -> Iterator[tuple[int, NDArray[np.floating], NDArray[np.intp]]]:
    """Give every set of runs in which pairs met, the frames of it, and the sensors in all of it."""
    for together in np.unique(met[met > 0]).tolist():
        chosen = [run for bit, run in enumerate(runs) if together >> bit & 1]
        sensors = np.flatnonzero((np.diag(met) & together) == together)
        kept = [names[i] for i in sensors]
        frames = [run.readings[:, [run.names.index(name) for name in kept]] for run in chosen]
        yield together, np.concatenate(frames), sensors


def _strangers(met: NDArray[np.int64], names: tuple[str, ...]) -> Iterator[str]:
    strangers = [names[i] for i in np.flatnonzero((met == 0).any(axis=1))]
    if strangers:
        yield (
            f"{np.count_nonzero(np.triu(met == 0))} pairs of sensors were never recorded together, "
            "so how far apart they are follows from others only: "
            f"{noun_and_items('sensor', strangers)}"
        )
