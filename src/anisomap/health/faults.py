"""Faults of a recording as a whole: which there are, and their repair.

To add a fault, write a function that yields what it found, and add one line to `CHECKS`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.health.sensors import MIN_CONTACTS
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.recording_faults.common_mode import find_common_noise, find_hum
from anisomap.numerics.recording_faults.copies import find_copies
from anisomap.numerics.recording_faults.courses import find_clipped, find_one_period, find_regions
from anisomap.numerics.recording_faults.drift import find_drift, remove_drift
from anisomap.numerics.recording_faults.gaps import fill_from_others, find_bridged
from anisomap.numerics.recording_faults.glitches import find_glitches, remove_glitches
from anisomap.numerics.recording_faults.lags import align, find_lags
from anisomap.numerics.recording_faults.leaks import find_leak, remove_leak
from anisomap.numerics.recording_faults.polarity import find_inverted
from anisomap.numerics.recording_faults.rewiring import find_rewired
from anisomap.numerics.recording_faults.spikes import find_spikes, remove_spikes
from anisomap.recording import Recording, as_runs, in_range
from anisomap.wording import join_items, noun_and_items

_MAX_FRAMES = 8192  # in which regions are searched
_ALL = 0.9  # share of the sensors above which a fault concerns the whole skin
_EXACT = 1e-3  # share of noise in the variance below which copies are exact
_MIN_MISSING = 0.02  # share of a sensor's readings; fewer change no correlation; chosen by hand


@dataclass(frozen=True)
class Finding:
    """A fault of the read-out or of the stimulation that spoils maps.

    Attributes
    ----------
    kind : str
        A key of `CHECKS`, or ``"board-noise"``: common noise of a group of sensors.
    sensors : tuple of str
        Names of the affected sensors.
    size : float
        Size of the fault, in `unit`.
    unit : str
        Unit of `size`; ``"share"`` for shares in [0, 1].
    what : str
        Description with the size, without sensors.
    consequence : str
        What a map of the recording suffers.
    mendable : bool
        Whether `repair` mends it.
    mended : str
        What `repair` does or did; empty if it is not mendable.
    """

    kind: str
    sensors: tuple[str, ...]
    size: float
    unit: str
    what: str
    consequence: str
    mendable: bool
    mended: str = ""

    def __str__(self) -> str:
        """Return the finding as a sentence."""
        listed = f": {noun_and_items('sensor', self.sensors)}" if self.sensors else ""
        return f"{self.what} ({self.consequence}){listed}"


@dataclass(frozen=True, eq=False)
class Found:
    """One fault of a recording.

    sensors: Their indices.
    size, what: See `Finding`.
    height: With which `what` ends, in units of the readings; none by default.
    evidence: What the repair needs.
    mended: What the repair does, if it differs from `Check.mended`; "" if it cannot be mended.
    kind: If it differs from the key of the check.
    """

    sensors: NDArray[np.intp] | Sequence[int]
    size: float
    what: str
    evidence: Any = None
    height: float | None = None
    mended: str | None = None
    kind: str = ""


@dataclass(frozen=True)
class Check:
    """A fault that is searched in recordings.

    find: Takes a recording, complete but for the first check, and yields its faults.
    unit, consequence, mended: See `Finding`.
    mend: Takes the recording and the evidence of all faults that can be mended.
    """

    find: Callable[[Recording], Iterator[Found]]
    unit: str
    consequence: str
    mended: str = ""
    mend: Callable[[Recording, Sequence[Any]], Recording] | None = None

    def describe(self, kind: str, found: Found, names: Sequence[str], unit: float) -> Finding:
        """Return what is said about a fault of readings in a unit."""
        height = "" if found.height is None else f"{unit * found.height:.3g}"
        mended = self.mended if found.mended is None else found.mended
        return Finding(
            kind=found.kind or kind,
            sensors=tuple(names[int(i)] for i in found.sensors),
            size=float(found.size),
            unit=self.unit,
            what=found.what + height,
            consequence=self.consequence,
            mendable=bool(mended),
            mended=mended,
        )


def _in_readings(
    remove: Callable[[NDArray[Any], Any], NDArray[Any]],
) -> Callable[[Recording, Sequence[Any]], Recording]:
    """Return a repair that removes one fault after the other from the readings."""

    def mend(recording: Recording, faults: Sequence[Any]) -> Recording:
        readings = recording.readings
        for fault in faults:
            readings = remove(readings, fault)
        return replace(recording, readings=readings)

    return mend


def _gaps(recording: Recording) -> Iterator[Found]:
    readings = recording.readings
    missing, bridged = ~np.isfinite(readings), find_bridged(readings)
    if bridged is not None:
        missing |= bridged
    share = missing.mean(axis=0)
    missing &= (share >= _MIN_MISSING) & (share < 1)
    affected = np.flatnonzero(missing.any(axis=0))
    if affected.size:
        typical = float(np.median(share[affected]))
        on_lines = np.isfinite(readings[missing]).any()
        yield Found(
            affected,
            typical,
            f"{typical:.0%} of the readings of {affected.size} of {recording.n_sensors} sensors "
            f"are {'on straight lines, as if interpolated' if on_lines else 'missing'}",
            missing,
        )


def _glitches(recording: Recording) -> Iterator[Found]:
    found = find_glitches(recording.readings)
    if found is not None:
        affected, number = np.flatnonzero(found.any(axis=0)), np.count_nonzero(found)
        yield Found(
            affected,
            float(number),
            f"{number} readings of {affected.size} sensors are far beyond all others",
            found,
        )


def _hum(recording: Recording) -> Iterator[Found]:
    hum = find_hum(recording.readings, recording.signals.never_at_rest)
    if hum is not None:
        rate = recording.rate_hz
        frequency = "" if rate is None else f" ({rate / hum.period:.3g} Hz)"
        yield Found(
            hum.sensors,
            hum.share,
            f"{hum.sensors.size} sensors hum with a period of {hum.period:.4g} frames{frequency}, "
            f"{hum.share:.0%} of the standard deviation of a sensor",
            hum,
        )


def _one_period(recording: Recording) -> Iterator[Found]:
    found = find_one_period(recording.readings)
    if found is not None:
        period, share = found
        yield Found(
            range(recording.n_sensors),
            share,
            f"{share:.0%} of the variance of the readings is a sine of {period:.4g} frames",
        )


def _common_noise(recording: Recording) -> Iterator[Found]:
    for noise in find_common_noise(recording.readings, recording.signals.never_at_rest):
        everywhere = noise.sensors.size >= _ALL * recording.n_sensors
        who = "all sensors" if everywhere else f"a group of {noise.sensors.size} sensors"
        yield Found(
            noise.sensors,
            noise.share,
            f"{who} share noise, {noise.share:.0%} of the standard deviation of a sensor",
            noise,
            mended=None if noise.separable else "",
            kind="" if everywhere else "board-noise",
        )


def _spikes(recording: Recording) -> Iterator[Found]:
    for spikes in find_spikes(recording.readings):
        yield Found(
            spikes.sensors,
            spikes.frames.size / recording.n_frames,
            f"a group of {spikes.sensors.size} sensors jumps for single frames, "
            f"{spikes.frames.size} times by ",
            spikes,
            spikes.height,
        )


def _drift(recording: Recording) -> Iterator[Found]:
    drift = find_drift(recording.readings, recording.signals.never_at_rest)
    if drift is not None:
        size = float(np.median(drift.sizes))
        yield Found(
            drift.sensors,
            size,
            f"the level at rest of {drift.sensors.size} of {recording.n_sensors} sensors drifts by "
            f"{size:.2g} standard deviations of their readings (median)",
            drift,
        )


def _saturation(recording: Recording) -> Iterator[Found]:
    clipped = find_clipped(recording.readings)
    if clipped:
        share = float(np.median(list(clipped.values())))
        yield Found(
            list(clipped),
            share,
            f"{len(clipped)} of {recording.n_sensors} sensors are at the end of their range in "
            f"{share:.1%} of the frames (median)",
        )


def _inverted(recording: Recording) -> Iterator[Found]:
    found = find_inverted(recording.readings, recording.signals.rest.known)
    if found.size:
        yield Found(
            found,
            found.size / recording.n_sensors,
            f"contact has the opposite sign in {found.size} of {recording.n_sensors} sensors",
            found,
        )


def _mirror(recording: Recording, faults: Sequence[NDArray[np.intp]]) -> Recording:
    (inverted,) = faults
    readings = np.array(recording.readings)
    rest = recording.signals.rest.value[inverted].astype(readings.dtype)
    readings[:, inverted] = 2 * rest - readings[:, inverted]
    return replace(recording, readings=readings)


def _lags(recording: Recording) -> Iterator[Found]:
    found = find_lags(recording.readings, recording.varying())
    if found is not None:
        frames = found.frames
        listed = join_items([f"{lag:+d}" for lag in np.unique(frames[frames != 0]).tolist()])
        yield Found(
            np.flatnonzero(frames),
            float(np.abs(frames).max()),
            f"groups of sensors lag the largest group by {listed} frames",
            frames,
            mended="each group was shifted by its lag; "
            f"{int(np.ptp(frames))} frames at the ends were left out",
        )


def _shift(recording: Recording, faults: Sequence[NDArray[np.intp]]) -> Recording:
    readings, times = align(recording.readings, faults[0]), recording.times
    return replace(
        recording, readings=readings, times=None if times is None else times[: len(readings)]
    )


def _leak(recording: Recording) -> Iterator[Found]:
    leak = find_leak(recording.readings)
    if leak is not None:
        yield Found(
            range(1, recording.n_sensors),
            leak.share,
            f"{leak.share:.1%} of each channel leak into the next "
            f"(seen in {leak.n_forward} of {leak.n_pairs} pairs, and not backwards)",
            leak,
        )


def _copies(recording: Recording) -> Iterator[Found]:
    contacts = recording.signals.contacts
    names, groups = (
        recording.names,
        [
            copies
            for copies in find_copies(recording.readings, *recording.extremes)
            if copies.noise < _EXACT or contacts[list(copies.sensors)].min() >= MIN_CONTACTS
        ],
    )
    left_out = sum(len(copies.sensors) - (copies.kept is not None) for copies in groups)
    for copies in groups:
        others = [i for i in copies.sensors if i != copies.kept]
        listed = join_items([names[i] for i in others])
        if left_out >= np.count_nonzero(recording.varying()):
            mended = ""  # no sensor that varies would be left
        elif copies.kept is None:
            mended = f"all were left out, since it is unknown which of {listed} is real"
        else:
            mended = (
                f"{names[copies.kept]} was kept, and {listed} left out, since their positions are "
                "unknown"
            )
        noise = f", with up to {copies.noise:.1%} of noise of their own"
        yield Found(
            copies.sensors,
            len(copies.sensors),
            f"{len(copies.sensors)} sensors read one wire{noise if copies.noise >= _EXACT else ''}",
            others,
            mended=mended,
        )


def _leave_out(recording: Recording, faults: Sequence[list[int]]) -> Recording:
    kept = np.ones(recording.n_sensors, dtype=bool)
    kept[[i for others in faults for i in others]] = False
    return recording.select(kept)


def _rewired(recording: Recording) -> Iterator[Found]:
    found = find_rewired(recording.readings, recording.signals.touched)
    if found is not None:
        sensors, frame = found
        yield Found(
            sensors,
            sensors.size / recording.n_sensors,
            f"{sensors.size} sensors read other places from about frame {frame} of "
            f"{recording.n_frames} on",
        )


def _separate_regions(recording: Recording) -> Iterator[Found]:
    step = -(-recording.n_frames // _MAX_FRAMES)
    found = find_regions(recording.signals.active[::step])
    if found is not None:
        yield Found(
            min(found.before, found.after, key=len),
            found.bridges.size,
            f"two regions of {found.before.size} and {found.after.size} sensors were touched one "
            f"after the other, the second from frame {found.frame * step} on, and "
            f"{found.bridges.size or 'no'} sensors with both",
        )


_ALIKE = "they look alike wherever they are"

CHECKS: Mapping[str, Check] = MappingProxyType(
    {
        "gaps": Check(
            _gaps,
            "share",
            "contacts in the gaps are lost, so these sensors seem less similar to their neighbours",
            "these readings were estimated from the most similar sensors",
            _in_readings(lambda readings, missing: fill_from_others(readings, missing)[0]),
        ),
        "glitches": Check(
            _glitches,
            "readings",
            "they outweigh all contacts of these sensors",
            "these readings were replaced by those beside them",
            _in_readings(remove_glitches),
        ),
        "hum": Check(
            _hum,
            "share of the standard deviation",
            _ALIKE,
            "a sine was fitted to each of them and subtracted",
            _in_readings(lambda readings, hum: hum.removed_from(readings)),
        ),
        "one-period": Check(
            _one_period,
            "share of the variance",
            "similarity depends on phase alone; there is nothing to map",
        ),
        "common-noise": Check(
            _common_noise,
            "share of the standard deviation",
            _ALIKE,
            "the common signal was estimated in each frame and subtracted",
            _in_readings(lambda readings, noise: noise.removed_from(readings)),
        ),
        "spikes": Check(
            _spikes,
            "share of the frames",
            _ALIKE,
            "these frames were replaced by the mean of the frames beside them",
            _in_readings(remove_spikes),
        ),
        "drift": Check(
            _drift,
            "standard deviations",
            "sensors that drift alike look related, and contacts are hidden",
            "their level at rest was estimated over time and subtracted",
            _in_readings(remove_drift),
        ),
        "saturation": Check(
            _saturation,
            "share of the frames",
            "heights of contacts are cut off; lengths that follow from heights are wrong",
        ),
        "inverted": Check(
            _inverted,
            "share",
            "they look unrelated to their neighbours",
            "these sensors were mirrored at their rest value",
            _mirror,
        ),
        "lags": Check(
            _lags,
            "frames",
            "sensors of different groups seem less similar than they are",
            "",
            _shift,
        ),
        "leak": Check(
            _leak,
            "share",
            "sensors that are adjacent in the order of the channels look like neighbours",
            "the leak was subtracted from each channel",
            _in_readings(remove_leak),
        ),
        "copies": Check(
            _copies,
            "sensors",
            "sensors at one place distort the map around them; at most one of them is right",
            "",
            _leave_out,
        ),
        "rewired": Check(
            _rewired,
            "share",
            "wires were exchanged; map the frames before and after by themselves",
        ),
        "separate-regions": Check(
            _separate_regions,
            "sensors touched with both",
            "the relative position of the regions is unknown; touch the skin between them",
        ),
    }
)
"""Checks in the order in which they are made.

