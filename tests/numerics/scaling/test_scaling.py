"""Classical scaling and stress minimisation: golden values, theorems and other libraries."""

from dataclasses import replace

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import eigh
from scipy.optimize import approx_fprime
from scipy.spatial.distance import cdist, pdist, squareform
from scipy.spatial.transform import Rotation
from sklearn.manifold import smacof as sklearn_smacof

from anisomap.errors import InputError
from anisomap.evaluation import align
from anisomap.numerics.compiled.parallel import MIN_PARALLEL_ROWS
from anisomap.numerics.scaling.multidimensional_scaling import (
    DENSE_LIMIT,
    SOLVERS,
    Problem,
    SmacofOptions,
    objective,
    plain_stress,
    smacof,
    torgerson,
)
from skins import lattice

# Borg & Groenen (1997), Modern Multidimensional Scaling, p. 154: four objects, their
# dissimilarities, the initial configuration, and the configuration after one step.
BORG_DISSIMILARITIES = np.array(
    [[0, 5, 3, 4], [5, 0, 2, 2], [3, 2, 0, 1], [4, 2, 1, 0]], dtype=float
)
BORG_START = np.array([[-0.266, -0.539], [0.451, 0.252], [0.016, -0.238], [-0.200, 0.524]])
BORG_AFTER_ONE_STEP = np.array([[-1.415, -2.471], [1.633, 1.107], [0.249, -0.067], [-0.468, 1.431]])
BORG_STRESS = [34.29899413, 0.58367883, 0.12738894]


