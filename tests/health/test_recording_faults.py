"""Faults of whole recordings: each is found by its name, and no other, and mended."""

import warnings
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from benchmarks.skins.independent import Case as SkinCase
from benchmarks.skins.independent import damaged, make
from benchmarks.verdicts.suite import DAMAGES
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

import anisomap
from anisomap import AnisomapWarning, Recording, assess, find_faults, repair
from anisomap.health import CHECKS, STATUSES, spoiling, weaknesses
from anisomap.health.recording_faults.stimulation import one_period
from anisomap.health.sensors import MIN_CONTACTS
from anisomap.live.quick_map import confirmed_faults
from anisomap.numerics.signals import Signals
from anisomap.sensor_map import is_faulty
from clean_recordings import COURSES, FORMS, TRUE_OF_CLEAN, Case, cases
from skins import bombarded_skin, flat_skin, lattice, mantel_r, quietly, rubbed, seeing_patch


@cache
def wired_at_random(seed=0, n_frames=1500):
    """Return a rubbed skin of 72 sensors whose channels are in random order."""
    positions = np.random.default_rng(seed).permutation(lattice(8, 9))
    readings = rubbed(positions, n_frames, seed=seed, reach=1.5).astype(np.float32)
    return Recording(readings, positions=positions, rate_hz=50)


def spoilt(recording, damage, seed=0):
    return damaged(recording, damage, np.random.default_rng(seed))


def faulty(recording):
    return str(recording.metadata["faulty"]).split(",")


def spoilt_in_part(recording, damage, share, seed=0):
    """Damage some sensors in a way that is otherwise of all; return the damaged ones as well."""
    rng = np.random.default_rng(seed)
    some = rng.permutation(recording.n_sensors)[: round(share * recording.n_sensors)]
    readings = np.array(recording.readings)
    readings[:, some] = damaged(recording, damage, rng).readings[:, some]
    return replace(recording, readings=readings), some


def kinds(findings):
    return {finding.kind for finding in findings}


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


@pytest.mark.parametrize("name", FOUND)
def test_faults_do_not_depend_on_the_unit(name):
    bad = spoilt(wired_at_random(), FOUND[name])
    units = Recording(bad.readings), Recording(np.ldexp(bad.readings, -45))  # as of tesla
    named = [[(one.kind, one.sensors) for one in find_faults(recording)] for recording in units]
    assert named[0] == named[1]
    assert named[0]


def pressed(positions, n_frames, *, seed, n_places):
    """Return readings under one press after another, at some places in random order."""
    rng = np.random.default_rng(seed)
    places = positions[rng.integers(len(positions), size=n_places)]
    readings, frame = np.zeros((n_frames, len(positions))), 0
    while frame < n_frames:
        place = places[rng.integers(n_places)] + rng.normal(0, 0.3, 2)
        length = int(rng.integers(5, 15))
        height = rng.uniform(0.6, 1.4) * np.sin(np.pi * np.arange(1, length + 1) / (length + 1))
        depth = np.maximum(0, 2 - np.linalg.norm(positions - place, axis=1))
        readings[frame : frame + length] = np.outer(height, depth)[: n_frames - frame]
        frame += length + int(rng.integers(1, 8))
    return readings


@pytest.mark.parametrize("seed", [1, 6, 9])
def test_sensors_that_recover_slowly_did_not_change(seed):
    readings = pressed(lattice(9, 10), 1400, seed=seed, n_places=30)
    left = lfilter([2.5 / 200], [1, 1 / 200 - 1], readings, axis=0)
    assert "changed" not in kinds(find_faults(Recording(readings + 0.15 * left)))


@pytest.mark.parametrize(("seed", "n_places"), [(1, 9), (7, 15), (20, 8), (74, 12)])
def test_few_places_that_are_pressed_again_and_again_are_no_fault(seed, n_places):
    strip = np.array([(i, j) for i in range(30) for j in range(4)], dtype=float)
    readings = pressed(strip, 850, seed=seed, n_places=n_places)
    for before, after in pairwise(readings):  # each rises at once, and recovers slowly
        after[:] = np.where(after > before, after, 0.85 * before + 0.15 * after)
    assert not find_faults(Recording(readings))


