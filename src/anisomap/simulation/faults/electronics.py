"""Faults between sensors: wiring, crosstalk, boards, multiplexers and supplies.

Levels are in units of the median standard deviation of the chosen sensors.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from anisomap.errors import InputError
from anisomap.numerics.neighbours import nearest_others
from anisomap.simulation.checks import COUNT, INNER_SHARE, POSITIVE, SHARE, at_least
from anisomap.simulation.faults.forms import Group, Rewritten, group_fault

_BOARD = at_least(0, whole=True)


@group_fault(share=SHARE, n_neighbours=COUNT)
def crosstalk(
    group: Group,
    *,
    share: float = 0.2,
    n_neighbours: int = 4,
) -> Rewritten:
    """Mix the readings of sensors with those of their neighbours.

    The recording must have true positions, which define the neighbours.

    Parameters
    ----------
    share : float
        Weight of the neighbours' mean, above 0 and at most 1.
    n_neighbours : int
        Number of nearest sensors to mix in. 4: the neighbours on a square grid.
    """
    recording = group.recording
    if recording.positions is None:
        raise InputError("crosstalk needs a recording with true positions of its sensors")
    if n_neighbours >= recording.n_sensors:
        raise InputError(
            f"n_neighbours must be below the number of sensors ({recording.n_sensors}), "
            f"got {n_neighbours}"
        )
    chosen, clean = group.chosen, group.readings
    _, nearest = nearest_others(recording.positions, n_neighbours, np.array(chosen, dtype=np.intp))
    readings = np.array(clean)
    for i, others in zip(chosen, nearest, strict=True):
        readings[:, i] = (1 - share) * clean[:, i] + share * clean[:, others].mean(axis=1)
    return readings, chosen


@group_fault()
def swapped(group: Group) -> Rewritten:
    """Exchange the readings of two groups of sensors, like swapped connectors.

    The first half of the sensors, an even number, is exchanged with the second, in order. Names and
    positions are kept.
    """
    chosen = group.in_order()
    if len(chosen) % 2:
        raise InputError(f"swapping needs an even number of sensors, got {len(chosen)}")
    half = len(chosen) // 2
    return _rewired(group, chosen, [*chosen[half:], *chosen[:half]])


@group_fault(share=INNER_SHARE)
def rewired(group: Group, *, share: float = 0.5) -> Rewritten:
    """Exchange the readings of sensors from some frame on, like connectors that are moved.

    Each sensor takes the readings of another, in a cycle of random order.

    Parameters
    ----------
    share : float
        Share of the recording before the change, between 0 and 1.
    """
    order = group.rng.permutation(np.array(group.chosen, dtype=np.intp))
    readings, late = np.array(group.readings), slice(int(share * len(group.readings)), None)
    readings[late, order] = group.readings[late, np.roll(order, 1)]
    return readings, group.chosen


@group_fault()
def mirrored(group: Group) -> Rewritten:
    """Reverse the order of the readings of a group of sensors, like a rotated module.

    The first sensor takes the readings of the last, and so on. The middle one of an odd number is
    not affected. Names and positions are kept.
    """
    chosen = group.in_order()
    return _rewired(group, chosen, chosen[::-1])


@group_fault(factor=at_least(1), level=at_least(0))
def duplicated(
    group: Group,
    *,
    source: str | int | None = None,
    factor: float = 1.0,
    level: float = 0.0,
) -> Rewritten:
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
    copies = group.chosen
    others = np.setdiff1d(np.arange(group.recording.n_sensors), copies)
    if not len(others):
        raise InputError(
            "duplicating needs at least one sensor to copy from, but all sensors were selected"
        )
    if source is None:
        sources = [int(i) for i in group.rng.choice(others, size=len(copies))]
    else:
        sources = [int(group.recording.indices([source])[0])] * len(copies)
    readings, affected = _rewired(group, copies, sources)
    if factor == 1 and level == 0:
        return readings, affected
    for i in copies:
        own = readings[:, i]
        known = own[np.isfinite(own)]
        noise = level * (known.std() if known.size else 0) * group.rng.standard_normal(own.size)
        readings[:, i] = own * factor ** group.rng.uniform(-0.5, 0.5) + noise
    return readings, affected


@group_fault(share=SHARE)
def leaking(group: Group, *, share: float = 0.05) -> Rewritten:
    """Add a share of the previous channel to each sensor, like a multiplexer that settles slowly.

    Parameters
    ----------
    share : float
        Share of the reading of the sensor before it that is added to a sensor, above 0 and at most
        1. The first sensor of a recording receives nothing.
    """
    chosen = [i for i in group.chosen if i > 0]
    readings = np.array(group.readings)
    for i in chosen:
        readings[:, i] += share * group.readings[:, i - 1]
    return readings, chosen


@group_fault(frames=COUNT, board=_BOARD)
def lagging(
    group: Group,
    *,
    frames: int = 3,
    board: int = 0,
) -> Rewritten:
    """Delay sensors, like boards that are polled late.

    Parameters
    ----------
    frames : int
        Delay in frames, at least 1. The first reading is held meanwhile.
    board : int
        Number of sensors of a board. Each board of the chosen sensors, in their order, lags
        `frames` more than the board before it; the first does not lag. 0: all lag alike.
    """
    readings, delayed = np.array(group.readings), []
    for number, members in enumerate(group.boards(board)):
        if delay := frames * number if board else frames:
            source = np.maximum(np.arange(len(group.readings)) - delay, 0)
            readings[:, members] = group.readings[source][:, members]
            delayed += members
    return readings, delayed


@group_fault(level=POSITIVE, board=_BOARD)
def common_noise(
    group: Group,
    *,
    level: float = 1.0,
    board: int = 0,
) -> Rewritten:
    """Add the same white noise to all sensors of a board, like a noisy supply.

    Parameters
    ----------
    level : float
        Standard deviation of the noise.
    board : int
        Number of sensors of a board, each with its own noise. 0: all sensors are on one board.
    """
    readings, chosen = np.array(group.readings), group.chosen
    scale = level * group.deviation
    for members in group.boards(board):
        readings[:, members] += scale * group.rng.standard_normal((len(group.readings), 1))
    return readings, chosen


@group_fault(level=POSITIVE, share=SHARE, board=_BOARD)
def spiking(
    group: Group,
    *,
    level: float = 5.0,
    share: float = 0.02,
    board: int = 0,
) -> Rewritten:
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
    readings, chosen = np.array(group.readings), group.chosen
    scale = level * group.deviation
    for members in group.boards(board):
        heights = scale * group.rng.exponential(size=len(group.readings))
        struck = group.rng.random(len(group.readings)) < share
        readings[:, members] += np.where(struck, heights, 0)[:, None]
    return readings, chosen


@group_fault(level=POSITIVE, period=at_least(2), factor=at_least(1))
def humming(
    group: Group,
    *,
    level: float = 1.0,
    period: float = 7.3,
    factor: float = 3.0,
) -> Rewritten:
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
    readings, chosen = np.array(group.readings), group.chosen
    phase = 2 * np.pi * (np.arange(len(group.readings)) / period + group.rng.random())
    gains = factor ** group.rng.uniform(-0.5, 0.5, len(chosen))
    amplitude = level * group.deviation
    readings[:, chosen] += amplitude * np.outer(np.sin(phase), gains)
    return readings, chosen


def _rewired(group: Group, targets: Sequence[int], sources: Sequence[int]) -> Rewritten:
    readings = np.array(group.readings)
    readings[:, targets] = group.readings[:, sources]
    return readings, [i for i, j in zip(targets, sources, strict=True) if i != j]
