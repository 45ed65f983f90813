"""Ways down the stress: one function plainly and compiled, and no end above majorisation."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import approx_fprime
from scipy.sparse.linalg import ArpackNoConvergence
from scipy.spatial.distance import cdist, pdist, squareform
from scipy.spatial.transform import Rotation

from anisomap.errors import InputError
from anisomap.evaluation import align
from anisomap.numerics.compiled import parallel
from anisomap.numerics.scaling import classical, stress
from anisomap.numerics.scaling.classical import torgerson
from anisomap.numerics.scaling.solvers import BOTH_UP_TO, SOLVERS
from anisomap.numerics.scaling.stress import Problem, objective, plain_stress
from anisomap.numerics.scaling.stress_minimisation import SmacofOptions, smacof
from skins import lattice

in_fixtures = settings(deadline=None, suppress_health_check=["function_scoped_fixture"])


@pytest.fixture
def always_compiled(monkeypatch):
    monkeypatch.setattr(stress, "MIN_COMPILED_ROWS", 1)


@pytest.fixture(params=["plain", "compiled"])
def either_way(request, monkeypatch):
    monkeypatch.setattr(
        stress, "MIN_COMPILED_ROWS", {"plain": 10_000, "compiled": 1}[request.param]
    )


@st.composite
def problems(draw):
    n, k = draw(st.integers(2, 20)), draw(st.integers(1, 4))
    pairs = n * (n - 1) // 2
    targets = squareform(draw(arrays(np.float64, pairs, elements=st.floats(0, 50))))
    weights = np.ones((1, n))
    if draw(st.booleans()):
        some = draw(arrays(np.float64, pairs, elements=st.sampled_from([0.0, 0.1, 1.0, 7.0])))
        # A path of pairs keeps it connected.
        weights = squareform(some) + np.eye(n, k=1) + np.eye(n, k=-1)
    # Steps of a quarter, so that some points coincide.
    places = arrays(np.float64, (n, k), elements=st.integers(-8, 8).map(lambda step: step / 4))
    return Problem(targets, weights), draw(places)


def bent_skin(n_rows, seed):
    """Distances along a flat skin, by paths a little too long: hard to lay flat in space."""
    noise = np.random.default_rng(seed)
    distances = pdist(lattice(n_rows, n_rows)) ** 0.9
    return squareform(distances * noise.uniform(0.9, 1.1, len(distances)))


@given(problems())
@in_fixtures
def test_compiled_loops_give_what_whole_matrices_give(always_compiled, case):
    problem, positions = case
    expected, slope = plain_stress(problem, positions)
    with objective(problem) as function:
        raw, gradient = function(positions)
    assert raw == pytest.approx(expected, rel=1e-12)
    np.testing.assert_allclose(gradient, slope, rtol=1e-9, atol=1e-9 * np.abs(slope).max(initial=1))


@given(problems())
@in_fixtures
def test_float32_gives_nearly_the_same(always_compiled, case):
    problem, positions = case
    coarse = problem.single()
    assume(coarse is not None)
    assert coarse.targets.dtype == coarse.weights.dtype == np.float32
    expected, slope = plain_stress(problem, positions)
    with objective(coarse, single=True) as function:
        raw, gradient = function(positions)
    squares = problem.weighted_squares() + problem.weighted_squares(positions)
    assert raw == pytest.approx(expected, abs=1e-6 * squares)
    pulls = problem.weights * (problem.targets + cdist(positions, positions))
    np.testing.assert_allclose(gradient, slope, atol=1e-5 * pulls.sum(axis=1).max(initial=0))


@pytest.mark.parametrize("unit", [1e-40, 1e-12, 1e12, 1e40])
def test_distances_that_leave_float32_are_scaled_without_it(always_compiled, unit):
    distances = unit * bent_skin(11, 0)
    assert Problem(distances, np.ones((1, len(distances)))).single() is None
    found, plain = smacof(distances, dimensions=2), smacof(distances / unit, dimensions=2)
    assert found.stress == pytest.approx(plain.stress, rel=1e-6)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("share_known", [1.0, 0.6])
def test_the_way_in_float32_ends_where_that_in_float64_does(always_compiled, seed, share_known):
    distances = bent_skin(11, seed)
    rng = np.random.default_rng(seed)
    weights = squareform(rng.uniform(size=len(squareform(distances))) < share_known)
    in_double = SmacofOptions(solver="lbfgs")
    found = smacof(distances, dimensions=2, weights=weights)
    expected = smacof(distances, dimensions=2, weights=weights, options=in_double)
    assert found.converged
    assert found.raw_stress == pytest.approx(expected.raw_stress, rel=1e-6)
    assert (np.diff(found.trace) <= 0).all()
    excess = squareform(weights) * (pdist(found.positions) - squareform(distances)) ** 2
    assert found.raw_stress == pytest.approx(excess.sum(), rel=1e-12)


def test_where_the_start_lies_does_not_matter(always_compiled):
    distances = bent_skin(11, 0)
    start = torgerson(distances, 2)
    near, far = (smacof(distances, start=start + shift).trace for shift in (0, 1e7))
    assert far[0] == pytest.approx(near[0], rel=1e-6)
    assert far[-1] == pytest.approx(near[-1], rel=1e-6)


def test_a_point_of_hardly_any_weight_is_scaled_without_float32(always_compiled):
    weights = np.ones((121, 121))
    weights[5] = weights[:, 5] = 1e-50
    assert Problem(bent_skin(11, 0), weights).single() is None


@pytest.mark.parametrize("most", [0, 1, 7, 12])
def test_both_ways_together_take_no_more_steps_than_allowed(always_compiled, most):
    found = smacof(bent_skin(11, 0), dimensions=2, options=SmacofOptions(0, most))
    assert len(found.trace) == most + 1
    assert not found.converged


@pytest.mark.parametrize("seed", range(5))
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


@pytest.mark.parametrize("solver", SOLVERS)
@given(problems())
@in_fixtures
def test_no_step_of_any_solver_raises_the_stress(either_way, solver, case):
    problem, start = case
    found = SOLVERS[solver](problem, start, 0.0, 40)
    assert (np.diff(found.trace) <= 0).all()
    assert found.trace[-1] == pytest.approx(plain_stress(problem, found.positions)[0], abs=1e-9)


@given(problems())
@settings(deadline=None)
def test_of_few_points_the_default_is_never_above_majorisation(case):
    problem, start = case
    published = SOLVERS["majorization"](problem, start, 1e-8, 300)
    assert SOLVERS["auto"](problem, start, 1e-8, 300).trace[-1] <= published.trace[-1]


def by_both(n_rows, seed, dimensions):
    distances = bent_skin(n_rows, seed)
    assert len(distances) > BOTH_UP_TO
    published = SmacofOptions(solver="majorization")
    return (
        smacof(distances, dimensions=dimensions),
        smacof(distances, dimensions=dimensions, options=published),
    )


@pytest.mark.parametrize("seed", range(6))
def test_where_there_is_one_valley_it_is_found_in_fewer_steps(either_way, seed):
    ours, published = by_both(11, seed, dimensions=2)
    assert ours.raw_stress <= published.raw_stress * (1 + 1e-7)
    assert len(ours.trace) < len(published.trace)


def test_where_there_are_many_it_goes_as_deep_on_the_whole():
    # A flat skin in space folds in many ways; which one is found hangs on the smallest step.
    pairs = [by_both(11, seed, dimensions=3) for seed in range(6)]
    depths = [np.log(ours.raw_stress / published.raw_stress) for ours, published in pairs]
    assert np.median(depths) <= 0
    assert max(depths) < 0.02
    assert all(5 * len(ours.trace) < len(published.trace) for ours, published in pairs)


def test_the_first_step_of_lbfgs_is_majorisation_s():
    distances = bent_skin(6, 0)
    first = [
        smacof(distances, options=SmacofOptions(0, 1, solver)).positions
        for solver in ("lbfgs", "majorization")
    ]
    np.testing.assert_allclose(*first, atol=1e-12)


def test_pairs_without_weight_are_pairs_unknown(either_way):
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


@pytest.mark.parametrize("n_threads", [2, 3])
def test_threads_change_nothing(always_compiled, n_threads, monkeypatch):
    distances = bent_skin(12, 0)
    alone = smacof(distances)
    monkeypatch.setattr(parallel, "MIN_PARALLEL_ROWS", 1)
    monkeypatch.setattr(parallel, "thread_count", lambda: n_threads)
    assert smacof(distances).positions.tobytes() == alone.positions.tobytes()


@pytest.mark.parametrize("n_points", [1, 2, 3])
@pytest.mark.parametrize("solver", SOLVERS)
def test_the_fewest_points(either_way, solver, n_points):
    distances = 1.0 - np.eye(n_points)
    found = smacof(distances, dimensions=2, options=SmacofOptions(solver=solver))
    assert found.raw_stress == pytest.approx(0, abs=1e-12)
    assert found.converged


@pytest.mark.parametrize("solver", SOLVERS)
def test_points_that_all_coincide_stay_finite(either_way, solver):
    found = smacof(bent_skin(3, 0), start=np.ones((9, 2)), options=SmacofOptions(solver=solver))
    assert np.isfinite(found.positions).all()
    assert smacof(np.zeros((9, 9)), options=SmacofOptions(solver=solver)).raw_stress < 1e-290


def test_an_unknown_solver_is_refused():
    with pytest.raises(InputError, match="majorization"):
        SmacofOptions(solver="newton")


def test_torgerson_tells_equal_eigenvalues_apart(monkeypatch):
    # Every rotation of a cube maps these points to one another: three eigenvalues are one.
    monkeypatch.setattr(classical, "DENSE_LIMIT", 10)
    points = np.random.default_rng(0).normal(size=(12, 3))
    points = np.concatenate([turn.apply(points) for turn in Rotation.create_group("O")])
    distances = squareform(pdist(points))
    np.testing.assert_allclose(squareform(pdist(torgerson(distances, 3))), distances, atol=1e-9)


@pytest.mark.parametrize("error", [ArpackNoConvergence("not settled", [], []), None])
def test_torgerson_falls_back_to_the_full_decomposition(error, monkeypatch):
    distances = bent_skin(7, 0) if error else np.zeros((49, 49))
    expected = torgerson(distances, 2)

    def unsettled(*_, **__):
        raise error

    monkeypatch.setattr(classical, "DENSE_LIMIT", 10)
    if error:
        monkeypatch.setattr(classical, "eigsh", unsettled)
    np.testing.assert_array_equal(torgerson(distances, 2), expected)


def test_small_maps_load_no_compiler():
    program = (
        "import sys, numpy as np\n"
        "from anisomap.numerics.graph.metric import metricise\n"
        "from anisomap.numerics.scaling.stress_minimisation import smacof\n"
        "place = np.random.default_rng(0).uniform(size=(60, 1))\n"
        "smacof(metricise(abs(place - place.T)))\n"
        "sys.exit('numba' in sys.modules)\n"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