def test_sensors_that_one_press_reached_are_no_copies_if_they_recover_slowly():
    bump, readings = np.sin(np.pi * np.arange(1, 10) / 10), np.zeros((900, 40))
    for i in range(20):  # no press reaches other sensors than these two
        readings[20 + 40 * i : 29 + 40 * i, [2 * i, 2 * i + 1]] = np.outer(bump, [1, 0.8])
    left = lfilter([2.5 / 200], [1, 1 / 200 - 1], readings, axis=0)
    assert "copies" not in kinds(find_faults(Recording(readings + 0.15 * left)))


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


@pytest.mark.parametrize("name", ["common-noise", "hum"])
def test_faults_of_readings_whose_squares_float32_does_not_hold_are_found(name):
    bad = spoilt(wired_at_random(), FOUND[name])
    found = find_faults(Recording(np.ldexp(bad.readings.astype(np.float32), -90)))
    assert name in kinds(found)
    assert all(np.isfinite(one.size) for one in found)


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


@pytest.mark.parametrize("skin", [wired_at_random, flat_skin, seeing_patch, bombarded_skin])
def test_sound_recordings_have_no_faults_and_are_not_changed(skin):
    for recording in [skin()] if skin is bombarded_skin else [skin(seed=301), skin(seed=303)]:
        found = repair(recording)
        assert found.findings == ()
        assert found.recording is recording


CLEAN = [one for one in cases(sizes=(20, 90), frames=(30, 200)) if one.body != "scattered"]
"""Without places drawn at random, of which some are isolated."""


@pytest.mark.parametrize("course", COURSES)
@pytest.mark.parametrize("form", FORMS)
def test_no_healthy_sensor_is_called_faulty(course, form):
    """Contacts of one frame and of many, few of them or none on most sensors, and few frames."""
    drawn = [one.draw(seed=5) for one in CLEAN if (one.course, one.form) == (course, form)]
    statuses = [sensor.status for recording in drawn for sensor in assess(recording)]
    assert sum(map(is_faulty, statuses)) <= 2  # of 430


def test_sensors_that_show_noise_alone_have_no_contacts():
    """Most sensors of a large skin, when a contact moves on a part of it."""
    readings = np.random.default_rng(0).normal(0, 0.01, (300, 400))
    readings[:, :40] += Case("plane", "strokes", "exact", 36, 300).draw(1).readings.max(1)[:, None]
    contacts = Signals(readings).contacts
    assert not contacts[40:].any()
    assert contacts[:40].all()


@pytest.mark.parametrize("seed", range(3))
def test_sensors_that_are_loaded_half_of_the_time_do_not_lack_contacts(seed):
    """Below a person who shifts on a seat, some sensors are never at rest, as their neighbours."""
    rng, places = np.random.default_rng(seed), lattice(7, 7)
    path = lfilter([1], [1, -0.97], rng.normal(size=(2000, 2)), axis=0)
    path = 3 + 0.8 * path / path.std(axis=0)
    apart = np.linalg.norm(places - path[:, None], axis=2)
    readings = np.exp(-(apart**2) / 5) + 0.002 * rng.normal(size=apart.shape)
    restless = np.flatnonzero(~Signals(readings).rest.known)
    health = assess(Recording(readings))
    assert {health[i].status for i in restless} == {"ok"}


def pressed_at_one_place(seed):
    """Press 64 sensors of a flat skin at one place, again and again."""
    rng, places = np.random.default_rng(seed), lattice(8, 8)[:, :2]
    force = np.tile(np.sin(np.pi * np.arange(40) / 40) ** 0.5, 12)
    apart = np.linalg.norm(places - places[rng.choice(64)], axis=1)
    readings = np.maximum(0, force[:, None] - 0.3 * apart**2)
    return readings + 0.01 * rng.normal(size=readings.shape)


@pytest.mark.parametrize("n_levels", [3, 8])
def test_few_levels_of_contacts_that_last_are_no_saturation(n_levels):
    rng, places = np.random.default_rng(n_levels), lattice(8, 9)
    lasting = np.repeat(places[rng.integers(len(places), size=40)], 60, axis=0)
    apart = np.linalg.norm(places - lasting[:, None], axis=2)
    force = np.tile(np.minimum(np.arange(60), np.arange(60)[::-1]) / 5, 40).clip(max=1)
    readings = np.round(n_levels * force[:, None] * np.maximum(0, 1 - apart**2 / 5))
    assert "saturation" not in kinds(find_faults(Recording(readings)))


@pytest.mark.parametrize("form", ["exact", "noise of 1 %", "8 bits", "binary"])
@pytest.mark.parametrize("n_sensors", [20, 60])
def test_a_contact_that_changes_its_force_but_not_its_place_is_no_fault(form, n_sensors):
    sound = Case("plane", "one place", form, n_sensors, 1000).draw(301)
    assert kinds(find_faults(sound)) <= TRUE_OF_CLEAN


