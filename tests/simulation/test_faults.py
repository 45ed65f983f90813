"""Injected faults: their effects and their log."""

from dataclasses import replace
from inspect import signature
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from anisomap.errors import InputError
from anisomap.recording import Recording
from anisomap.simulation.injection import (
    FAULTS,
    FRAME_FAULTS,
    Fault,
    fault_mask,
    inject,
    injected_faults,
    parse_fault,
)

seeds = st.integers(0, 2**32 - 1)


def random_touches(seed, n_frames=400, n_sensors=6):
    """Recording with each sensor at rest in three of four frames."""
    rng = np.random.default_rng(seed)
    depth = rng.exponential(size=(n_frames, n_sensors))
    readings = np.where(rng.random((n_frames, n_sensors)) < 0.25, depth, 0).astype(np.float32)
    places = np.column_stack([np.arange(n_sensors), np.zeros(n_sensors)])
    return Recording(readings, rate_hz=20, positions=places, metadata={"scenario": "random"})


def broken(kind, recording, sensors=(), **parameters):
    """Inject a fault, and check that it changes only logged readings of a new recording."""
    before = recording.readings.copy()
    if kind in FRAME_FAULTS:
        faulty = FRAME_FAULTS[kind](recording, **parameters)
    else:
        faulty = FAULTS[kind](recording, sensors, **parameters)
    np.testing.assert_array_equal(recording.readings, before)
    if kind != "dropped-frames":
        sound = ~fault_mask(faulty)
        np.testing.assert_array_equal(faulty.readings[sound], before[sound])
    return faulty


def change(kind, recording, sensors, **parameters):
    """Readings with a fault, less those without."""
    return broken(kind, recording, sensors, **parameters).readings - recording.readings


