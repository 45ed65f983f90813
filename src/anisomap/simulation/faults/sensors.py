"""Faults of single sensors.

All functions take a recording, sensors (names or indices) and ``rng`` (a numpy Generator or a seed,
ignored by faults that are not random), and return a new recording with the fault in its log. They
raise InputError if a sensor does not exist or a parameter is outside its range.

Faults of single sensors that change the course of their readings.

All functions take a recording, sensors and ``rng``, like those of
`anisomap.simulation.faults.sensors`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.numerics.gaps import fill_gaps
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.recording import Recording
from anisomap.simulation.checks import check_count, check_positive
from anisomap.simulation.faults.log import Fault, Spans, all_frames, with_faults

Column: TypeAlias = NDArray[np.floating]
Sensors: TypeAlias = Iterable[str | int]
Randomness: TypeAlias = np.random.Generator | int


@dataclass(frozen=True, eq=False)
class Channel:
    """Readings of one sensor before a fault.

    Attributes
    ----------
    readings : ndarray of shape (T,)
        A copy.
    lowest, highest : float
        Range of the finite readings of all sensors; 0 and 0 if there are none.
    rng : numpy.random.Generator
    """

    readings: Column
    lowest: float
    highest: float
    rng: np.random.Generator

    @property
    def span(self) -> float:
        """Width of the range of the recording."""
        return self.highest - self.lowest

    @property
    def rest(self) -> float:
        """Estimated reading at rest. Missing readings are interpolated first."""
        complete = Recording(self.readings[:, None]).complete("interpolate")
        return float(estimate_rest(complete.readings).value[0])

    def overwritten(self, value: float, mean_gap: float, mean_span: float) -> tuple[Column, Spans]:
        """Set the readings of random spans to a value; see `random_spans`."""
        spans = random_spans(self.readings.size, mean_gap, mean_span, self.rng)
        for start, stop in spans:
            self.readings[start:stop] = value
        return self.readings, spans


def dead(recording: Recording, sensors: Sensors, *, rng: Randomness = 0) -> Recording:
    """Fix sensors at their rest value.

    The rest value is the most frequent reading of each sensor, see
    `anisomap.numerics.similarity.rest.Rest`.
    """
    return inject_sensors(
        recording,
        "dead",
        sensors,
        rng,
        lambda channel: np.full_like(channel.readings, channel.rest),
    )


def saturating(
    recording: Recording,
    sensors: Sensors,
    *,
    rng: Randomness = 0,
    level: float | None = None,
    mean_gap: float = 100.0,
    mean_span: float = 20.0,
) -> Recording:
    """Set sensors to full scale intermittently, independent of touch.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    level : float, optional
        Full scale, in the unit of the readings. Defaults to the highest reading of the recording.
    mean_gap, mean_span : float
        Mean number of frames between saturated spans, and of their length; at least 1. Both are
        geometrically distributed. Chosen by hand, as the paper gives no values: a sensor is
        saturated one sixth of the time.

    Returns
    -------
    Recording
        In a recording that is short compared to `mean_gap`, sensors may have no saturated span.

    Raises
    ------
    InputError
        If `mean_gap` or `mean_span` is below 1.

    Notes
    -----
    Sensor 30 of McGregor et al. (2011), section "Prototyping Issues": "a tendency to saturate
    intermittently regardless of whether it was being physically stimulated or not".
    """

    def saturate(channel: Channel) -> tuple[Column, Spans]:
        full_scale = channel.highest if level is None else level
        return channel.overwritten(full_scale, mean_gap, mean_span)

    return inject_sensors(recording, "saturating", sensors, rng, saturate)


def noisy(
    recording: Recording, sensors: Sensors, *, rng: Randomness = 0, level: float = 0.1
) -> Recording:
    """Add white Gaussian noise to sensors.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    level : float
        Standard deviation, as a share of the range of the recording.
    """
    check_positive("level", level)

    def disturb(channel: Channel) -> Column:
        noise = channel.rng.standard_normal(channel.readings.size)
        return np.asarray(channel.readings + level * channel.span * noise)

    return inject_sensors(recording, "noisy", sensors, rng, disturb)


def stuck(
    recording: Recording, sensors: Sensors, *, rng: Randomness = 0, level: float | None = None
) -> Recording:
    """Fix sensors at a value other than rest.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    level : float, optional
        The value, in the unit of the readings. By default, drawn uniformly from the upper half of
        the range of the recording, to be distinct from rest.
    """

    def fix(channel: Channel) -> Column:
        middle = (channel.lowest + channel.highest) / 2
        value = channel.rng.uniform(middle, channel.highest) if level is None else level
        return np.full_like(channel.readings, value)

    return inject_sensors(recording, "stuck", sensors, rng, fix)


def drifting(
    recording: Recording, sensors: Sensors, *, rng: Randomness = 0, level: float = 0.3
) -> Recording:
    """Add a random walk to the baseline of sensors, like temperature drift.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    level : float
        Largest deviation of the walk, which starts at 0, as a share of the range of the recording.
        Chosen by hand: 0.3 resembles a light touch.
    """
    check_positive("level", level)

    def drift(channel: Channel) -> Column:
        walk = np.cumsum(channel.rng.standard_normal(channel.readings.size))
        walk -= walk[0]
        furthest = float(np.abs(walk).max()) or 1.0
        return np.asarray(channel.readings + level * channel.span / furthest * walk)

    return inject_sensors(recording, "drifting", sensors, rng, drift)


def gain_spread(
    recording: Recording, sensors: Sensors, *, rng: Randomness = 0, factor: float = 5.0
) -> Recording:
    """Multiply the readings of sensors by random gains.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    factor : float
        Ratio of the largest to the smallest gain, at least 1. Gains are distributed uniformly
        around 1 on a logarithmic scale. Rest values are multiplied, too. Chosen by hand for
        elastomers of uneven thickness.
    """
    if not (np.isfinite(factor) and factor >= 1):
        raise InputError(f"factor must be at least 1, got {factor:g}")

    def amplify(channel: Channel) -> Column:
        return np.asarray(channel.readings * factor ** channel.rng.uniform(-0.5, 0.5))

    return inject_sensors(recording, "gain-spread", sensors, rng, amplify)


def hysteresis(
    recording: Recording, sensors: Sensors, *, rng: Randomness = 0, recovery: float = 20.0
) -> Recording:
    """Delay the return of sensors to rest, like foam and silicone.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    recovery : float
        Time constant of the exponential return to rest, in frames. Readings move away from rest
        without delay. Chosen by hand: 20 frames are 1 s at 20 Hz.
    """
    check_positive("recovery", recovery, "frames")
    kept = np.exp(-1 / recovery)

    def lag(channel: Channel) -> Column:
        rest = channel.rest
        beyond = channel.readings - rest
        side = 1.0 if np.nanmax(beyond, initial=0) >= -np.nanmin(beyond, initial=0) else -1.0
        left, lagging = 0.0, np.array(channel.readings)
        for frame, depth in enumerate(side * beyond):
            left = max(kept * left, depth) if np.isfinite(depth) else kept * left
            if np.isfinite(depth):
                lagging[frame] = rest + side * left
        return lagging

    return inject_sensors(recording, "hysteresis", sensors, rng, lag)


def quantised(
    recording: Recording, sensors: Sensors, *, rng: Randomness = 0, levels: int = 16
) -> Recording:
    """Round the readings of sensors to few levels, like a low-resolution converter.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    levels : int
        Number of levels over the range of the recording, at least 2. 16 are 4 bits.
    """
    check_count("levels", levels)
    if levels < 2:
        raise InputError(f"levels must be at least 2, got {levels}")

    def quantise(channel: Channel) -> Column:
        step = channel.span / (levels - 1) or 1.0
        rounded = np.round((channel.readings - channel.lowest) / step)
        return np.asarray(channel.lowest + step * rounded)

    return inject_sensors(recording, "quantised", sensors, rng, quantise)


def thresholded(
    recording: Recording, sensors: Sensors, *, rng: Randomness = 0, level: float = 0.1
) -> Recording:
    """Reduce the readings of sensors to 0 (at rest) and 1 (touched).

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    level : float
        Minimum deviation from rest that counts as touch, as a share of the range of the recording.
    """
    check_positive("level", level)

    def threshold(channel: Channel) -> Column:
        touched = np.abs(channel.readings - channel.rest) > level * channel.span
        return np.where(np.isfinite(channel.readings), touched, channel.readings)

    return inject_sensors(recording, "thresholded", sensors, rng, threshold)


def nan_bursts(
    recording: Recording,
    sensors: Sensors,
    *,
    rng: Randomness = 0,
    mean_gap: float = 200.0,
    mean_span: float = 5.0,
) -> Recording:
    """Replace readings by NaN intermittently, like a loose connector.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    mean_gap, mean_span : float
        Mean number of frames between bursts, and of their length; at least 1. Both are
        geometrically distributed. Chosen by hand.
    """

    def lose(channel: Channel) -> tuple[Column, Spans]:
        return channel.overwritten(np.nan, mean_gap, mean_span)

    return inject_sensors(recording, "nan-bursts", sensors, rng, lose)


def random_spans(
    n_frames: int, mean_gap: float, mean_span: float, rng: np.random.Generator
) -> Spans:
    """Draw spans of frames with geometrically distributed gaps and lengths.

    Raises
    ------
    InputError
        If a mean is below 1 frame.
    """
    for name, frames in {"mean_gap": mean_gap, "mean_span": mean_span}.items():
        if not (np.isfinite(frames) and frames >= 1):
            raise InputError(f"{name} must be at least 1 frame, got {frames:g}")
    # A gap and a span take at least two frames together, so this number fills the recording.
    shape = (n_frames // 2 + 1, 2)
    edges = rng.geometric([1 / mean_gap, 1 / mean_span], size=shape).cumsum().reshape(shape)
    return tuple(
        (int(start), int(min(stop, n_frames))) for start, stop in edges if start < n_frames
    )


def inject_sensors(
    recording: Recording,
    kind: str,
    sensors: Sensors,
    rng: Randomness,
    effect: Callable[[Channel], Column | tuple[Column, Spans]],
) -> Recording:
    """Apply an effect to each sensor and log it.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    kind : str
        Name of the fault in the log.
    effect : callable
        Takes a `Channel` and returns its new readings, or these and the affected spans. Without
        spans, all frames are affected.
    """
    generator = np.random.default_rng(rng)
    finite = recording.readings[np.isfinite(recording.readings)]
    lowest, highest = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    readings, faults = np.array(recording.readings), []
    for i in recording.indices(sensors):
        found = effect(Channel(readings[:, i].copy(), lowest, highest, generator))
        readings[:, i], spans = (
            found if isinstance(found, tuple) else (found, all_frames(recording.n_frames))
        )
        faults.append(Fault(kind, recording.names[i], spans))
    return with_faults(recording, readings, faults)


def inverted(recording: Recording, sensors: Sensors, *, rng: Randomness = 0) -> Recording:
    """Reverse the sign of contact of sensors: readings are subtracted from full scale.

    Full scale is the highest reading of the recording plus the lowest.
    """
    return inject_sensors(
        recording,
        "inverted",
        sensors,
        rng,
        lambda channel: np.asarray(channel.lowest + channel.highest - channel.readings),
    )


def warming(
    recording: Recording,
    sensors: Sensors,
    *,
    rng: Randomness = 0,
    level: float = 0.3,
    time: float = 0.3,
) -> Recording:
    """Raise the baseline of sensors exponentially towards a limit, like electronics that warm up.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    level : float
        Limit, as a share of the range of the recording, times a random number between 0.5 and 1.5
        and a random sign for each sensor.
    time : float
        Time constant as a share of the recording; chosen by hand.
    """
    check_positive("level", level)
    check_positive("time", time)
    course = 1 - np.exp(-np.linspace(0, 1 / time, recording.n_frames))

    def warm(channel: Channel) -> Column:
        limit = channel.rng.uniform(0.5, 1.5) * channel.rng.choice([-1.0, 1.0])
        return np.asarray(channel.readings + limit * level * channel.span * course)

    return inject_sensors(recording, "warming", sensors, rng, warm)


def clipped(
    recording: Recording, sensors: Sensors, *, rng: Randomness = 0, level: float = 0.3
) -> Recording:
    """Limit readings to a range that is too small.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    level : float
        Highest possible reading, as a share of the range of each sensor, between 0 and 1.

    Raises
    ------
    InputError
        If `level` is not between 0 and 1.
    """
    if not 0 < level < 1:
        raise InputError(f"level must be above 0 and below 1, got {level:g}")

    def limit(channel: Channel) -> Column:
        lowest, highest = _range(channel.readings)
        return np.minimum(channel.readings, lowest + level * (highest - lowest))

    return inject_sensors(recording, "clipped", sensors, rng, limit)


def bridged_gaps(
    recording: Recording,
    sensors: Sensors,
    *,
    rng: Randomness = 0,
    mean_gap: float = 50.0,
    mean_span: float = 50.0,
) -> Recording:
    """Replace spans of readings by a straight line, like a logger that interpolates losses.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    mean_gap, mean_span : float
        Mean number of frames between spans, and of their length; at least 1. Both are
        geometrically distributed. Half of the readings are lost by default.
    """

    def bridge(channel: Channel) -> tuple[Column, Spans]:
        known = np.isfinite(channel.readings)
        lost = np.array(channel.readings)
        spans = random_spans(lost.size, mean_gap, mean_span, channel.rng)
        for start, stop in spans:
            lost[start:stop] = np.nan
        filled = fill_gaps(lost[:, None])[:, 0]
        return np.where(known, filled, channel.readings), spans

    return inject_sensors(recording, "bridged-gaps", sensors, rng, bridge)


def rarely_touched(
    recording: Recording, sensors: Sensors, *, rng: Randomness = 0, contacts: int = 2
) -> Recording:
    """Set sensors to rest except during their first contacts.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    contacts : int
        Number of contacts (runs of frames off the rest value) that remain, at least 1.
    """
    check_count("contacts", contacts)

    def rest(channel: Channel) -> Column:
        touched = channel.readings != channel.rest
        begins = touched & ~np.concatenate([[False], touched[:-1]])
        late = np.cumsum(begins) > contacts
        return np.where(late & np.isfinite(channel.readings), channel.rest, channel.readings)

    return inject_sensors(recording, "rarely-touched", sensors, rng, rest)


def cycling(
    recording: Recording, sensors: Sensors, *, rng: Randomness = 0, period: float = 50.0
) -> Recording:
    """Replace the readings of sensors by sines of one period with random phases.

    Parameters
    ----------
    recording, sensors, rng
        See `FAULTS`.
    period : float
        Period in frames, at least 2; chosen by hand.

    Raises
    ------
    InputError
        If `period` is below 2.
    """
    if not period >= 2:
        raise InputError(f"period must be at least 2 frames, got {period:g}")
    turns = np.arange(recording.n_frames) / period

    def cycle(channel: Channel) -> Column:
        height = channel.span or 1.0
        wave = (1 + np.sin(2 * np.pi * (turns + channel.rng.random()))) / 2
        return np.asarray(channel.lowest + height * wave)

    return inject_sensors(recording, "cycling", sensors, rng, cycle)


def _range(readings: NDArray[np.floating]) -> tuple[float, float]:
    """Return the range of the finite readings; 0 and 0 if there are none."""
    finite = readings[np.isfinite(readings)]
    return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
