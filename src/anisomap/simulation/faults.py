"""Reproducible faults for any recording, simulated or real: of sensors, of wiring, of frames.

A fault is a function of a `Target` and of parameters with defaults, which returns the readings of
the chosen sensors, or a recording if frames are lost. To add a fault, add a function, its name to
`FAULTS`, and the range of a new parameter to `RANGES`. Defaults without a source were chosen by
hand. Levels are in units of the range of the recording, and those of faults of boards in units of
the median standard deviation of the chosen sensors. Gaps and spans are geometrically distributed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from inspect import signature
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.errors import InputError
from anisomap.numerics.gaps import fill_gaps
from anisomap.numerics.ranges import COUNT, FINITE, NOT_NEGATIVE, POSITIVE, SHARE, Range, at_least
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.recording import Recording
from anisomap.simulation.options import parse_parameters

Readings: TypeAlias = NDArray[np.floating]
Points: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Target:
    """A recording before a fault, indices of the chosen sensors as given, and a generator."""

    recording: Recording
    chosen: NDArray[np.intp]
    rng: np.random.Generator

    @property
    def readings(self) -> Readings:
        """A copy of the readings of the chosen sensors, shape (T, k)."""
        return np.array(self.recording.readings[:, self.chosen])

    @cached_property
    def rest(self) -> Readings:
        """Estimated readings at rest, (k,); missing readings are interpolated first."""
        complete = Recording(self.readings).complete("interpolate").readings
        return np.asarray(estimate_rest(complete).value, dtype=complete.dtype)

    @cached_property
    def limits(self) -> tuple[float, float]:
        """Lowest and highest finite reading of the recording; 0 and 0 if there are none."""
        finite = self.recording.readings[np.isfinite(self.recording.readings)]
        return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)

    @property
    def span(self) -> float:
        """Width of the range of the recording."""
        return self.limits[1] - self.limits[0]

    @cached_property
    def deviation(self) -> float:
        """Median standard deviation of the chosen sensors; 1 if none varies."""
        readings = self.readings.astype(np.float64)
        known = np.isfinite(readings)
        seen = known.any(axis=0)
        deviations = readings[:, seen].std(axis=0, where=known[:, seen])
        varying = deviations[deviations > 0]
        return float(np.median(varying)) if varying.size else 1.0

    def boards(self, size: int) -> list[slice]:
        """Divide the chosen sensors into boards of a size; 0 makes one board of all."""
        step = size or max(1, len(self.chosen))
        return [slice(at, at + step) for at in range(0, len(self.chosen), step)]

    def spans(self, mean_gap: float, mean_span: float, count: int) -> NDArray[np.bool_]:
        """Draw spans of frames for each of some sensors or boards, (T, count)."""
        marked = np.zeros((self.recording.n_frames, count), dtype=np.bool_)
        # A gap and a span take at least two frames together, so this number fills the recording.
        shape = (len(marked) // 2 + 1, 2)
        for column in marked.T:
            edges = self.rng.geometric([1 / mean_gap, 1 / mean_span], shape).cumsum().reshape(shape)
            for start, stop in edges[edges[:, 0] < len(marked)]:
                column[start:stop] = True
        return marked

    def overwritten(self, value: Any, mean_gap: float, mean_span: float) -> Readings:
        """Set random spans of the chosen sensors to a value."""
        return np.where(self.spans(mean_gap, mean_span, len(self.chosen)), value, self.readings)

    def walks(self) -> Points:
        """Draw a random walk for each sensor, from 0 to at most 1 away from it; (T, k)."""
        walks = np.cumsum(self.rng.standard_normal(self.readings.shape[::-1]), axis=1).T
        walks -= walks[0]
        furthest = np.abs(walks).max(axis=0)
        return np.asarray(walks / np.where(furthest > 0, furthest, 1))

    def along(self) -> tuple[Points, Points]:
        """Return true positions about their mean, (N, d), and where the skin is longest, (d,)."""
        if self.recording.positions is None:
            raise InputError("this fault needs a recording with true positions of its sensors")
        centred = self.recording.positions - self.recording.positions.mean(axis=0)
        return centred, np.linalg.svd(centred, full_matrices=False)[2][0]


def dead(target: Target) -> Readings:
    """Fix sensors at their rest value, the most frequent reading of each."""
    return np.broadcast_to(target.rest, target.readings.shape)


def stuck(target: Target, *, value: float | None = None) -> Readings:
    """Fix sensors at a value: by default, one from the upper half of the range for each."""
    lowest, highest = target.limits
    drawn = target.rng.uniform((lowest + highest) / 2, highest, len(target.chosen))
    return np.broadcast_to(drawn if value is None else value, target.readings.shape)


def saturating(
    target: Target, *, value: float | None = None, mean_gap: float = 100, mean_span: float = 20
) -> Readings:
    """Set sensors to full scale, by default that of the recording, independent of touch.

    Like sensor 30 of McGregor et al. (2011), "Prototyping Issues", which gives no lengths.
    """
    return target.overwritten(target.limits[1] if value is None else value, mean_gap, mean_span)


def intermittent(target: Target, *, mean_gap: float = 50, mean_span: float = 20) -> Readings:
    """Set sensors to rest intermittently, like a contact that comes and goes."""
    return target.overwritten(target.rest, mean_gap, mean_span)


def nan_bursts(target: Target, *, mean_gap: float = 200, mean_span: float = 5) -> Readings:
    """Replace readings by NaN intermittently, like a loose connector that is noticed."""
    return target.overwritten(np.nan, mean_gap, mean_span)


def bridged_gaps(target: Target, *, mean_gap: float = 50, mean_span: float = 50) -> Readings:
    """Replace spans of readings by a straight line, like a logger that interpolates losses."""
    lost = target.overwritten(np.nan, mean_gap, mean_span)
    return np.where(np.isfinite(target.readings), fill_gaps(lost), target.readings)


def rarely_touched(target: Target, *, contacts: int = 2) -> Readings:
    """Set sensors to rest except during their first contacts: runs of frames off rest."""
    readings = target.readings
    touched = readings != target.rest
    begins = touched & ~np.vstack([np.zeros_like(touched[:1]), touched[:-1]])
    late = np.cumsum(begins, axis=0) > contacts
    return np.where(late & np.isfinite(readings), target.rest, readings)


def noisy(target: Target, *, level: float = 0.1) -> Readings:
    """Add white Gaussian noise with a standard deviation of `level` to sensors."""
    noise = target.rng.standard_normal(target.readings.shape[::-1]).T
    return np.asarray(target.readings + level * target.span * noise)


def quantised(target: Target, *, levels: int = 16) -> Readings:
    """Round readings to few levels of the range, like a low-resolution converter."""
    lowest, step = target.limits[0], target.span / (levels - 1) or 1.0
    return np.asarray(lowest + step * np.round((target.readings - lowest) / step))


def thresholded(target: Target, *, level: float = 0.1) -> Readings:
    """Reduce readings to 0 (at rest) and 1 (off rest by more than `level`)."""
    touched = np.abs(target.readings - target.rest) > level * target.span
    return np.where(np.isfinite(target.readings), touched, target.readings)


def clipped(target: Target, *, share: float = 0.3) -> Readings:
    """Limit the readings of each sensor to the lowest `share` of their own range."""
    readings = target.readings.astype(np.float64)
    known = np.isfinite(readings)
    lowest = readings.min(axis=0, initial=target.limits[1], where=known)
    highest = readings.max(axis=0, initial=target.limits[0], where=known)
    return np.where(known, np.minimum(readings, lowest + share * (highest - lowest)), readings)


def stuck_bit(target: Target, *, bit: int = 6, bits: int = 8) -> Readings:
    """Set a bit of a converter of the range of the recording for good; bit 0 is the least."""
    if bit >= bits:
        raise InputError(f"bit must be below bits ({bits}), got {bit}")
    readings, lowest = target.readings, target.limits[0]
    step, known = target.span / (2**bits - 1) or 1.0, np.isfinite(readings)
    codes = np.where(known, np.round((readings - lowest) / step), 0).astype(np.int64)
    return np.where(known, lowest + step * (codes | 2**bit), readings)


def inverted(target: Target) -> Readings:
    """Reverse the sign of contact: the range of the recording is turned upside down."""
    return np.asarray(sum(target.limits) - target.readings)


def drifting(target: Target, *, level: float = 0.3) -> Readings:
    """Add a random walk to the baselines of sensors, at most `level`, like temperature drift."""
    return np.asarray(target.readings + level * target.span * target.walks())


def gain_drift(target: Target, *, factor: float = 3) -> Readings:
    """Multiply deviations from rest by gains that wander from 1 to `factor` or 1 / `factor`."""
    return np.asarray(target.rest + (target.readings - target.rest) * factor ** target.walks())


def warming(target: Target, *, level: float = 0.3, time: float = 0.3) -> Readings:
    """Raise or lower baselines exponentially towards a limit, like electronics that warm up.

    Limits lie between 0.5 and 1.5 times `level`; `time` is a share of the recording.
    """
    course = 1 - np.exp(-np.linspace(0, 1 / time, target.recording.n_frames))
    limits = [target.rng.uniform(0.5, 1.5) * target.rng.choice([-1.0, 1.0]) for _ in target.chosen]
    return np.asarray(target.readings + np.outer(course, limits) * level * target.span)


def stepping(target: Target, *, level: float = 0.3, count: int = 3) -> Readings:
    """Shift the baseline of each sensor at `count` random frames, with an sd of `level`."""
    jumps = np.zeros(target.readings.shape)
    for column in jumps.T:
        frames = target.rng.integers(0, len(column), count)
        np.add.at(column, frames, level * target.span * target.rng.standard_normal(count))
    return np.asarray(target.readings + np.cumsum(jumps, axis=0))


def glitching(target: Target, *, level: float = 100, count: int = 1) -> Readings:
    """Replace `count` readings by a value `level` above the lowest, like a transmission error."""
    readings = target.readings
    for column in readings.T:
        frames = target.rng.permutation(len(column))[:count]
        column[frames] = target.limits[0] + level * (target.span or 1.0)
    return readings


def cycling(target: Target, *, period: float = 50) -> Readings:
    """Replace the readings of sensors by sines of one period, in frames, with random phases."""
    turns = np.arange(target.recording.n_frames)[:, None] / period
    waves = (1 + np.sin(2 * np.pi * (turns + target.rng.random(len(target.chosen))))) / 2
    return np.asarray(target.limits[0] + (target.span or 1.0) * waves)


def duplicated(target: Target, *, factor: float = 1, noise: float = 0) -> Readings:
    """Replace sensors by copies of others, drawn at random, like one wire read twice.

    `factor` is the ratio of the largest to the smallest gain of a copy, and `noise` the standard
    deviation of its white noise, relative to that of what is copied.
    """
    others = np.setdiff1d(np.arange(target.recording.n_sensors), target.chosen)
    if not len(others):
        raise InputError("duplicated needs a sensor to copy from, but all sensors were chosen")
    readings = target.recording.readings[:, target.rng.choice(others, size=len(target.chosen))]
    for column in readings.T if factor > 1 or noise else ():
        known = column[np.isfinite(column)]
        deviation = noise * (known.std() if known.size else 0)
        added = deviation * target.rng.standard_normal(column.size)
        column[:] = column * factor ** target.rng.uniform(-0.5, 0.5) + added
    return readings


def shorted(target: Target) -> Readings:
    """Connect sensors with one another: all read their mean."""
    return np.repeat(target.readings.mean(axis=1, keepdims=True), len(target.chosen), axis=1)


def leaking(target: Target, *, share: float = 0.05) -> Readings:
    """Add a share of the channel before, if any, like a multiplexer that settles slowly."""
    before = target.recording.readings[:, target.chosen - 1]
    return np.asarray(target.readings + share * np.where(target.chosen > 0, before, 0))


def lagging(target: Target, *, frames: int = 3, board: int = 0) -> Readings:
    """Delay sensors, like boards that are polled late; the first reading is held meanwhile.

    With `board` sensors on a board, each board lags `frames` more than the one before it.
    """
    readings = target.readings
    for number, members in enumerate(target.boards(board)):
        delay = frames * number if board else frames
        source = np.maximum(np.arange(len(readings)) - delay, 0)
        readings[:, members] = readings[source, members]
    return readings


def freezing(
    target: Target, *, mean_gap: float = 100, mean_span: float = 20, board: int = 0
) -> Readings:
    """Hold the readings of boards of some sensors, 0 for all, like a bus that hangs."""
    readings, boards = target.readings, target.boards(board)
    held = target.spans(mean_gap, mean_span, len(boards))
    for members, frozen in zip(boards, held.T, strict=True):
        source = np.maximum.accumulate(np.where(frozen, 0, np.arange(len(readings))))
        readings[:, members] = readings[source, members]
    return readings


def common_noise(target: Target, *, level: float = 1, board: int = 0) -> Readings:
    """Add the same white noise to the sensors of a board, 0 for all, like a noisy supply."""
    readings = target.readings
    for members in target.boards(board):
        noise = target.rng.standard_normal((len(readings), 1))
        readings[:, members] += level * target.deviation * noise
    return readings


def spiking(target: Target, *, level: float = 5, share: float = 0.02, board: int = 0) -> Readings:
    """Add spikes of single frames to the sensors of a board, 0 for all, at once.

    A frame has a spike with the probability `share`, and `level` is the mean of their heights.
    """
    readings = target.readings
    for members in target.boards(board):
        heights = level * target.deviation * target.rng.exponential(size=len(readings))
        struck = target.rng.random(len(readings)) < share
        readings[:, members] += np.where(struck, heights, 0)[:, None]
    return readings


def humming(
    target: Target, *, level: float = 1, period: float = 7.3, factor: float = 3
) -> Readings:
    """Add a sine of one period, in frames, and phase to sensors, each with a gain of its own.

    `level` is the median amplitude, `factor` the ratio of the largest to the smallest gain.
    """
    phase = 2 * np.pi * (np.arange(target.recording.n_frames) / period + target.rng.random())
    gains = factor ** target.rng.uniform(-0.5, 0.5, len(target.chosen))
    return np.asarray(target.readings + level * target.deviation * np.outer(np.sin(phase), gains))


def swapped(target: Target) -> Readings:
    """Exchange the signals of the first half of the sensors, as given, with the second half."""
    if len(target.chosen) % 2:
        raise InputError(f"swapping needs an even number of sensors, got {len(target.chosen)}")
    return np.roll(target.readings, len(target.chosen) // 2, axis=1)


def shifted(target: Target, *, by: int = 1) -> Readings:
    """Move each signal on by some sensors, and the last to the first, like a shifted connector."""
    return np.roll(target.readings, by, axis=1)


def folded(target: Target) -> Readings:
    """Close a joint across the middle of the skin, so that its halves are touched together.

    Each sensor reads the larger of its own reading and that of the sensor nearest to its image.
    """
    places, along = target.along()
    _, nearest = KDTree(places).query(places - 2 * np.outer(places @ along, along))
    return np.fmax(target.readings, target.readings[:, nearest])


def separate_regions(target: Target, *, regions: int = 2) -> Readings:
    """Touch one region of the skin after the other, and nothing else meanwhile.

    Regions are slices of equal numbers of sensors along the direction in which the skin is longest.
    """
    readings, (places, along) = target.readings, target.along()
    touched = np.array_split(np.argsort(places @ along, kind="stable"), regions)
    edges = np.linspace(0, len(readings), regions + 1).astype(int)
    for inside, (start, stop) in zip(touched, pairwise(edges.tolist()), strict=True):
        readings[start:stop, np.delete(target.chosen, inside)] = np.delete(target.rest, inside)
    return readings


def dropped_frames(target: Target, *, share: float = 0.05) -> Recording:
    """Remove a random share of the frames and of their times, like an overloaded logger."""
    recording = target.recording
    lost = target.rng.random(recording.n_frames) < share
    lost[0] &= not lost.all()
    times = None if recording.times is None else recording.times[~lost]
    return replace(recording, readings=recording.readings[~lost], times=times)


FAULTS: dict[str, Callable[..., Readings | Recording]] = {
    function.__name__.replace("_", "-"): function
    for function in (
        *(dead, stuck, saturating, intermittent, nan_bursts, bridged_gaps, rarely_touched, noisy),
        *(quantised, thresholded, clipped, stuck_bit, inverted, drifting, gain_drift, warming),
        *(stepping, glitching, cycling, duplicated, shorted, leaking, lagging, freezing),
        *(common_noise, spiking, humming, swapped, shifted, folded, separate_regions),
        dropped_frames,
    )
}
"""Functions of a `Target` and of parameters, by the kind of fault."""

OF_ALL = ("folded", "separate-regions", "dropped-frames")
"""Faults of the whole recording, for which no sensors are chosen."""

RANGES: dict[str, Range] = {
    **dict.fromkeys(("bits", "by", "contacts", "count", "frames"), COUNT),
    **dict.fromkeys(("bit", "board"), at_least(0, whole=True)),
    **dict.fromkeys(("levels", "regions"), at_least(2, whole=True)),
    **dict.fromkeys(("factor", "mean_gap", "mean_span"), at_least(1)),
    **dict.fromkeys(("level", "time"), POSITIVE),
}
RANGES |= {"noise": NOT_NEGATIVE, "period": at_least(2), "share": SHARE, "value": FINITE}
RANGES["after"] = Range("at least 0 and below 1", lambda value: 0 <= value < 1)


def parameters_of(kind: str) -> dict[str, Any]:
    """Return the parameters of a kind of fault, with their defaults."""
    if kind not in FAULTS:
        raise InputError(f"there is no fault {kind!r}; choose from {', '.join(FAULTS)}")
    own = {name: one.default for name, one in signature(FAULTS[kind]).parameters.items()}
    del own["target"]
    return own if kind == "dropped-frames" else {**own, "after": 0.0}


def inject(
    recording: Recording,
    fault: str,
    sensors: Iterable[str | int] = (),
    *,
    rng: np.random.Generator | int = 0,
    **parameters: float,
) -> Recording:
    """Inject a fault into a recording.

    Parameters
    ----------
    recording : Recording
    fault : str
        A key of `FAULTS`, or a text of kind, sensors and parameters, such as
        ``saturating:s3,s7,value=1`` or ``lagging:*,board=12,after=0.5``.
    sensors : iterable of str or int
        Names or indices, ``*`` for all, or ``10%`` for a random share; their order matters where
        signals are exchanged.
    rng : numpy.random.Generator or int
        The same seed gives the same fault.
    **parameters
        Parameters of the function in `FAULTS`. All faults but lost frames also have ``after``, the
        share of the recording from which on they act; 0 by default.

    Returns
    -------
    Recording
        With the same names and positions. Its metadata name the fault and the chosen sensors.

    Raises
    ------
    InputError
        If a kind, sensor or parameter is unknown, a value is outside its range, or the fault does
        not apply to this recording.
    """
    kind, _, rest = (part.strip() for part in fault.partition(":"))
    items = [item.strip() for item in rest.split(",") if item.strip()]
    named = [*sensors, *(item for item in items if "=" not in item)]
    given = parameters | parse_parameters(item for item in items if "=" in item)
    known, generator = parameters_of(kind), np.random.default_rng(rng)
    for name, value in given.items():
        if name not in known:
            raise InputError(
                f"the fault {kind} has no parameter {name!r}; choose from {', '.join(known)}"
            )
        RANGES[name].check(name, value)
    if kind in OF_ALL and named:
        raise InputError(f"the fault {kind} affects all sensors; leave out {named[0]}")
    if kind not in OF_ALL and not named:
        raise InputError(
            f"the fault {kind} needs sensors: {kind}:NAME,NAME, {kind}:10% or {kind}:*"
        )
    chosen = [i for text in named or "*" for i in _looked_up(text, recording, generator)]
    if twice := [recording.names[i] for i in chosen if chosen.count(i) > 1]:
        raise InputError(f"sensor {twice[0]} is listed twice; list each sensor once")
    own = {name: value for name, value in given.items() if name != "after"}
    changed = FAULTS[kind](Target(recording, np.array(chosen, dtype=np.intp), generator), **own)
    if not isinstance(changed, Recording):
        readings, first = np.array(recording.readings), int(given.get("after", 0) * len(changed))
        readings[first:, chosen] = changed[first:]
        changed = replace(recording, readings=readings)
    done = [recording.names[i] for i in chosen] if named else []
    stated = ",".join([*done, *(f"{name}={value}" for name, value in given.items())])
    log = [str(recording.metadata["faults"])] if "faults" in recording.metadata else []
    log.append(f"{kind}:{stated}" if stated else kind)
    return replace(changed, metadata={**recording.metadata, "faults": "; ".join(log)})


def _looked_up(text: str | int, recording: Recording, rng: np.random.Generator) -> list[int]:
    """Look up a sensor, or those of ``*`` or a share. A sensor with such a name goes first."""
    if text in recording.names or not (text == "*" or str(text).endswith("%")):
        return [int(i) for i in recording.indices([text])]
    if text == "*":
        return [*range(recording.n_sensors)]
    try:
        share = float(str(text)[:-1]) / 100
    except ValueError:
        share = np.nan
    if not 0 < share <= 1:
        raise InputError(f"a share of the sensors must be above 0% and at most 100%, got {text!r}")
    count = max(1, round(share * recording.n_sensors))
    return [int(i) for i in np.sort(rng.choice(recording.n_sensors, size=count, replace=False))]
