"""What goes wrong between sensors: crosstalk, and readings under another sensor's name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.errors import InputError
from anisomap.recording import Recording
from anisomap.simulation.faults.log import Fault, spoilt, throughout
from anisomap.simulation.faults.sensors import Randomness, Sensors


def crosstalk(
    recording: Recording,
    sensors: Sensors,
    *,
    rng: Randomness = 0,
    share: float = 0.2,
    n_neighbours: int = 4,
) -> Recording:
    """Let sensors read some of what their neighbours do.

    Parameters
    ----------
    recording : Recording
        With true positions, which tell who is whose neighbour.
    sensors : iterable of str or int
        Names or indices.
    rng : numpy.random.Generator or int
        Nothing here is random; taken so that all faults are called alike.
    share : float
        How much of a reading is the mean of the neighbours', between 0 and 1.
    n_neighbours : int
        How many neighbours count. 4: those beside a sensor on a grid.

    Returns
    -------
    Recording

    Raises
    ------
    InputError
        If positions are not known, or there are too few sensors.
    """
    if not 0 < share <= 1:
        raise InputError(f"share is {share:g}; it must be above 0 and at most 1")
    if recording.positions is None:
        raise InputError(
            "crosstalk is between neighbours, and the recording does not say where its sensors "
            "are; give it true positions"
        )
    if not 1 <= n_neighbours < recording.n_sensors:
        raise InputError(
            f"n_neighbours is {n_neighbours}; it must be at least 1 and less than the "
            f"{recording.n_sensors} sensors"
        )
    clean = recording.readings
    chosen = recording.indices(sensors)
    # A sensor that shares its place with another need not be the first that is found there.
    around = KDTree(recording.positions).query(recording.positions[chosen], k=n_neighbours + 1)[1]
    readings = np.array(clean)
    for i, near in zip(chosen, np.asarray(around), strict=True):
        others = near[near != i][:n_neighbours]
        readings[:, i] = (1 - share) * clean[:, i] + share * clean[:, others].mean(axis=1)
    return _throughout(recording, readings, "crosstalk", chosen)


def swapped(recording: Recording, sensors: Sensors, *, rng: Randomness = 0) -> Recording:
    """Exchange the readings of two groups of sensors, as plugs of two triangles can be.

    Parameters
    ----------
    recording : Recording
    sensors : iterable of str or int
        An even number; the first half trades places with the second, each with its counterpart.
    rng : numpy.random.Generator or int
        Nothing here is random; taken so that all faults are called alike.

    Returns
    -------
    Recording
        Names and positions stay; the readings are wrong for both.

    Raises
    ------
    InputError
        If the number is odd, or a sensor stands there twice.
    """
    chosen = _in_order(recording, sensors)
    if len(chosen) % 2:
        raise InputError(f"{len(chosen)} sensors cannot be swapped; give an even number")
    half = len(chosen) // 2
    return _rewired(recording, "swapped", chosen, [*chosen[half:], *chosen[:half]])


def mirrored(recording: Recording, sensors: Sensors, *, rng: Randomness = 0) -> Recording:
    """Reverse the order of a group of sensors, as of a triangle that is mounted wrongly.

    Parameters
    ----------
    recording : Recording
    sensors : iterable of str or int
        The first takes the readings of the last, and so on.
    rng : numpy.random.Generator or int
        Nothing here is random; taken so that all faults are called alike.

    Returns
    -------
    Recording
        Names and positions stay. The middle one of an odd number keeps its readings.

    Raises
    ------
    InputError
        If a sensor stands there twice.
    """
    chosen = _in_order(recording, sensors)
    return _rewired(recording, "mirrored", chosen, chosen[::-1])


def duplicated(
    recording: Recording,
    sensors: Sensors,
    *,
    rng: Randomness = 0,
    source: str | int | None = None,
) -> Recording:
    """Make channels copies of another.

    Parameters
    ----------
    recording : Recording
    sensors : iterable of str or int
        The copies.
    rng : numpy.random.Generator or int
        Chooses what each copies, unless that is given.
    source : str or int, optional
        What all copy; one of the other sensors at random, each, unless given.

    Returns
    -------
    Recording

    Raises
    ------
    InputError
        If no other sensor is left to copy.
    """
    generator = np.random.default_rng(rng)
    copies = recording.indices(sensors)
    others = np.setdiff1d(np.arange(recording.n_sensors), copies)
    if not len(others):
        raise InputError("every sensor would be a copy, and none is left to copy from")
    if source is None:
        sources = [int(i) for i in generator.choice(others, size=len(copies))]
    else:
        sources = [int(recording.indices([source])[0])] * len(copies)
    return _rewired(recording, "duplicated", [int(i) for i in copies], sources)


def _rewired(recording: Recording, kind: str, to: Sequence[int], by: Sequence[int]) -> Recording:
    readings = np.array(recording.readings)
    readings[:, to] = recording.readings[:, by]
    moved = [i for i, j in zip(to, by, strict=True) if i != j]
    return _throughout(recording, readings, kind, moved)


def _throughout(
    recording: Recording,
    readings: NDArray[np.floating],
    kind: str,
    sensors: Sequence[int] | NDArray[np.intp],
) -> Recording:
    spans = throughout(recording.n_frames)
    return spoilt(
        recording, readings, [Fault(kind, recording.names[int(i)], spans) for i in sensors]
    )


def _in_order(recording: Recording, sensors: Sensors) -> list[int]:
    chosen = [int(recording.indices([sensor])[0]) for sensor in sensors]
    for i in chosen:
        if chosen.count(i) > 1:
            raise InputError(f"sensor {recording.names[i]} is named twice; name each once")
    return chosen
