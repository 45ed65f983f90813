"""The verdict on a map: the rule, the evidence from halves, and the maps that are not judged."""

import itertools
import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import anisomap
from anisomap import Recording, diagnose, reconstruct, reconstruct_from
from anisomap.diagnosis import LEVELS, UNKNOWN, Doubt, Evidence, Verdict, judge
from anisomap.diagnosis.parts import repeatability_of_halves
from anisomap.diagnosis.verdict import expected_mantel_r
from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation import mantel
from anisomap.large import reconstruct_chunks
from anisomap.options import MethodOptions
from anisomap.reconstruction import reconstruct_with_stages
from skins import flat_map, flat_skin, lattice

quiet = pytest.mark.filterwarnings("ignore::anisomap.AnisomapWarning")

ERRORS = st.floats(0, 10)
DOUBTS = st.builds(
    Doubt,
    st.just("kind"),
    ERRORS,
    st.just("a doubt"),
    st.booleans(),
    excludes_usable=st.booleans(),
)


def evidence(repeatability=0.1, *doubts, extent=4.0):
    return Evidence(repeatability, extent, 2, doubts)


def rank(verdict):
    return list(LEVELS).index(verdict.level)


@given(ERRORS, ERRORS, st.lists(DOUBTS, max_size=3), DOUBTS, st.floats(0.5, 20))
def test_more_noise_and_more_doubt_never_improve_a_verdict(one, other, doubts, more, extent):
    low, high = sorted((one, other))
    better = judge(evidence(low, *doubts, extent=extent))
    for worse in (
        judge(evidence(high, *doubts, extent=extent)),
        judge(evidence(low, *doubts, more, extent=extent)),
    ):
        assert rank(worse) <= rank(better)
        assert worse.expected_error >= better.expected_error
        assert worse.expected_error == pytest.approx(
            math.hypot(worse.repeatability, worse.systematic)
        )


@given(ERRORS, st.lists(DOUBTS, max_size=3))
def test_every_verdict_has_a_reason_and_usable_maps_a_small_error(repeatability, doubts):
    found = judge(evidence(repeatability, *doubts))
    assert found.reasons
    assert found.reasons[0] in str(found)
    assert found.level != "usable" or found.expected_error <= 1


def test_doubts_about_the_shape_leave_a_map_usable_locally():
    bent = Doubt("bent", 3.0, "contacts are long", keeps_neighbours=True)
    assert judge(evidence()).level == "usable"
    found = judge(evidence(0.1, bent))
    assert (found.level, found.reasons[0]) == ("usable locally", "contacts are long")
    assert judge(evidence(0.1, replace(bent, keeps_neighbours=False))).level == "not usable"
    assert judge(evidence(5.0, bent)).level == "not usable"


def test_small_faults_exclude_usable_maps_and_are_the_first_reason():
    fault = Doubt("leak", 0.1, "channels leak", keeps_neighbours=True)
    assert judge(evidence(0.2, fault)).level == "usable"
    found = judge(evidence(0.2, replace(fault, excludes_usable=True)))
    assert (found.level, found.reasons[0]) == ("usable locally", "channels leak")


def test_levels_are_ordered_and_checked():
    for worse, better in itertools.combinations(LEVELS, 2):
        assert Verdict(better).is_at_least(worse)
        assert not Verdict(worse).is_at_least(better)
        assert Verdict(worse).is_at_least(worse)
        assert not Verdict(UNKNOWN).is_at_least(worse)
    for wrong in (lambda: Verdict("good"), lambda: Verdict().is_at_least("good")):
        with pytest.raises(InputError, match="usable locally"):
            wrong()


@pytest.mark.parametrize("error", [0.3, 1.0, 2.0])
def test_the_expected_mantel_r_is_that_of_independent_errors(error):
    rng = np.random.default_rng(0)
    truth = lattice(12, 12)
    noisy = truth + rng.normal(0, error / math.sqrt(2), truth.shape)
    distances = np.linalg.norm(noisy[:, None] - noisy[None], axis=2)
    extent = distances[np.triu_indices(len(truth), 1)].std()
    r = mantel(anisomap.SensorMap(noisy), anisomap.SensorMap(truth), permutations=0).r
    assert expected_mantel_r(error, extent, 2) == pytest.approx(r, abs=0.04)
    assert expected_mantel_r(error, 0.0, 2) == 0


