"""Faults between sensors: crosstalk, and readings assigned to the wrong sensor.

All functions take a recording, sensors and ``rng``, like the faults of single sensors.

Faults of read-out electronics that serve several sensors: boards, multiplexers, supplies.

All functions take a recording, sensors and ``rng``, like the faults of single sensors. Levels are
in units of the median standard deviation of the chosen sensors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.errors import InputError
from anisomap.recording import Recording
from anisomap.simulation.checks import check_positive
from anisomap.simulation.faults.log import Fault, all_frames, with_faults
from anisomap.simulation.faults.sensors import Randomness, Sensors


def crosstalk(
    recording: Recording,
    sensors: Sensors,
    *,
    rng: Randomness = 0,
    share: float = 0.2,
    n_neighbours: int = 4,
) -> Recording:
    """Mix the readings of sensors with those of their neighbours.

    Parameters
    ----------
    recording : Recording
        With true positions, which define the neighbours.
    sensors, rng
        See `FAULTS`.
    share : float
        Weight of the neighbours' mean, above 0 and at most 1.
    n_neighbours : int
        Number of nearest sensors to mix in. 4: the neighbours on a square grid.

    Raises
    ------
    InputError
        If the recording has no positions, or at most `n_neighbours` sensors, or `share` is not in
        (0, 1].
    """
    if not 0 < share <= 1:
        raise InputError(f"share must be above 0 and at most 1, got {share:g}")
    if recording.positions is None:
        raise InputError("crosstalk needs a recording with true positions of its sensors")
    if not 1 <= n_neighbours < recording.n_sensors:
        raise InputError(
            f"n_neighbours must be at least 1 and below the number of sensors "
            f"({recording.n_sensors}), got {n_neighbours}"
        )
    clean = recording.readings
    chosen = recording.indices(sensors)
    # One more than needed, because the sensor itself is not always first if positions coincide.
    nearest = KDTree(recording.positions).query(recording.positions[chosen], k=n_neighbours + 1)[1]
    readings = np.array(clean)
    for i, near in zip(chosen, np.asarray(nearest), strict=True):
        others = near[near != i][:n_neighbours]
        readings[:, i] = (1 - share) * clean[:, i] + share * clean[:, others].mean(axis=1)
    return _logged(recording, readings, "crosstalk", chosen)


def swapped(recording: Recording, sensors: Sensors, *, rng: Randomness = 0) -> Recording:
    """Exchange the readings of two groups of sensors, like swapped connectors.

    Parameters
    ----------
    recording, rng
        See `FAULTS`.
    sensors : iterable of str or int
        An even number. The first half is exchanged with the second, in order. Names and positions
        are kept.

    Raises
    ------
    InputError
        If the number of sensors is odd, or a sensor is listed twice.
    """
    chosen = _in_order(recording, sensors)
    if len(chosen) % 2:
        raise InputError(f"swapping needs an even number of sensors, got {len(chosen)}")
    half = len(chosen) // 2
    return _rewired(recording, "swapped", chosen, [*chosen[half:], *chosen[:half]])


def mirrored(recording: Recording, sensors: Sensors, *, rng: Randomness = 0) -> Recording:
    """Reverse the order of the readings of a group of sensors, like a rotated module.

    Parameters
    ----------
    recording, rng
        See `FAULTS`.
    sensors : iterable of str or int
        The first takes the readings of the last, and so on. The middle one of an odd number is
        not affected. Names and positions are kept.

    Raises
    ------
    InputError
        If a sensor is listed twice.
    """
    chosen = _in_order(recording, sensors)
    return _rewired(recording, "mirrored", chosen, chosen[::-1])


def duplicated(
    recording: Recording,
    sensors: Sensors,
    *,
    rng: Randomness = 0,
    source: str | int | None = None,
    factor: float = 1.0,
    level: float = 0.0,
) -> Recording:
    """Replace the readings of sensors by those of another sensor, like one wire read twice.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    source : str or int, optional
        Sensor to copy from. By default, one of the other sensors is drawn for each copy.
    factor : float
        Ratio of the largest to the smallest gain of a copy, at least 1. Gains are distributed
        uniformly around 1 on a logarithmic scale.
    level : float
        Standard deviation of the white noise that is added to each copy, as a share of the standard
        deviation of the readings that it copies; at least 0.

    Raises
    ------
    InputError
        If no other sensor is left to copy from, or a parameter is out of range.
    """
    if not (np.isfinite(factor) and factor >= 1):
        raise InputError(f"factor must be at least 1, got {factor:g}")
    if not (np.isfinite(level) and level >= 0):
        raise InputError(f"level must be at least 0, got {level:g}")
    generator = np.random.default_rng(rng)
    copies = recording.indices(sensors)
    others = np.setdiff1d(np.arange(recording.n_sensors), copies)
    if not len(others):
        raise InputError(
            "duplicating needs at least one sensor to copy from, but all sensors were selected"
        )
    if source is None:
        sources = [int(i) for i in generator.choice(others, size=len(copies))]
    else:
        sources = [int(recording.indices([source])[0])] * len(copies)
    copied = _rewired(recording, "duplicated", [int(i) for i in copies], sources)
    if factor == 1 and level == 0:
        return copied
    readings = np.array(copied.readings)
    for i in copies:
        own = readings[:, i]
        known = own[np.isfinite(own)]
        noise = level * (known.std() if known.size else 0) * generator.standard_normal(own.size)
        readings[:, i] = own * factor ** generator.uniform(-0.5, 0.5) + noise
    return replace(copied, readings=readings)


def _rewired(
    recording: Recording, kind: str, targets: Sequence[int], sources: Sequence[int]
) -> Recording:
    readings = np.array(recording.readings)
    readings[:, targets] = recording.readings[:, sources]
    moved = [i for i, j in zip(targets, sources, strict=True) if i != j]
    return _logged(recording, readings, kind, moved)


def _logged(
    recording: Recording,
    readings: NDArray[np.floating],
    kind: str,
    sensors: Sequence[int] | NDArray[np.intp],
) -> Recording:
    spans = all_frames(recording.n_frames)
    return with_faults(
        recording, readings, [Fault(kind, recording.names[int(i)], spans) for i in sensors]
    )


def _in_order(recording: Recording, sensors: Sensors) -> list[int]:
    chosen = [int(recording.indices([sensor])[0]) for sensor in sensors]
    for i in chosen:
        if chosen.count(i) > 1:
            raise InputError(f"sensor {recording.names[i]} is listed twice; list each sensor once")
    return chosen


def leaking(
    recording: Recording, sensors: Sensors, *, rng: Randomness = 0, share: float = 0.05
) -> Recording:
    """Add a share of the previous channel to each sensor, like a multiplexer that settles slowly.

    Parameters
    ----------
    recording, rng
        See `FAULTS`.
    sensors : iterable of str or int
        Sensors that receive the reading of the sensor before them. The first sensor of a recording
        receives nothing.
    share : float
        Share of the previous reading that is added, above 0 and at most 1.

    Raises
    ------
    InputError
        If `share` is not in (0, 1].
    """
    _check_share(share)
    chosen = [int(i) for i in recording.indices(sensors) if i > 0]
    readings = np.array(recording.readings)
    for i in chosen:
        readings[:, i] += share * recording.readings[:, i - 1]
    return _logged_boards(recording, readings, "leaking", chosen)


def lagging(
    recording: Recording,
    sensors: Sensors,
    *,
    rng: Randomness = 0,
    frames: int = 3,
    board: int = 0,
) -> Recording:
    """Delay sensors, like boards that are polled late.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    frames : int
        Delay in frames, at least 1. The first reading is held meanwhile.
    board : int
        Number of sensors of a board. Each board of the chosen sensors, in their order, lags
        `frames` more than the board before it; the first does not lag. 0: all lag alike.

    Raises
    ------
    InputError
        If `frames` is below 1, or `board` is negative.
    """
    if frames < 1:
        raise InputError(f"frames must be at least 1, got {frames}")
    readings = np.array(recording.readings)
    delayed = []
    for number, members in enumerate(_boards(recording, sensors, board)):
        delay = frames * number if board else frames
        if delay:
            source = np.maximum(np.arange(recording.n_frames) - delay, 0)
            readings[:, members] = recording.readings[source][:, members]
            delayed += members
    return _logged_boards(recording, readings, "lagging", delayed)


def common_noise(
    recording: Recording,
    sensors: Sensors,
    *,
    rng: Randomness = 0,
    level: float = 1.0,
    board: int = 0,
) -> Recording:
    """Add the same white noise to all sensors of a board, like a noisy supply.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    level : float
        Standard deviation of the noise.
    board : int
        Number of sensors of a board, each with its own noise. 0: all sensors are on one board.
    """
    check_positive("level", level)
    generator = np.random.default_rng(rng)
    readings = np.array(recording.readings)
    boards = list(_boards(recording, sensors, board))
    scale = level * _typical_deviation(recording, boards)
    for members in boards:
        readings[:, members] += scale * generator.standard_normal((recording.n_frames, 1))
    return _logged_boards(recording, readings, "common-noise", _flat(boards))


def spiking(
    recording: Recording,
    sensors: Sensors,
    *,
    rng: Randomness = 0,
    level: float = 5.0,
    share: float = 0.02,
    board: int = 0,
) -> Recording:
    """Add spikes of single frames to all sensors of a board at once.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    level : float
        Mean height of a spike; heights are distributed exponentially.
    share : float
        Expected share of the frames with a spike, above 0 and at most 1.
    board : int
        Number of sensors of a board, each with its own spikes. 0: all sensors are on one board.

    Raises
    ------
    InputError
        If `level` is not positive, or `share` is not in (0, 1].
    """
    check_positive("level", level)
    _check_share(share)
    generator = np.random.default_rng(rng)
    readings = np.array(recording.readings)
    boards = list(_boards(recording, sensors, board))
    scale = level * _typical_deviation(recording, boards)
    for members in boards:
        heights = scale * generator.exponential(size=recording.n_frames)
        struck = generator.random(recording.n_frames) < share
        readings[:, members] += np.where(struck, heights, 0)[:, None]
    return _logged_boards(recording, readings, "spiking", _flat(boards))


def humming(
    recording: Recording,
    sensors: Sensors,
    *,
    rng: Randomness = 0,
    level: float = 1.0,
    period: float = 7.3,
    factor: float = 3.0,
) -> Recording:
    """Add a sine of one period and phase to sensors, each with a gain of its own.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    level : float
        Median amplitude of the sine.
    period : float
        Period in frames, at least 2. Chosen by hand, not a whole number of frames.
    factor : float
        Ratio of the largest to the smallest gain, at least 1. Gains are distributed uniformly on a
        logarithmic scale.

    Raises
    ------
    InputError
        If a parameter is out of range.
    """
    check_positive("level", level)
    if not period >= 2:
        raise InputError(f"period must be at least 2 frames, got {period:g}")
    if not (np.isfinite(factor) and factor >= 1):
        raise InputError(f"factor must be at least 1, got {factor:g}")
    generator = np.random.default_rng(rng)
    chosen = [int(i) for i in recording.indices(sensors)]
    phase = 2 * np.pi * (np.arange(recording.n_frames) / period + generator.random())
    gains = factor ** generator.uniform(-0.5, 0.5, len(chosen))
    readings = np.array(recording.readings)
    readings[:, chosen] += (
        level * _typical_deviation(recording, [chosen]) * np.outer(np.sin(phase), gains)
    )
    return _logged_boards(recording, readings, "humming", chosen)


def _boards(recording: Recording, sensors: Sensors, size: int) -> Iterator[list[int]]:
    """Divide sensors into boards of a size, in order; 0 makes one board of all."""
    if size < 0:
        raise InputError(f"board must be at least 0 sensors, got {size}")
    chosen = [int(i) for i in recording.indices(sensors)]
    step = size or max(1, len(chosen))
    for start in range(0, len(chosen), step):
        yield chosen[start : start + step]


def _flat(boards: Sequence[Sequence[int]]) -> list[int]:
    return [i for members in boards for i in members]


def _typical_deviation(recording: Recording, boards: Sequence[Sequence[int]]) -> float:
    """Return the median standard deviation of sensors; 1 if none varies."""
    chosen = _flat(boards)
    readings = recording.readings[:, chosen].astype(np.float64)
    known = np.isfinite(readings)
    counts = np.maximum(known.sum(axis=0), 1)
    centred = np.where(known, readings, 0)
    centred -= centred.sum(axis=0) / counts
    deviations = np.sqrt(np.where(known, centred**2, 0).sum(axis=0) / counts)
    varying = deviations[deviations > 0]
    return float(np.median(varying)) if varying.size else 1.0


def _check_share(share: float) -> None:
    if not 0 < share <= 1:
        raise InputError(f"share must be above 0 and at most 1, got {share:g}")


def _logged_boards(
    recording: Recording, readings: NDArray[np.floating], kind: str, sensors: Sequence[int]
) -> Recording:
    spans = all_frames(recording.n_frames)
    return with_faults(
        recording, readings, [Fault(kind, recording.names[i], spans) for i in sensors]
    )
