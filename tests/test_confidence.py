"""Confidence of maps: calibration, and the cases without one."""

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import anisomap
from anisomap import Recording, confidence, diagnose, reconstruct, reconstruct_from
from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation.confidence import (
    agreement_of_halves,
    confidence_in_words,
    expected_mantel_r,
)
from anisomap.methods import MethodOptions
from skins import flat_skin, lattice

quiet = pytest.mark.filterwarnings("ignore::anisomap.AnisomapWarning")


@given(st.floats(-1, 1), st.floats(-1, 1))
def test_expected_mantel_r_increases_with_the_agreement_of_halves(one, other):
    low, high = sorted((one, other))
    assert 0 <= expected_mantel_r(low) <= expected_mantel_r(high) <= 1


def test_halves_are_disjoint_and_their_agreement_is_a_mantel_r():
    frames = np.arange(400.0)[:, None] * np.ones(6)
    seen = []

    def place(half):
        seen.append(half[:, 0])
        return lattice()[:6] + 0.01 * half.mean()

    assert agreement_of_halves(frames, place) == pytest.approx(1)
    for one, other in (seen[:2], seen[2:]):
        assert not set(one) & set(other)
        assert set(one) | set(other) == set(frames[:, 0])
    rng = np.random.default_rng(0)
    at_random = agreement_of_halves(frames, lambda _: rng.normal(size=(60, 3)))
    assert abs(at_random) < 0.3


def test_unplaced_sensors_are_ignored_and_failed_maps_have_no_agreement():
    frames = np.ones((100, 8))

    def half_blind(half):
        places = lattice()[:8].astype(float)
        places[:3] = np.nan
        return places

    def fails(half):
        raise InputError("no")

    assert agreement_of_halves(frames, half_blind) == pytest.approx(1)
    assert agreement_of_halves(frames, fails) == 0
    assert math.isnan(agreement_of_halves(frames[:79], half_blind))
    assert math.isnan(expected_mantel_r(math.nan))


@quiet
def test_confidence_is_calibrated_and_lower_for_short_recordings():
    short, long = [], []
    for seed in range(4):
        for n_frames, found in ((120, short), (1500, long)):
            skin = flat_skin(seed=seed, n_frames=n_frames)
            made = reconstruct(skin, dimensions=2)
            r = anisomap.score(made, skin.positions, permutations=0).mantel.r
            found.append((confidence(made, skin), r))
    assert max(c for c, _ in short) < min(c for c, _ in long)
    for expected, r in long:
        assert expected > 0.9
        assert abs(expected - r) < 0.05


def test_insufficient_evidence_is_noted():
    rng = np.random.default_rng(0)
    noisy = flat_skin(n_frames=400).readings + rng.normal(0, 2.5, (400, 42))
    unparted = MethodOptions(split_unrelated=False)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        made = diagnose(reconstruct(noisy, dimensions=2, options=unparted), noisy, options=unparted)
    assert made.notes == tuple(str(w.message) for w in told if w.category is AnisomapWarning)
    assert made.confidence < 0.9
    assert any("insufficient evidence" in note for note in made.notes)
    assert "insufficient evidence" in confidence_in_words(made.confidence)


def test_unrelated_halves_have_no_confidence():
    assert expected_mantel_r(0.0) < 0.1
    assert expected_mantel_r(-0.5) <= expected_mantel_r(0.0)
    assert expected_mantel_r(1.0) == pytest.approx(0.99)


@quiet
def test_noise_has_low_confidence():
    found = []
    for seed in range(4):
        noise = np.random.default_rng(seed).normal(size=(600, 30))
        unsplit = MethodOptions(split_unrelated=False)
        made = reconstruct(noise, dimensions=2, options=unsplit)
        found.append(confidence(made, noise))
    assert max(c for c in found if not math.isnan(c)) < 0.7


@quiet
def test_confidence_is_unknown_for_few_sensors_and_unequal_runs():
    skin = flat_skin()
    few = Recording(skin.readings[:, :8])
    assert math.isnan(confidence(reconstruct(few, dimensions=2), few))
    runs = [skin.select(range(30)), skin.select(range(12, 42))]
    assert math.isnan(confidence(reconstruct(runs, dimensions=2), runs))


@quiet
def test_confidence_is_unknown_without_readings_or_refinement():
    skin = flat_skin(n_frames=300)
    assert math.isnan(reconstruct(skin).confidence)
    assert math.isnan(confidence(reconstruct(skin, "r-anisomap"), skin))
    similarity = np.corrcoef(skin.readings.T)
    assert math.isnan(reconstruct_from(similarity=similarity).confidence)
    assert "unknown" in confidence_in_words(math.nan)


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
        made = reconstruct_from(dimensions=2, **{stage: matrix})
        assert math.isnan(confidence(made, skin))
    chunked = anisomap.large.reconstruct_chunks(skin.readings, dimensions=2)
    assert math.isnan(confidence(chunked, skin))
    made = reconstruct(skin, dimensions=2)
    assert confidence(made, skin) > 0.9
    shuffled = replace(made, positions=made.positions[rng.permutation(42)])
    assert confidence(shuffled, skin) < 0.5


def test_a_confidence_needs_complete_readings():
    skin = flat_skin(n_frames=300)
    readings = np.array(skin.readings)
    readings[7, 3] = np.nan
    with pytest.raises(InputError, match="sensor s3, frame 7"):
        confidence(reconstruct(skin, dimensions=2), readings)


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
