"""The curvature of the covariogram's objective, and minima found with it."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.distance import cdist, pdist

from anisomap.numerics.covariogram.covariogram_fit import minimise, overlapping_blocks
from anisomap.numerics.covariogram.objective import (
    Block,
    CovariogramOptions,
    Problem,
    gauss_newton_matrix,
    objective,
)

LOG_EXPONENT = 0.3


def exact_blocks(points, block_size, prior=0.0, repulsion=0.0, noise=1e-3):
    """Return blocks of a similarity that one function of distance explains exactly."""
    distances = cdist(points, points)
    similarity = 0.8 * np.exp(-(distances ** np.exp(LOG_EXPONENT))) + 0.05
    np.fill_diagonal(similarity, 1.0)
    known = ~np.eye(len(points), dtype=bool)
    options = CovariogramOptions(prior_weight=prior, repulsion=repulsion)
    problem = Problem(similarity, distances, known, noise, options)
    return [Block(sensors, problem) for sensors in overlapping_blocks(points, block_size)]


def by_axes(positions, gradient):
    """Order a gradient by axes, as the curvature is."""
    return np.append(gradient[:-1].reshape(positions.shape).T.ravel(), gradient[-1])


@pytest.mark.parametrize("block_size", [20, 7])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_curvature_is_the_hessian_where_nothing_is_left_to_explain(block_size, dimensions):
    points = np.random.default_rng(dimensions).uniform(0, 2, (14, dimensions))
    blocks = exact_blocks(points, block_size)
    found = np.triu(gauss_newton_matrix(blocks, points, LOG_EXPONENT))
    step, expected = 1e-5, []
    parameters = np.append(points.T.ravel(), LOG_EXPONENT)
    for i in range(parameters.size):
        slopes = []
        for sign in (1, -1):
            moved = parameters.copy()
            moved[i] += sign * step
            x = np.ascontiguousarray(moved[:-1].reshape(dimensions, -1).T)
            slopes.append(by_axes(x, objective(blocks, x, moved[-1])[1]))
        expected.append((slopes[0] - slopes[1]) / (2 * step))
    scale = np.abs(expected).max()
    np.testing.assert_allclose(found, np.triu(expected), atol=1e-5 * scale)


def test_the_curvature_with_priors_is_positive_semi_definite():
    points = np.random.default_rng(1).uniform(0, 2, (30, 3))
    blocks = exact_blocks(points, 12, prior=1.0, repulsion=0.1)
    upper = np.triu(gauss_newton_matrix(blocks, points * 1.1, 0.0))
    values = np.linalg.eigvalsh(upper + np.triu(upper, 1).T)
    assert values[0] > -1e-9 * values[-1]


@pytest.mark.parametrize("seed", [301, 302, 303])
def test_the_minimum_is_that_of_a_long_search(seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 4, (60, 2))
    blocks = exact_blocks(points, 60, prior=1.0, repulsion=0.1)
    start = points + rng.normal(0, 0.1, points.shape)
    options = CovariogramOptions()
    found = minimise(blocks, start, options, tolerance=options.tolerance, displacement=1e-3)
    assert found.converged

    def plain(parameters):
        return objective(blocks, parameters[:-1].reshape(start.shape), parameters[-1])

    long = minimize(
        plain, np.append(start.ravel(), 0.0), jac=True, method="L-BFGS-B",
        options={"maxiter": 3000, "maxfun": 6000, "ftol": 1e-14, "gtol": 1e-10},
    )  # fmt: skip
    assert found.value <= long.fun + 1e-5 * max(1, abs(long.fun))
    distances = pdist(long.x[:-1].reshape(start.shape))
    assert np.corrcoef(pdist(found.positions), distances)[0, 1] > 1 - 1e-5


def test_no_iterations_leave_the_start():
    points = np.random.default_rng(0).uniform(0, 2, (20, 2))
    blocks = exact_blocks(points, 20)
    found = minimise(
        blocks, points, CovariogramOptions(max_iterations=0), tolerance=1e-7, displacement=1e-3
    )
    np.testing.assert_array_equal(found.positions, points)
    assert found.iterations == 0
    assert not found.converged