def test_repeatability_is_the_error_of_a_mean_of_frames():
    """The map is the mean of frames, so the error of the map is known."""
    rng = np.random.default_rng(0)
    truth = lattice(8, 8).astype(float)
    found, expected = [], []
    for _ in range(8):
        frames = truth.ravel() + rng.normal(size=(400, truth.size))
        made = frames.mean(axis=0).reshape(truth.shape)
        found.append(
            repeatability_of_halves(
                len(frames), made, lambda i, x=frames: x[i].mean(axis=0).reshape(truth.shape)
            )
        )
        expected.append(anisomap.align(made, truth).rms)
    assert np.mean(found) == pytest.approx(np.mean(expected), rel=0.15)


def test_halves_are_disjoint_and_cover_the_recording():
    seen = []

    def place(half):
        seen.append(set(half.tolist()))
        return lattice()[:6] + 0.01 * half.mean()

    assert repeatability_of_halves(400, lattice()[:6], place) == pytest.approx(0, abs=1e-6)
    one, other = seen
    assert not one & other
    assert one | other == set(range(400))


def test_halves_without_a_map_leave_no_evidence():
    def fails(half):
        raise InputError("no")

    places = lattice()[:8].astype(float)
    assert repeatability_of_halves(100, places, fails) == math.inf
    blind = np.where(np.arange(8)[:, None] < 3, np.nan, places)
    assert repeatability_of_halves(100, places, lambda _: blind) == pytest.approx(0, abs=1e-6)
    same = np.ones((8, 2))
    assert repeatability_of_halves(100, same, lambda _: places) == math.inf
    assert judge(evidence(math.inf)).level == "not usable"


@quiet
@pytest.mark.slow
def test_expected_errors_are_near_the_true_ones_and_larger_for_short_recordings():
    short, long = [], []
    for seed in range(4):
        for n_frames, found in ((120, short), (1500, long)):
            skin = flat_skin(seed=seed, n_frames=n_frames)
            made = diagnose(reconstruct(skin, dimensions=2), skin)
            true = anisomap.score(made, skin.positions, permutations=0).rms_in_spacings
            found.append((made.verdict.expected_error, true))
    assert min(e for e, _ in short) > max(e for e, _ in long)
    # Contacts refine these maps further than the resamples and halves show, to .03 spacings.
    assert 1 / 2 < np.median([e / true for e, true in short + long]) < 3.5


def test_insufficient_evidence_is_noted():
    rng = np.random.default_rng(0)
    noisy = flat_skin(n_frames=400).readings + rng.normal(0, 2.5, (400, 42))
    unparted = MethodOptions(split_unrelated=False)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        made = diagnose(reconstruct(noisy, dimensions=2, options=unparted), noisy, options=unparted)
    assert made.notes == tuple(str(w.message) for w in told if w.category is AnisomapWarning)
    assert made.verdict.level == "not usable"
    assert any("insufficient evidence" in note for note in made.notes)
    assert any("insufficient evidence" in reason for reason in made.verdict.reasons)


@quiet
def test_maps_of_noise_are_not_usable():
    for seed in range(2):
        noise = np.random.default_rng(seed).normal(size=(300, 20))
        unsplit = MethodOptions(split_unrelated=False)
        made = reconstruct(noise, dimensions=2, options=unsplit)
        assert diagnose(made, noise).verdict.level == "not usable"


def verdict(made, recording):
    return diagnose(made, recording).verdict


@quiet
def test_the_verdict_is_unknown_for_few_sensors_and_unequal_runs():
    skin = flat_skin()
    few = Recording(skin.readings[:, :8])
    assert "fewer than 12 sensors" in str(verdict(reconstruct(few, dimensions=2), few))
    runs = [skin.select(range(30)), skin.select(range(12, 42))]
    found = verdict(reconstruct(runs, dimensions=2), runs)
    assert found.level == UNKNOWN
    assert "different sensors" in str(found)


