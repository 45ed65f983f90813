"""Documented, reproducible faults for any recording: of sensors, between sensors, and of frames.

To add a fault, add one function with a decorator of `anisomap.simulation.injection`. Defaults
without a source were chosen by hand. Faults of single sensors have levels in units of the range of
the recording; faults between sensors, in units of the median standard deviation of the chosen
sensors. Gaps and spans are geometrically distributed, with means of at least one frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.numerics.gaps import fill_gaps
from anisomap.numerics.neighbours import nearest_others
from anisomap.numerics.ranges import COUNT, FINITE, INNER_SHARE, POSITIVE, SHARE, at_least
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.recording import Recording
from anisomap.simulation.injection import (
    ALL_SENSORS,
    Channel,
    Fault,
    Group,
    Readings,
    Spans,
    all_frames,
    finite_range,
    frame_fault,
    group_fault,
    injected_faults,
    logged,
    sensor_fault,
)

_AT_LEAST_1 = at_least(1)
_BOARD = at_least(0, whole=True)

# x the interval to the next frame. Below 0.5, so that adjacent frames stay in order.
_MAX_JITTER = 0.45


@sensor_fault()
def dead(channel: Channel) -> Readings:
    """Fix sensors at their rest value.

    The rest value is the most frequent reading of each sensor, see
    `anisomap.numerics.similarity.rest.Rest`.
    """
    return np.full_like(channel.readings, channel.rest)


@sensor_fault(level=FINITE)
def stuck(channel: Channel, *, level: float | None = None) -> Readings:
    """Fix sensors at a value other than rest.

    The value, `level`, is in the unit of the readings. By default, it is drawn uniformly from the
    upper half of the range of the recording.
    """
    middle = (channel.lowest + channel.highest) / 2
    value = channel.rng.uniform(middle, channel.highest) if level is None else level
    return np.full_like(channel.readings, value)


@sensor_fault(level=FINITE, mean_gap=_AT_LEAST_1, mean_span=_AT_LEAST_1)
def saturating(
    channel: Channel,
    *,
    level: float | None = None,
    mean_gap: float = 100.0,
    mean_span: float = 20.0,
) -> tuple[Readings, Spans]:
    """Set sensors to full scale intermittently, independent of touch.

    Full scale, `level`, is in the unit of the readings, and by default the highest reading of the
    recording. A sensor is saturated one sixth of the time; in a recording that is short compared to
    `mean_gap`, it may never be.

    Sensor 30 of McGregor et al. (2011), section "Prototyping Issues": "a tendency to saturate
    intermittently regardless of whether it was being physically stimulated or not". The paper gives
    no lengths of spans and gaps.
    """
    return channel.overwritten(channel.highest if level is None else level, mean_gap, mean_span)


@sensor_fault(level=POSITIVE)
def noisy(channel: Channel, *, level: float = 0.1) -> Readings:
    """Add white Gaussian noise to sensors.

    Its standard deviation is `level`.
    """
    noise = channel.rng.standard_normal(channel.readings.size)
    return np.asarray(channel.readings + level * channel.span * noise)


@sensor_fault(level=POSITIVE)
def drifting(channel: Channel, *, level: float = 0.3) -> Readings:
    """Add a random walk to the baseline of sensors, like temperature drift.

    `level` is its largest deviation from 0, where it starts; 0.3 resembles a light touch.
    """
    walk = np.cumsum(channel.rng.standard_normal(channel.readings.size))
    walk -= walk[0]
    furthest = float(np.abs(walk).max()) or 1.0
    return np.asarray(channel.readings + level * channel.span / furthest * walk)


@sensor_fault(factor=_AT_LEAST_1)
def gain_spread(channel: Channel, *, factor: float = 5.0) -> Readings:
    """Multiply the readings of sensors by random gains.

    Gains are distributed uniformly around 1 on a logarithmic scale; `factor` is the ratio of the
    largest to the smallest. Rest values are multiplied, too.
    """
    return np.asarray(channel.readings * factor ** channel.rng.uniform(-0.5, 0.5))


@sensor_fault(recovery=POSITIVE)
def hysteresis(channel: Channel, *, recovery: float = 20.0) -> Readings:
    """Delay the return of sensors to rest, like foam and silicone.

    `recovery` is the time constant of the exponential return, in frames; 20 frames are 1 s at 20
    Hz. Readings move away from rest without delay.
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
def quantised(channel: Channel, *, levels: int = 16) -> Readings:
    """Round the readings of sensors to few levels, like a low-resolution converter.

    The levels divide the range of the recording; 16 are 4 bits.
    """
    step = channel.span / (levels - 1) or 1.0
    return np.asarray(channel.lowest + step * np.round((channel.readings - channel.lowest) / step))


