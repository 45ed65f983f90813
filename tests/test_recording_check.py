"""Faults of whole recordings: each is found by its name, nothing else is, and repair undoes it."""

import warnings
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import anisomap
from anisomap import AnisomapWarning, Recording, find_faults, repair
from anisomap.health import CHECKS, spoiling
from anisomap.numerics.recording_faults.gaps import find_bridged
from anisomap.simulation import inject, injected_faults, parse_fault
from skins import bombarded_skin, flat_skin, lattice, mantel_r, rubbed, seeing_patch


@cache
def wired_at_random(seed=0, n_frames=1500):
    """Return a rubbed skin of 72 sensors whose channels are in random order."""
    positions = np.random.default_rng(seed).permutation(lattice(8, 9))
    readings = rubbed(positions, n_frames, seed=seed, reach=1.5)
    return Recording(readings, positions=positions, rate_hz=50)


def spoilt(recording, *faults, seed=0):
    return inject(recording, [parse_fault(text) for text in faults], seed)


def kinds(findings):
    return {finding.kind for finding in findings}


FOUND = {
    "copies": ["duplicated:5%"],
    "copies, noisy": ["duplicated:5%,factor=3,level=0.2"],
    "leak": ["leaking:*"],
    "leak, large": ["leaking:*,share=0.2"],
    "lags": ["lagging:*,board=12,frames=3"],
    "lags of half": ["lagging:50%,frames=10"],
    "inverted": ["inverted:30%"],
    "common-noise": ["common-noise:*,level=1"],
    "board-noise": ["common-noise:*,level=1,board=12"],
    "hum": ["humming:*,level=1"],
    "drift": ["warming:*,level=0.2"],
    "spikes": ["spiking:*,board=12"],
    "gaps": ["bridged-gaps:20%"],
    "saturation": ["clipped:30%"],
    "few-contacts": ["rarely-touched:20%"],
    "one-period": ["cycling:*"],
    "separate-regions": ["separate-regions"],
    "clock-jitter": ["clock-jitter"],
}


@pytest.mark.parametrize("name", FOUND)
def test_a_fault_is_found_and_no_other(name):
    bad = spoilt(wired_at_random(301), *FOUND[name], seed=301)
    found = find_faults(bad)
    kind = name.partition(",")[0].removesuffix(" of half")
    assert kinds(found) - {"few-contacts"} == {kind} - {"few-contacts"}
    assert kind in kinds(found)
    for finding in found:
        assert set(finding.sensors) <= set(bad.names)
        assert finding.size >= 0
        assert bool(finding.mended) == finding.mendable
        assert finding.consequence in str(finding)


@pytest.mark.parametrize("fault", ["inverted:30%", "clipped:20%"])
def test_the_affected_sensors_are_named(fault):
    bad = spoilt(wired_at_random(), fault)
    (found,) = find_faults(bad)
    assert set(found.sensors) == {fault.sensor for fault in injected_faults(bad)}


def test_copies_are_named_with_their_source():
    bad = spoilt(wired_at_random(), "duplicated:s3,s9")
    clean = wired_at_random().readings
    for finding in find_faults(bad):
        columns = bad.readings[:, bad.indices(finding.sensors)]
        assert (columns == columns[:, :1]).all()
        assert (clean == columns[:, :1]).all(axis=0).any()
    copied = {name for finding in find_faults(bad) for name in finding.sensors}
    assert {"s3", "s9"} <= copied


@pytest.mark.parametrize("skin", [wired_at_random, flat_skin, seeing_patch, bombarded_skin])
def test_sound_recordings_have_no_faults_and_are_not_changed(skin):
    recording = skin() if skin is bombarded_skin else skin(seed=301)
    found = repair(recording)
    assert found.findings == ()
    assert found.recording is recording


@pytest.mark.parametrize("name", ["icub_hexagon", "icub_palm", "plantar"])
def test_real_skins_have_no_faults(recordings_folder, name):
    assert find_faults(anisomap.read(recordings_folder / f"{name}.npz")) == ()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["insole_L", "nao_torso", "retina_stacy", "retina_macc2"])
def test_real_bodies_have_no_faults_of_the_read_out(recordings_folder, name):
    path = recordings_folder.parent / "recordings-hard" / f"{name}.npz"
    if not path.is_file():
        pytest.skip(f"{path.name} is not here")
    assert kinds(find_faults(anisomap.read(path))) <= {"few-contacts"}


@given(share=st.floats(0.03, 0.3), chained=st.booleans())
@settings(max_examples=4)
def test_a_leak_is_subtracted_exactly(share, chained):
    clean = wired_at_random().readings
    leaking = np.array(clean)
    for i in range(1, clean.shape[1]):
        leaking[:, i] += share * (leaking if chained else clean)[:, i - 1]
    found = repair(leaking)
    (finding,) = found.findings
    assert finding.kind == "leak"
    assert finding.size == pytest.approx(share, rel=0.02)
    np.testing.assert_allclose(found.recording.readings, clean, atol=0.01 * share)


@given(inverted=st.sets(st.integers(0, 71), min_size=1, max_size=30))
@settings(max_examples=5)
def test_inverted_sensors_are_mirrored_at_rest(inverted):
    clean = wired_at_random()
    readings = np.array(clean.readings)
    readings[:, sorted(inverted)] *= -1
    found = repair(Recording(readings))
    (finding,) = found.findings
    assert finding.kind == "inverted"
    assert set(finding.sensors) == {f"s{i}" for i in inverted}
    np.testing.assert_array_equal(found.recording.readings, clean.readings)


