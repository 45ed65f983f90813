"""Health of sensors: each faulty one is found by its status, and no other."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import anisomap
from anisomap import Recording, assess, find_faults, summarise
from anisomap.health import weaknesses
from anisomap.numerics.signals import Signals
from anisomap.numerics.similarity.rest import estimate_rest
from skins import bombarded_skin, flat_skin, lattice, rubbed, seeing_patch

SENSOR = 16


def with_fault(change, skin=None, sensors=(SENSOR,)):
    readings, rng = np.array((skin or flat_skin()).readings), np.random.default_rng(0)
    for sensor in sensors:
        readings[:, sensor] = change(readings[:, sensor], rng, readings)
    return Recording(readings)


def suspects(recording):
    return {one.name: one.status for one in assess(recording) if one.status != "ok"}


def saturates(values, rng, readings):
    """Saturate at random times, as the paper's sensor 30 did."""
    faulty = values.copy()
    for start in rng.integers(0, len(values) - 30, len(values) // 40):
        faulty[start : start + rng.integers(5, 30)] = readings.max()
    return faulty


FAULTS = {
    "silent": lambda values, rng, readings: 0 * values,
    "stuck": lambda values, rng, readings: 0 * values + readings.max(),
    "saturating": saturates,
    "isolated": lambda values, rng, readings: np.where(
        rng.uniform(size=values.size) < 0.05, rng.uniform(0.1, 1, values.size), 0
    ),
    "noisy": lambda values, rng, readings: values + rng.normal(0, 2 * values.std(), values.size),
}


@pytest.mark.parametrize(
    ("skin", "sensors"),
    [(flat_skin(), (SENSOR,)), (flat_skin(seed=1), (SENSOR,)), (bombarded_skin(), (5, 17))],
    ids=["flat", "another", "simulated"],
)
@pytest.mark.parametrize("fault", FAULTS)
def test_faulty_sensors_are_found_and_no_other(fault, skin, sensors):
    recording = with_fault(FAULTS[fault], skin, sensors)
    assert suspects(recording) == dict.fromkeys((f"s{sensor}" for sensor in sensors), fault)
    assert all(assess(recording)[sensor].reason for sensor in sensors)


def noisy_skin(seed):
    """Return a skin with noise of 1 % of a contact, and other levels at rest."""
    rng, readings = np.random.default_rng(seed), flat_skin(seed=seed, n_frames=3000).readings
    return readings + rng.normal(0, 0.01, readings.shape) + rng.uniform(0, 3, readings.shape[1])


@given(
    seed=st.integers(0, 99),
    share=st.floats(0.1, 0.7),
    length=st.integers(12, 30),
    value=st.sampled_from([np.min, np.max]),
)
@settings(max_examples=12)
def test_a_sensor_that_drops_out_is_intermittent_and_no_other(seed, share, length, value):
    readings, rng = noisy_skin(seed), np.random.default_rng(seed)
    out = np.repeat(
        rng.permutation(len(readings) // length) < share * len(readings) / length, length
    )
    readings[: out.size, SENSOR][out] = value(readings[:, SENSOR])
    assert suspects(Recording(readings)) == {f"s{SENSOR}": "intermittent"}


@given(seed=st.integers(0, 99), share=st.floats(0.1, 0.9))
@settings(max_examples=8)
def test_sensors_that_a_range_cuts_off_are_not_intermittent(seed, share):
    """A third of the sensors lie below the range in a share of the frames without contact."""
    readings = noisy_skin(seed)
    readings[:, ::3] = np.maximum(readings[:, ::3], np.quantile(readings[:, ::3], share, axis=0))
    assert "intermittent" not in suspects(Recording(readings)).values()


def thresholded(seed):
    return Recording(flat_skin(seed=seed).readings > 0.5)


@pytest.mark.parametrize("skin", [flat_skin, seeing_patch, thresholded])
@pytest.mark.parametrize("seed", range(2))
def test_healthy_skins_give_no_false_alarms(skin, seed):
    assert suspects(skin(seed=seed)) == {}


@pytest.mark.parametrize("name", ["icub_hexagon", "icub_palm", "icub_torso", "plantar"])
def test_healthy_real_skins_give_no_false_alarms(recordings_folder, name):
    recording = anisomap.read(recordings_folder / f"{name}.npz")
    assert suspects(recording) == {}
    assert name == "icub_torso" or find_faults(recording) == ()


def test_an_electrode_at_an_eye_resembles_no_other(hard_recordings_folder):
    assert {*suspects(anisomap.read(hard_recordings_folder / "eeg.npz"))} == {"EOG1"}


@pytest.mark.parametrize("seed", range(5))
def test_sensors_that_are_farther_apart_than_others_are_not_isolated(seed):
    fingertip, palm = 0.6 * lattice(8, 8), [6, 0] + 1.2 * lattice(5, 6)
    readings = rubbed(np.vstack([fingertip, palm]), 2500, seed=seed, reach=1.8)
    assert suspects(Recording(readings)) == {}


@given(gain=st.sampled_from([-4.0, -0.5, 0.25, 8.0]), offset=st.sampled_from([0.0, 256.0]))
@settings(max_examples=4)
def test_health_does_not_depend_on_units(gain, offset):
    readings = np.round(with_fault(saturates).readings * 64)
    plain, changed = (
        [sensor.status for sensor in assess(Recording(r))]
        for r in (readings, gain * readings + offset)
    )
    assert plain == changed


def test_statistics_of_a_sensor():
    readings = np.zeros((100, 4))
    readings[10:20, 0] = readings[50:55, 0] = 2
    readings[10:20, 1] = 1
    found = assess(Recording(readings, names=["a", "b", "c", "d"]))[0]
    assert (found.minimum, found.maximum, found.distinct) == (0, 2, 2)
    assert found.active == pytest.approx(0.15)
    assert found.contacts == 2
    expected = np.corrcoef(readings[:, 0], readings[:, 1])[0, 1]
    assert found.best_match == pytest.approx(expected, abs=1e-5)


def test_a_summary_counts_frames_sensors_and_missing_readings():
    readings = np.array(flat_skin().readings, dtype=float)
    readings[:, 3] = 0
    readings[5, 4] = np.nan
    readings[6, 4] = np.inf
    found = summarise(Recording(readings, rate_hz=50))
    assert (found.n_frames, found.n_sensors, found.missing, found.n_constant) == (1500, 42, 2, 1)
    assert found.duration == pytest.approx(1499 / 50)
    assert found.share_of_zeros == np.mean(readings == 0)
    assert found.maximum == np.nanmax(readings[np.isfinite(readings)])
    assert any("never varied" in warning for warning in found.warnings)


def touched_once():
    readings = np.array(flat_skin().readings)
    readings[:, SENSOR], readings[700, SENSOR] = 0, 1
    return readings


@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_a_sensor_that_stays_beyond_rest_for_long_hides_no_noisy_one(real):
    readings = np.tile(with_fault(FAULTS["noisy"]).readings, (6, 1)).astype(real)
    for level in (0.1, 0.3, 1.1):
        readings[:, 0] = level * ((np.arange(9000) > 2400) & (np.arange(9000) < 6600))
        assert suspects(Recording(readings)) == {"s0": "few contacts", f"s{SENSOR}": "noisy"}


def test_a_sensor_touched_once_is_not_faulty():
    assert assess(Recording(touched_once()))[SENSOR].status == "few contacts"


@pytest.mark.parametrize(
    ("readings", "doubt"),
    [
        (flat_skin().readings * (np.arange(1500) < 200)[:, None], "fewer than 5 contacts"),
        (np.random.default_rng(0).normal(size=(800, 30)), "do not trust"),
        (touched_once(), f"s{SENSOR}"),
        (flat_skin().readings[:400], "only 400 frames"),
    ],
)
def test_weak_recordings_give_a_warning(readings, doubt):
    recording = Recording(readings)
    assert any(doubt in found for found in weaknesses(recording, assess(recording)))


@given(
    column=st.one_of(
        arrays(np.float32, st.integers(1, 60), elements=st.integers(0, 5)),
        arrays(np.float64, st.integers(1, 60), elements=st.floats(-2, 2)),
    ),
    sign=st.sampled_from([1, -1]),
)
@settings(max_examples=40)
def test_signals_count_the_frames_beyond_the_threshold(column, sign):
    column = sign * column
    readings = column[:, None]
    expected = estimate_rest(readings).active(readings)[:, 0]
    signals = Signals(readings)
    np.testing.assert_array_equal(signals.active[:, 0], expected)
    assert signals.n_active == np.count_nonzero(expected)
    assert signals.rest.distinct == np.unique(column).size
    extreme = column.max() if signals.rest.side[0] > 0 else column.min()
    assert signals.at_extreme == np.count_nonzero(expected & (column == extreme))
