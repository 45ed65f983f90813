"""Injected faults: their effects, and how they are asked for."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from anisomap.errors import InputError
from anisomap.recording import Recording
from anisomap.simulation import FAULTS, inject
from anisomap.simulation.faults import OF_ALL, parameters_of

seeds = st.integers(0, 2**32 - 1)
OF_SENSORS = [kind for kind in FAULTS if kind not in OF_ALL]


def random_touches(seed, n_frames=400, n_sensors=6):
    """Recording with each sensor at rest in three of four frames."""
    rng = np.random.default_rng(seed)
    depth = rng.exponential(size=(n_frames, n_sensors))
    readings = np.where(rng.random((n_frames, n_sensors)) < 0.25, depth, 0).astype(np.float32)
    places = np.column_stack([np.arange(n_sensors), np.zeros(n_sensors)])
    return Recording(readings, rate_hz=20, positions=places, metadata={"scenario": "random"})


def change(fault, recording, **parameters):
    """Readings with a fault, less those without."""
    return inject(recording, fault, **parameters).readings - recording.readings


@pytest.mark.parametrize("kind", FAULTS)
@given(seed=seeds, chosen=st.permutations(range(6)), after=st.sampled_from([0, 0.3]))
@settings(max_examples=20)
def test_a_fault_changes_only_the_chosen_readings(kind, seed, chosen, after):
    clean = random_touches(seed)
    before, sensors = clean.readings.copy(), [] if kind in OF_ALL else chosen[: 2 + 2 * (seed % 2)]
    given = {} if kind == "dropped-frames" or not after else {"after": after}
    faulty = inject(clean, kind, sensors, rng=seed, **given)
    np.testing.assert_array_equal(clean.readings, before)
    assert faulty.readings.dtype == before.dtype
    again = inject(clean, kind, sensors, rng=seed, **given)
    np.testing.assert_array_equal(again.readings, faulty.readings)
    assert faulty.metadata["scenario"] == "random"
    assert str(faulty.metadata["faults"]).startswith(kind)
    assert (faulty.names, faulty.rate_hz) == (clean.names, clean.rate_hz)
    if kind != "dropped-frames":
        np.testing.assert_array_equal(
            faulty.readings[: int(after * 400)], before[: int(after * 400)]
        )
    if sensors:
        others = np.setdiff1d(np.arange(6), sensors)
        np.testing.assert_array_equal(faulty.readings[:, others], before[:, others])


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
    faulty = inject(recording, kind, [] if kind in OF_ALL else [0, 2], rng=1)
    assert faulty.readings.shape[1] == 4
    assert faulty.n_frames == recording.n_frames or kind == "dropped-frames"


@given(seeds)
@settings(max_examples=30)
def test_faults_of_single_sensors_have_the_documented_effect(seed):
    clean = random_touches(seed)
    before, top = clean.readings, float(clean.readings.max())

    def column(fault):
        return inject(clean, fault, [1], rng=seed).readings[:, 1]

    assert (column("dead") == 0).all()
    raised = Recording(7 - 2 * before)
    assert (inject(raised, "dead:0").readings[:, 0] == 7).all()
    held = column("stuck")
    assert len(set(held.tolist())) == 1
    assert top / 2 <= held[0] <= top
    full = column("saturating:mean_gap=20")
    assert set(full[full != before[:, 1]]) <= {top}
    lost = column("intermittent:mean_gap=20")
    assert set(lost[lost != before[:, 1]]) == {0}
    walk = column("drifting:level=0.4") - before[:, 1]
    assert np.abs(walk).max() == pytest.approx(0.4 * top, rel=1e-4)
    assert np.abs(np.diff(walk)).max() < 0.4 * np.ptp(walk)
    touched = before[:, 1] > 0
    gains = column("gain-drift:factor=4")[touched] / before[touched, 1]
    assert 1 < np.exp(np.abs(np.log(gains)).max()) <= 4 * (1 + 1e-6)
    steps = np.abs(np.diff(column("stepping:count=3") - before[:, 1])) > 1e-5 * top
    assert np.count_nonzero(steps) <= 3
    noise = change("noisy:*,level=0.3", clean, rng=seed) / top
    assert noise.std(axis=0) == pytest.approx(0.3, rel=0.2)
    assert np.abs(np.corrcoef(noise.T) - np.eye(6)).max() < 0.3
    few = inject(clean, "quantised:*,levels=4").readings
    assert len(np.unique(few)) <= 4
    assert np.abs(few - before).max() <= top / 6 + 1e-6
    codes = np.round(inject(clean, "stuck-bit:*,bit=2,bits=4").readings * 15 / top).astype(int)
    assert (codes & 4).all()
    np.testing.assert_array_equal(codes | 4, np.round(before * 15 / top).astype(int) | 4)
    assert set(np.unique(column("thresholded"))) <= {0, 1}
    np.testing.assert_allclose(column("inverted"), before.min() + top - before[:, 1], rtol=1e-6)
    cut = column("clipped:share=0.3")
    assert cut.max() == pytest.approx(0.3 * np.ptp(before[:, 1]))
    np.testing.assert_array_equal(cut[cut < cut.max()], before[cut < cut.max(), 1])
    warmed = column("warming") - before[:, 1]
    assert (np.diff(np.sign(warmed[-1]) * warmed) > -1e-6).all()
    rare = column("rarely-touched:contacts=2") > 0
    assert np.count_nonzero(rare[1:] & ~rare[:-1]) + rare[0] <= 2
    wave = column("cycling:period=20")
    np.testing.assert_allclose(wave[20:], wave[:-20], atol=1e-4)
    gaps, bridged = column("nan-bursts:mean_gap=20"), column("bridged-gaps:mean_gap=20,mean_span=5")
    inside = np.isnan(gaps[1:-1]) & np.isnan(gaps[:-2]) & np.isnan(gaps[2:])
    assert np.abs(np.diff(bridged.astype(float), 2))[inside].max(initial=0) < 1e-5


def test_saturated_spans_have_geometric_lengths_with_the_given_means():
    clean = Recording(np.zeros((200_000, 1)))
    faulty = inject(clean, "saturating:0,value=5,mean_gap=60,mean_span=15", rng=1)
    edges = np.flatnonzero(np.diff(faulty.readings[:, 0])) + 1
    spans, gaps = np.diff(edges)[::2], np.diff(edges)[1::2]
    # The mean and the standard deviation of a geometric distribution are nearly equal. 2,700 spans
    # determine them to 2 and 3 %.
    for lengths, mean in ((spans, 15), (gaps, 60)):
        assert lengths.mean() == pytest.approx(mean, rel=0.08)
        assert lengths.std() == pytest.approx(mean, rel=0.12)
    assert faulty.readings.mean() == pytest.approx(5 * 15 / 75, rel=0.08)


def test_wiring_faults_move_readings_and_keep_names():
    clean = random_touches(1)
    before = clean.readings
    traded = inject(clean, "swapped:s4,s1,s0,s5").readings
    np.testing.assert_array_equal(traded[:, [4, 1, 0, 5]], before[:, [0, 5, 4, 1]])
    moved = inject(clean, "shifted:s0,s1,s2,after=0.5").readings
    np.testing.assert_array_equal(moved[200:, :3], before[200:, [2, 0, 1]])
    np.testing.assert_array_equal(moved[:200], before[:200])
    copied = inject(clean, "duplicated", ["s0", "s1", "s2", "s3", "s4"]).readings
    np.testing.assert_array_equal(copied, before[:, [5] * 6])
    joined = inject(clean, "shorted:s1,s4").readings[:, [1, 4]]
    np.testing.assert_allclose(joined.T, np.tile(before[:, [1, 4]].mean(axis=1), (2, 1)), rtol=1e-6)
    closed = inject(clean, "folded").readings
    np.testing.assert_array_equal(closed, np.maximum(before, before[:, ::-1]))


@given(seeds)
@settings(max_examples=30)
def test_copies_have_gains_and_noise_of_their_own(seed):
    clean = random_touches(seed, n_frames=4000)
    copied = inject(clean, "duplicated:0,1,2,3,4,factor=4,noise=0.5", rng=seed).readings
    source = clean.readings[:, 5]
    for i in range(5):
        slope = np.cov(copied[:, i], source)[0, 1] / source.var()
        assert 0.45 < slope < 2.2
        left = copied[:, i] - slope * source
        assert left.std() == pytest.approx(0.5 * source.std(), rel=0.1)


@given(seeds, st.floats(0.01, 1), st.integers(1, 20), st.floats(2.1, 50))
@settings(max_examples=30)
def test_sensors_of_a_board_share_a_fault(seed, share, frames, period):
    clean = random_touches(seed)
    leak = change("leaking:*", clean, share=share)
    assert (leak[:, 0] == 0).all()
    np.testing.assert_allclose(leak[:, 1:], share * clean.readings[:, :-1], atol=1e-5)
    late = inject(clean, "lagging:*", frames=frames, board=2).readings
    for board in range(3):
        delay, columns = board * frames, [2 * board, 2 * board + 1]
        np.testing.assert_array_equal(late[delay:, columns], clean.readings[: 400 - delay, columns])
        assert (late[:delay, columns] == clean.readings[0, columns]).all()
    together = inject(clean, "lagging:1,4", frames=frames).readings
    np.testing.assert_array_equal(together[frames:, [1, 4]], clean.readings[:-frames, [1, 4]])
    held = inject(clean, "freezing:*,board=3,mean_gap=20", rng=seed).readings
    still = (held[1:] == held[:-1]).reshape(-1, 2, 3)
    assert ((held == clean.readings)[1:].reshape(-1, 2, 3) | still).all()
    hum = change("humming:*,factor=4", clean, rng=seed, period=period)
    values = np.linalg.svd(hum.astype(float), compute_uv=False)
    assert values[1] < 1e-3 * values[0]  # one phase, and gains of their own
    gains = np.abs(hum).max(axis=0)
    assert 1 <= gains.max() / gains.min() <= 4.01
    noise = change("common-noise:*,level=3,board=3", clean, rng=seed)
    np.testing.assert_allclose(noise, np.repeat(noise[:, [0, 3]], 3, axis=1), atol=1e-5)
    assert abs(np.corrcoef(noise[:, 0], noise[:, 3])[0, 1]) < 0.3
    assert noise.std() == pytest.approx(3 * np.median(clean.readings.std(axis=0)), rel=0.2)
    spikes = change("spiking:1,2,5,share=0.1", clean, rng=seed)
    np.testing.assert_allclose(spikes[:, [1, 2]], spikes[:, [5, 5]], atol=1e-5)
    assert 0.02 < np.mean(spikes[:, 1] > 0) < 0.2


@given(seeds, st.integers(2, 6))
@settings(max_examples=30)
def test_regions_are_touched_one_after_the_other(seed, regions):
    active = inject(random_touches(seed), "separate-regions", regions=regions).readings > 0
    edges = np.linspace(0, 400, regions + 1).astype(int)
    runs = [set(np.flatnonzero(active[a:b].any(axis=0))) for a, b in pairwise(edges)]
    assert sum(map(len, runs)) == len(set.union(*runs))


@given(seed=seeds, share=st.floats(0.01, 1))
def test_lost_frames_leave_the_others_and_their_times(seed, share):
    clean = replace(random_touches(seed, n_frames=80), times=np.arange(80) / 20)
    faulty = inject(clean, "dropped-frames", rng=seed, share=share)
    frames = np.round(20 * faulty.times).astype(int)
    np.testing.assert_array_equal(faulty.readings, clean.readings[frames])


def test_faults_are_written_as_text_or_given_as_arguments():
    clean, rng = random_touches(2), np.random.default_rng(5)
    faulty = clean
    for text in (
        "dead:s0",
        "stuck: 1 , value=7",
        "noisy:50%,level=0.3,after=0.5",
        "dropped-frames",
    ):
        faulty = inject(faulty, text, rng=rng)
    first, second, third, last = str(faulty.metadata["faults"]).split("; ")
    assert (first, second, last) == ("dead:s0", "stuck:s1,value=7", "dropped-frames")
    assert third.startswith("noisy:s")
    assert third.count(",s") == 2
    assert faulty.n_frames < clean.n_frames
    named = inject(clean, "noisy", ["s3", 0], rng=1, level=0.3)
    text = inject(clean, "noisy:s3,s0,level=0.3", rng=1)
    np.testing.assert_array_equal(named.readings, text.readings)
    odd = 'a "quoted", =\n; one Ω'
    assert (
        inject(Recording(clean.readings[:, [2]], names=[odd]), "dead", [odd]).readings == 0
    ).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rusty:s1", "there is no fault 'rusty'; choose from dead, stuck"),
        ("dead", "the fault dead needs sensors"),
        ("dead:", "needs sensors"),
        ("dead:s1,level=3", "the fault dead has no parameter 'level'; choose from after"),
        ("noisy:s1,lvl=3", "no parameter 'lvl'; choose from level"),
        ("noisy:s1,level=loud", "'level=loud': 'loud' is not a number"),
        ("dropped-frames:s1", "affects all sensors; leave out s1"),
        ("dropped-frames:after=0.5", "no parameter 'after'"),
        ("dead:0%", "above 0% and at most 100%, got '0%'"),
        ("dead:many%", "above 0% and at most 100%, got 'many%'"),
        *((f"{kind}:s99,s1", "there is no sensor 's99'") for kind in OF_SENSORS),
        ("duplicated:*", "needs a sensor to copy from"),
        ("swapped:0,1,2", "even number of sensors, got 3"),
        ("shifted:1,0,1", "sensor s1 is listed twice"),
        ("stuck-bit:1,bit=8", "bit must be below bits"),
        ("separate-regions", "needs a recording with true positions"),
        ("folded", "needs a recording with true positions"),
    ],
)
def test_an_invalid_fault_raises_an_error(text, message):
    recording = Recording(np.eye(4)) if "needs a recording" in message else random_touches(0)
    with pytest.raises(InputError, match=message):
        inject(recording, text)


@pytest.mark.parametrize("kind", FAULTS)
@pytest.mark.parametrize("value", [float("nan"), -1])
def test_every_parameter_of_a_fault_has_a_range(kind, value):
    for name in parameters_of(kind).keys() - ({"value"} if value == -1 else set()):
        with pytest.raises(InputError, match=f"{name} must be .*, got {value}"):
            inject(random_touches(0), kind, [] if kind in OF_ALL else ["s0"], **{name: value})