@pytest.mark.parametrize("seed", range(3))
def test_sensors_that_one_place_of_contact_touches_alike_are_no_copies(seed):
    readings = pressed_at_one_place(seed)
    assert "copies" not in kinds(find_faults(readings))
    assert "copies" not in kinds(find_faults((readings > 0.3).astype(float)))
    readings[:, 9] = readings[:, 40]  # their noise is the same, too
    assert "copies" in kinds(find_faults(readings))


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


def test_noise_has_no_faults():
    assert find_faults(np.random.default_rng(0).normal(size=(4000, 60))) == ()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["insole_L", "nao_torso", "retina_stacy"])
def test_real_bodies_have_no_faults_of_the_read_out(recordings_folder, name):
    path = recordings_folder.parent / "recordings-hard" / f"{name}.npz"
    if not path.is_file():
        pytest.skip(f"{path.name} is not here")
    assert kinds(find_faults(anisomap.read(path))) == set()


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


def test_a_few_touches_of_a_piezoelectric_skin_are_not_of_one_period():
    """Its readings are changes of pressure, and few touches of like lengths come at even times."""
    for seed in range(20):
        rng, places = np.random.default_rng(seed), lattice(3, 4)
        starts = np.cumsum(rng.integers(6, 11, 9))
        pressure = np.zeros((51, 12))
        for begin, after in pairwise(starts.tolist()):
            width = min(after, 51) - begin
            if width > 0:
                rise = np.sin(np.pi * np.arange(width) / width) ** 2
                apart = np.linalg.norm(places - rng.uniform(0, [2, 3]), axis=1)
                pressure[begin : begin + width] = rise[:, None] * np.exp(-(apart**2) / 4)
        assert one_period(Recording(np.diff(pressure, axis=0))) is None


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


@pytest.mark.parametrize("seed", [31, 66, 102])
def test_large_contacts_that_reach_many_channels_are_no_leak(seed):
    """One contact raises a dozen channels in a row, so the signs of a dozen pairs agree."""
    rng, places = np.random.default_rng(seed), lattice(12, 12)
    readings = np.zeros((300, 144))
    for begin in range(0, 300, 15):
        path = rng.uniform(0, 11, 2) + np.linspace(0, 1, 12)[:, None] * rng.normal(size=2)
        apart = np.linalg.norm(places - path[:, None], axis=2)
        rise = np.sin(np.linspace(0.1, np.pi - 0.1, 12))
        readings[begin : begin + 12] = rise[:, None] * np.maximum(0, 1 - (apart / 5) ** 2)
    readings += 0.004 * rng.normal(size=readings.shape)
    assert "leak" not in kinds(find_faults(Recording(readings)))


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


def test_what_holds_in_no_other_frames_is_not_mended():
    """Named in clean recordings of these seeds, by chance."""
    for case in (
        Case("sphere", "jumps", "noise of 1 %", 20, 30),
        Case("plane", "one place", "noise of 1 %", 20, 1000),
    ):
        clean = case.draw(303)
        assert repair(clean).recording is clean


@pytest.mark.parametrize("seed", range(6))
def test_noise_in_a_few_frames_is_not_an_inverted_contact(seed):
    """Sensors that a contact hardly reached show noise of either sign, and 0 in most frames."""
    rng, places = np.random.default_rng(seed), lattice(20, 20)
    path, step = np.full((200, 2), 10.0), np.zeros(2)
    for t in range(1, 200):
        step = 0.95 * step + 0.175 * rng.normal(size=2)
        path[t] = 19 - np.abs(19 - np.abs(path[t - 1] + step))
    apart = np.linalg.norm(places - path[:, None], axis=2)
    depth = np.maximum(0, np.exp(-(apart**2) / 4) - 0.05)
    readings = depth + 0.01 * rng.normal(size=depth.shape) * (depth > 0)
    assert "inverted" not in kinds(find_faults(Recording(readings)))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("kind", "case"),
    [
        ("inverted", Case("plane", "strokes", "noise of 1 %", 196, 200)),
        ("inverted", Case("plane", "presses", "noise of 1 %", 196, 200)),
        ("spikes", Case("scattered", "jumps", "exact", 196, 500)),
    ],
)
def test_few_or_short_contacts_are_no_fault(kind, case, seed):
    assert list(CHECKS[kind](case.draw(seed))) == []


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


