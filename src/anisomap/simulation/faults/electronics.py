"""Faults between sensors: wiring, crosstalk, boards, multiplexers and supplies.

Levels are in units of the median standard deviation of the chosen sensors.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from anisomap.errors import InputError
from anisomap.recording import Recording
from anisomap.simulation.checks import COUNT, POSITIVE, SHARE, at_least
from anisomap.simulation.faults.forms import Readings, Sensors, group_fault

_BOARD = at_least(0, whole=True)


@group_fault(share=SHARE, n_neighbours=COUNT)
def crosstalk(
    recording: Recording,
    sensors: Sensors,
    rng: np.random.Generator,
    *,
    share: float = 0.2,
    n_neighbours: int = 4,
) -> tuple[Readings, Sequence[int]]:
    """Mix the readings of sensors with those of their neighbours.

    The recording must have true positions, which define the neighbours.

    Parameters
    ----------
    share : float
        Weight of the neighbours' mean, above 0 and at most 1.
    n_neighbours : int
        Number of nearest sensors to mix in. 4: the neighbours on a square grid.
    """
    if recording.positions is None:
        raise InputError("crosstalk needs a recording with true positions of its sensors")
    if n_neighbours >= recording.n_sensors:
        raise InputError(
            f"n_neighbours must be below the number of sensors ({recording.n_sensors}), "
            f"got {n_neighbours}"
        )
    chosen, clean = _indices(recording, sensors), recording.readings
    # One more than needed, because the sensor itself is not always first if positions coincide.
    nearest = KDTree(recording.positions).query(recording.positions[chosen], k=n_neighbours + 1)[1]
    readings = np.array(clean)
    for i, near in zip(chosen, np.asarray(nearest), strict=True):
        others = near[near != i][:n_neighbours]
        readings[:, i] = (1 - share) * clean[:, i] + share * clean[:, others].mean(axis=1)
    return readings, chosen


@group_fault()
def swapped(
    recording: Recording, sensors: Sensors, rng: np.random.Generator
) -> tuple[Readings, Sequence[int]]:
    """Exchange the readings of two groups of sensors, like swapped connectors.

    The first half of the sensors, an even number, is exchanged with the second, in order. Names and
    positions are kept.
    """
    chosen = _distinct(recording, sensors)
    if len(chosen) % 2:
        raise InputError(f"swapping needs an even number of sensors, got {len(chosen)}")
    half = len(chosen) // 2
    return _rewired(recording, chosen, [*chosen[half:], *chosen[:half]])


@group_fault()
def mirrored(
    recording: Recording, sensors: Sensors, rng: np.random.Generator
) -> tuple[Readings, Sequence[int]]:
    """Reverse the order of the readings of a group of sensors, like a rotated module.

    The first sensor takes the readings of the last, and so on. The middle one of an odd number is
    not affected. Names and positions are kept.
    """
    chosen = _distinct(recording, sensors)
    return _rewired(recording, chosen, chosen[::-1])


@group_fault(factor=at_least(1), level=at_least(0))
def duplicated(
    recording: Recording,
    sensors: Sensors,
    rng: np.random.Generator,
    *,
    source: str | int | None = None,
    factor: float = 1.0,
    level: float = 0.0,
) -> tuple[Readings, Sequence[int]]:
    """Replace the readings of sensors by those of another sensor, like one wire read twice.

    Parameters
    ----------
    source : str or int, optional
        Sensor to copy from. By default, one of the other sensors is drawn for each copy.
    factor : float
        Ratio of the largest to the smallest gain of a copy, at least 1. Gains are distributed
        uniformly around 1 on a logarithmic scale.
    level : float
        Standard deviation of the white noise that is added to each copy, as a share of the standard
        deviation of the readings that it copies; at least 0.
    """
    copies = _indices(recording, sensors)
    others = np.setdiff1d(np.arange(recording.n_sensors), copies)
    if not len(others):
        raise InputError(
            "duplicating needs at least one sensor to copy from, but all sensors were selected"
        )
    if source is None:
        sources = [int(i) for i in rng.choice(others, size=len(copies))]
    else:
        sources = _indices(recording, [source]) * len(copies)
    readings, affected = _rewired(recording, copies, sources)
    if factor == 1 and level == 0:
        return readings, affected
    for i in copies:
        own = readings[:, i]
        known = own[np.isfinite(own)]
        noise = level * (known.std() if known.size else 0) * rng.standard_normal(own.size)
        readings[:, i] = own * factor ** rng.uniform(-0.5, 0.5) + noise
    return readings, affected


@group_fault(share=SHARE)
def leaking(
    recording: Recording, sensors: Sensors, rng: np.random.Generator, *, share: float = 0.05
) -> tuple[Readings, Sequence[int]]:
    """Add a share of the previous channel to each sensor, like a multiplexer that settles slowly.

    Parameters
    ----------
    share : float
        Share of the reading of the sensor before it that is added to a sensor, above 0 and at most
        1. The first sensor of a recording receives nothing.
    """
    chosen = [i for i in _indices(recording, sensors) if i > 0]
    readings = np.array(recording.readings)
    for i in chosen:
        readings[:, i] += share * recording.readings[:, i - 1]
    return readings, chosen


@group_fault(frames=COUNT, board=_BOARD)
def lagging(
    recording: Recording,
    sensors: Sensors,
    rng: np.random.Generator,
    *,
    frames: int = 3,
    board: int = 0,
) -> tuple[Readings, Sequence[int]]:
    """Delay sensors, like boards that are polled late.

    Parameters
    ----------
    frames : int
        Delay in frames, at least 1. The first reading is held meanwhile.
    board : int
        Number of sensors of a board. Each board of the chosen sensors, in their order, lags
        `frames` more than the board before it; the first does not lag. 0: all lag alike.
    """
    readings, delayed = np.array(recording.readings), []
    for number, members in enumerate(_boards(_indices(recording, sensors), board)):
        if delay := frames * number if board else frames:
            source = np.maximum(np.arange(recording.n_frames) - delay, 0)
            readings[:, members] = recording.readings[source][:, members]
            delayed += members
    return readings, delayed


@group_fault(level=POSITIVE, board=_BOARD)
def common_noise(
    recording: Recording,
    sensors: Sensors,
    rng: np.random.Generator,
    *,
    level: float = 1.0,
    board: int = 0,
) -> tuple[Readings, Sequence[int]]:
    """Add the same white noise to all sensors of a board, like a noisy supply.

    Parameters
    ----------
    level : float
        Standard deviation of the noise.
    board : int
        Number of sensors of a board, each with its own noise. 0: all sensors are on one board.
    """
    readings, chosen = np.array(recording.readings), _indices(recording, sensors)
    scale = level * _typical_deviation(recording, chosen)
    for members in _boards(chosen, board):
        readings[:, members] += scale * rng.standard_normal((recording.n_frames, 1))
    return readings, chosen


@group_fault(level=POSITIVE, share=SHARE, board=_BOARD)
def spiking(
    recording: Recording,
    sensors: Sensors,
    rng: np.random.Generator,
    *,
    level: float = 5.0,
    share: float = 0.02,
    board: int = 0,
) -> tuple[Readings, Sequence[int]]:
    """Add spikes of single frames to all sensors of a board at once.

    Parameters
    ----------
    level : float
        Mean height of a spike; heights are distributed exponentially.
    share : float
        Expected share of the frames with a spike, above 0 and at most 1.
    board : int
        Number of sensors of a board, each with its own spikes. 0: all sensors are on one board.
    """
    readings, chosen = np.array(recording.readings), _indices(recording, sensors)
    scale = level * _typical_deviation(recording, chosen)
    for members in _boards(chosen, board):
        heights = scale * rng.exponential(size=recording.n_frames)
        struck = rng.random(recording.n_frames) < share
        readings[:, members] += np.where(struck, heights, 0)[:, None]
    return readings, chosen


@group_fault(level=POSITIVE, period=at_least(2), factor=at_least(1))
def humming(
    recording: Recording,
    sensors: Sensors,
    rng: np.random.Generator,
    *,
    level: float = 1.0,
    period: float = 7.3,
    factor: float = 3.0,
) -> tuple[Readings, Sequence[int]]:
    """Add a sine of one period and phase to sensors, each with a gain of its own.

    Parameters
    ----------
    level : float
        Median amplitude of the sine.
    period : float
        Period in frames, at least 2. Chosen by hand, not a whole number of frames.
    factor : float
        Ratio of the largest to the smallest gain, at least 1. Gains are distributed uniformly on a
        logarithmic scale.
    """
    readings, chosen = np.array(recording.readings), _indices(recording, sensors)
    phase = 2 * np.pi * (np.arange(recording.n_frames) / period + rng.random())
    gains = factor ** rng.uniform(-0.5, 0.5, len(chosen))
    amplitude = level * _typical_deviation(recording, chosen)
    readings[:, chosen] += amplitude * np.outer(np.sin(phase), gains)
    return readings, chosen


def _indices(recording: Recording, sensors: Sensors) -> list[int]:
    return [int(i) for i in recording.indices(sensors)]


def _distinct(recording: Recording, sensors: Sensors) -> list[int]:
    """Look sensors up in the given order."""
    chosen = [i for sensor in sensors for i in _indices(recording, [sensor])]
    for i in chosen:
        if chosen.count(i) > 1:
            raise InputError(f"sensor {recording.names[i]} is listed twice; list each sensor once")
    return chosen


def _rewired(
    recording: Recording, targets: Sequence[int], sources: Sequence[int]
) -> tuple[Readings, Sequence[int]]:
    readings = np.array(recording.readings)
    readings[:, targets] = recording.readings[:, sources]
    return readings, [i for i, j in zip(targets, sources, strict=True) if i != j]


def _boards(sensors: list[int], size: int) -> list[list[int]]:
    """Divide sensors into boards of a size, in order; 0 makes one board of all."""
    step = size or max(1, len(sensors))
    return [sensors[start : start + step] for start in range(0, len(sensors), step)]


def _typical_deviation(recording: Recording, sensors: Sequence[int]) -> float:
    """Return the median standard deviation of sensors; 1 if none varies."""
    readings = recording.readings[:, sensors].astype(np.float64)
    known = np.isfinite(readings)
    counts = np.maximum(known.sum(axis=0), 1)
    centred = np.where(known, readings, 0)
    centred -= centred.sum(axis=0) / counts
    deviations = np.sqrt(np.where(known, centred**2, 0).sum(axis=0) / counts)
    varying = deviations[deviations > 0]
    return float(np.median(varying)) if varying.size else 1.0