@pytest.mark.parametrize("kind", FAULTS)
@given(seed=seeds, chosen=st.sets(st.integers(0, 5), max_size=5))
@settings(max_examples=20)
def test_a_fault_changes_only_logged_readings(kind, seed, chosen):
    sensors = sorted(chosen)[: len(chosen) // 2 * 2] if kind == "swapped" else sorted(chosen)
    clean = random_touches(seed)
    faulty = broken(kind, clean, sensors, rng=seed)
    mask = fault_mask(faulty)
    assert faulty.readings.dtype == clean.readings.dtype
    again = broken(kind, clean, sensors, rng=seed)
    np.testing.assert_array_equal(again.readings, faulty.readings)
    assert not mask[:, [i for i in range(6) if i not in sensors]].any()
    done = injected_faults(faulty)
    named = [f"s{i}" for i in sensors]
    if kind == "leaking" and 0 in sensors:
        named.remove("s0")  # no channel comes before the first
    if kind == "mirrored" and len(sensors) % 2:
        del named[len(sensors) // 2]  # the middle sensor is not affected
    assert [fault.sensor for fault in done] == named
    assert {fault.kind for fault in done} <= {kind}
    # The spans of a fault lie within the recording and do not overlap.
    assert mask.sum() == sum(stop - start for fault in done for start, stop in fault.spans)
    assert faulty.metadata["scenario"] == "random"
    assert (faulty.names, faulty.rate_hz) == (clean.names, clean.rate_hz)
    assert injected_faults(clean) == ()
    assert not fault_mask(clean).any()


@pytest.mark.parametrize("kind", sorted({*FRAME_FAULTS} - {"separate-regions"}))
@given(seed=seeds, share=st.floats(0.01, 0.9))
def test_a_frame_fault_changes_only_logged_frames(kind, seed, share):
    strength = {"level" if kind == "clock-jitter" else "share": share}
    times = np.arange(80) / 20 + np.linspace(0, 0.01, 80)
    clean = replace(random_touches(seed, n_frames=80), times=times)
    faulty = broken(kind, clean, rng=seed, **strength)
    (fault,) = injected_faults(faulty)
    assert fault.kind == kind
    assert (np.diff(faulty.times) > 0).all()
    mask = fault_mask(faulty)
    starts = [start for start, _ in fault.spans]
    if kind == "repeated-frames":
        stale = np.flatnonzero(mask.all(axis=1))
        np.testing.assert_array_equal(starts, stale)
        np.testing.assert_array_equal(faulty.readings[stale], faulty.readings[stale - 1])
        return
    assert not mask.any()
    if kind == "clock-jitter":
        assert np.abs(faulty.times - times).max() < 0.06
        return
    frames = np.searchsorted(times, faulty.times)  # original index of each frame
    np.testing.assert_array_equal(faulty.readings, clean.readings[frames])
    np.testing.assert_array_equal(starts, np.flatnonzero(np.diff(frames, prepend=-1) > 1))


@given(seed=seeds, share=st.floats(0.05, 0.8))
def test_dropping_frames_renumbers_earlier_spans(seed, share):
    clean = replace(random_touches(seed), times=np.arange(400) / 20)
    lost = broken("nan-bursts", clean, ["s1"], rng=seed, mean_gap=30)
    both = broken("saturating", lost, ["s2"], rng=seed)
    shorter = broken("dropped-frames", both, rng=seed, share=share)
    frames = np.round(20 * shorter.times).astype(int)
    np.testing.assert_array_equal(fault_mask(shorter), fault_mask(both)[frames])


@pytest.mark.parametrize("kind", FAULTS)
@pytest.mark.parametrize(
    "readings",
    [
        np.zeros((1, 4)),
        np.full((5, 4), np.nan),
        np.array([[0.0, 1, np.nan, 1]] * 3 + [[1.0, 0, 0, np.inf]]),
        np.random.default_rng(0).integers(0, 2, (50, 4)),
    ],
    ids=["one frame", "nothing", "missing", "0/1"],
)
def test_faults_apply_to_degenerate_recordings(kind, readings):
    recording = Recording(readings, positions=np.eye(4)[:, :3])
    parameters = {"n_neighbours": 2} if kind == "crosstalk" else {}
    faulty = broken(kind, recording, [0, 2], rng=1, **parameters)
    assert faulty.readings.shape == recording.readings.shape


@given(seeds)
@settings(max_examples=30)
def test_faults_of_single_sensors_have_the_documented_effect(seed):
    clean = random_touches(seed)
    before, top = clean.readings, float(clean.readings.max())

    def column(kind, **parameters):
        return broken(kind, clean, [1], **parameters).readings[:, 1]

    assert (column("dead") == 0).all()
    raised = Recording(7 - 2 * before)
    assert (broken("dead", raised, [0]).readings[:, 0] == 7).all()
    held = column("stuck", rng=seed)
    assert len(set(held.tolist())) == 1
    assert top / 2 <= held[0] <= top
    full = broken("saturating", clean, [0, 5], rng=seed)
    assert (full.readings[fault_mask(full)] == top).all()
    walk = column("drifting", rng=seed, level=0.4) - before[:, 1]
    assert np.abs(walk).max() == pytest.approx(0.4 * top, rel=1e-4)
    assert np.abs(np.diff(walk)).max() < 0.4 * np.ptp(walk)
    noise = change("noisy", clean, range(6), rng=seed, level=0.3) / top
    assert noise.std(axis=0) == pytest.approx(0.3, rel=0.2)
    assert np.abs(np.corrcoef(noise.T) - np.eye(6)).max() < 0.3
    gained = broken("gain-spread", clean, range(6), rng=seed, factor=5)
    gains = gained.readings.max(0) / before.max(0)
    assert np.abs(np.log(gains)).max() <= np.log(5) / 2 + 1e-6
    slow = column("hysteresis", recovery=10)
    assert (slow >= before[:, 1]).all()
    assert (slow[1:] >= slow[:-1] * np.exp(-0.1) - 1e-6).all()
    few = broken("quantised", clean, range(6), levels=4).readings
    assert len(np.unique(few)) <= 4
    assert np.abs(few - before).max() <= top / 6 + 1e-6
    assert set(np.unique(column("thresholded"))) <= {0, 1}
    np.testing.assert_allclose(column("inverted"), before.min() + top - before[:, 1], rtol=1e-6)
    cut = column("clipped", level=0.3)
    assert cut.max() == pytest.approx(0.3 * np.ptp(before[:, 1]))
    np.testing.assert_array_equal(cut[cut < cut.max()], before[cut < cut.max(), 1])
    warmed = column("warming", rng=seed) - before[:, 1]
    assert (np.diff(np.sign(warmed[-1]) * warmed) > -1e-6).all()
    rare = column("rarely-touched", contacts=2) > 0
    assert np.count_nonzero(rare[1:] & ~rare[:-1]) + rare[0] <= 2
    wave = column("cycling", rng=seed, period=20)
    np.testing.assert_allclose(wave[20:], wave[:-20], atol=1e-4)
    bridged = broken("bridged-gaps", clean, [2], rng=seed, mean_gap=20, mean_span=10)
    for start, stop in injected_faults(bridged)[0].spans:
        line = bridged.readings[max(start - 1, 0) : stop + 1, 2].astype(float)
        assert np.abs(np.diff(line, 2)).max(initial=0) < 1e-5


def test_saturated_spans_have_geometric_lengths_with_the_given_means():
    clean = Recording(np.zeros((200_000, 1)))
    faulty = broken("saturating", clean, [0], rng=1, level=5.0, mean_gap=60, mean_span=15)
    (fault,) = injected_faults(faulty)
    starts, stops = np.array(fault.spans).T
    spans, gaps = stops - starts, starts[1:] - stops[:-1]
    # The mean and the standard deviation of a geometric distribution are nearly equal. 2,700 spans
    # determine them to 2 and 3 %.
    for lengths, mean in ((spans, 15), (gaps, 60)):
        assert lengths.mean() == pytest.approx(mean, rel=0.08)
        assert lengths.std() == pytest.approx(mean, rel=0.12)
    assert faulty.readings.mean() == pytest.approx(5 * 15 / 75, rel=0.08)


def test_wiring_faults_move_readings_and_keep_names():
    clean = random_touches(1)
    before = clean.readings
    traded = broken("swapped", clean, ["s4", "s1", "s0", "s5"]).readings
    np.testing.assert_array_equal(traded[:, [4, 1, 0, 5]], before[:, [0, 5, 4, 1]])
    turned = broken("mirrored", clean, ["s0", "s1", "s2"]).readings
    np.testing.assert_array_equal(turned[:, :3], before[:, 2::-1])
    copied = broken("duplicated", clean, ["s2", "s3"], source="s5").readings
    np.testing.assert_array_equal(copied[:, [2, 3]], before[:, [5, 5]])
    mixed = broken("crosstalk", clean, ["s2"], share=0.5, n_neighbours=2).readings[:, 2]
    np.testing.assert_allclose(
        mixed, 0.5 * before[:, 2] + 0.25 * (before[:, 1] + before[:, 3]), rtol=1e-6
    )


@given(seeds)
@settings(max_examples=30)
def test_copies_have_gains_and_noise_of_their_own(seed):
    clean = random_touches(seed, n_frames=4000)
    copied = broken("duplicated", clean, [1, 2], source=5, rng=seed, factor=4, level=0.5).readings
    source = clean.readings[:, 5]
    for i in (1, 2):
        slope = np.cov(copied[:, i], source)[0, 1] / source.var()
        assert 0.45 < slope < 2.2
        left = copied[:, i] - slope * source
        assert left.std() == pytest.approx(0.5 * source.std(), rel=0.1)


@given(seeds, st.floats(0.01, 1), st.integers(1, 20), st.floats(2.1, 50))
@settings(max_examples=30)
def test_sensors_of_a_board_share_a_fault(seed, share, frames, period):
    clean = random_touches(seed)
    leak = change("leaking", clean, range(6), share=share)
    assert (leak[:, 0] == 0).all()
    np.testing.assert_allclose(leak[:, 1:], share * clean.readings[:, :-1], atol=1e-5)
    late = broken("lagging", clean, range(6), frames=frames, board=2).readings
    for board in range(3):
        delay, columns = board * frames, [2 * board, 2 * board + 1]
        np.testing.assert_array_equal(late[delay:, columns], clean.readings[: 400 - delay, columns])
        assert (late[:delay, columns] == clean.readings[0, columns]).all()
    together = broken("lagging", clean, [1, 4], frames=frames).readings
    np.testing.assert_array_equal(together[frames:, [1, 4]], clean.readings[:-frames, [1, 4]])
    hum = change("humming", clean, range(6), rng=seed, period=period, factor=4)
    values = np.linalg.svd(hum.astype(float), compute_uv=False)
    assert values[1] < 1e-3 * values[0]  # one phase, and gains of their own
    gains = np.abs(hum).max(axis=0)
    assert 1 <= gains.max() / gains.min() <= 4.01
    noise = change("common-noise", clean, range(6), rng=seed, level=3, board=3)
    np.testing.assert_allclose(noise, np.repeat(noise[:, [0, 3]], 3, axis=1), atol=1e-5)
    assert abs(np.corrcoef(noise[:, 0], noise[:, 3])[0, 1]) < 0.3
    assert noise.std() == pytest.approx(3 * np.median(clean.readings.std(axis=0)), rel=0.2)
    spikes = change("spiking", clean, [1, 2, 5], rng=seed, share=0.1)
    np.testing.assert_allclose(spikes[:, [1, 2]], spikes[:, [5, 5]], atol=1e-5)
    assert (spikes[:, [0, 3, 4]] == 0).all()
    assert 0.02 < np.mean(spikes[:, 1] > 0) < 0.2


@given(seeds, st.integers(2, 6))
@settings(max_examples=30)
def test_regions_are_touched_one_after_the_other(seed, regions):
    clean = random_touches(seed)
    active = broken("separate-regions", clean, regions=regions).readings > 0
    edges = np.linspace(0, 400, regions + 1).astype(int)
    runs = [set(np.flatnonzero(active[a:b].any(axis=0))) for a, b in pairwise(edges)]
    assert sum(map(len, runs)) == len(set.union(*runs))


def test_faults_of_sensors_with_odd_names_and_gaps_are_logged():
    gaps = random_touches(0).readings[:, [2]].copy()
    gaps[3:9] = np.nan
    name = 'a "quoted", \n; one Ω'
    quiet = broken("dead", Recording(gaps, names=[name]), [name])
    assert (quiet.readings == 0).all()
    assert injected_faults(quiet) == (Fault("dead", name, ((0, 400),)),)


@pytest.mark.parametrize("record", ["nonsense", '{"kind": 1}', "[1]", '[{"kind": "dead"}]', "3"])
def test_a_damaged_log_raises_an_error(record):
    recording = Recording(np.eye(3), metadata={"faults": record})
    with pytest.raises(InputError, match="is not a valid log of faults"):
        injected_faults(recording)


def test_faults_are_parsed_from_text():
    clean = random_touches(2)
    requests = [
        parse_fault(text)
        for text in ("dead:s0", "stuck: 1 , level=7", "noisy:50%,level=0.3", "dropped-frames")
    ]
    faulty = inject(clean, requests, 5)
    kinds = [fault.kind for fault in injected_faults(faulty)]
    assert kinds == ["dead", "stuck", "noisy", "noisy", "noisy", "dropped-frames"]
    assert faulty.n_frames < clean.n_frames
    whole = inject(clean, requests[:3], 5)
    some = whole.select([3, 0])
    np.testing.assert_array_equal(fault_mask(some), fault_mask(whole)[:, [3, 0]])
    assert fault_mask(some, ["dead"]).sum() == some.n_frames
    everyone = inject(clean, [parse_fault("thresholded:*")])
    assert len(injected_faults(everyone)) == 6
    again = inject(clean, requests, 5)
    np.testing.assert_array_equal(again.readings, faulty.readings)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rusty:s1", "there is no fault 'rusty'; choose from dead, stuck"),
        ("dead", "the fault dead needs sensors"),
        ("dead:", "needs sensors"),
        ("dead:s1,level=3", "the fault dead has no parameter 'level'; it has no parameters"),
        ("noisy:s1,lvl=3", "no parameter 'lvl'; choose from level"),
        ("noisy:s1,level=loud", "parameter level of the fault noisy must be a number, got 'loud'"),
        ("dropped-frames:s1", "affects all sensors; leave out s1"),
        ("dead:0%", "above 0% and at most 100%, got '0%'"),
        ("dead:many%", "above 0% and at most 100%, got 'many%'"),
        *((f"{kind}:s99,s1", "there is no sensor 's99'") for kind in FAULTS),
        ("duplicated:*", "at least one sensor to copy from"),
        ("swapped:0,1,2", "even number of sensors, got 3"),
        ("mirrored:1,0,1", "sensor s1 is listed twice"),
        ("saturating:0,mean_gap=0", "mean_gap must be at least 1, got 0"),
        ("clipped:0,level=1", "level must be above 0 and below 1, got 1"),
        ("leaking:0,share=2", "share must be above 0 and at most 1, got 2"),
        ("lagging:0,frames=2.5", r"frames must be an integer of at least 1, got 2\.5"),
        ("crosstalk:0,n_neighbours=6", r"below the number of sensors \(6\), got 6"),
        ("separate-regions:regions=7", "regions must be at most the number of sensors"),
        ("crosstalk:0", "needs a recording with true positions"),
        ("separate-regions", "needs a recording with true positions"),
        ("clock-jitter", "needs a recording with times or a rate"),
    ],
)
def test_an_invalid_request_raises_an_error(text, message):
    recording = Recording(np.eye(4)) if "needs a recording" in message else random_touches(0)
    with pytest.raises(InputError, match=message):
        inject(recording, [parse_fault(text)])


@pytest.mark.parametrize("kind", [*FAULTS, *FRAME_FAULTS])
def test_every_parameter_of_a_fault_refuses_nan(kind):
    fault = (FAULTS | FRAME_FAULTS)[kind]
    for name in signature(fault).parameters.keys() - {"recording", "sensors", "rng", "source"}:
        with pytest.raises(InputError, match=f"{name} must be .*, got nan"):
            broken(kind, random_touches(0), ["s0"], **{name: float("nan")})