def random_problem(seed):
    rng = np.random.default_rng(seed)
    n, k = rng.integers(5, 25), rng.integers(1, 4)
    distances = squareform(
        pdist(rng.normal(size=(n, k + 1))) * rng.uniform(0.5, 2, n * (n - 1) // 2)
    )
    return distances, rng.normal(size=(n, k))


def test_the_worked_example_of_borg_and_groenen():
    # The book prints the start with three decimals, which limits the agreement.
    one_step = smacof(BORG_DISSIMILARITIES, start=BORG_START, options=SmacofOptions(0, 1))
    np.testing.assert_allclose(one_step.positions, BORG_AFTER_ONE_STEP, atol=1e-3)
    published = SmacofOptions(solver="majorization")
    trace = smacof(BORG_DISSIMILARITIES, start=BORG_START, options=published).trace
    np.testing.assert_allclose(trace[:3], BORG_STRESS, rtol=2e-3)


@pytest.mark.parametrize("seed", range(10))
def test_never_above_scikit_learn_from_the_same_start(seed):
    distances, start = random_problem(seed)
    _, theirs = sklearn_smacof(
        distances,
        n_components=start.shape[1],
        init=start,
        n_init=1,
        normalized_stress=False,
        metric=True,
    )
    ours = smacof(distances, start=start, options=SmacofOptions(solver="majorization"))
    assert ours.raw_stress <= theirs * (1 + 1e-9)


@pytest.mark.parametrize("unit", [1e-6, 0.01, 1000.0])
@pytest.mark.parametrize("seed", range(2))
def test_the_unit_does_not_matter(seed, unit):
    distances, start = random_problem(seed)
    found = smacof(distances, start=start)
    other = smacof(unit * distances, start=unit * start)
    assert other.raw_stress == pytest.approx(unit**2 * found.raw_stress, rel=1e-6)
    np.testing.assert_allclose(other.positions, unit * found.positions, rtol=1e-4)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_exact_distances_are_reproduced(k):
    points = np.random.default_rng(k).normal(size=(30, k))
    found = smacof(squareform(pdist(points)), dimensions=k)
    assert align(found.positions, points).rms < 1e-6
    assert found.stress < 1e-6


def test_equal_weights_do_not_matter():
    distances, start = random_problem(1)
    plain = smacof(distances, start=start)
    weighted = smacof(distances, start=start, weights=np.full_like(distances, 3.0))
    np.testing.assert_allclose(weighted.positions, plain.positions, atol=1e-9)
    general = np.full_like(distances, 3.0)
    general[0, 1] = general[1, 0] = 3.0 + 1e-12  # unequal: the general solver
    np.testing.assert_allclose(
        smacof(distances, start=start, weights=general).positions, plain.positions, atol=1e-6
    )


@pytest.mark.parametrize("n_points", [12, DENSE_LIMIT + 10])
def test_torgerson_equals_its_definition(n_points):
    points = np.random.default_rng(0).normal(size=(n_points, 4)) * [1, 2, 3, 4]
    distances = squareform(pdist(points)) ** 0.9
    centring = np.eye(n_points) - 1 / n_points
    values, vectors = eigh(-centring @ distances**2 @ centring / 2)
    expected = vectors[:, :-3:-1] * np.sqrt(values[:-3:-1])
    found = torgerson(distances, 2)
    np.testing.assert_allclose(np.abs(found), np.abs(expected), atol=1e-7)


def test_torgerson_clips_negative_eigenvalues():
    distances = np.ones((4, 4)) - np.eye(4)
    distances[0, 1] = distances[1, 0] = 10
    found = torgerson(distances, 4)
    assert np.isfinite(found).all()
    assert not found[:, -1].any()


@pytest.mark.parametrize("n_rows", [8, 15])  # dense and iterative eigensolver
def test_rounding_does_not_decide_the_signs_of_torgerson(n_rows):
    # On a rectangle, opposite corners have the greatest coordinates.
    places = np.stack(np.meshgrid(np.arange(n_rows), np.arange(n_rows + 2.0)), -1).reshape(-1, 2)
    distances = pdist(places)
    maps = [
        torgerson(squareform(distances * (1 + 1e-13 * rng.standard_normal(len(distances)))), 2)
        for rng in map(np.random.default_rng, range(8))
    ]
    for other in maps:
        np.testing.assert_allclose(other, maps[0], atol=1e-9)


def test_the_same_input_gives_the_same_bytes():
    points = np.random.default_rng(0).normal(size=(DENSE_LIMIT + 50, 2))
    distances = squareform(pdist(points)) ** 0.9
    first = smacof(distances, dimensions=2, options=SmacofOptions(1e-6, 20)).positions
    again = smacof(distances, dimensions=2, options=SmacofOptions(1e-6, 20)).positions
    assert first.tobytes() == again.tobytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"start": np.zeros((3, 2))}, r"\(4, k\)"),
        ({"start": np.full((4, 2), np.nan)}, "NaN"),
        ({"weights": -np.ones((4, 4))}, "at least 0"),
        ({"weights": np.ones((3, 3))}, "weights have shape"),
        ({"dimensions": 0}, "at least 1, got 0"),
    ],
)
def test_what_cannot_be_scaled_is_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        smacof(BORG_DISSIMILARITIES, **arguments)


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [("tolerance", -1, "tolerance"), ("max_iterations", -1, "max_iterations"),
     ("solver", "newton", "majorization")],
)  # fmt: skip
def test_impossible_options_are_refused(option, value, message):
    with pytest.raises(InputError, match=message):
        SmacofOptions(**{option: value})


@st.composite
def problems(draw):
    n, k = draw(st.integers(2, 20)), draw(st.integers(1, 4))
    pairs = n * (n - 1) // 2
    targets = squareform(draw(arrays(np.float64, pairs, elements=st.floats(0, 50))))
    weights = np.ones((1, n))
    if draw(st.booleans()):
        some = draw(arrays(np.float64, pairs, elements=st.sampled_from([0.0, 0.1, 1.0, 7.0])))
        # A path connects all points.
        weights = squareform(some) + np.eye(n, k=1) + np.eye(n, k=-1)
    # A grid, so that some points coincide.
    places = arrays(np.float64, (n, k), elements=st.integers(-8, 8).map(lambda step: step / 4))
    return Problem(targets, weights), draw(places)


def bent_skin(n_rows, seed):
    """Concave and noisy distances of a flat lattice."""
    noise = np.random.default_rng(seed)
    distances = pdist(lattice(n_rows, n_rows)) ** 0.9
    return squareform(distances * noise.uniform(0.9, 1.1, len(distances)))


