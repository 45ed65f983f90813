"""The covariogram fit: exact derivatives, known solutions and invariances."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import check_grad, minimize
from scipy.spatial.distance import cdist, pdist, squareform

from anisomap.errors import InputError
from anisomap.numerics.compiled.parallel import load_loops
from anisomap.numerics.covariogram.covariogram_fit import fit_covariogram, minimise
from anisomap.numerics.covariogram.objective import (
    CompiledPairs,
    CovariogramOptions,
    Objective,
    Pairs,
    Problem,
    Weights,
)
from anisomap.numerics.graph.dissimilarity import direct_dissimilarity
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.scaling.multidimensional_scaling import smacof
from skins import likeness


def skin(n_sensors=40, dimensions=2, seed=0):
    """Positions, and their correlations under a covariogram."""
    places = np.random.default_rng(seed).uniform(-1.5, 1.5, (n_sensors, dimensions))
    similarity = 0.9 * np.exp(-(cdist(places, places) ** 1.5)) - 0.05
    np.fill_diagonal(similarity, 1)
    return places, similarity


def drawn(similarity, n_frames, seed):
    """Sample correlations of a number of independent frames."""
    rng = np.random.default_rng(seed)
    values, vectors = np.linalg.eigh(similarity)
    root = vectors * np.sqrt(values.clip(0))
    return np.corrcoef((rng.standard_normal((n_frames, len(similarity))) @ root.T).T)


def set_out(similarity, dimensions, noise):
    metric = metricise(direct_dissimilarity(similarity, np.full(similarity.shape, noise)))
    return metric, smacof(metric, dimensions=dimensions).positions


@pytest.mark.parametrize("most", [14, 13])
@pytest.mark.parametrize("unknown", [0.0, 0.3])
def test_the_gradient_is_that_of_finite_differences(most, unknown):
    rng = np.random.default_rng(1)
    places, similarity = skin(14, 3)
    metric = cdist(places, places) * np.exp(0.2 * rng.standard_normal((14, 14)))
    metric = metric + metric.T
    metric[0, 1:5] = metric[1:5, 0] = np.inf
    known = rng.uniform(size=(14, 14)) >= unknown
    known &= known.T & ~np.eye(14, dtype=bool)
    options = CovariogramOptions(max_whitened=most)
    objective = Objective(Problem(similarity, metric, known, 0.3, 1.0, options))

    def value(p):
        return objective.value_and_slope(p[:-1].reshape(14, 3), p[-1])

    for _ in range(3):
        at = np.append(places.ravel() + 0.3 * rng.standard_normal(42), rng.uniform(-0.5, 0.7))
        slope = value(at)[1]
        error = check_grad(lambda p: value(p)[0], lambda p: value(p)[1], at)
        assert error < 1e-5 * np.linalg.norm(slope)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_positions_and_function_are_recovered_without_noise(dimensions):
    places, similarity = skin(60, dimensions)
    metric, start = set_out(similarity, dimensions, 1e-8)
    found = fit_covariogram(similarity, start, metric, noise=1e-8)
    assert found.converged
    assert likeness(found.positions, places) > 0.9999 > likeness(start, places) + 0.001
    assert found.amplitude == pytest.approx(0.9, rel=0.02)
    assert found.exponent == pytest.approx(1.5, rel=0.02)
    assert found.offset == pytest.approx(-0.05, abs=0.02)
    at = found.at(cdist(found.positions, found.positions))
    pairs = np.triu_indices(60, 1)
    np.testing.assert_allclose(at[pairs], similarity[pairs], atol=0.02)


@pytest.mark.parametrize("n_frames", [100, 400, 1600])
def test_the_fit_improves_on_its_start_under_noise(n_frames):
    before, after = [], []
    for seed in range(4):
        places, similarity = skin(60, 2, seed)
        observed = drawn(similarity, n_frames, seed)
        metric, start = set_out(observed, 2, 1 / n_frames)
        found = fit_covariogram(observed, start, metric, noise=1 / n_frames)
        before.append(1 - likeness(start, places))
        after.append(1 - likeness(found.positions, places))
    assert np.mean(after) < 0.8 * np.mean(before)


@given(st.integers(0, 30))
def test_the_fit_is_equivariant_to_labels_and_units(seed):
    rng = np.random.default_rng(seed)
    similarity = skin(20, 2, seed)[1]
    observed = drawn(similarity, 500, seed)
    metric, start = set_out(observed, 2, 0.002)
    few = CovariogramOptions(max_iterations=5)
    found = fit_covariogram(observed, start, metric, noise=0.002, options=few)
    other = rng.permutation(20)
    again = fit_covariogram(
        observed[np.ix_(other, other)],
        7 * start[other],
        7 * metric[np.ix_(other, other)],
        noise=0.002,
        options=few,
    )
    np.testing.assert_allclose(again.positions, found.positions[other], atol=1e-5)
    assert again.objective == pytest.approx(found.objective, rel=1e-6)


def test_the_objective_never_increases():
    _, similarity = skin(30)
    observed = drawn(similarity, 200, 0)
    metric, start = set_out(observed, 2, 0.005)
    ends = [
        fit_covariogram(
            observed, start, metric, noise=0.005, options=CovariogramOptions(max_iterations=n)
        ).objective
        for n in (0, 1, 3, 10, 30, 300)
    ]
    assert all(later <= earlier + 1e-9 for earlier, later in itertools.pairwise(ends))
    assert ends[-1] < ends[0]


def test_a_common_signal_does_not_change_the_map():
    places, similarity = skin(60, 2)
    shared = (similarity + 1.0) / 2.0  # half of every reading is a hum
    plain, hummed = (
        fit_covariogram(s, *set_out(s, 2, 1e-4)[::-1], noise=1e-4) for s in (similarity, shared)
    )
    assert likeness(hummed.positions, places) > likeness(plain.positions, places) - 0.005


def test_unknown_pairs_are_ignored():
    places, similarity = skin(40)
    metric, start = set_out(similarity, 2, 1e-4)
    rng = np.random.default_rng(3)
    known = rng.uniform(size=(40, 40)) < 0.8
    known &= known.T
    nonsense = np.where(known, similarity, rng.uniform(-1, 1, (40, 40)))
    nonsense = np.where(known, similarity, (nonsense + nonsense.T) / 2)
    first, second = (
        fit_covariogram(s, start, metric, noise=1e-4, known=known) for s in (similarity, nonsense)
    )
    np.testing.assert_array_equal(first.positions, second.positions)
    assert likeness(first.positions, places) > 0.99


def test_a_fit_that_is_not_whitened_gives_nearly_the_map_of_one_that_is():
    places, similarity = skin(120, 2)
    observed = drawn(similarity, 1000, 0)
    metric, start = set_out(observed, 2, 0.001)
    whitened, plain = (
        fit_covariogram(
            observed, start, metric, noise=0.001, options=CovariogramOptions(max_whitened=most)
        ).positions
        for most in (120, 0)
    )
    assert likeness(whitened, plain) > 0.995
    assert 1 - likeness(plain, places) < 2 * (1 - likeness(whitened, places)) + 0.001


@pytest.mark.parametrize(
    "change", [{"prior_weight": -1}, {"repulsion": np.nan}, {"ridge": 0}, {"max_whitened": -1},
               {"max_iterations": -1}]
)  # fmt: skip
def test_invalid_options_are_refused(change):
    with pytest.raises(InputError, match=next(iter(change))):
        CovariogramOptions(**change)


def test_a_fit_near_another_starts_from_its_exponent_and_curvature():
    _, similarity = skin()
    first, second = (drawn(similarity, 2000, seed) for seed in range(2))
    metric, start = set_out(first, 2, 1 / 2000)
    whole = CovariogramOptions(prior_weight=0)  # the prior depends on the unit
    near = fit_covariogram(first, start, metric, noise=1 / 2000, options=whole)
    again = fit_covariogram(
        first, 7 * near.positions, 7 * metric, noise=1 / 2000, options=whole, near=near
    )
    assert again.iterations <= 5
    assert not any(array.flags.writeable for array in (near.factor, near.positions))
    np.testing.assert_allclose(pdist(again.positions), pdist(near.positions), atol=0.01)
    ended = fit_covariogram(second, start, metric, noise=1 / 2000, options=whole)
    few = replace(whole, max_iterations=5)
    left = [
        1 - likeness(fit.positions, ended.positions)
        for fit in (
            fit_covariogram(second, near.positions, metric, noise=1 / 2000, options=few),
            fit_covariogram(second, near.positions, metric, noise=1 / 2000, options=few, near=near),
        )
    ]
    assert left[1] < left[0]


LOG_EXPONENT = 0.3


def exact(points, max_whitened=500, prior=0.0, repulsion=0.0, noise=1e-3):
    """Return the objective for a similarity that one function of distance explains exactly."""
    distances = cdist(points, points)
    similarity = 0.8 * np.exp(-(distances ** np.exp(LOG_EXPONENT))) + 0.05
    np.fill_diagonal(similarity, 1.0)
    known = ~np.eye(len(points), dtype=bool)
    options = CovariogramOptions(repulsion=repulsion, max_whitened=max_whitened)
    return Objective(Problem(similarity, distances, known, noise, prior, options))


def by_axes(positions, gradient):
    """Order a gradient by axes, as the curvature is."""
    return np.append(gradient[:-1].reshape(positions.shape).T.ravel(), gradient[-1])


@pytest.mark.parametrize(("max_whitened", "tolerance"), [(14, 1e-5), (0, 0.1)])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_curvature_is_the_hessian_where_nothing_is_left_to_explain(
    max_whitened, tolerance, dimensions
):
    points = np.random.default_rng(dimensions).uniform(0, 2, (14, dimensions))
    objective = exact(points, max_whitened)
    found = np.triu(objective.gauss_newton_matrix(points, LOG_EXPONENT))
    step, expected = 1e-5, []
    parameters = np.append(points.T.ravel(), LOG_EXPONENT)
    for i in range(parameters.size):
        slopes = []
        for sign in (1, -1):
            moved = parameters.copy()
            moved[i] += sign * step
            x = np.ascontiguousarray(moved[:-1].reshape(dimensions, -1).T)
            slopes.append(by_axes(x, objective.value_and_slope(x, moved[-1])[1]))
        expected.append((slopes[0] - slopes[1]) / (2 * step))
    scale = np.abs(expected).max()
    np.testing.assert_allclose(found, np.triu(expected), atol=tolerance * scale)


@pytest.mark.parametrize("max_whitened", [30, 0])
def test_the_curvature_with_priors_is_positive_semi_definite(max_whitened):
    points = np.random.default_rng(1).uniform(0, 2, (30, 3))
    objective = exact(points, max_whitened, prior=1.0, repulsion=0.1)
    upper = np.triu(objective.gauss_newton_matrix(points * 1.1, 0.0))
    values = np.linalg.eigvalsh(upper + np.triu(upper, 1).T)
    assert values[0] > -1e-9 * values[-1]


@pytest.mark.parametrize("seed", [301, 302, 303])
def test_the_minimum_is_that_of_a_long_search(seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 4, (60, 2))
    objective = exact(points, prior=1.0, repulsion=0.1)
    start = points + rng.normal(0, 0.1, points.shape)
    found = minimise(objective, start, 1e-8, 300)
    assert found.converged

    def plain(parameters):
        return objective.value_and_slope(parameters[:-1].reshape(start.shape), parameters[-1])

    long = minimize(
        plain, np.append(start.ravel(), 0.0), jac=True, method="L-BFGS-B",
        options={"maxiter": 3000, "maxfun": 6000, "ftol": 1e-14, "gtol": 1e-10},
    )  # fmt: skip
    assert found.value <= long.fun + 1e-5 * max(1, abs(long.fun))
    distances = pdist(long.x[:-1].reshape(start.shape))
    assert np.corrcoef(pdist(found.positions), distances)[0, 1] > 1 - 1e-5


def test_no_iterations_leave_the_start():
    points = np.random.default_rng(0).uniform(0, 2, (20, 2))
    objective = exact(points)
    found = minimise(objective, points, 1e-7, 0)
    np.testing.assert_array_equal(found.positions, points)
    assert found.iterations == 0
    assert not found.converged


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
        "inverse_metric": np.append(1, rng.choice([0, 0.2, 3], n_pairs - 1)).astype(dtype),
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
    n_lengths = float(np.count_nonzero(plain.inverse_metric))
    weights = Weights(0.8, float(np.exp(log_exponent)), 0.1, 1e-3, 1e-4, 0.3, n_lengths)
    ours, theirs = (p.slope(expected, whitened, weights) for p in (compiled, plain))
    assert ours[0] == pytest.approx(theirs[0], rel=1e-5, abs=1e-4)
    assert ours[1] == pytest.approx(theirs[1], rel=1e-4, abs=1e-4)
    force = theirs[2]
    size, scale = 1 + np.abs(force).sum() * 1e-3, np.abs(force).max()
    np.testing.assert_allclose(ours[2], force, rtol=1e-4, atol=1e-6 * scale)
    pulled, reference = (p.gradient(force, points) for p in (compiled, plain))
    np.testing.assert_allclose(pulled, reference, rtol=1e-6, atol=1e-6 * size)


@problems
def test_the_decay_is_that_of_its_definition(n_points, dimensions, log_exponent, seed):
    points = np.random.default_rng(seed).normal(0, 1, (n_points, dimensions))
    known = constants(n_points, seed, np.float64)
    found = Pairs(**known).decay(points, log_exponent)
    distances = pdist(points)
    powers = np.minimum(distances ** np.exp(log_exponent), 80)
    np.testing.assert_allclose(found.shape, known["known"] * np.exp(-powers), rtol=1e-9)
    np.testing.assert_allclose(found.steepness, powers * found.shape, rtol=1e-9)
    np.testing.assert_allclose(found.squares, distances**2, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.exp(found.logarithms), distances, rtol=1e-9, atol=1e-6)


@given(st.integers(2, 60), st.integers(0, 999))
def test_products_are_those_of_matrices(n_points, seed):
    pairs = Pairs(**constants(n_points, seed, np.float64))
    one, other = (squareform(x, checks=False) for x in (pairs.similarity, pairs.inverse_metric))
    assert pairs.product(pairs.similarity, pairs.inverse_metric) == pytest.approx(
        float((one * other).sum()), abs=1e-9
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
