"""Similarities computed in chunks equal those of the whole recording."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from anisomap.evidence import SIMILARITIES
from anisomap.large.streaming import CHUNKED, computed_similarity
from anisomap.numerics.similarity import binning as value_counts
from anisomap.numerics.similarity import co_occurrence
from anisomap.numerics.similarity.binning import ValueCounts
from anisomap.numerics.similarity.correlation import Moments, StoredCodes

BINS = 4
rows = st.lists(st.integers(1, 299), max_size=4, unique=True).map(sorted)


def readings_of(seed, n_values=9):
    rng = np.random.default_rng(seed)
    touch = np.cumsum(rng.normal(0, 0.5, 300))[:, None] % 6
    depth = np.maximum(0, 1.5 - abs(touch - np.arange(6))) * rng.uniform(0.5, 2, 6)
    levels = np.round(depth / depth.max() * (n_values - 1)) * rng.choice([-3.0, 0.25, 1.0], 6) + 7
    levels[:, 5] = 7
    return levels


def merged(mapper, parts):
    return functools.reduce(lambda total, part: total.merged(part), map(mapper, parts))


def in_chunks(name, parts):
    recipe = CHUNKED[name]
    mapper = Moments.of
    if recipe.prepare:
        mapper = recipe.prepare(merged(ValueCounts.of, parts), BINS)
    return recipe.finish(merged(mapper, parts))


def test_every_similarity_can_be_computed_in_chunks():
    # Distinct contacts are those of the whole recording.
    assert set(CHUNKED) == set(SIMILARITIES) - {"contact-agreement"}


@pytest.mark.parametrize("many", [1, 10**6], ids=["compiled", "numpy"])
@pytest.mark.parametrize("name", CHUNKED)
@given(seed=st.integers(0, 20), cuts=rows, data=st.data())
@settings(max_examples=8)
def test_chunks_give_the_similarity_of_the_whole(name, many, seed, cuts, data):
    readings = readings_of(seed)
    expected = SIMILARITIES[computed_similarity(name)].compute(readings, BINS)
    parts = data.draw(st.permutations(np.split(readings, cuts)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(co_occurrence, "MIN_COMPILED_SENSORS", many)
        found = in_chunks(name, parts)
        np.testing.assert_allclose(found, expected, atol=1e-12)
        np.testing.assert_array_equal(found, found.T)
        if name in ("co-activation", "mutual-information"):
            np.testing.assert_array_equal(found, in_chunks(name, [readings]))


def test_codes_of_few_frames_of_many_sensors_are_stored_instead_of_counts():
    readings = np.random.default_rng(0).integers(0, 8, (64, 700)).astype(np.uint8)
    recipe = CHUNKED["mutual-information"]
    mapper = recipe.prepare(ValueCounts.of(readings), 8)
    total = mapper(readings[:20]).merged(mapper(readings[20:]))
    assert isinstance(total, StoredCodes)
    found = recipe.finish(total)
    expected = SIMILARITIES["mutual-information"].compute(readings, 8)
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("name", ["spearman", "mutual-information"])
def test_rounding_of_continuous_readings_changes_little(name, monkeypatch):
    rng = np.random.default_rng(0)
    common = rng.normal(size=(4000, 1))
    readings = common + rng.normal(0, 0.7, size=(4000, 6))
    monkeypatch.setattr(value_counts, "MAX_VALUES", 6 * 500)
    expected = SIMILARITIES[name].compute(readings, BINS)
    parts = np.array_split(readings, 7)
    np.testing.assert_allclose(in_chunks(name, parts), expected, atol=0.01)
