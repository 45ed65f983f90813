"""Sound recordings, in which no fault may be found."""

from itertools import pairwise

import numpy as np
import pytest
from benchmarks.skins.independent import Case as SkinCase
from benchmarks.skins.independent import make
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

import anisomap
from anisomap import Recording, assess, find_faults, repair
from anisomap.health import CHECKS
from anisomap.health.recording_faults.stimulation import one_period
from anisomap.numerics.signals import Signals
from anisomap.sensor_map import is_faulty
from clean_recordings import COURSES, FORMS, TRUE_OF_CLEAN, Case, cases
from damaged_skins import kinds, wired_at_random
from skins import bombarded_skin, flat_skin, lattice, seeing_patch


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


def slowly_recovering(readings):
    return readings + 0.15 * lfilter([2.5 / 200], [1, 1 / 200 - 1], readings, axis=0)


@pytest.mark.parametrize("seed", [1, 6, 9])
def test_sensors_that_recover_slowly_did_not_change(seed):
    readings = pressed(lattice(9, 10), 1400, seed=seed, n_places=30)
    assert "changed" not in kinds(find_faults(slowly_recovering(readings)))


@pytest.mark.parametrize(("seed", "n_places"), [(1, 9), (7, 15), (20, 8), (74, 12)])
def test_few_places_that_are_pressed_again_and_again_are_no_fault(seed, n_places):
    strip = np.array([(i, j) for i in range(30) for j in range(4)], dtype=float)
    readings = pressed(strip, 850, seed=seed, n_places=n_places)
    for before, after in pairwise(readings):  # each rises at once, and recovers slowly
        after[:] = np.where(after > before, after, 0.85 * before + 0.15 * after)
    assert not find_faults(readings)


def test_sensors_that_one_press_reached_are_no_copies_if_they_recover_slowly():
    bump, readings = np.sin(np.pi * np.arange(1, 10) / 10), np.zeros((900, 40))
    for i in range(20):  # no press reaches other sensors than these two
        readings[20 + 40 * i : 29 + 40 * i, [2 * i, 2 * i + 1]] = np.outer(bump, [1, 0.8])
    assert "copies" not in kinds(find_faults(slowly_recovering(readings)))


def noise(*, seed):
    return Recording(np.random.default_rng(seed).normal(size=(4000, 60)))


@pytest.mark.parametrize("skin", [wired_at_random, flat_skin, seeing_patch, bombarded_skin, noise])
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
    assert "saturation" not in kinds(find_faults(readings))


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


@pytest.mark.slow
@pytest.mark.parametrize("name", ["insole_L", "nao_torso", "retina_stacy"])
def test_real_bodies_have_no_faults_of_the_read_out(hard_recordings_folder, name):
    assert find_faults(anisomap.read(hard_recordings_folder / f"{name}.npz")) == ()


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
    assert "leak" not in kinds(find_faults(readings))


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
    assert "inverted" not in kinds(find_faults(readings))


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
