"""Diagnostics of multidimensional scaling, against independent implementations."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.spatial.distance import pdist, squareform
from sklearn.isotonic import IsotonicRegression

from anisomap import InputError, mantel, reconstruct
from anisomap.evaluation import partial_mantel, shepard, shift_test, stress_per_point
from anisomap.numerics.scaling.stress_minimisation import smacof
from skins import flat_skin

seeds = st.integers(0, 2**32 - 1)


def distances(rng, n=9, k=3):
    return squareform(pdist(rng.normal(size=(n, k))))


@given(seeds, st.booleans())
@settings(max_examples=10)
def test_stress_per_point_is_the_mean_of_the_residuals_of_a_point(seed, weighted):
    """The definition of ``spp`` in R's smacof, point by point."""
    rng = np.random.default_rng(seed)
    wanted, positions = distances(rng), rng.normal(size=(9, 2))
    weights = squareform(rng.uniform(size=36)) if weighted else np.ones((9, 9))
    residuals = weights * (wanted - squareform(pdist(positions))) ** 2
    expected = [np.mean(np.delete(residuals[i], i)) for i in range(9)]
    found = stress_per_point(wanted, positions, weights=weights if weighted else None)
    np.testing.assert_allclose(found, expected / np.sum(expected))
    assert found.sum() == pytest.approx(1)


def test_the_misplaced_point_has_the_greatest_stress():
    points = np.stack(np.meshgrid(range(5), range(5)), -1).reshape(-1, 2).astype(float)
    wanted = squareform(pdist(points))
    assert stress_per_point(wanted, points) == pytest.approx(np.full(25, 0.04))
    points[7] += 3
    assert stress_per_point(wanted, points).argmax() == 7
    wanted[7], wanted[:, 7] = np.inf, np.inf
    wanted[7, 7] = 0
    points[3] += 1
    assert stress_per_point(wanted, points)[7] == 0


@given(seeds)
@settings(max_examples=15)
def test_the_shepard_diagram_is_an_isotonic_regression(seed):
    rng = np.random.default_rng(seed)
    wanted, positions = distances(rng), rng.normal(size=(9, 2))
    found = shepard(wanted, positions)
    expected = IsotonicRegression().fit_transform(squareform(wanted), pdist(positions))
    order = np.argsort(squareform(wanted))
    np.testing.assert_allclose(found.disparities, expected[order], atol=1e-9)
    residual = np.sum((expected - pdist(positions)) ** 2) / np.sum(pdist(positions) ** 2)
    assert found.nonmetric_stress == pytest.approx(np.sqrt(residual), abs=1e-9)
    monotone = shepard(np.sqrt(squareform(pdist(positions))), positions)
    assert monotone.nonmetric_stress == pytest.approx(0, abs=1e-6)
    assert (monotone.nonmetric_fit, monotone.linear_fit) == pytest.approx((1, 1))


def test_nonmetric_stress_is_at_most_the_metric_stress():
    wanted = distances(np.random.default_rng(2), n=20, k=4)
    scaled = smacof(wanted, dimensions=2)
    found = shepard(wanted, scaled.positions)
    assert 0 < found.nonmetric_stress < scaled.stress
    with pytest.raises(InputError, match="at least 2 known pairs"):
        shepard([[0, 1], [1, 0]], [[0.0], [1.0]])


@given(seeds)
@settings(max_examples=15)
def test_partial_mantel_is_the_correlation_of_residuals(seed):
    rng = np.random.default_rng(seed)
    first, second, third = (distances(rng) for _ in range(3))
    x, y, z = map(squareform, (first, second, third))
    design = np.column_stack([np.ones_like(z), z])
    residuals = [v - design @ np.linalg.lstsq(design, v, rcond=None)[0] for v in (x, y)]
    found = partial_mantel(first, second, third, permutations=0)
    assert found.r == pytest.approx(np.corrcoef(*residuals)[0, 1], abs=1e-9)
    assert found.r == pytest.approx(
        partial_mantel(second, first, third, permutations=0).r, abs=1e-9
    )


def test_the_null_of_partial_mantel_relabels_the_first_configuration():
    """All 120 relabellings of five sensors, each by itself."""
    rng = np.random.default_rng(4)
    first, second, third = (distances(rng, n=5) for _ in range(3))
    every = [
        partial_mantel(first[np.ix_(order, order)], second, third, permutations=0).r
        for order in permutations(range(5))
    ]
    null = partial_mantel(first, second, third, permutations=2000, rng=1).null
    assert set(np.round(null, 9)) <= set(np.round(every, 9))
    assert np.mean(null) == pytest.approx(np.mean(every), abs=0.05)
    assert len(set(np.round(null, 9))) > 0.9 * len(set(np.round(every, 9)))


def test_partial_mantel_removes_what_a_third_configuration_explains():
    rng = np.random.default_rng(0)
    layout = rng.normal(size=(40, 2))
    maps = [layout + rng.normal(scale=0.3, size=(40, 2)) for _ in range(2)]
    assert mantel(*maps, permutations=0).r > 0.5
    assert abs(partial_mantel(*maps, layout, permutations=0).r) < 0.25
    with pytest.raises(InputError, match="determines one"):
        partial_mantel(layout, maps[0], layout)
    with pytest.raises(InputError, match="got 40, 40 and 39"):
        partial_mantel(*maps, layout[1:])


def test_mantel_of_a_published_example():
    """The example in the documentation of the Python package mantel (J. W. Carr)."""
    first = squareform([0.2, 0.4, 0.3, 0.6, 0.9, 0.4])
    second = squareform([0.5, 0.3, 0.3, 0.7, 0.3, 0.6])
    assert mantel(first, second, permutations=0).r == pytest.approx(-0.090752, abs=1e-6)


def test_shifts_leave_unrelated_sensors_alike_and_related_ones_apart():
    def strongest(readings):
        return np.abs(np.corrcoef(readings.T) - np.eye(readings.shape[1])).max()

    rng = np.random.default_rng(0)
    steps = rng.normal(size=(60, 500, 5))
    walks = lfilter([1], [1, -0.9], steps, axis=1)[:, 100:]  # permuted frames would not be alike
    p = [shift_test(w, strongest, n_shifts=19, greater=True, rng=1).p_value for w in walks]
    # Uniform on 0.05, 0.1 ... 1 if the test is exact.
    assert 0.35 < np.mean(p) < 0.65
    assert np.mean(np.array(p) <= 0.1) < 0.25
    related = np.column_stack([walks[0, :, 0], walks[0, :, 0] + 0.1 * steps[1, 100:, 0]])
    assert shift_test(related, strongest, n_shifts=19, greater=True).p_value == 0.05


def test_the_stress_of_a_map_of_a_skin_is_no_chance():
    readings = flat_skin(n_frames=600).readings
    found = shift_test(
        readings, lambda x: reconstruct(x, "r-anisomap", 2).stress, n_shifts=9, rng=3
    )
    assert found.p_value == 0.1
    assert found.observed < found.null.min()
    again = shift_test(readings, lambda x: float(x[0, 0]), n_shifts=3, rng=3)
    assert again.null.shape == (3,)
