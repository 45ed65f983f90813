"""Faults of single sensors."""

from __future__ import annotations

import numpy as np

from anisomap.numerics.gaps import fill_gaps
from anisomap.simulation.checks import COUNT, FINITE, INNER_SHARE, POSITIVE, at_least
from anisomap.simulation.faults.forms import Channel, Column, finite_range, sensor_fault
from anisomap.simulation.faults.log import Spans


@sensor_fault()
def dead(channel: Channel) -> Column:
    """Fix sensors at their rest value.

    The rest value is the most frequent reading of each sensor, see
    `anisomap.numerics.similarity.rest.Rest`.
    """
    return np.full_like(channel.readings, channel.rest)


@sensor_fault(level=FINITE)
def stuck(channel: Channel, *, level: float | None = None) -> Column:
    """Fix sensors at a value other than rest.

    Parameters
    ----------
    level : float, optional
        The value, in the unit of the readings. By default, drawn uniformly from the upper half of
        the range of the recording, to be distinct from rest.
    """
    middle = (channel.lowest + channel.highest) / 2
    value = channel.rng.uniform(middle, channel.highest) if level is None else level
    return np.full_like(channel.readings, value)


@sensor_fault(level=FINITE, mean_gap=at_least(1), mean_span=at_least(1))
def saturating(
    channel: Channel,
    *,
    level: float | None = None,
    mean_gap: float = 100.0,
    mean_span: float = 20.0,
) -> tuple[Column, Spans]:
    """Set sensors to full scale intermittently, independent of touch.

    Parameters
    ----------
    level : float, optional
        Full scale, in the unit of the readings. Defaults to the highest reading of the recording.
    mean_gap, mean_span : float
        Mean number of frames between saturated spans, and of their length; at least 1. Both are
        geometrically distributed. Chosen by hand, as the paper gives no values: a sensor is
        saturated one sixth of the time. In a recording that is short compared to `mean_gap`,
        sensors may have no saturated span.

    Notes
    -----
    Sensor 30 of McGregor et al. (2011), section "Prototyping Issues": "a tendency to saturate
    intermittently regardless of whether it was being physically stimulated or not".
    """
    return channel.overwritten(channel.highest if level is None else level, mean_gap, mean_span)


@sensor_fault(level=POSITIVE)
def noisy(channel: Channel, *, level: float = 0.1) -> Column:
    """Add white Gaussian noise to sensors.

    Parameters
    ----------
    level : float
        Standard deviation, as a share of the range of the recording.
    """
    noise = channel.rng.standard_normal(channel.readings.size)
    return np.asarray(channel.readings + level * channel.span * noise)


@sensor_fault(level=POSITIVE)
def drifting(channel: Channel, *, level: float = 0.3) -> Column:
    """Add a random walk to the baseline of sensors, like temperature drift.

    Parameters
    ----------
    level : float
        Largest deviation of the walk, which starts at 0, as a share of the range of the recording.
        Chosen by hand: 0.3 resembles a light touch.
    """
    walk = np.cumsum(channel.rng.standard_normal(channel.readings.size))
    walk -= walk[0]
    furthest = float(np.abs(walk).max()) or 1.0
    return np.asarray(channel.readings + level * channel.span / furthest * walk)


@sensor_fault(factor=at_least(1))
def gain_spread(channel: Channel, *, factor: float = 5.0) -> Column:
    """Multiply the readings of sensors by random gains.

    Parameters
    ----------
    factor : float
        Ratio of the largest to the smallest gain, at least 1. Gains are distributed uniformly
        around 1 on a logarithmic scale. Rest values are multiplied, too. Chosen by hand for
        elastomers of uneven thickness.
    """
    return np.asarray(channel.readings * factor ** channel.rng.uniform(-0.5, 0.5))


@sensor_fault(recovery=POSITIVE)
def hysteresis(channel: Channel, *, recovery: float = 20.0) -> Column:
    """Delay the return of sensors to rest, like foam and silicone.

    Parameters
    ----------
    recovery : float
        Time constant of the exponential return to rest, in frames. Readings move away from rest
        without delay. Chosen by hand: 20 frames are 1 s at 20 Hz.
    """
    kept, rest = np.exp(-1 / recovery), channel.rest
    beyond = channel.readings - rest
    side = 1.0 if np.nanmax(beyond, initial=0) >= -np.nanmin(beyond, initial=0) else -1.0
    left, lagging = 0.0, np.array(channel.readings)
    for frame, depth in enumerate(side * beyond):
        left = max(kept * left, depth) if np.isfinite(depth) else kept * left
        if np.isfinite(depth):
            lagging[frame] = rest + side * left
    return lagging


@sensor_fault(levels=at_least(2, whole=True))
def quantised(channel: Channel, *, levels: int = 16) -> Column:
    """Round the readings of sensors to few levels, like a low-resolution converter.

    Parameters
    ----------
    levels : int
        Number of levels over the range of the recording, at least 2. 16 are 4 bits.
    """
    step = channel.span / (levels - 1) or 1.0
    return np.asarray(channel.lowest + step * np.round((channel.readings - channel.lowest) / step))


