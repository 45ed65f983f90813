"""Checks for what a recording lacks: readings, contacts, stimulation that tells places apart."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anisomap.health.contact_counts import count_contacts
from anisomap.health.findings import Check, Finding, Subject
from anisomap.numerics.recording_faults.courses import (
    Regions,
    find_clipped,
    find_one_period,
    find_regions,
)
from anisomap.numerics.recording_faults.gaps import fill_from_others, find_bridged
from anisomap.recording import Recording

_MIN_MISSING = 0.02  # share of a sensor's readings; fewer change no correlation; chosen by hand
_MIN_JITTER = 0.05  # of the interval between frames; chosen by hand
_LOST_FRAME = 1.5  # intervals: a frame is missing
_MIN_CONTACTS = 5  # as in `anisomap.health.assessment.MIN_CONTACTS`
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