@given(problems())
def test_the_weighted_stress_is_that_of_the_result(case):
    problem, start = case
    weights = np.broadcast_to(problem.weights, problem.targets.shape)
    found = smacof(problem.targets, weights=weights, start=start, options=SmacofOptions(0, 60))
    assert (np.diff(found.trace) <= 0).all()
    excess = weights * (squareform(pdist(found.positions)) - problem.targets) ** 2
    assert found.raw_stress == pytest.approx(excess.sum() / 2, rel=1e-9, abs=1e-9)
    assert found.trace[-1] == found.raw_stress


@given(problems())
def test_compiled_loops_equal_numpy(case):
    problem, positions = case
    expected, slope = plain_stress(problem, positions)
    raw, gradient = objective(replace(problem, compiled=True))(positions)
    assert raw == pytest.approx(expected, rel=1e-12)
    np.testing.assert_allclose(gradient, slope, rtol=1e-9, atol=1e-9 * np.abs(slope).max(initial=1))


@given(problems())
def test_float32_is_nearly_equal(case):
    problem, positions = case
    single = (one.astype(np.float32) for one in (problem.targets, problem.weights))
    expected, slope = plain_stress(problem, positions)
    raw, gradient = objective(Problem(*single, compiled=True))(positions)
    squares = problem.squares() + problem.squares(positions)
    # Coincident points are the smallest normal number apart.
    tiny = positions.size**2 * float(np.finfo(np.float32).tiny)
    assert raw == pytest.approx(expected, abs=1e-6 * squares + tiny)
    pulls = problem.weights * (problem.targets + cdist(positions, positions))
    np.testing.assert_allclose(gradient, slope, atol=1e-5 * pulls.sum(axis=1).max(initial=0))


def test_translating_the_start_does_not_matter():
    distances = bent_skin(23, 0)
    start = torgerson(distances, 2)
    near, far = (smacof(distances, start=start + shift).trace for shift in (0, 1e7))
    assert far[0] == pytest.approx(near[0], rel=1e-6)
    assert far[-1] == pytest.approx(near[-1], rel=1e-6)


@pytest.mark.parametrize("limit", [0, 1, 7, 12])
def test_iterations_are_limited(limit):
    found = smacof(bent_skin(23, 0), dimensions=2, options=SmacofOptions(0, limit))
    assert len(found.trace) == limit + 1
    assert not found.converged


