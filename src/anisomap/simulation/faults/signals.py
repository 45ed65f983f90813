"""Faults of single sensors that change the course of their readings.

All functions take a recording, sensors and ``rng``, like those of
`anisomap.simulation.faults.sensors`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.numerics.gaps import fill_gaps
from anisomap.recording import Recording
from anisomap.simulation.checks import check_count, check_positive
from anisomap.simulation.faults.log import Spans
from anisomap.simulation.faults.sensors import (
    Channel,
    Column,
    Randomness,
    Sensors,
    inject_sensors,
    random_spans,
)


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
