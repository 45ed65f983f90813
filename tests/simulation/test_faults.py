from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap.errors import InputError
from anisomap.recording import Recording
from anisomap.simulation.faults import (
    FAULTS,
    Fault,
    dead,
    fault_mask,
    inflicted_faults,
    noisy,
    saturating,
)

seeds = st.integers(0, 2**32 - 1)


def touched_now_and_then(seed: int, n_frames: int = 400, n_sensors: int = 6) -> Recording:
    """Sensors at rest three frames of four."""
    rng = np.random.default_rng(seed)
    depth = rng.exponential(size=(n_frames, n_sensors))
    readings = np.where(rng.random((n_frames, n_sensors)) < 0.25, depth, 0).astype(np.float32)
    return Recording(readings, rate_hz=20, metadata={"scenario": "made up"})


@pytest.mark.parametrize("kind", FAULTS)
@given(seed=seeds, sensors=st.sets(st.integers(0, 5)))
def test_a_fault_touches_exactly_what_it_says(kind: str, seed: int, sensors: set[int]) -> None:
    whole = touched_now_and_then(seed)
    before = whole.readings.copy()
    spoilt = FAULTS[kind](whole, sensors, rng=seed)
    mask = fault_mask(spoilt)
    np.testing.assert_array_equal(whole.readings, before)
    np.testing.assert_array_equal(spoilt.readings[~mask], before[~mask])
    assert spoilt.readings.dtype == before.dtype
    assert not mask[:, [i for i in range(6) if i not in sensors]].any()
    done = inflicted_faults(spoilt)
    assert [fault.sensor for fault in done] == [f"s{i}" for i in sorted(sensors)]
    assert {fault.kind for fault in done} <= {kind}
    assert mask.sum() == sum(stop - start for fault in done for start, stop in fault.spans)
    assert spoilt.metadata["scenario"] == "made up"
    assert (spoilt.names, spoilt.rate_hz) == (whole.names, whole.rate_hz)
    assert inflicted_faults(whole) == ()
    assert not fault_mask(whole).any()


