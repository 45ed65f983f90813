"""Faults of whole recordings: each is found by its name, and no other, and mended."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.skins.independent import Case as SkinCase
from benchmarks.skins.independent import make
from benchmarks.verdicts.suite import DAMAGES
from hypothesis import given, settings
from hypothesis import strategies as st

import anisomap
from anisomap import AnisomapWarning, Recording, assess, find_faults, repair
from anisomap.health import CHECKS, STATUSES, spoiling, weaknesses
from anisomap.health.recording_faults.stimulation import one_period
from anisomap.health.sensors import MIN_CONTACTS
from anisomap.live.quick_map import confirmed_faults
from anisomap.sensor_map import is_faulty
from clean_recordings import Case
from damaged_skins import kinds, spoilt, spoilt_in_part, wired_at_random
from skins import flat_skin, lattice, mantel_r, quietly, rubbed


def faulty(recording):
    return str(recording.metadata["faulty"]).split(",")


FOUND = {
    "copies": "copied",
    "copies, noisy": "copied:noise=.2",
    "leak": "leak",
    "inverted": "inverted:share=.3",
    "common-noise": "common-noise:level=1",
    "board-noise": "common-noise:level=1,of_boards=1",
    "hum": "humming",
    "spikes": "spikes:of_boards=1",
    "gaps": "gaps",
    "saturation": "saturating:share=.3",
    "changed": "shifted:start=.5",
    "separate-regions": "regions",
}


@pytest.mark.parametrize("name", FOUND)
def test_a_fault_is_found_and_no_other(name):
    bad = spoilt(wired_at_random(301), FOUND[name], seed=301)
    found = find_faults(bad)
    kind = name.partition(",")[0]
    assert kinds(found) == {kind}
    if kind in {"inverted", "saturation"}:
        (named,) = (finding.sensors for finding in found if finding.kind == kind)
        assert set(named) == set(faulty(bad))
    for finding in found:
        assert set(finding.sensors) <= set(bad.names)
        assert finding.size >= 0
        assert bool(finding.mended) == finding.mendable
        assert finding.consequence in str(finding)
    # Other units, as of tesla, do not matter, even if float32 does not hold squares of readings.
    small = find_faults(np.ldexp(bad.readings.astype(np.float32), -90))
    assert [(one.kind, one.sensors) for one in small] == [(one.kind, one.sensors) for one in found]
    assert all(np.isfinite(one.size) for one in small)


def test_a_pause_in_the_middle_hides_no_fault():
    bad = spoilt(wired_at_random(301), FOUND["spikes"], seed=301).readings
    half = len(bad) // 2
    pause = np.tile(np.median(bad, axis=0), (9000, 1))
    paused = Recording(np.concatenate([bad[:half], pause, bad[half:]]))
    assert "spikes" in kinds(find_faults(paused))


def test_a_sensor_whose_changes_float32_does_not_resolve_hides_no_fault():
    bad = spoilt(wired_at_random(), FOUND["hum"])
    steady = 1e5 + 1e-4 * np.random.default_rng(0).normal(size=(bad.n_frames, 1))
    found = find_faults(Recording(np.hstack([bad.readings.astype(np.float64), steady])))
    assert kinds(found) == kinds(find_faults(bad))


@pytest.mark.parametrize("name", ["", "spikes", "inverted"])
def test_faults_do_not_depend_on_a_large_zero_of_each_sensor(name):
    sound = wired_at_random(301)
    readings = (spoilt(sound, FOUND[name], seed=301) if name else sound).readings
    rng = np.random.default_rng(0)
    readings = readings + 0.01 * rng.normal(size=readings.shape) * (name != "inverted")
    zeros = np.round(1e7 * rng.uniform(-1, 1, sound.n_sensors))
    assert kinds(find_faults(Recording(readings.astype(np.float64) + zeros))) == {name} - {""}


def test_copies_are_named_with_their_source():
    bad = spoilt(wired_at_random(), "copied:share=.03")
    for finding in find_faults(bad):
        columns = bad.readings[:, bad.indices(finding.sensors)]
        np.testing.assert_allclose(np.corrcoef(columns.T), 1, atol=1e-6)
    assert {name for one in find_faults(bad) for name in one.sensors} == set(faulty(bad))
    noisier = spoilt(wired_at_random(), "copied:share=.03,noise=.3")
    found = repair(noisier)
    assert set(noisier.names) - set(found.recording.names) == set(faulty(noisier)[:2])
    assert len(found.done) == len(found.findings)


def folded(positions):
    """Fold a flat skin along its middle: both halves lie 1 apart."""
    x, middle = positions[:, 0], positions[:, 0].max() / 2
    height = np.where(x > middle, 1.0, 0.0)
    return np.column_stack([np.minimum(x, 2 * middle - x), positions[:, 1], height])


def test_another_posture_is_found_with_its_frame_and_larger_contacts_are_not():
    positions = np.random.default_rng(301).permutation(lattice(7, 8))
    flat = rubbed(positions, 1500, seed=301)
    bent = rubbed(folded(positions), 1500, seed=302)
    (finding,) = find_faults(np.vstack([flat, bent]))
    assert finding.kind == "changed"
    assert "change at about frame 1500 of 3000" in finding.what
    for reach in (2.0, 4.0):
        other = rubbed(positions, 1500, seed=303, reach=reach)
        assert find_faults(np.vstack([flat, other])) == ()


@pytest.mark.parametrize("name", ["leak", "spikes", "common-noise", "saturation"])
def test_what_has_no_known_inverse_is_named_and_left_as_it_is(name):
    bad = spoilt(wired_at_random(), FOUND[name])
    found = repair(bad)
    assert name in kinds(found.findings)
    assert found.recording is bad


@given(share=st.floats(0.03, 0.3), chained=st.booleans())
@settings(max_examples=4)
def test_the_share_of_a_leak_is_stated(share, chained):
    clean = wired_at_random().readings
    leaking = np.array(clean)
    for i in range(1, clean.shape[1]):
        leaking[:, i] += share * (leaking if chained else clean)[:, i - 1]
    (finding,) = find_faults(leaking)
    assert finding.kind == "leak"
    assert finding.size == pytest.approx(share, rel=0.3)


@pytest.mark.parametrize("period", [2.5, 12, 100])
def test_sines_have_nothing_to_map(period):
    turns = np.arange(400)[:, None] / period + np.random.default_rng(0).random(20)
    sines = Recording(np.sin(2 * np.pi * turns))
    assert find_faults(sines) == ()
    share, found = one_period(sines)
    assert share > 0.9
    assert found == pytest.approx(period, rel=0.1)
    judged = quietly(anisomap.diagnose, quietly(anisomap.reconstruct, sines, dimensions=2), sines)
    assert judged.verdict.level == "not usable"
    assert "is a sine" in judged.verdict.reasons[0]


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


@pytest.mark.parametrize("seed", range(4))
def test_inverted_sensors_are_found_among_untouched_ones(seed):
    clean = Case("plane", "strokes", "noise of 1 %", 196, 1000).draw(seed)
    readings = np.array(clean.readings)
    often = np.count_nonzero(readings > 0.1, axis=0) >= 20
    often &= clean.signals.contacts >= MIN_CONTACTS  # fewer are too little to tell
    inverted = np.random.default_rng(seed).permutation(np.flatnonzero(often))[:9]
    readings[:, inverted] *= -1
    (found,) = CHECKS["inverted"](Recording(readings))
    assert sorted(found.sensors) == sorted(inverted)


@pytest.mark.parametrize("fault", ["common-noise:level=1,of_boards=1", "humming:level=2"])
def test_signals_of_the_electronics_are_subtracted(fault):
    clean = wired_at_random()
    before = clean.readings - clean.readings.mean(axis=0)
    bad = spoilt(clean, fault)
    after = repair(bad).recording.readings
    added, left = (
        np.std(readings - readings.mean(axis=0) - before) for readings in (bad.readings, after)
    )
    assert left < 0.1 * added


@pytest.mark.parametrize("missing", [np.nan, np.inf, -np.inf])
def test_missing_readings_that_follow_each_other_are_found_without_a_warning(missing):
    readings = np.array(flat_skin().readings)
    readings[100:400, 16] = missing
    (found,) = find_faults(readings)
    assert (found.kind, found.sensors) == ("gaps", ("s16",))


def test_missing_readings_are_estimated_from_neighbours():
    clean = wired_at_random()
    bad, _ = spoilt_in_part(clean, "gaps:share=.5", 0.2)
    lost = np.isnan(bad.readings)
    filled = repair(bad).recording.readings
    lines = bad.complete("interpolate").readings
    assert np.isfinite(filled).all()
    np.testing.assert_array_equal(filled[~lost], clean.readings[~lost])
    errors = [np.std((r - clean.readings)[lost]) for r in (filled, lines)]
    assert errors[0] < errors[1]


def noisy_skin(seed, level=0.01):
    recording = wired_at_random(seed)
    noise = np.random.default_rng(seed).normal(0, level, recording.readings.shape)
    return replace(recording, readings=recording.readings + noise.astype(np.float32))


@pytest.mark.parametrize("seed", [0, 301])
def test_frames_that_repeat_are_left_out(seed):
    sound = noisy_skin(seed)
    bad = spoilt(sound, "frozen:frames=40", seed=seed)
    found = repair(bad)
    assert kinds(found.findings) == {"frozen"}
    # What is left are frames of the sound recording, all but short spans' of them once.
    rows = {row.tobytes() for row in sound.readings}
    left = [row.tobytes() for row in found.recording.readings]
    assert set(left) <= rows
    assert len(set(left)) >= 0.99 * len(left)
    assert find_faults(found.recording) == ()


def test_sensors_that_repeat_their_readings_are_named_and_no_others():
    sound = noisy_skin(0)
    bad, some = spoilt_in_part(sound, "frozen:frames=40,share=.2", 0.1)
    (found,) = find_faults(bad)
    assert found.kind == "frozen"
    assert set(found.sensors) == {sound.names[i] for i in some}
    assert not found.mendable


@pytest.mark.parametrize("seed", range(3))
def test_sensors_whose_rest_steps_are_named_with_a_frame_and_no_others(seed):
    rng, sound = np.random.default_rng(seed), noisy_skin(seed)
    some, readings = rng.permutation(72)[:12], np.array(sound.readings)
    assert "steps" not in kinds(find_faults(sound))
    for frame in (500, 1100):
        readings[frame:, some] += 0.4 * rng.permutation([*[-1, 1] * 6]) * rng.uniform(1, 2, 12)
    (found,) = (
        one for one in find_faults(replace(sound, readings=readings)) if one.kind == "steps"
    )
    assert set(found.values["frames"]) <= {500, 1100}
    assert set(found.sensors) <= {sound.names[i] for i in some}
    assert len(found.sensors) >= 6


def test_a_board_whose_supply_steps_is_named_with_the_frame_and_no_other():
    """Not if similar sensors are touched at this moment, but no other is ever named."""
    n_found, n_sensors = 0, 12
    for seed in range(6):
        rng, sound = np.random.default_rng(seed), make(SkinCase("plate:n=64", "poke", seed=seed))
        frame, first = int(rng.integers(400, 1100)), 12 * int(rng.integers(5))
        some, readings = np.arange(first, first + n_sensors), np.array(sound.readings)
        signs = rng.permutation(np.resize([-1, 1], n_sensors))
        readings[frame:, some] += signs * rng.uniform(0.3, 0.6, n_sensors)
        for found in CHECKS["steps"](replace(sound, readings=readings)):
            n_found += 1
            assert found.values["frames"] == [frame]
            assert set(found.sensors) <= set(some)
    assert n_found >= 2


@pytest.mark.parametrize("fault", ["copied:share=.1,noise=.1", "inverted:share=.5"])
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
    health = assess(Recording(readings))
    assert len(health) == shape[1]
    assert {sensor.status for sensor in health} <= set(STATUSES)
    assert kinds(find_faults(readings)) <= set(CHECKS)
    assert find_faults(np.full(shape, np.nan)) == ()


def test_some_sensors_are_left_of_a_recording_of_one_signal():
    rng = np.random.default_rng(0)
    found = repair(rng.random((300, 1)) * rng.random(40))
    assert kinds(found.findings) == {"copies"}
    assert found.recording.varying().any()


def test_what_spoils_a_map_is_among_its_notes():
    bad = spoilt(wired_at_random(), "leak:share=.2")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)
        made = anisomap.reconstruct(bad, "r-anisomap", 2)
        made = anisomap.diagnose(made, bad, with_verdict=False)
    (note,) = spoiling(find_faults(bad))
    assert note in made.notes
    assert "leaks into the next" in note


@pytest.mark.parametrize("fault", ["dead", "stuck", "intermittent", ""])
def test_statements_about_a_sensor_do_not_contradict_each_other(fault):
    skin = wired_at_random(301)
    recording = spoilt(skin, fault, seed=301) if fault else skin
    health = assess(recording)
    told = weaknesses(recording, health)
    for sensor in health:
        sentences = [text for text in told if sensor.name in text.rpartition(": ")[2].split(", ")]
        assert len(sentences) <= (sensor.status != "ok")
    assert all(is_faulty(sensor.status) for sensor in confirmed_faults(health))
    assert repair(recording).findings == find_faults(recording)


@pytest.mark.filterwarnings("ignore::anisomap.AnisomapWarning")
def test_wires_that_are_exchanged_between_days_are_named_and_veto():
    positions = np.random.default_rng(3).permutation(lattice(7, 8))
    names = [f"t{i}" for i in range(56)]
    one, other = (
        Recording(rubbed(positions, 1200, seed=seed, reach=1.5), names=names) for seed in (3, 4)
    )
    assert find_faults([one, other]) == ()
    wires = np.arange(one.n_sensors)
    wires[[5, 31]] = wires[[31, 5]]
    days = [one, Recording(other.readings[:, wires], names=names)]
    (finding,) = find_faults(days)
    assert (finding.kind, finding.sensors) == ("changed", ("t5", "t31"))
    verdict = anisomap.diagnose(anisomap.reconstruct(days, dimensions=2), days).verdict
    assert verdict.level == "not usable"
    assert "t5, t31" in verdict.reasons[0]
    missing = [one, other.select(np.arange(55))]
    judged = anisomap.diagnose(anisomap.reconstruct(missing, dimensions=2), missing).verdict
    assert judged.level == "usable"


@pytest.mark.filterwarnings("ignore::anisomap.AnisomapWarning")
@given(st.sampled_from(["", *DAMAGES]), st.integers(0, 99))
@settings(max_examples=12)
def test_no_sensor_lies_far_outside_of_the_map_of_a_damaged_recording(damage, seed):
    """At most 100 median radii, also if the only reading of a sensor is lost by thinning."""
    touch = ("poke", "sway", "rain")[seed % 3]
    skin = make(SkinCase("plate:n=36", touch, "linear", damage, 900, seed)).complete("interpolate")
    readings = np.pad(skin.readings, ((0, 0), (0, seed // 3 % 3)))
    readings[451, skin.n_sensors :] = 3 * skin.readings.std()
    made = anisomap.reconstruct(readings, dimensions=2)
    for label, size in enumerate(made.component_sizes):
        places = made.positions[made.component == label]
        radii = np.linalg.norm(places - np.median(places, axis=0), axis=1)
        assert size < 3 or radii.max() <= 100 * np.median(radii)
