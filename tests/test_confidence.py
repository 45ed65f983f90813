"""How far a map can be trusted where nobody knows the truth."""

import math
import warnings

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
def test_the_more_halves_agree_the_more_is_expected(one, other):
    low, high = sorted((one, other))
    assert 0 <= expected_mantel_r(low) <= expected_mantel_r(high) <= 1


def test_halves_share_no_frame_and_agreement_is_their_mantel_r():
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


def test_what_halves_cannot_place_is_left_out_and_no_map_is_no_agreement():
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
def test_short_recordings_are_trusted_less_and_the_confidence_is_about_right():
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


def test_too_little_evidence_is_said():
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


def test_halves_that_share_nothing_leave_no_confidence():
    assert expected_mantel_r(0.0) < 0.1
    assert expected_mantel_r(-0.5) <= expected_mantel_r(0.0)
    assert expected_mantel_r(1.0) == pytest.approx(0.99)


@quiet
def test_a_map_of_noise_is_not_trusted():
    found = []
    for seed in range(4):
        noise = np.random.default_rng(seed).normal(size=(600, 30))
        unsplit = MethodOptions(split_unrelated=False)
        made = reconstruct(noise, dimensions=2, options=unsplit)
        found.append(confidence(made, noise))
    assert max(c for c in found if not math.isnan(c)) < 0.7


@quiet
def test_what_cannot_be_judged_has_no_confidence():
    skin = flat_skin()
    few = Recording(skin.readings[:, :8])
    assert math.isnan(confidence(reconstruct(few, dimensions=2), few))
    runs = [skin.select(range(30)), skin.select(range(12, 42))]
    assert math.isnan(confidence(reconstruct(runs, dimensions=2), runs))


@quiet
def test_nobody_is_asked_where_nothing_can_be_told():
    skin = flat_skin(n_frames=300)
    assert math.isnan(reconstruct(skin).confidence)
    assert math.isnan(confidence(reconstruct(skin, "r-anisomap"), skin))
    similarity = np.corrcoef(skin.readings.T)
    assert math.isnan(reconstruct_from(similarity=similarity).confidence)
    assert "unknown" in confidence_in_words(math.nan)


def test_diagnosis_is_of_the_sensors_of_the_map():
    skin = flat_skin(n_frames=300)
    made = reconstruct(skin, "r-anisomap", 2)
    with pytest.raises(InputError, match="must have the sensors of the map"):
        diagnose(made, skin.select(range(40)))