@quiet
def test_the_verdict_is_unknown_without_readings_or_refinement():
    skin, made = flat_skin(n_frames=300), flat_map(n_frames=300)
    assert made.verdict.level == UNKNOWN
    assert "r-anisomap" in str(verdict(flat_map("r-anisomap", n_frames=300), skin))
    similarity = np.corrcoef(skin.readings.T)
    assert reconstruct_from(similarity=similarity).verdict.level == UNKNOWN
    assert diagnose(made, skin, with_verdict=False).verdict == Verdict()


def test_diagnosis_requires_the_sensors_of_the_map():
    skin = flat_skin(n_frames=300)
    made = reconstruct(skin, "r-anisomap", 2)
    with pytest.raises(InputError, match="must have the sensors of the map"):
        diagnose(made, skin.select(range(40)))


@quiet
def test_maps_that_do_not_follow_from_the_recording_are_not_trusted():
    skin = flat_skin()
    rng = np.random.default_rng(0)
    noise = rng.uniform(1, 2, (42, 42))
    precomputed = {"similarity": np.corrcoef(skin.readings.T), "dissimilarity": noise + noise.T}
    for stage, matrix in precomputed.items():
        np.fill_diagonal(matrix, 1 if stage == "similarity" else 0)
        made = reconstruct_from(method="r-anisomap", dimensions=2, **{stage: matrix})
        assert verdict(made, skin).level == UNKNOWN
    chunked = reconstruct_chunks(skin.readings, "r-anisomap", dimensions=2)
    assert verdict(chunked, skin).level == UNKNOWN
    made = flat_map()
    assert verdict(made, skin).level == "usable"
    shuffled = replace(made, positions=made.positions[rng.permutation(42)])
    assert verdict(shuffled, skin).level == "not usable"


def test_a_verdict_needs_complete_readings():
    skin = flat_skin(n_frames=300)
    readings = np.array(skin.readings)
    readings[7, 3] = np.nan
    with pytest.raises(InputError, match="sensor s3, frame 7"):
        diagnose(flat_map(n_frames=300), readings)


@quiet
def test_diagnosis_can_be_repeated_and_knows_dropped_sensors():
    readings = np.array(flat_skin(n_frames=300).readings)
    readings[:, 8] = np.random.default_rng(0).uniform(size=300)
    made = reconstruct(readings, "r-anisomap", 2, drop=[8])
    once = diagnose(made, readings)
    assert not any("s8" in note for note in once.notes)
    assert diagnose(once, readings).notes == once.notes


def test_sensors_are_unassessed_before_a_diagnosis():
    skin = flat_skin(n_frames=600)
    made = reconstruct(skin, "r-anisomap", 2)
    assert set(made.health) == {"unassessed"}
    assert set(diagnose(made, skin).health) == {"ok"}


@quiet
@pytest.mark.parametrize("method", ["covariogram", "contact-fit"])
@pytest.mark.slow
def test_a_diagnosis_alone_is_that_with_the_stages_of_the_map(method):
    skin = flat_skin(n_frames=800)
    made, stages = reconstruct_with_stages(skin, method, 2, drop=["s3"])
    known = diagnose(made, skin, drop=["s3"], stages=stages)
    alone = diagnose(made, skin, drop=["s3"])
    elsewhere = diagnose(replace(made, positions=7 - 3 * made.positions), skin, drop=["s3"])
    assert alone.verdict == known.verdict
    np.testing.assert_array_equal(alone.covariances, known.covariances)
    assert elsewhere.verdict.expected_error == pytest.approx(known.verdict.expected_error, 1e-3)
    np.testing.assert_allclose(elsewhere.covariances, 9 * known.covariances, rtol=0.01, atol=1e-9)


@quiet
def test_a_diagnosis_of_a_map_that_was_changed_does_not_use_its_stages():
    skin = flat_skin(n_frames=300)
    made, stages = reconstruct_with_stages(skin, dimensions=2)
    moved = made.positions + np.random.default_rng(0).normal(size=made.positions.shape)
    changed = diagnose(replace(made, positions=moved), skin, stages=stages)
    assert changed.verdict.expected_error > diagnose(made, skin).verdict.expected_error