@pytest.mark.parametrize("kind", FAULTS)
def test_the_same_seed_gives_the_same_fault(kind: str) -> None:
    whole = touched_now_and_then(0, n_frames=2000)
    first, again, other = (FAULTS[kind](whole, ["s1", "s4"], rng=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.readings, again.readings)
    assert dict(first.metadata) == dict(again.metadata)
    if kind != "dead":
        assert not np.array_equal(first.readings, other.readings)
        assert not np.array_equal(first.readings[:, 1], first.readings[:, 4])


@given(seeds)
def test_dead_sensors_rest_always(seed: int) -> None:
    spoilt = dead(touched_now_and_then(seed), ["s2"])
    assert (spoilt.readings[:, 2] == 0).all()
    raised = touched_now_and_then(seed)
    raised = Recording(7 - 2 * raised.readings)
    assert (dead(raised, [0]).readings[:, 0] == 7).all()


def test_a_dead_sensor_may_have_missed_readings() -> None:
    readings = touched_now_and_then(1).readings.copy()
    readings[3:9, 2] = np.nan
    assert (dead(Recording(readings), [2]).readings[:, 2] == 0).all()


@given(seeds)
def test_saturating_sensors_read_full_scale_in_their_spans(seed: int) -> None:
    whole = touched_now_and_then(seed)
    spoilt = saturating(whole, [0, 5], rng=seed)
    assert (spoilt.readings[fault_mask(spoilt)] == whole.readings.max()).all()
    for fault in inflicted_faults(spoilt):
        edges = np.array(fault.spans).ravel()
        assert (np.diff(edges) > 0).all()
        assert ((edges >= 0) & (edges <= whole.n_frames)).all()


def test_saturation_comes_and_goes_at_random_as_often_and_as_long_as_asked_for() -> None:
    whole = Recording(np.zeros((200_000, 1)))
    spoilt = saturating(whole, [0], rng=1, level=5.0, mean_gap=60, mean_span=15)
    (fault,) = inflicted_faults(spoilt)
    starts, stops = np.array(fault.spans).T
    spans, gaps = stops - starts, starts[1:] - stops[:-1]
    # Of geometric lengths, mean and standard deviation are nearly the same.
    for lengths, mean in ((spans, 15), (gaps, 60)):
        assert lengths.mean() == pytest.approx(mean, rel=0.06)
        assert lengths.std() == pytest.approx(mean, rel=0.1)
    assert spoilt.readings.mean() == pytest.approx(5 * 15 / 75, rel=0.06)


def test_saturation_has_nothing_to_do_with_touch() -> None:
    whole = touched_now_and_then(2, n_frames=50_000)
    mask = fault_mask(saturating(whole, [0], rng=2))[:, 0]
    active = whole.readings[:, 0] > 0
    assert active[mask].mean() == pytest.approx(active[~mask].mean(), abs=0.02)


@pytest.mark.parametrize("level", [0.05, 0.5])
def test_noise_is_white_normal_and_as_strong_as_asked_for(level: float) -> None:
    whole = touched_now_and_then(3, n_frames=20_000)
    spoilt = noisy(whole, ["s0", "s3"], rng=1, level=level)
    noise = (spoilt.readings - whole.readings)[:, [0, 3]] / np.ptp(whole.readings)
    assert noise.std() == pytest.approx(level, rel=0.03)
    assert abs(noise.mean()) < 0.02 * level
    assert np.mean(np.abs(noise) < level) == pytest.approx(0.683, abs=0.01)
    assert abs(np.corrcoef(noise[:-1, 0], noise[1:, 0])[0, 1]) < 0.03
    assert abs(np.corrcoef(noise.T)[0, 1]) < 0.03


def test_faults_compose_and_stay_on_the_record() -> None:
    whole = touched_now_and_then(4, n_frames=3000)
    spoilt = noisy(saturating(dead(whole, [1]), [2, 3], rng=1), [3], rng=1)
    assert [(fault.kind, fault.sensor) for fault in inflicted_faults(spoilt)] == [
        ("dead", "s1"),
        ("saturating", "s2"),
        ("saturating", "s3"),
        ("noisy", "s3"),
    ]
    np.testing.assert_array_equal(
        fault_mask(spoilt),
        fault_mask(spoilt, ["dead", "noisy"]) | fault_mask(spoilt, ["saturating"]),
    )
    assert fault_mask(spoilt, ["dead"]).sum() == 3000
    some = spoilt.select([3, 0])
    np.testing.assert_array_equal(fault_mask(some), fault_mask(spoilt)[:, [3, 0]])


def test_names_that_would_upset_a_record_do_not() -> None:
    names = ('a "quoted" one', "commas, ; and\nbreaks", "Ω")
    spoilt = dead(Recording(np.eye(3), names=names), names)
    assert inflicted_faults(spoilt) == tuple(
        sorted(
            (Fault("dead", name, ((0, 3),)) for name in names), key=lambda f: names.index(f.sensor)
        )
    )


@pytest.mark.parametrize("record", ["nonsense", '{"kind": 1}', "[1]", '[{"kind": "dead"}]', "3"])
def test_a_damaged_record_is_refused(record: str) -> None:
    recording = Recording(np.eye(3), metadata={"faults": record})
    with pytest.raises(InputError, match="do not say what was done"):
        inflicted_faults(recording)


@pytest.mark.parametrize("kind", FAULTS)
def test_a_sensor_that_is_not_there_is_refused(kind: str) -> None:
    with pytest.raises(InputError, match="there is no sensor 's99'"):
        FAULTS[kind](touched_now_and_then(0), ["s99"])


@pytest.mark.parametrize(
    ("fault", "parameters", "message"),
    [
        (saturating, {"mean_gap": 0}, "mean_gap is 0 frames; it must be at least 1"),
        (saturating, {"mean_span": float("nan")}, "mean_span is nan"),
        (noisy, {"level": 0}, "level is 0; it must be a positive number"),
        (noisy, {"level": -1}, "level is -1"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(
    fault: Any, parameters: Any, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        fault(touched_now_and_then(0), [0], **parameters)