@pytest.mark.parametrize("seed", range(2))
def test_the_gradient_is_the_derivative_of_the_stress(seed):
    rng = np.random.default_rng(seed)
    weights = squareform(rng.uniform(size=45))
    problem = Problem(squareform(rng.uniform(1, 2, size=45)), weights)
    positions = rng.normal(size=(10, 2))
    differences = approx_fprime(
        positions.ravel(), lambda flat: plain_stress(problem, flat.reshape(10, 2))[0]
    )
    gradient = plain_stress(problem, positions)[1]
    np.testing.assert_allclose(gradient.ravel(), differences, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("solver", SOLVERS)
@given(case=problems())
def test_no_step_raises_the_stress(compiled, solver, case):
    problem, start = replace(case[0], compiled=compiled), case[1]
    found = SOLVERS[solver](problem, start, 0.0, 40)
    assert (np.diff(found.trace) <= 0).all()
    assert found.trace[-1] == pytest.approx(plain_stress(problem, found.positions)[0], abs=1e-9)


def by_both(n_rows, seed, dimensions):
    distances = bent_skin(n_rows, seed)
    published = SmacofOptions(solver="majorization")
    return (
        smacof(distances, dimensions=dimensions),
        smacof(distances, dimensions=dimensions, options=published),
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_single_minimum_is_found_in_fewer_steps_than_by_majorisation(seed):
    ours, published = by_both(11, seed, dimensions=2)
    assert ours.raw_stress <= published.raw_stress * (1 + 1e-7)
    assert len(ours.trace) < len(published.trace)


def test_many_minima_are_about_as_low_as_by_majorisation():
    # A flat skin folds in space in many ways, and rounding decides between them.
    pairs = [by_both(11, seed, dimensions=3) for seed in range(2)]
    depths = [np.log(ours.raw_stress / published.raw_stress) for ours, published in pairs]
    assert np.median(depths) < 0.005
    assert max(depths) < 0.02
    assert all(5 * len(ours.trace) < len(published.trace) for ours, published in pairs)


def test_the_first_step_of_lbfgs_is_that_of_majorisation():
    distances = bent_skin(6, 0)
    first = [
        smacof(distances, options=SmacofOptions(0, 1, solver)).positions
        for solver in ("lbfgs", "majorization")
    ]
    np.testing.assert_allclose(*first, atol=1e-12)


def test_pairs_without_weight_are_unknown():
    points = np.random.default_rng(0).uniform(size=(80, 2))
    distances = squareform(pdist(points))
    unknown = distances > 0.6
    tight = SmacofOptions(1e-12, 20_000)
    missing = smacof(np.where(unknown, np.inf, distances), dimensions=2, options=tight)
    assert align(missing.positions, points).rms < 1e-3
    wrong = np.where(unknown, 3 * distances, distances)
    weightless = smacof(
        wrong, start=np.roll(points, 1, axis=1) ** 2, weights=~unknown, options=tight
    )
    assert align(weightless.positions, points).rms < 1e-3


def test_results_do_not_depend_on_the_number_of_threads(monkeypatch):
    points = np.random.default_rng(0).uniform(size=(MIN_PARALLEL_ROWS, 3))
    distances = squareform(pdist(points))
    results = []
    for n_threads in (1, 3):
        monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", n_threads)
        found = smacof(distances, start=points[:, :2], options=SmacofOptions(0, 3))
        results.append(found.positions.tobytes())
    assert results[0] == results[1]


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("n_points", [1, 2, 3])
@pytest.mark.parametrize("solver", SOLVERS)
def test_up_to_three_points_are_exact(compiled, solver, n_points):
    problem = Problem(1.0 - np.eye(n_points), np.ones((1, n_points)), compiled)
    start = np.random.default_rng(0).normal(size=(n_points, 2))
    found = SOLVERS[solver](problem, start, 1e-12, 3000)
    assert found.trace[-1] == pytest.approx(0, abs=1e-9)
    assert found.converged


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("solver", SOLVERS)
def test_coincident_points_stay_finite(compiled, solver):
    problem = Problem(bent_skin(3, 0), np.ones((1, 9)), compiled)
    assert np.isfinite(SOLVERS[solver](problem, np.ones((9, 2)), 1e-8, 100).positions).all()
    apart = np.random.default_rng(0).normal(size=(9, 2))
    zeros = Problem(np.zeros((9, 9)), np.ones((1, 9)), compiled)
    trace = SOLVERS[solver](zeros, apart, 1e-8, 3000).trace
    assert trace[-1] < 1e-25 * trace[0], "points meet, but for rounding"


def test_torgerson_resolves_equal_eigenvalues():
    # Points with the symmetry of a cube: three eigenvalues are equal.
    points = np.random.default_rng(0).normal(size=(12, 3))
    points = np.concatenate([turn.apply(points) for turn in Rotation.create_group("O")])
    assert len(points) > DENSE_LIMIT
    distances = squareform(pdist(points))
    np.testing.assert_allclose(squareform(pdist(torgerson(distances, 3))), distances, atol=1e-9)


def test_torgerson_of_coincident_points_is_zero():
    found = torgerson(np.zeros((DENSE_LIMIT + 1, DENSE_LIMIT + 1)), 2)
    np.testing.assert_array_equal(found, np.zeros((DENSE_LIMIT + 1, 2)))


@pytest.mark.parametrize("coincident", [False, True])
def test_a_reused_workspace_does_not_change_the_stress(coincident):
    rng = np.random.default_rng(2)
    positions = rng.normal(size=(12, 3))
    if coincident:
        positions[4] = positions[7]
    targets = squareform(pdist(rng.normal(size=(12, 3))))
    problem = Problem(targets, np.ones((1, 12)))
    workspace = np.full((3, 12, 12), np.nan)
    for _ in range(2):
        raw, slope = plain_stress(problem, positions, workspace)
        expected = plain_stress(problem, positions)
        assert raw == expected[0]
        np.testing.assert_array_equal(slope, expected[1])
    assert raw == pytest.approx(((squareform(pdist(positions)) - targets) ** 2).sum() / 2)
    assert np.isfinite(slope).all()
