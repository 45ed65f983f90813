"""Checks for faults of the read-out: its signals, its order and its clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anisomap.health.findings import Check, Finding, Subject
from anisomap.numerics.recording_faults.common_mode import (
    CommonSignal,
    find_common_noise,
    find_hum,
)
from anisomap.numerics.recording_faults.copies import Copies, find_copies
from anisomap.numerics.recording_faults.drift import Drift, find_drift, remove_drift
from anisomap.numerics.recording_faults.lags import Lags, align, find_lags
from anisomap.numerics.recording_faults.leaks import Leak, find_leak, remove_leak
from anisomap.numerics.recording_faults.polarity import find_inverted
from anisomap.numerics.recording_faults.spikes import Spikes, find_spikes, remove_spikes
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.recording import Recording
from anisomap.wording import join_items

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
