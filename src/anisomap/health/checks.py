"""Findings about a recording as a whole, and their repair.

Checks for faults of the read-out: its signals, its order and its clock.

Checks for what a recording lacks: readings, contacts, stimulation that tells places apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.health.activity import count_contacts, count_runs, frames_in_contact
from anisomap.numerics.columns import columns
from anisomap.numerics.recording_faults.common_mode import (
    CommonSignal,
    find_common_noise,
    find_hum,
    never_at_rest,
)
from anisomap.numerics.recording_faults.copies import Copies, find_copies
from anisomap.numerics.recording_faults.courses import (
    Regions,
    find_clipped,
    find_one_period,
    find_regions,
)
from anisomap.numerics.recording_faults.drift import Drift, find_drift, remove_drift
from anisomap.numerics.recording_faults.gaps import fill_from_others, find_bridged
from anisomap.numerics.recording_faults.lags import Lags, align, find_lags
from anisomap.numerics.recording_faults.leaks import Leak, find_leak, remove_leak
from anisomap.numerics.recording_faults.polarity import find_inverted
from anisomap.numerics.recording_faults.spikes import Spikes, find_spikes, remove_spikes
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.recording import Recording
from anisomap.wording import join_items, noun_and_items

_MAX_FRAMES = 8192  # in which activity is compared


@dataclass(frozen=True)
class Finding:
    """A fault of the read-out or of the stimulation that spoils maps.

    Attributes
    ----------
    kind : str
        A key of `CHECKS`.
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
class Subject:
    """A complete recording that is examined, with statistics that several checks use."""

    recording: Recording

    @property
    def readings(self) -> NDArray[np.floating]:
        """Readings of the recording, shape (T, N)."""
        return self.recording.readings

    @cached_property
    def active(self) -> NDArray[np.bool_]:
        """Whether sensors are in contact, shape (t, N): in all frames, or in evenly spaced ones."""
        part = self.readings[:: -(-len(self.readings) // _MAX_FRAMES)]
        active = np.empty(part.shape[::-1], dtype=bool)
        for column, frames in zip(columns(part), active, strict=True):
            frames[:] = frames_in_contact(column)
        return active.T

    @cached_property
    def never_at_rest(self) -> NDArray[np.intp]:
        """Sensors that no value occurs often in."""
        return never_at_rest(self.readings)

    def contacts(self, sensors: NDArray[np.intp]) -> NDArray[np.intp]:
        """Count the contacts of some sensors: runs of frames beyond rest, shape (n,)."""
        found = (
            count_runs(frames_in_contact(column)) for column in columns(self.readings[:, sensors])
        )
        return np.fromiter(found, dtype=np.intp, count=sensors.size)


@dataclass(frozen=True)
class Check:
    """A fault that is searched in recordings.

    find: Takes a `Subject`, and returns evidence of the fault, or None.
    describe: Takes the recording and the evidence, and returns the findings.
    mend: Takes the recording and the evidence, and returns a mended recording.
    """

    find: Callable[[Subject], Any]
    describe: Callable[[Recording, Any], tuple[Finding, ...]]
    mend: Callable[[Recording, Any], Recording] | None = None


_ALL = 0.9  # share of the sensors above which a fault concerns the whole skin


def _names(recording: Recording, sensors: NDArray[np.intp] | tuple[int, ...]) -> tuple[str, ...]:
    return tuple(recording.names[int(i)] for i in sensors)


def _describe_copies(recording: Recording, found: tuple[Copies, ...]) -> tuple[Finding, ...]:
    findings = []
    for copies in found:
        names = _names(recording, copies.sensors)
        exact = copies.noise < 1e-3
        if copies.kept is None:
            mended = f"all were left out, since it is unknown which of {join_items(names)} is real"
        else:
            kept = recording.names[copies.kept]
            others = join_items([name for name in names if name != kept])
            mended = f"{kept} was kept, and {others} left out, since their positions are unknown"
        findings.append(
            Finding(
                "copies",
                names,
                float(len(names)),
                "sensors",
                f"{len(names)} sensors read one wire"
                + ("" if exact else f", with up to {copies.noise:.1%} of noise of their own"),
                "sensors at one place distort the map around them; at most one of them is right",
                mendable=True,
                mended=mended,
            )
        )
    return tuple(findings)


def _merge_copies(recording: Recording, found: tuple[Copies, ...]) -> Recording:
    kept = np.ones(recording.n_sensors, dtype=bool)
    for copies in found:
        kept[[i for i in copies.sensors if i != copies.kept]] = False
    return recording.select(kept)


def _describe_leak(recording: Recording, leak: Leak) -> tuple[Finding, ...]:
    return (
        Finding(
            "leak",
            recording.names[1:],
            leak.share,
            "share",
            f"{leak.share:.1%} of each channel leak into the next "
            f"(seen in {leak.n_forward} of {leak.n_pairs} pairs, and not backwards)",
            "sensors that are adjacent in the order of the channels look like neighbours",
            mendable=True,
            mended="the leak was subtracted from each channel",
        ),
    )


def _describe_lags(recording: Recording, lags: Lags) -> tuple[Finding, ...]:
    values = np.unique(lags.frames[lags.frames != 0]).tolist()
    late = np.flatnonzero(lags.frames)
    listed = join_items([f"{value:+d}" for value in values])
    return (
        Finding(
            "lags",
            _names(recording, late),
            float(np.abs(lags.frames).max()),
            "frames",
            f"groups of sensors lag the largest group by {listed} frames",
            "sensors of different groups seem less similar than they are",
            mendable=True,
            mended="each group was shifted by its lag; "
            f"{int(np.ptp(lags.frames))} frames at the ends were left out",
        ),
    )


def _align(recording: Recording, lags: Lags) -> Recording:
    readings = align(recording.readings, lags.frames)
    times = recording.times
    return replace(
        recording,
        readings=readings,
        times=None if times is None else times[: len(readings)],
        rate_hz=recording.rate_hz,
    )


def _find_inverted(subject: Subject) -> NDArray[np.intp] | None:
    found = find_inverted(subject.readings)
    return found if found.size else None


def _describe_inverted(recording: Recording, inverted: NDArray[np.intp]) -> tuple[Finding, ...]:
    share = len(inverted) / recording.n_sensors
    return (
        Finding(
            "inverted",
            _names(recording, inverted),
            share,
            "share",
            f"contact has the opposite sign in {len(inverted)} of {recording.n_sensors} sensors",
            "they look unrelated to their neighbours",
            mendable=True,
            mended="these sensors were mirrored at their rest value",
        ),
    )


def _flip(recording: Recording, inverted: NDArray[np.intp]) -> Recording:
    readings = np.array(recording.readings)
    rest = estimate_rest(recording.readings[:, inverted]).value.astype(readings.dtype)
    readings[:, inverted] = 2 * rest - readings[:, inverted]
    return replace(recording, readings=readings)


def _find_common(subject: Subject) -> tuple[CommonSignal, ...] | None:
    return find_common_noise(subject.readings, subject.never_at_rest) or None


def _describe_common(
    recording: Recording, signals: tuple[CommonSignal, ...]
) -> tuple[Finding, ...]:
    findings = []
    for signal in signals:
        everywhere = signal.sensors.size >= _ALL * recording.n_sensors
        who = "all sensors" if everywhere else f"a group of {signal.sensors.size} sensors"
        findings.append(
            Finding(
                "common-noise" if everywhere else "board-noise",
                _names(recording, signal.sensors),
                signal.share,
                "share of the standard deviation",
                f"{who} share noise, {signal.share:.0%} of the standard deviation of a sensor",
                "they look alike wherever they are",
                mendable=signal.separable,
                mended="the common signal was estimated in each frame and subtracted"
                if signal.separable
                else "",
            )
        )
    return tuple(findings)


def _remove_common(recording: Recording, signals: tuple[CommonSignal, ...]) -> Recording:
    readings = recording.readings
    for signal in signals:
        if signal.separable:
            readings = signal.removed_from(readings)
    return replace(recording, readings=readings)


def _describe_hum(recording: Recording, hum: CommonSignal) -> tuple[Finding, ...]:
    rate = recording.rate_hz
    frequency = "" if rate is None else f" ({rate / hum.period:.3g} Hz)"
    return (
        Finding(
            "hum",
            _names(recording, hum.sensors),
            hum.share,
            "share of the standard deviation",
            f"{hum.sensors.size} sensors hum with a period of {hum.period:.4g} frames{frequency}, "
            f"{hum.share:.0%} of the standard deviation of a sensor",
            "they look alike wherever they are",
            mendable=True,
            mended="a sine was fitted to each of them and subtracted",
        ),
    )


def _describe_drift(recording: Recording, drift: Drift) -> tuple[Finding, ...]:
    size = float(np.median(drift.sizes))
    return (
        Finding(
            "drift",
            _names(recording, drift.sensors),
            size,
            "standard deviations",
            f"the level at rest of {drift.sensors.size} of {recording.n_sensors} sensors drifts by "
            f"{size:.2g} standard deviations of their readings (median)",
            "sensors that drift alike look related, and contacts are hidden",
            mendable=True,
            mended="their level at rest was estimated over time and subtracted",
        ),
    )


def _find_spikes(subject: Subject) -> tuple[Spikes, ...] | None:
    return find_spikes(subject.readings) or None


def _describe_spikes(recording: Recording, found: tuple[Spikes, ...]) -> tuple[Finding, ...]:
    return tuple(
        Finding(
            "spikes",
            _names(recording, spikes.sensors),
            spikes.frames.size / recording.n_frames,
            "share of the frames",
            f"a group of {spikes.sensors.size} sensors jumps for single frames, "
            f"{spikes.frames.size} times by {spikes.height:.3g}",
            "they look alike wherever they are",
            mendable=True,
            mended="these frames were replaced by the mean of the frames beside them",
        )
        for spikes in found
    )


def _remove_spikes(recording: Recording, found: tuple[Spikes, ...]) -> Recording:
    readings = recording.readings
    for spikes in found:
        readings = remove_spikes(readings, spikes)
    return replace(recording, readings=readings)


COPIES = Check(
    lambda r: find_copies(r.readings, *r.recording.extremes) or None,
    _describe_copies,
    _merge_copies,
)
LEAK = Check(
    lambda r: find_leak(r.readings),
    _describe_leak,
    lambda r, leak: replace(r, readings=remove_leak(r.readings, leak)),
)
LAGS = Check(lambda r: find_lags(r.readings, r.recording.varying()), _describe_lags, _align)
INVERTED = Check(_find_inverted, _describe_inverted, _flip)
COMMON_NOISE = Check(_find_common, _describe_common, _remove_common)
HUM = Check(
    lambda r: find_hum(r.readings, r.never_at_rest),
    _describe_hum,
    lambda r, hum: replace(r, readings=hum.removed_from(r.readings)),
)
DRIFT = Check(
    lambda r: find_drift(r.readings, r.never_at_rest),
    _describe_drift,
    lambda r, drift: replace(r, readings=remove_drift(r.readings, drift)),
)
SPIKES = Check(_find_spikes, _describe_spikes, _remove_spikes)


_MIN_MISSING = 0.02  # share of a sensor's readings; fewer change no correlation; chosen by hand
_MIN_JITTER = 0.05  # of the interval between frames; chosen by hand
_LOST_FRAME = 1.5  # intervals: a frame is missing
_MIN_CONTACTS = 5  # as in `anisomap.health.sensors.MIN_CONTACTS`
_MAX_SHARE_RARE = 0.05  # of the sensors, that may be touched rarely; chosen by hand


def _find_gaps(subject: Subject) -> NDArray[np.bool_] | None:
    bridged = find_bridged(subject.readings)
    complete = np.isfinite(subject.recording.extremes).all()
    if bridged is None and complete:
        return None
    missing = (
        np.zeros(subject.readings.shape, dtype=bool) if complete else ~np.isfinite(subject.readings)
    )
    if bridged is not None:
        missing |= bridged
    share = missing.mean(axis=0)
    affected = (share >= _MIN_MISSING) & (share < 1)
    return np.where(affected, missing, False) if affected.any() else None


def _describe_gaps(recording: Recording, missing: NDArray[np.bool_]) -> tuple[Finding, ...]:
    affected = np.flatnonzero(missing.any(axis=0))
    share = float(np.median(missing[:, affected].mean(axis=0)))
    bridged = bool(np.isfinite(recording.readings[missing]).any())
    return (
        Finding(
            "gaps",
            tuple(recording.names[int(i)] for i in affected),
            share,
            "share",
            f"{share:.0%} of the readings of {affected.size} of {recording.n_sensors} sensors are "
            + ("on straight lines, as if interpolated" if bridged else "missing"),
            "contacts in the gaps are lost, so these sensors seem less similar to their neighbours",
            mendable=True,
            mended="these readings were estimated from the most similar sensors",
        ),
    )


def _fill_gaps(recording: Recording, missing: NDArray[np.bool_]) -> Recording:
    readings, _ = fill_from_others(recording.readings, missing)
    return replace(recording, readings=readings)


def _find_clipped(subject: Subject) -> dict[int, float] | None:
    return find_clipped(subject.readings) or None


def _describe_clipped(recording: Recording, clipped: dict[int, float]) -> tuple[Finding, ...]:
    share = float(np.median(list(clipped.values())))
    return (
        Finding(
            "saturation",
            tuple(recording.names[i] for i in clipped),
            share,
            "share of the frames",
            f"{len(clipped)} of {recording.n_sensors} sensors are at the end of their range in "
            f"{share:.1%} of the frames (median)",
            "heights of contacts are cut off; lengths that follow from heights are wrong",
            mendable=False,
        ),
    )


@dataclass(frozen=True)
class _Clock:
    jitter: float
    lost: int


def _find_jitter(subject: Subject) -> _Clock | None:
    recording = subject.recording
    if recording.times is None or recording.n_frames < 3:
        return None
    steps = np.diff(recording.times)
    usual = float(np.median(steps))
    regular = steps[steps < _LOST_FRAME * usual]
    jitter = float(np.std(regular)) / usual if regular.size else 0.0
    lost = int(np.round(steps[steps >= _LOST_FRAME * usual] / usual - 1).sum())
    found = jitter >= _MIN_JITTER or lost >= _MIN_MISSING * recording.n_frames
    return _Clock(jitter, lost) if found else None


def _describe_jitter(_: Recording, clock: _Clock) -> tuple[Finding, ...]:
    lost = f"; about {clock.lost} frames are missing" if clock.lost else ""
    return (
        Finding(
            "clock-jitter",
            (),
            clock.jitter,
            "share of the interval",
            f"intervals between frames vary by {clock.jitter:.0%}{lost}",
            "maps do not depend on intervals; only lags in seconds do",
            mendable=False,
        ),
    )


def _find_rare(subject: Subject) -> NDArray[np.intp] | None:
    active, recording = subject.active, subject.recording
    suspects = np.flatnonzero((count_contacts(active) < _MIN_CONTACTS) & recording.varying())
    if not suspects.size:
        return None
    rare = suspects[subject.contacts(suspects) < _MIN_CONTACTS]
    return rare if rare.size > _MAX_SHARE_RARE * recording.n_sensors else None


def _describe_rare(recording: Recording, rare: NDArray[np.intp]) -> tuple[Finding, ...]:
    return (
        Finding(
            "few-contacts",
            tuple(recording.names[int(i)] for i in rare),
            rare.size / recording.n_sensors,
            "share",
            f"{rare.size} of {recording.n_sensors} sensors were touched fewer than "
            f"{_MIN_CONTACTS} times",
            "their positions are unreliable; touch them again",
            mendable=False,
        ),
    )


def _find_regions(subject: Subject) -> Regions | None:
    found = find_regions(subject.active)
    if found is None:
        return None
    step = -(-subject.recording.n_frames // len(subject.active))
    return replace(found, frame=found.frame * step)


def _describe_regions(recording: Recording, found: Regions) -> tuple[Finding, ...]:
    smaller = min(found.before, found.after, key=len)
    return (
        Finding(
            "separate-regions",
            tuple(recording.names[int(i)] for i in smaller),
            float(found.bridges.size),
            "sensors touched with both",
            f"two regions of {found.before.size} and {found.after.size} sensors were touched one "
            f"after the other, the second from frame {found.frame} on, and "
            f"{found.bridges.size or 'no'} sensors with both",
            "the relative position of the regions is unknown; touch the skin between them",
            mendable=False,
        ),
    )


def _describe_period(recording: Recording, found: tuple[float, float]) -> tuple[Finding, ...]:
    period, share = found
    return (
        Finding(
            "one-period",
            recording.names,
            share,
            "share of the variance",
            f"{share:.0%} of the variance of the readings is a sine of {period:.4g} frames",
            "similarity depends on phase alone; there is nothing to map",
            mendable=False,
        ),
    )


GAPS = Check(_find_gaps, _describe_gaps, _fill_gaps)
SATURATION = Check(_find_clipped, _describe_clipped)
CLOCK_JITTER = Check(_find_jitter, _describe_jitter)
FEW_CONTACTS = Check(_find_rare, _describe_rare)
SEPARATE_REGIONS = Check(_find_regions, _describe_regions)
ONE_PERIOD = Check(lambda r: find_one_period(r.readings), _describe_period)