Each fault is mended before the next is searched, since one fault can hide another or look like it:
the order is opposite to that in which faults arise, from contact to file.
"""

FINAL = ("one-period",)
"""Findings after which nothing else is searched."""

_BEFORE_COMPLETION = ("gaps",)  # these look at missing readings


def spoiling(findings: Sequence[Finding]) -> tuple[str, ...]:
    """List what spoils a map among the faults of its recording."""
    return tuple(
        f"{finding}" + ("; repair the recording" if finding.mendable else "")
        for finding in findings
    )


@dataclass(frozen=True, eq=False)
class Repair:
    """A repaired recording.

    Attributes
    ----------
    recording : Recording
        With all mendable faults mended.
    findings : tuple of Finding
        All faults that were found, mendable or not.
    """

    recording: Recording
    findings: tuple[Finding, ...]

    @property
    def done(self) -> tuple[str, ...]:
        """What was done, one sentence for each mended fault."""
        return tuple(
            f"{finding.what}: {finding.mended}" for finding in self.findings if finding.mendable
        )


def repair(recording: Recording | ArrayLike) -> Repair:
    """Find the faults of a recording, and mend those that can be mended.

    Parameters
    ----------
    recording : Recording or array_like of shape (T, N)
        Columns in the order in which channels are read, for leaks and lags. Missing readings are
        estimated from similar sensors where they are many, and else interpolated.

    Returns
    -------
    Repair
        The recording itself, if nothing was mended. Copies are left out, so it may have fewer
        sensors, and, after lags, fewer frames.

    Examples
    --------
    A skin of 60 sensors, of which one is wired twice:

    >>> import numpy as np
    >>> places = np.random.default_rng(0).uniform(0, 5, (60, 2))
    >>> touches = np.random.default_rng(1).uniform(0, 5, (2000, 1, 2))
    >>> readings = np.maximum(0, 1.5 - np.linalg.norm(touches - places, axis=2))
    >>> readings[:, 7] = readings[:, 31]
    >>> found = repair(readings)
    >>> found.recording.n_sensors
    59
    >>> [(finding.kind, finding.sensors) for finding in found.findings]
    [('copies', ('s7', 's31'))]
    """
    (run,) = as_runs(recording)
    return _examined(run)


def find_faults(
    recording: Recording | ArrayLike | Sequence[Recording],
) -> tuple[Finding, ...]:
    """Find the faults of a recording that spoil a map of it.

    Parameters
    ----------
    recording : Recording, array_like of shape (T, N), or sequence of Recording
        Several recordings that lack sensors are examined one by one.

    Returns
    -------
    tuple of Finding
        In the order of `CHECKS`; empty if there are none.
    """
    found: dict[tuple[str, tuple[str, ...]], Finding] = {}
    for run in as_runs(recording):
        for finding in _examined(run).findings:
            found.setdefault((finding.kind, finding.sensors), finding)
    return tuple(found.values())


def _examined(recording: Recording) -> Repair:
    findings: list[Finding] = []
    scaled, unit = in_range(recording)
    with limited_blas(recording.n_sensors):
        current = scaled
        for kind, check in CHECKS.items():
            if kind not in _BEFORE_COMPLETION:
                current = current.complete("interpolate")
            found = list(check.find(current))
            described = [check.describe(kind, one, current.names, unit) for one in found]
            findings += described
            if found and kind in FINAL:
                break
            evidence = [
                one.evidence for one, said in zip(found, described, strict=True) if said.mendable
            ]
            if check.mend is not None and evidence:
                current = check.mend(current, evidence)
    if unit != 1:
        current = recording if current is scaled else _times(current, unit)
    return Repair(current, tuple(findings))


def _times(recording: Recording, unit: float) -> Recording:
    with np.errstate(over="ignore"):  # of differences, which are twice as large
        return replace(recording, readings=recording.readings * unit)