@sensor_fault(level=POSITIVE)
def thresholded(channel: Channel, *, level: float = 0.1) -> Readings:
    """Reduce the readings of sensors to 0 (at rest) and 1 (touched).

    Deviations from rest by more than `level` count as touch.
    """
    touched = np.abs(channel.readings - channel.rest) > level * channel.span
    return np.where(np.isfinite(channel.readings), touched, channel.readings)


@sensor_fault(mean_gap=_AT_LEAST_1, mean_span=_AT_LEAST_1)
def nan_bursts(
    channel: Channel, *, mean_gap: float = 200.0, mean_span: float = 5.0
) -> tuple[Readings, Spans]:
    """Replace readings by NaN intermittently, like a loose connector."""
    return channel.overwritten(np.nan, mean_gap, mean_span)


@sensor_fault()
def inverted(channel: Channel) -> Readings:
    """Reverse the sign of contact of sensors: readings are subtracted from full scale.

    Full scale is the highest reading of the recording plus the lowest.
    """
    return np.asarray(channel.lowest + channel.highest - channel.readings)


@sensor_fault(level=POSITIVE, time=POSITIVE)
def warming(channel: Channel, *, level: float = 0.3, time: float = 0.3) -> Readings:
    """Raise the baseline of sensors exponentially towards a limit, like electronics that warm up.

    The limit is `level` times a random number between 0.5 and 1.5 and a random sign for each
    sensor; `time` is the time constant as a share of the recording.
    """
    course = 1 - np.exp(-np.linspace(0, 1 / time, channel.readings.size))
    limit = channel.rng.uniform(0.5, 1.5) * channel.rng.choice([-1.0, 1.0])
    return np.asarray(channel.readings + limit * level * channel.span * course)


@sensor_fault(level=INNER_SHARE)
def clipped(channel: Channel, *, level: float = 0.3) -> Readings:
    """Limit readings to a range that is too small.

    Its width is `level` times that of the readings of each sensor.
    """
    lowest, highest = finite_range(channel.readings)
    return np.minimum(channel.readings, lowest + level * (highest - lowest))


@sensor_fault(mean_gap=_AT_LEAST_1, mean_span=_AT_LEAST_1)
def bridged_gaps(
    channel: Channel, *, mean_gap: float = 50.0, mean_span: float = 50.0
) -> tuple[Readings, Spans]:
    """Replace spans of readings by a straight line, like a logger that interpolates losses."""
    known, before = np.isfinite(channel.readings), channel.readings.copy()
    lost, spans = channel.overwritten(np.nan, mean_gap, mean_span)
    return np.where(known, fill_gaps(lost[:, None])[:, 0], before), spans


@sensor_fault(level=POSITIVE, count=COUNT)
def glitching(channel: Channel, *, level: float = 100.0, count: int = 1) -> tuple[Readings, Spans]:
    """Replace single readings by values far outside the range, like a transmission error.

    `count` readings are replaced by a value that is `level` above the lowest one.
    """
    frames = np.sort(channel.rng.permutation(channel.readings.size)[:count])
    channel.readings[frames] = channel.lowest + level * (channel.span or 1.0)
    return channel.readings, _single_frames(frames)


@sensor_fault(contacts=COUNT)
def rarely_touched(channel: Channel, *, contacts: int = 2) -> Readings:
    """Set sensors to rest except during their first contacts.

    A contact is a run of frames off the rest value.
    """
    touched = channel.readings != channel.rest
    begins = touched & ~np.concatenate([[False], touched[:-1]])
    late = np.cumsum(begins) > contacts
    return np.where(late & np.isfinite(channel.readings), channel.rest, channel.readings)


@sensor_fault(period=at_least(2))
def cycling(channel: Channel, *, period: float = 50.0) -> Readings:
    """Replace the readings of sensors by sines of one period with random phases.

    The period is in frames, at least 2.
    """
    turns = np.arange(channel.readings.size) / period
    wave = (1 + np.sin(2 * np.pi * (turns + channel.rng.random()))) / 2
    return np.asarray(channel.lowest + (channel.span or 1.0) * wave)


@group_fault(share=SHARE, n_neighbours=COUNT)
def crosstalk(group: Group, *, share: float = 0.2, n_neighbours: int = 4) -> None:
    """Mix the readings of sensors with those of their neighbours.

    The mean of the nearest `n_neighbours` has the weight `share`. The recording must have true
    positions, which define the neighbours; 4 are those on a square grid.
    """
    recording, clean = group.recording, group.recording.readings
    if recording.positions is None:
        raise InputError("crosstalk needs a recording with true positions of its sensors")
    if n_neighbours >= recording.n_sensors:
        raise InputError(
            f"n_neighbours must be below the number of sensors ({recording.n_sensors}), "
            f"got {n_neighbours}"
        )
    chosen = np.array(group.chosen, dtype=np.intp)
    _, nearest = nearest_others(recording.positions, n_neighbours, chosen)
    for i, others in zip(chosen, nearest, strict=True):
        group.readings[:, i] = (1 - share) * clean[:, i] + share * clean[:, others].mean(axis=1)


