"""Maps of sessions: quick ones of samples of frames, advice, and robots with known numbering."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import anisomap
from anisomap import Recording, io, reconstruct, route
from anisomap.evaluation import align
from anisomap.health import SensorHealth
from anisomap.live import ExaminationOptions, LiveSession, workers
from anisomap.live.batches import Batch
from anisomap.live.quick_map import Advice, QuickMapper, confirmed_faults, turned_onto
from anisomap.live.recorder import JournalWriter
from anisomap.live.session import SessionMaps
from anisomap.live.workers import Examination, examine
from anisomap.map_verdict import LEVELS, UNKNOWN, Verdict
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.sampling import MAX_FRAMES
from anisomap.numerics.signals import count_contacts
from anisomap.numerics.similarity.rest import estimate_rest
from live_processes import Given, wait_for_maps
from skins import flat_skin, lattice, rubbed

SKIN = flat_skin(n_frames=1500)
READINGS = SKIN.readings.astype(float)

PADS = [96 + i for i in range(48) if i not in (11, 23, 35, 43)]
NAMES = [f"palm.{i - 96}" for i in PADS]
OPTIONS = {"method": "r-anisomap", "dimensions": 2, "preset": "icub-hand"}


def mapper_of(readings, *sizes, names=(), dimensions=2):
    """Return a mapper that was given frames in parts."""
    names = names or [f"s{i}" for i in range(readings.shape[1])]
    mapper = QuickMapper(names, dimensions)
    for part in np.split(readings, np.cumsum(sizes or [17] * (len(readings) // 17))):
        mapper.add(part)
    return mapper


@pytest.mark.parametrize("level", [*LEVELS, UNKNOWN])
def test_the_headline_says_what_to_do_and_repeats_no_verdict(level):
    options = ExaminationOptions(spacing_mm=6.0)
    maps = SessionMaps(options, print, print, lambda: 0.0)
    assert maps.guidance == ("Touch the skin", False)
    maps.quick = mapper_of(READINGS[:34]).make()
    place = maps.quick.advice.places[0].in_words(maps.names)
    assert place in maps.guidance[0] or "not touched yet" in maps.guidance[0]
    maps.quick = replace(maps.quick, advice=Advice())
    assert maps.guidance[0].startswith("Touch the whole skin")
    verdict = Verdict(level, 0.3, reasons=("record longer",))
    maps.checked = Examination(None, (), None, verdict, np.nan, 80, 1.0, final=False)
    told, good = maps.guidance
    assert good == (level == "usable")
    assert told.startswith("Good: positions are accurate to" if good else "Touch the whole skin")
    assert ("1.8 mm" in told) == good
    assert "80" not in told


def test_the_headline_follows_the_state_of_the_session(tmp_path, monkeypatch):
    session = LiveSession(Given(), tmp_path / "r.csv")
    assert session.guidance[0] == "Waiting for the first frame"
    session.recorder.n_frames = 34
    assert session.guidance[0] == "No connection to a test: trying again"
    session.source.is_open = True
    session.maps.quick = mapper_of(READINGS[:34]).make()
    assert session.guidance == session.maps.guidance
    monkeypatch.setattr(LiveSession, "lags", True)
    assert session.guidance[0].startswith("Wait: the map does not yet include")
    session.pause(True)
    assert session.guidance[0].startswith("Paused")
    session.ended.set()
    assert session.guidance == ("The session is over.", False)


@given(sizes=st.lists(st.integers(1, 60), max_size=4), offset=st.floats(-1e3, 1e3))
@settings(max_examples=15)
def test_maps_do_not_depend_on_the_batches(sizes, offset):
    readings = (rubbed(lattice(4, 4), 300, seed=3) + offset).astype(np.float32)
    found = mapper_of(readings, *sizes)
    np.testing.assert_array_equal(found.sample.readings, readings)
    active = estimate_rest(readings).active(readings)
    np.testing.assert_array_equal(found.make().contacts, count_contacts(active))


def test_contacts_are_counted_beyond_the_sample():
    """None is lost that is longer than the distance of the frames that are kept."""
    slow = np.repeat(rubbed(lattice(3, 3), MAX_FRAMES // 4 + 100, seed=1), 8, axis=0)
    found = mapper_of(slow)
    made = found.make()
    assert made.n_frames == len(slow) > 2 * len(found.sample.readings)
    contacts = count_contacts(estimate_rest(slow).active(slow))
    np.testing.assert_array_equal(made.contacts, contacts)


def test_missing_readings_are_interpolated():
    readings = rubbed(lattice(3, 3), 200, seed=2).astype(np.float32)
    readings[50:60, 2], readings[0, 4], readings[20, 3] = np.nan, np.nan, np.nan
    expected = Recording(readings).complete("interpolate").readings
    for sizes in ((200,), (55, 145), (1, 20, 179)):
        found = mapper_of(readings, *sizes).make()
        active = estimate_rest(expected).active(expected)
        np.testing.assert_array_equal(found.contacts, count_contacts(active))


def test_a_sensor_that_never_sends_a_number_has_no_place():
    readings = rubbed(lattice(4, 4), 400, seed=2)
    readings[:, 7] = np.nan
    made = mapper_of(readings, 100).make()
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(made.positions).any(axis=1)), 7)


def test_maps_grow_without_turning_over():
    mapper, before = QuickMapper(SKIN.names, 2), None
    for at in range(0, 1500, 100):
        mapper.add(READINGS[at : at + 100])
        made = mapper.make()
        assert made.n_frames == at + 100
        if made.reason:
            assert not np.isfinite(made.positions).any()
            continue
        if before is not None:
            shared = np.isfinite(before).all(axis=1) & np.isfinite(made.positions).all(axis=1)
            if shared.sum() > 10:
                fit = fit_similarity(made.positions[shared], before[shared], scaling=False)
                np.testing.assert_allclose(fit.rotation, np.eye(2), atol=1e-6)
        before = made.positions
    # A warm map is the cold one, which is that of the published method.
    cold = mapper_of(READINGS).make().positions
    published = reconstruct(SKIN, "r-anisomap", 2).positions
    for found in (before, published):
        assert align(found, cold).rms < 1e-3  # of an RMS radius of 1


@given(seed=st.integers(0, 100), mirrored=st.booleans(), dimensions=st.sampled_from([2, 3]))
def test_a_map_is_turned_onto_the_one_before(seed, mirrored, dimensions):
    rng = np.random.default_rng(seed)
    before = turned_onto(rng.normal(size=(12, dimensions)), None)
    rotation = np.linalg.qr(rng.normal(size=(dimensions, dimensions)))[0]
    rotation[:, 0] *= -1 if mirrored else 1
    moved = 3 * before @ rotation + rng.normal(size=dimensions)
    np.testing.assert_allclose(turned_onto(moved, before), before, atol=1e-9)


def test_the_coach_names_what_was_not_touched_and_says_when_it_is_enough():
    half = np.flatnonzero(SKIN.positions[:, 0] > 3)
    readings = READINGS[READINGS[:, half].max(axis=1) == 0]
    untouched = np.flatnonzero(readings.max(axis=0) == 0)
    made = mapper_of(readings, names=SKIN.names).make()
    assert set(made.advice.untouched) == set(untouched) >= set(half)
    assert mapper_of(READINGS).make().advice == Advice()


def test_dropped_sensors_are_no_advice():
    readings = READINGS.copy()
    readings[:, :8] = 0
    mapper = mapper_of(readings)
    assert mapper.make().advice.untouched == tuple(range(8))
    mapper.drop = {*range(8)}
    assert mapper.make().advice == Advice()


def test_a_dead_sensor_does_not_keep_a_session_from_its_end():
    readings = READINGS.copy()
    readings[:, 38] = 0
    assert 38 in mapper_of(readings[:34]).make().advice.untouched
    maps = SessionMaps(ExaminationOptions(), print, print, lambda: 0.0)
    maps.quick = mapper_of(readings).make()
    assert maps.quick.advice == Advice(dead=(38,))
    verdict = Verdict("usable", 0.3)
    maps.checked = Examination(None, (), None, verdict, np.nan, 80, 1.0, final=False)
    told, good = maps.guidance
    assert good
    assert told.startswith("s38 never responded: dead? Good")


@pytest.mark.parametrize("n_frames", [1, 2, 3])
def test_first_frames_give_a_reason_instead_of_a_map(n_frames):
    made = mapper_of(READINGS[[0] * n_frames], 3).make()
    assert made.reason
    assert not np.isfinite(made.positions).any()


def health(name, status, contacts):
    return SensorHealth(name, status, "why", 0, 1, 2, 0.1, contacts, 0.9, 0.9)


def test_a_sensor_that_was_not_touched_yet_is_not_told_as_faulty():
    sensors = [
        health("untouched", "silent", 0),
        health("stuck", "stuck", 0),
        health("rare", "isolated", 3),
        health("noisy", "noisy", 40),
        health("fine", "ok", 40),
    ]
    assert [sensor.name for sensor in confirmed_faults(sensors)] == ["stuck", "noisy"]
    assert confirmed_faults(sensors[:1], ["untouched"]) == (sensors[0],)


@pytest.mark.parametrize("value", [1e308, -1.7e308, 1e39, np.inf])
def test_readings_out_of_range_are_missing(value):
    """Warnings are errors in the tests."""
    readings = np.random.default_rng(0).random((50, 4))
    readings[7, 2] = value
    batch = Batch(readings)
    assert np.argwhere(np.isnan(batch.readings)).tolist() == [[7, 2]]
    assert np.isfinite(mapper_of(batch.readings).make().highest_depth).all()


@pytest.fixture(scope="module")
def hand():
    """Return readings of a hand without fingers, in which values that are no pads vary too."""
    readings = np.full((400, 192), 255.0)
    readings[:, 96:144] = np.random.default_rng(0).random((400, 48))
    readings[:, PADS] = rubbed(lattice(4, 11), 400)
    return readings


@pytest.mark.slow
def test_a_session_maps_and_names_the_pads_of_a_port(hand, tmp_path):
    options = ExaminationOptions(**OPTIONS, spacing_mm=4.5)
    source = Given([Batch(hand)])
    with LiveSession(source, tmp_path / "r.csv", options) as session:
        wait_for_maps(session, lambda maps: maps.quick)
        quick = session.maps.quick
        command = session.command
    # The final map of the session is made by the same function, in another process.
    final = examine(tmp_path / "r.csv", len(hand), options, final=True)
    assert [quick.names[i] for i in PADS] == NAMES
    assert quick.left_out == tuple(sorted(set(range(192)) - set(PADS)))
    assert np.isfinite(quick.positions[PADS]).all()
    assert list(final.sensor_map.names) == NAMES
    assert "--preset icub-hand" in command
    assert "--contacts compact" in command
    assert "--spacing 4.5mm" in command
    np.testing.assert_array_equal(anisomap.read(tmp_path / "r.csv").readings, hand)
    read = io.read(tmp_path / "r.csv", options=io.ReadOptions(preset="icub-hand"))
    again = anisomap.reconstruct(read, "r-anisomap", 2)
    np.testing.assert_allclose(final.sensor_map.positions, again.positions, atol=1e-6)


@pytest.mark.parametrize("limit", ["none", "of a map", "of a map in between"])
def test_pads_are_named_however_much_is_read(hand, tmp_path, monkeypatch, limit):
    """Above some limits, frames are sampled."""
    writer = JournalWriter(tmp_path / "r.csv", [f"s{i}" for i in range(192)])
    writer.add(np.arange(len(hand)) / 50, hand)
    writer.close()
    if limit == "of a map":
        monkeypatch.setattr(route, "MAX_READINGS", 192 * 300)
    monkeypatch.setattr(workers, "MAX_INTERIM_READINGS", 192 * 300)
    options = ExaminationOptions(**OPTIONS, drop=("palm.0-palm.2,nobody",))
    final = limit != "of a map in between"
    found = examine(tmp_path / "r.csv", len(hand), options, final=final)
    assert found.sensor_map is not None, found.verdict
    assert list(found.sensor_map.names) == NAMES
    unplaced = [name for name, one in zip(NAMES, found.sensor_map.placed, strict=True) if not one]
    assert unplaced == ["palm.0", "palm.1", "palm.2"]
