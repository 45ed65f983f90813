"""What goes wrong with one sensor.

Each takes a recording and the sensors to spoil, and gives a new recording.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.recording import Recording
from anisomap.simulation.checks import check_count, check_positive
from anisomap.simulation.faults.log import (
    Fault,
    Spans,
    random_spans,
    spoilt,
    throughout,
    value_range,
)

Column: TypeAlias = NDArray[np.floating]
Sensors: TypeAlias = Iterable[str | int]
Randomness: TypeAlias = np.random.Generator | int


def dead(recording: Recording, sensors: Sensors, *, rng: Randomness = 0) -> Recording:
    """Make sensors read their rest value always.

    Parameters
    ----------
    recording : Recording
    sensors : iterable of str or int
        Names or indices.
    rng : numpy.random.Generator or int
        Nothing here is random; taken so that all faults are called alike.

    Returns
    -------
    Recording
        Rest is each sensor's most frequent reading: `anisomap.numerics.similarity.rest.Rest`.
    """

    def silence(column: Column) -> tuple[Column, Spans]:
        return np.full_like(column, rest_of(column)), throughout(column.size)

    return _inject(recording, "dead", sensors, silence)


def saturating(
    recording: Recording,
    sensors: Sensors,
    *,
    rng: Randomness = 0,
    level: float | None = None,
    mean_gap: float = 100.0,
    mean_span: float = 20.0,
) -> Recording:
    """Make sensors jump to full scale now and then, touched or not: the paper's sensor 30.

    Parameters
    ----------
    recording : Recording
    sensors : iterable of str or int
        Names or indices.
    rng : numpy.random.Generator or int
        Decides when, or the seed of what does.
    level : float, optional
        Full scale, in the unit of the readings; the recording's highest reading unless given.
    mean_gap, mean_span : float
        How many frames, at least 1, pass on average between two jumps, and how many each lasts.
        Both are geometric: a sensor forgets how long it has been well or unwell. The paper gives
        no numbers; these keep a sensor saturated a sixth of the time.

    Returns
    -------
    Recording
        One that is short beside `mean_gap` may be spared; its faults' spans are empty then.

    Notes
    -----
    McGregor et al. (2011), section "Prototyping Issues": "a tendency to saturate intermittently
    regardless of whether it was being physically stimulated or not".
    """
    generator = np.random.default_rng(rng)
    full_scale = value_range(recording)[1] if level is None else level

    def jump(column: Column) -> tuple[Column, Spans]:
        spans = random_spans(column.size, mean_gap, mean_span, generator)
        for start, stop in spans:
            column[start:stop] = full_scale
        return column, spans

    return _inject(recording, "saturating", sensors, jump)


def noisy(
    recording: Recording,
    sensors: Sensors,
    *,
    rng: Randomness = 0,
    level: float = 0.1,
) -> Recording:
    """Add white noise to sensors.

    Parameters
    ----------
    recording : Recording
    sensors : iterable of str or int
        Names or indices.
    rng : numpy.random.Generator or int
        Source of the noise, or its seed.
    level : float
        Standard deviation of the (normal) noise, as a share of the recording's range.

    Returns
    -------
    Recording
    """
    check_positive("level", level)
    generator = np.random.default_rng(rng)
    lowest, highest = value_range(recording)
    spread = level * (highest - lowest)

    def disturb(column: Column) -> tuple[Column, Spans]:
        return column + spread * generator.standard_normal(column.size), throughout(column.size)

    return _inject(recording, "noisy", sensors, disturb)


def stuck(
    recording: Recording,
    sensors: Sensors,
    *,
    rng: Randomness = 0,
    level: float | None = None,
) -> Recording:
    """Make sensors read one value always, other than rest.

    Parameters
    ----------
    recording : Recording
    sensors : iterable of str or int
        Names or indices.
    rng : numpy.random.Generator or int
        Chooses the value, unless it is given.
    level : float, optional
        The value, in the unit of the readings; anywhere in the upper half of the recording's range
        unless given, so that it is not taken for rest.

    Returns
    -------
    Recording
    """
    generator = np.random.default_rng(rng)
    lowest, highest = value_range(recording)

    def stick(column: Column) -> tuple[Column, Spans]:
        value = generator.uniform((lowest + highest) / 2, highest) if level is None else level
        return np.full_like(column, value), throughout(column.size)

    return _inject(recording, "stuck", sensors, stick)


def drifting(
    recording: Recording, sensors: Sensors, *, rng: Randomness = 0, level: float = 0.3
) -> Recording:
    """Let the baseline of sensors wander, as capacitance does with temperature.

    Parameters
    ----------
    recording : Recording
    sensors : iterable of str or int
        Names or indices.
    rng : numpy.random.Generator or int
        Decides how it wanders.
    level : float
        How far it strays at most, as a share of the recording's range. 0.3: it can be mistaken for
        a light touch.

    Returns
    -------
    Recording
        A random walk is added, which starts at 0.
    """
    check_positive("level", level)
    generator = np.random.default_rng(rng)
    lowest, highest = value_range(recording)

    def drift(column: Column) -> tuple[Column, Spans]:
        walk = np.cumsum(generator.standard_normal(column.size))
        walk -= walk[0]
        furthest = float(np.abs(walk).max()) or 1.0
        return column + level * (highest - lowest) / furthest * walk, throughout(column.size)

    return _inject(recording, "drifting", sensors, drift)


def gain_spread(
    recording: Recording, sensors: Sensors, *, rng: Randomness = 0, factor: float = 5.0
) -> Recording:
    """Give sensors different gains.

    Parameters
    ----------
    recording : Recording
    sensors : iterable of str or int
        Names or indices.
    rng : numpy.random.Generator or int
        Draws the gains.
    factor : float
        Largest gain over the smallest, at least 1; drawn evenly on a logarithmic scale about 1.
        5: what elastomers of uneven thickness do.

    Returns
    -------
    Recording
        Readings are multiplied, rest and all.
    """
    if not (np.isfinite(factor) and factor >= 1):
        raise InputError(f"factor is {factor:g}; it must be at least 1")
    generator = np.random.default_rng(rng)

    def amplify(column: Column) -> tuple[Column, Spans]:
        return column * factor ** generator.uniform(-0.5, 0.5), throughout(column.size)

    return _inject(recording, "gain-spread", sensors, amplify)


def hysteresis(
    recording: Recording, sensors: Sensors, *, rng: Randomness = 0, recovery: float = 20.0
) -> Recording:
    """Let sensors come back to rest slowly, as foam and silicone do.

    Parameters
    ----------
    recording : Recording
    sensors : iterable of str or int
        Names or indices.
    rng : numpy.random.Generator or int
        Nothing here is random; taken so that all faults are called alike.
    recovery : float
        Frames in which what is left of a touch falls to 1/e. 20: a second at 20 frames a second.

    Returns
    -------
    Recording
        A reading rises at once, away from rest, and falls no faster than the skin recovers.
    """
    check_positive("recovery", recovery, "frames")
    kept = np.exp(-1 / recovery)

    def lag(column: Column) -> tuple[Column, Spans]:
        rest = rest_of(column)
        beyond = column - rest
        side = 1.0 if np.nanmax(beyond, initial=0) >= -np.nanmin(beyond, initial=0) else -1.0
        left, lagging = 0.0, np.array(column)
        for frame, depth in enumerate(side * beyond):
            left = max(kept * left, depth) if np.isfinite(depth) else kept * left
            if np.isfinite(depth):
                lagging[frame] = rest + side * left
        return lagging, throughout(column.size)

    return _inject(recording, "hysteresis", sensors, lag)


def quantised(
    recording: Recording, sensors: Sensors, *, rng: Randomness = 0, levels: int = 16
) -> Recording:
    """Round readings to a few values, as a cheap converter does.

    Parameters
    ----------
    recording : Recording
    sensors : iterable of str or int
        Names or indices.
    rng : numpy.random.Generator or int
        Nothing here is random; taken so that all faults are called alike.
    levels : int
        How many values over the recording's range, at least 2. 16: four bits.

    Returns
    -------
    Recording
    """
    check_count("levels", levels)
    if levels < 2:
        raise InputError(f"levels is {levels}; it must be at least 2")
    lowest, highest = value_range(recording)
    step = (highest - lowest) / (levels - 1) or 1.0

    def quantise(column: Column) -> tuple[Column, Spans]:
        return lowest + step * np.round((column - lowest) / step), throughout(column.size)

    return _inject(recording, "quantised", sensors, quantise)


def thresholded(
    recording: Recording, sensors: Sensors, *, rng: Randomness = 0, level: float = 0.1
) -> Recording:
    """Leave of each reading only whether the sensor is touched: 0 or 1.

    Parameters
    ----------
    recording : Recording
    sensors : iterable of str or int
        Names or indices.
    rng : numpy.random.Generator or int
        Nothing here is random; taken so that all faults are called alike.
    level : float
        How far from its rest a sensor counts as touched, as a share of the recording's range.

    Returns
    -------
    Recording
    """
    check_positive("level", level)
    lowest, highest = value_range(recording)

    def threshold(column: Column) -> tuple[Column, Spans]:
        touched = np.abs(column - rest_of(column)) > level * (highest - lowest)
        return np.where(np.isfinite(column), touched, column), throughout(column.size)

    return _inject(recording, "thresholded", sensors, threshold)


def nan_bursts(
    recording: Recording,
    sensors: Sensors,
    *,
    rng: Randomness = 0,
    mean_gap: float = 200.0,
    mean_span: float = 5.0,
) -> Recording:
    """Lose readings now and then, as a bus with a loose plug does.

    Parameters
    ----------
    recording : Recording
    sensors : iterable of str or int
        Names or indices.
    rng : numpy.random.Generator or int
        Decides when.
    mean_gap, mean_span : float
        How many frames, at least 1, pass on average between two bursts, and how many each lasts.

    Returns
    -------
    Recording
        Lost readings are NaN.
    """
    generator = np.random.default_rng(rng)

    def lose(column: Column) -> tuple[Column, Spans]:
        spans = random_spans(column.size, mean_gap, mean_span, generator)
        for start, stop in spans:
            column[start:stop] = np.nan
        return column, spans

    return _inject(recording, "nan-bursts", sensors, lose)


def rest_of(column: Column) -> float:
    """Estimate what a sensor reads at rest, whatever readings it misses."""
    filled = Recording(column[:, None]).complete("interpolate").readings
    return float(estimate_rest(filled).value[0])


def _inject(
    recording: Recording,
    kind: str,
    sensors: Sensors,
    spoil: Callable[[Column], tuple[Column, Spans]],
) -> Recording:
    readings, faults = np.array(recording.readings), []
    for i in recording.indices(sensors):
        readings[:, i], spans = spoil(readings[:, i].copy())
        faults.append(Fault(kind, recording.names[i], spans))
    return spoilt(recording, readings, faults)
