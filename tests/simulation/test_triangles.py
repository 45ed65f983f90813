"""Distances from triangles, against brute force."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from anisomap.numerics.triangles import TriangleSearch, nearest_on_triangles
from anisomap.scene import Mesh


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1.0, 30.0, 1000.0]))
def test_distance_is_exact_with_triangles_of_mixed_size(seed: int, largest: float) -> None:
    rng = np.random.default_rng(seed)
    sizes = np.where(rng.random(30) < 0.2, largest, 1.0)
    corners = rng.uniform(-1, 1, (30, 1, 3)) + sizes[:, None, None] * rng.normal(size=(30, 3, 3))
    search = TriangleSearch(Mesh(corners.reshape(-1, 3), np.arange(90).reshape(30, 3)))
    points = rng.uniform(-1, 1, (20, 3)) * rng.choice([1.0, largest], (20, 1))
    brute = [
        np.linalg.norm(point - nearest_on_triangles(np.tile(point, (30, 1)), corners), axis=1).min()
        for point in points
    ]
    found = np.abs(search.signed_distance(points))
    np.testing.assert_allclose(found, brute, rtol=1e-9, atol=1e-9 * largest)


def test_distance_from_a_sliver_is_exact() -> None:
    sliver = np.array([[0, 0, 0], [1e6, 0, 0], [0, 1e-6, 0], [0, 0, 1e-6]])
    search = TriangleSearch(Mesh(sliver, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    points = [[5e5, 3, 4], [-3.0, 0, 4], [1e6 + 1, 0, 0]]
    assert search.signed_distance(np.array(points)) == pytest.approx([5, 5, 1])
