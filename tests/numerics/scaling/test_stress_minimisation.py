"""Classical scaling and stress minimisation: golden values, theorems and scikit-learn."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import eigh
from scipy.spatial.distance import pdist, squareform
from sklearn.manifold import smacof as sklearn_smacof

from anisomap.errors import InputError
from anisomap.evaluation import align
from anisomap.numerics.scaling.multidimensional_scaling import (
    DENSE_LIMIT,
    SmacofOptions,
    smacof,
    torgerson,
)

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
    ours = smacof(distances, start=start)
    assert ours.raw_stress <= theirs * (1 + 1e-9)


@st.composite
def weighted_problems(draw):
    n, k = draw(st.integers(3, 9)), draw(st.integers(1, 3))
    pairs = n * (n - 1) // 2
    distances = draw(arrays(np.float64, pairs, elements=st.floats(0, 50)))
    weights = draw(arrays(np.float64, pairs, elements=st.sampled_from([0.0, 0.1, 1.0, 7.0])))
    start = draw(arrays(np.float64, (n, k), elements=st.floats(-20, 20)))
    weights = squareform(weights) + np.eye(n, k=1) + np.eye(n, k=-1)  # a path connects all points
    return squareform(distances), weights, start


@given(weighted_problems())
def test_the_weighted_stress_never_rises_and_is_that_of_the_result(problem):
    distances, weights, start = problem
    found = smacof(distances, weights=weights, start=start, options=SmacofOptions(0, 60))
    assert (np.diff(found.trace) <= 0).all()
    fitted = squareform(pdist(found.positions))
    expected = (weights * (fitted - distances) ** 2).sum() / 2
    assert found.raw_stress == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert found.trace[-1] == found.raw_stress


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


def test_connected_components_are_rejected():
    distances = np.full((4, 4), np.inf)
    distances[:2, :2] = distances[2:, 2:] = 1
    np.fill_diagonal(distances, 0)
    with pytest.raises(InputError, match="2 connected components"):
        smacof(distances)


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


@pytest.mark.parametrize("options", [{"tolerance": -1}, {"max_iterations": -1}])
def test_impossible_options_are_refused(options):
    with pytest.raises(InputError, match=next(iter(options))):
        SmacofOptions(**options)
