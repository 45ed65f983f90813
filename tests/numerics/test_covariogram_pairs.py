"""Functions of the distances of pairs: compiled against numpy, and both against definitions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from anisomap.numerics.compiled.parallel import load_loops
from anisomap.numerics.covariogram.objective import CompiledPairs, Pairs, Weights, pack


def constants(n_points, seed, dtype=np.float32, unknown=0.2):
    """Return the arguments of `Pairs` with random symmetric matrices."""
    rng = np.random.default_rng(seed)
    n_pairs = n_points * (n_points - 1) // 2
    known = (rng.random(n_pairs) > unknown).astype(dtype)
    similarity, one, other = rng.normal(0, 0.3, (3, n_pairs)).astype(dtype)
    return {
        "known": known,
        "similarity": similarity * known,
        "whitened_known": one,
        "whitened_similarity": other,
        "inverse_metric": rng.uniform(0.2, 3, n_pairs).astype(dtype),
        "n_sensors": n_points,
    }


def points_of(n_points, dimensions, seed):
    points = np.random.default_rng(seed).normal(0, 3, (n_points, dimensions))
    points[1] = points[0]  # coincident points
    return points


problems = given(st.integers(2, 80), st.integers(1, 4), st.floats(-1.2, 1.3), st.integers(0, 999))


@problems
def test_compiled_loops_do_as_numpy(n_points, dimensions, log_exponent, seed):
    points, given_pairs = points_of(n_points, dimensions, seed), constants(n_points, seed)
    plain, compiled = Pairs(**given_pairs), CompiledPairs(**given_pairs)
    expected, found = (pairs.decay(points, log_exponent) for pairs in (plain, compiled))
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-4, atol=2e-6)
    whitened = np.random.default_rng(seed).normal(0, 0.3, len(expected.shape)).astype(np.float32)
    weights = Weights(0.8, float(np.exp(log_exponent)), 0.1, 1e-3, 1e-4)
    ours, theirs = (p.slope(expected, whitened, weights) for p in (compiled, plain))
    assert ours[0] == pytest.approx(theirs[0], rel=1e-5, abs=1e-4)
    assert ours[1] == pytest.approx(theirs[1], rel=1e-4, abs=1e-4)
    force = theirs[2]
    size, scale = 1 + np.abs(force).sum() * 1e-3, np.abs(force).max()
    np.testing.assert_allclose(ours[2], force, rtol=1e-4, atol=1e-6 * scale)
    pulled, reference = (p.gradient(force, points) for p in (compiled, plain))
    np.testing.assert_allclose(pulled, reference, rtol=1e-6, atol=1e-6 * size)
    assert compiled.product(found.shape, whitened) == pytest.approx(
        plain.product(found.shape, whitened), rel=1e-5, abs=1e-4
    )


@problems
def test_the_decay_is_that_of_its_definition(n_points, dimensions, log_exponent, seed):
    points = np.random.default_rng(seed).normal(0, 1, (n_points, dimensions))
    known = constants(n_points, seed, np.float64)
    found = Pairs(**known).decay(points, log_exponent)
    distances = pack(cdist(points, points))
    powers = np.minimum(distances ** np.exp(log_exponent), 80)
    np.testing.assert_allclose(found.shape, known["known"] * np.exp(-powers), rtol=1e-9)
    np.testing.assert_allclose(found.steepness, powers * found.shape, rtol=1e-9)
    np.testing.assert_allclose(found.squares, distances**2, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.exp(found.logarithms), distances, rtol=1e-9, atol=1e-6)


@given(st.integers(2, 60), st.integers(0, 999))
def test_unpacking_reverses_packing(n_points, seed):
    pairs = Pairs(**constants(n_points, seed, np.float64))
    matrix = pairs.unpack(pairs.similarity)
    np.testing.assert_array_equal(matrix, matrix.T)
    assert not np.diag(matrix).any()
    np.testing.assert_array_equal(pack(matrix), pairs.similarity)
    np.testing.assert_array_equal(
        CompiledPairs(**constants(n_points, seed, np.float64)).unpack(pairs.similarity), matrix
    )
    other = pairs.unpack(pairs.inverse_metric)
    assert pairs.product(pairs.similarity, pairs.inverse_metric) == pytest.approx(
        float((matrix * other).sum()), abs=1e-9
    )


def test_series_equal_the_functions_within_single_precision():
    loops = load_loops("covariogram")
    exponents = np.linspace(-87, 88, 40001).astype(np.float32)
    found = np.array([loops.exponential(x) for x in exponents], dtype=np.float64)
    np.testing.assert_allclose(found, np.exp(exponents.astype(np.float64)), rtol=1.2e-7)
    numbers = np.exp(np.random.default_rng(0).uniform(-87, 88, 20000)).astype(np.float32)
    numbers[:10000] = np.random.default_rng(1).uniform(0.5, 2, 10000)
    exact = np.log(numbers.astype(np.float64))
    found = np.array([loops.logarithm(x) for x in numbers], dtype=np.float64)
    np.testing.assert_allclose(found, exact, rtol=1.2e-7, atol=1.2e-7)