@pytest.mark.parametrize(("frames", "board"), [(1, 18), (4, 12), (10, 24)])
def test_boards_are_aligned(frames, board):
    clean = wired_at_random()
    n_frames = clean.n_frames
    delays = frames * (np.arange(72) // board)
    lagging = np.column_stack(
        [np.roll(column, delay) for column, delay in zip(clean.readings.T, delays, strict=True)]
    )
    found = repair(Recording(lagging))
    assert kinds(found.findings) == {"lags"}
    aligned = found.recording.readings
    assert len(aligned) == n_frames - delays.max()
    np.testing.assert_array_equal(aligned, clean.readings[: len(aligned)])


@pytest.mark.parametrize(
    "fault", ["common-noise:*,level=2", "common-noise:*,board=12", "humming:*,level=2"]
)
def test_signals_of_the_electronics_are_subtracted(fault):
    clean = wired_at_random()
    before = clean.readings - clean.readings.mean(axis=0)
    bad = spoilt(clean, fault)
    after = repair(bad).recording.readings
    added, left = (
        np.std(readings - readings.mean(axis=0) - before) for readings in (bad.readings, after)
    )
    assert left < 0.1 * added


def test_copies_are_left_out_and_the_noisier_one_is_the_copy():
    bad = spoilt(wired_at_random(), "duplicated:s3,s9,factor=2,level=0.3")
    found = repair(bad)
    left_out = set(bad.names) - set(found.recording.names)
    assert left_out == {"s3", "s9"}
    assert len(found.done) == len(found.findings)


def test_missing_readings_are_estimated_from_neighbours():
    clean = wired_at_random()
    bad = spoilt(clean, "nan-bursts:20%,mean_gap=50,mean_span=50")
    lost = np.isnan(bad.readings)
    filled = repair(bad).recording.readings
    lines = bad.complete("interpolate").readings
    assert np.isfinite(filled).all()
    np.testing.assert_array_equal(filled[~lost], clean.readings[~lost])
    errors = [np.std((r - clean.readings)[lost]) for r in (filled, lines)]
    assert errors[0] < errors[1]


@pytest.mark.parametrize(
    "fault",
    [
        "duplicated:10%,factor=3,level=0.1",
        "leaking:*,share=0.2",
        "lagging:*,board=12",
        f"inverted:{','.join(f's{i}' for i in range(0, 72, 2))}",
    ],
    ids=lambda fault: fault.partition(":")[0],
)
def test_a_repaired_recording_is_mapped_better(fault):
    bad = spoilt(wired_at_random(), fault)
    before, after = (
        1 - mantel_r(anisomap.reconstruct(recording, "r-anisomap", 2), recording)
        for recording in (bad, repair(bad).recording)
    )
    assert after < before / 4


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (2, 2), (5, 1), (3, 40), (40, 3), (400, 2)])
def test_tiny_recordings_are_examined(shape):
    readings = np.random.default_rng(0).integers(0, 3, shape)
    assert kinds(find_faults(readings)) <= set(CHECKS)
    assert find_faults(np.full(shape, np.nan)) == ()


@given(
    gain=st.sampled_from([0.125, 4.0, 1024.0]),
    offset=st.sampled_from([0.0, 128.0]),
    kind=st.sampled_from(["leak", "copies", "inverted", "lags"]),
)
@settings(max_examples=4)
def test_findings_do_not_depend_on_units(gain, offset, kind):
    bad = spoilt(wired_at_random(), *FOUND[kind])
    readings = np.round(bad.readings * 1024) / 1024
    plain, changed = (find_faults(Recording(r)) for r in (readings, gain * readings + offset))
    assert kinds(plain) == kinds(changed) == {kind}


def test_what_spoils_a_map_is_among_its_notes():
    bad = spoilt(wired_at_random(), "leaking:*,share=0.2")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)
        made = anisomap.reconstruct(bad, "r-anisomap", 2)
        made = anisomap.diagnose(made, bad, with_verdict=False)
    (note,) = spoiling(find_faults(bad))
    assert note in made.notes
    assert "leak into the next" in note


@pytest.mark.parametrize("fault", ["", "lagging:*,board=16", "lagging:50%,frames=5"])
def test_lags_of_many_sensors_are_found(fault):
    positions = np.random.default_rng(302).permutation(lattice(14, 15))
    readings = rubbed(positions, 1500, seed=302, reach=2.5)
    recording = spoilt(Recording(readings), fault) if fault else Recording(readings)
    assert ("lags" in kinds(find_faults(recording))) == bool(fault)


@given(
    begin=st.integers(0, 160),
    length=st.integers(9, 40),
    dtype=st.sampled_from([np.float32, np.float64]),
    seed=st.integers(0, 2**16),
)
@settings(max_examples=25)
def test_lines_are_marked_wherever_they_begin(begin, length, dtype, seed):
    readings = np.random.default_rng(seed).normal(size=(400, 3))
    expected = np.zeros(readings.shape, dtype=bool)
    for start, rise in ((begin, 5), (begin + 200, -5)):
        readings[start : start + length + 1, 1] = np.linspace(0, rise, length + 1)
        expected[start + 1 : start + length, 1] = True
    np.testing.assert_array_equal(find_bridged(readings.astype(dtype)), expected)