@sensor_fault(level=POSITIVE)
def thresholded(channel: Channel, *, level: float = 0.1) -> Column:
    """Reduce the readings of sensors to 0 (at rest) and 1 (touched).

    Parameters
    ----------
    level : float
        Minimum deviation from rest that counts as touch, as a share of the range of the recording.
    """
    touched = np.abs(channel.readings - channel.rest) > level * channel.span
    return np.where(np.isfinite(channel.readings), touched, channel.readings)


@sensor_fault(mean_gap=at_least(1), mean_span=at_least(1))
def nan_bursts(
    channel: Channel, *, mean_gap: float = 200.0, mean_span: float = 5.0
) -> tuple[Column, Spans]:
    """Replace readings by NaN intermittently, like a loose connector.

    Parameters
    ----------
    mean_gap, mean_span : float
        Mean number of frames between bursts, and of their length; at least 1. Both are
        geometrically distributed. Chosen by hand.
    """
    return channel.overwritten(np.nan, mean_gap, mean_span)


@sensor_fault()
def inverted(channel: Channel) -> Column:
    """Reverse the sign of contact of sensors: readings are subtracted from full scale.

    Full scale is the highest reading of the recording plus the lowest.
    """
    return np.asarray(channel.lowest + channel.highest - channel.readings)


@sensor_fault(level=POSITIVE, time=POSITIVE)
def warming(channel: Channel, *, level: float = 0.3, time: float = 0.3) -> Column:
    """Raise the baseline of sensors exponentially towards a limit, like electronics that warm up.

    Parameters
    ----------
    level : float
        Limit, as a share of the range of the recording, times a random number between 0.5 and 1.5
        and a random sign for each sensor.
    time : float
        Time constant as a share of the recording; chosen by hand.
    """
    course = 1 - np.exp(-np.linspace(0, 1 / time, channel.readings.size))
    limit = channel.rng.uniform(0.5, 1.5) * channel.rng.choice([-1.0, 1.0])
    return np.asarray(channel.readings + limit * level * channel.span * course)


@sensor_fault(level=INNER_SHARE)
def clipped(channel: Channel, *, level: float = 0.3) -> Column:
    """Limit readings to a range that is too small.

    Parameters
    ----------
    level : float
        Highest possible reading, as a share of the range of each sensor, between 0 and 1.
    """
    lowest, highest = finite_range(channel.readings)
    return np.minimum(channel.readings, lowest + level * (highest - lowest))


@sensor_fault(mean_gap=at_least(1), mean_span=at_least(1))
def bridged_gaps(
    channel: Channel, *, mean_gap: float = 50.0, mean_span: float = 50.0
) -> tuple[Column, Spans]:
    """Replace spans of readings by a straight line, like a logger that interpolates losses.

    Parameters
    ----------
    mean_gap, mean_span : float
        Mean number of frames between spans, and of their length; at least 1. Both are
        geometrically distributed. Half of the readings are lost by default.
    """
    known, before = np.isfinite(channel.readings), channel.readings.copy()
    lost, spans = channel.overwritten(np.nan, mean_gap, mean_span)
    return np.where(known, fill_gaps(lost[:, None])[:, 0], before), spans


@sensor_fault(level=POSITIVE, count=COUNT)
def glitching(channel: Channel, *, level: float = 100.0, count: int = 1) -> tuple[Column, Spans]:
    """Replace single readings by values far outside the range, like a transmission error.

    Parameters
    ----------
    level : float
        The value above the lowest reading, in ranges of the recording.
    count : int
        Number of readings, at least 1.
    """
    frames = np.sort(channel.rng.permutation(channel.readings.size)[:count])
    channel.readings[frames] = channel.lowest + level * (channel.span or 1.0)
    return channel.readings, tuple((frame, frame + 1) for frame in frames.tolist())


@sensor_fault(contacts=COUNT)
def rarely_touched(channel: Channel, *, contacts: int = 2) -> Column:
    """Set sensors to rest except during their first contacts.

    Parameters
    ----------
    contacts : int
        Number of contacts (runs of frames off the rest value) that remain, at least 1.
    """
    touched = channel.readings != channel.rest
    begins = touched & ~np.concatenate([[False], touched[:-1]])
    late = np.cumsum(begins) > contacts
    return np.where(late & np.isfinite(channel.readings), channel.rest, channel.readings)


@sensor_fault(period=at_least(2))
def cycling(channel: Channel, *, period: float = 50.0) -> Column:
    """Replace the readings of sensors by sines of one period with random phases.

    Parameters
    ----------
    period : float
        Period in frames, at least 2; chosen by hand.
    """
    turns = np.arange(channel.readings.size) / period
    wave = (1 + np.sin(2 * np.pi * (turns + channel.rng.random()))) / 2
    return np.asarray(channel.lowest + (channel.span or 1.0) * wave)