@group_fault()
def swapped(group: Group) -> list[int]:
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
def rewired(group: Group, *, share: float = 0.5) -> None:
    """Exchange the readings of sensors from some frame on, like connectors that are moved.

    After a `share` of the recording, each sensor takes the readings of another, in a cycle of
    random order.
    """
    order = group.rng.permutation(np.array(group.chosen, dtype=np.intp))
    late = slice(int(share * len(group.readings)), None)
    group.readings[late, order] = group.readings[late, np.roll(order, 1)]


@group_fault()
def mirrored(group: Group) -> list[int]:
    """Reverse the order of the readings of a group of sensors, like a rotated module.

    The first sensor takes the readings of the last, and so on. The middle one of an odd number is
    not affected. Names and positions are kept.
    """
    chosen = group.in_order()
    return _rewired(group, chosen, chosen[::-1])


@group_fault(factor=_AT_LEAST_1, level=at_least(0))
def duplicated(
    group: Group, *, source: str | int | None = None, factor: float = 1.0, level: float = 0.0
) -> list[int]:
    """Replace the readings of sensors by those of another sensor, like one wire read twice.

    The name or index of the other sensor is `source`; by default, one is drawn for each copy. Each
    copy has a gain, see `gain_spread`, and white noise with a standard deviation of `level` times
    that of the readings that it copies.
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
    affected = _rewired(group, copies, sources)
    if factor == 1 and level == 0:
        return affected
    for i in copies:
        own = group.readings[:, i]
        known = own[np.isfinite(own)]
        noise = level * (known.std() if known.size else 0) * group.rng.standard_normal(own.size)
        group.readings[:, i] = own * factor ** group.rng.uniform(-0.5, 0.5) + noise
    return affected


@group_fault(share=SHARE)
def leaking(group: Group, *, share: float = 0.05) -> list[int]:
    """Add a share of the previous channel to each sensor, like a multiplexer that settles slowly.

    The first sensor of a recording receives nothing.
    """
    chosen = [i for i in group.chosen if i > 0]
    for i in chosen:
        group.readings[:, i] += share * group.recording.readings[:, i - 1]
    return chosen


@group_fault(frames=COUNT, board=_BOARD)
def lagging(group: Group, *, frames: int = 3, board: int = 0) -> list[int]:
    """Delay sensors, like boards that are polled late.

    All sensors lag by `frames`; the first reading is held meanwhile. With `board` sensors on a
    board, each board of the chosen sensors, in their order, lags `frames` more than the board
    before it; the first does not lag.
    """
    delayed: list[int] = []
    for number, members in enumerate(group.boards(board)):
        if delay := frames * number if board else frames:
            source = np.maximum(np.arange(len(group.readings)) - delay, 0)
            group.readings[:, members] = group.readings[source][:, members]
            delayed += members
    return delayed


@group_fault(level=POSITIVE, board=_BOARD)
def common_noise(group: Group, *, level: float = 1.0, board: int = 0) -> None:
    """Add the same white noise to all sensors of a board, like a noisy supply.

    The noise has a standard deviation of `level`. There are `board` sensors on a board, 0 for all
    on one board; each board has its own noise.
    """
    scale, n_frames = level * group.deviation, len(group.readings)
    for members in group.boards(board):
        group.readings[:, members] += scale * group.rng.standard_normal((n_frames, 1))


@group_fault(level=POSITIVE, share=SHARE, board=_BOARD)
def spiking(group: Group, *, level: float = 5.0, share: float = 0.02, board: int = 0) -> None:
    """Add spikes of single frames to all sensors of a board at once.

    A frame has a spike with the probability `share`; heights are distributed exponentially, with
    the mean `level`. There are `board` sensors on a board, 0 for all on one board; each board has
    its own spikes.
    """
    scale, n_frames = level * group.deviation, len(group.readings)
    for members in group.boards(board):
        heights = scale * group.rng.exponential(size=n_frames)
        struck = group.rng.random(n_frames) < share
        group.readings[:, members] += np.where(struck, heights, 0)[:, None]


@group_fault(level=POSITIVE, period=at_least(2), factor=_AT_LEAST_1)
def humming(group: Group, *, level: float = 1.0, period: float = 7.3, factor: float = 3.0) -> None:
    """Add a sine of one period and phase to sensors, each with a gain of its own.

    `level` is the median amplitude, `period` is in frames, by default not a whole number of them,
    and `factor` is the ratio of the largest to the smallest gain, see `gain_spread`.
    """
    phase = 2 * np.pi * (np.arange(len(group.readings)) / period + group.rng.random())
    gains = factor ** group.rng.uniform(-0.5, 0.5, len(group.chosen))
    group.readings[:, group.chosen] += level * group.deviation * np.outer(np.sin(phase), gains)


def _rewired(group: Group, targets: Sequence[int], sources: Sequence[int]) -> list[int]:
    group.readings[:, targets] = group.readings[:, sources]
    return [i for i, j in zip(targets, sources, strict=True) if i != j]


@frame_fault(share=INNER_SHARE)
def dropped_frames(
    recording: Recording, rng: np.random.Generator, *, share: float = 0.05
) -> Recording:
    """Remove random frames, like an overloaded logger.

    An expected `share` of the frames and their times are removed, but at least one remains; the
    nominal rate is kept. The log marks the frame after each gap, but no reading as wrong. Spans of
    earlier faults are renumbered.
    """
    lost = rng.random(recording.n_frames) < share
    if lost.all():
        lost[0] = False
    kept = np.flatnonzero(~lost)
    earlier = []
    for fault in injected_faults(recording):
        spans = (tuple(np.searchsorted(kept, span).tolist()) for span in fault.spans)
        left = tuple((start, stop) for start, stop in spans if stop > start)
        earlier.append(replace(fault, spans=left))
    times = None if recording.times is None else recording.times[kept]
    shorter = replace(recording, readings=recording.readings[kept], times=times)
    after_gap = np.flatnonzero(np.diff(kept, prepend=-1) > 1)
    return logged(shorter, [Fault("dropped-frames", "", _single_frames(after_gap))], earlier)


@frame_fault(share=INNER_SHARE)
def repeated_frames(
    recording: Recording, rng: np.random.Generator, *, share: float = 0.05
) -> Recording:
    """Replace random frames by the previous frame, like a slow driver.

    An expected `share` of the frames is replaced, never the first.
    """
    stale = rng.random(recording.n_frames) < share
    stale[0] = False
    source = np.maximum.accumulate(np.where(stale, 0, np.arange(recording.n_frames)))
    fault = Fault("repeated-frames", ALL_SENSORS, _single_frames(np.flatnonzero(stale)))
    return logged(replace(recording, readings=recording.readings[source]), [fault])


@frame_fault(level=INNER_SHARE)
def clock_jitter(
    recording: Recording, rng: np.random.Generator, *, level: float = 0.2
) -> Recording:
    """Add Gaussian jitter to the times of frames.

    Its standard deviation is `level` times the median interval, and it is limited to 0.45 of the
    intervals on either side, so that times increase. The recording must have times, or a rate from
    which they are computed. The log marks all frames, but no reading as wrong.
    """
    times = recording.times
    if times is None:
        if recording.rate_hz is None:
            raise InputError("clock jitter needs a recording with times or a rate")
        times = np.arange(recording.n_frames) / recording.rate_hz
    gaps = np.diff(times) if len(times) > 1 else np.ones(1)
    limit = _MAX_JITTER * np.minimum([*gaps, gaps[-1]], [gaps[0], *gaps])[: len(times)]
    jitter = level * float(np.median(gaps)) * rng.standard_normal(len(times))
    jittered = replace(recording, times=times + np.clip(jitter, -limit, limit))
    return logged(jittered, [Fault("clock-jitter", "", all_frames(recording))])


@frame_fault(regions=at_least(2, whole=True))
def separate_regions(
    recording: Recording, rng: np.random.Generator, *, regions: int = 2
) -> Recording:
    """Touch one region of the skin after the other, and nothing else meanwhile.

    The recording must have true positions, and is divided into as many runs as `regions`: slices of
    equal numbers of sensors along the direction in which the skin is longest. During each run, the
    sensors outside its region read their rest value.
    """
    if recording.positions is None:
        raise InputError("separating regions needs a recording with true positions of its sensors")
    if regions > min(recording.n_sensors, recording.n_frames):
        raise InputError(
            f"regions must be at most the number of sensors and of frames, got {regions}"
        )
    centred = recording.positions - recording.positions.mean(axis=0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    parts = np.array_split(np.argsort(along, kind="stable"), regions)
    edges = np.linspace(0, recording.n_frames, regions + 1).astype(int)
    rest = estimate_rest(recording.complete("interpolate").readings).value
    readings, faults = np.array(recording.readings), []
    for region, span in enumerate(pairwise(edges.tolist())):
        outside = np.concatenate([part for i, part in enumerate(parts) if i != region])
        readings[slice(*span), outside] = rest[outside]
        faults += [Fault("separate-regions", recording.names[i], (span,)) for i in outside.tolist()]
    return logged(replace(recording, readings=readings), faults)


def _single_frames(frames: NDArray[np.intp]) -> Spans:
    return tuple((frame, frame + 1) for frame in frames.tolist())