@pytest.mark.parametrize("seed", [20, 24, 31])
def test_a_sensor_that_a_slow_finger_stays_on_is_not_inverted(seed):
    """It is touched most of the time, so that its readings are skewed to the other side."""
    rng = np.random.default_rng(seed)
    places = np.argwhere(np.ones((6, 6))).astype(float)
    readings = np.zeros((100, 36))
    for _ in range(2):
        turns = rng.uniform(0.01, 0.05, 2) * np.arange(100)[:, None] + rng.uniform(0, 6.3, 2)
        apart = np.linalg.norm(2.5 + 2.6 * np.sin(turns)[:, None] - places, axis=2)
        readings = np.maximum(readings, np.exp(-((apart / rng.uniform(1, 2)) ** 2)))
    assert list(CHECKS["inverted"](Recording(np.round(1000 * readings)))) == []


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
    (found,) = find_faults(Recording(readings))
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


@pytest.mark.parametrize("seed", [842, 845, 851])
@pytest.mark.parametrize("body", ["hand:n=60", "glove:n=60", "plate:n=49"])
def test_hands_that_rest_in_one_place_after_another_change_and_step_nothing(body, seed):
    held = make(SkinCase(body, "hold", n_frames=3000, seed=seed))
    assert not kinds(find_faults(held)) & {"changed", "steps"}


@pytest.mark.parametrize("noise", [0, 0.01])
@pytest.mark.parametrize("seed", range(4))
def test_blocks_that_are_moved_at_once_and_held_are_no_steps(noise, seed):
    rng, places = np.random.default_rng(seed), lattice(9, 9)
    lengths = rng.integers(30, 200, 40)
    held = [
        (np.linalg.norm(places - rng.uniform(0, 8, 2), axis=1) < rng.uniform(1, 6))
        * rng.uniform(0.5, 1, 81)
        for _ in lengths
    ]
    readings = np.repeat(held, lengths, axis=0)
    readings = readings + noise * rng.normal(size=readings.shape)
    assert list(CHECKS["steps"](Recording(readings))) == []


@pytest.mark.parametrize("form", FORMS)
def test_still_contacts_are_not_frozen_readings(form):
    """Frames of a still contact repeat if readings have no noise, and do not if they have."""
    case = Case("plane", "presses", "exact", 60, 800)
    held = np.repeat(case.draw(3).readings[::20], 20, axis=0)
    readings = FORMS[form](held.astype(np.float64), np.random.default_rng(3))
    assert list(CHECKS["frozen"](Recording(readings))) == []


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


@given(seed=st.integers(0, 99), level=st.floats(0.5, 10))
@settings(max_examples=3)
def test_a_field_that_changes_its_sign_is_not_inverted(seed, level):
    """Bending raises the readings of one side of a skin and lowers those of the other."""
    skin, rng = wired_at_random(), np.random.default_rng(seed)
    course = np.cumsum(rng.normal(size=(skin.n_frames, 2)), axis=0)
    course = (course - course.mean(axis=0)) / course.std(axis=0)
    slope = course @ (skin.positions - skin.positions.mean(axis=0)).T
    noise = rng.normal(0, 0.01, slope.shape)
    bent = Recording(skin.readings + level * (slope / slope.std() + noise))
    assert "inverted" not in kinds(find_faults(bent))


def test_what_spoils_a_map_is_among_its_notes():
    bad = spoilt(wired_at_random(), "leak:share=.2")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)
        made = anisomap.reconstruct(bad, "r-anisomap", 2)
        made = anisomap.diagnose(made, bad, with_verdict=False)
    (note,) = spoiling(find_faults(bad))
    assert note in made.notes
    assert "leaks into the next" in note


@pytest.mark.parametrize("seed", range(6))
def test_sources_at_several_places_are_no_common_noise(seed):
    """Sources of an EEG: each reaches the sensors near it, so that neighbours link all sensors."""
    rng = np.random.default_rng(seed)
    places, sources = (rng.normal(size=(n, 3)) for n in (40, 12))
    places[:, 2] = np.abs(places[:, 2])  # a scalp
    places, sources = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (places, sources))
    reach = np.exp(-2 * ((places[:, None] - sources) ** 2).sum(axis=2))
    courses = lfilter([1], [1, -0.9], rng.normal(size=(1000, 12)), axis=0)
    readings = courses @ reach.T + rng.normal(0, 0.2, (1000, 40))
    assert list(CHECKS["common-noise"](Recording(readings))) == []


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
