"""Estimated normals of surfaces with known normals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from anisomap.errors import InputError
from anisomap.numerics.surfaces import estimate_normals
from anisomap.simulation.bodies import sphere


def cylinder(n_around: int, n_along: int) -> tuple[np.ndarray, np.ndarray]:
    angle, along = np.meshgrid(
        2 * np.pi * np.arange(n_around) / n_around, 0.3 * np.arange(n_along), indexing="ij"
    )
    outward = np.column_stack([np.cos(angle.ravel()), np.sin(angle.ravel()), 0 * angle.ravel()])
    return outward + along.ravel()[:, None] * [0, 0, 1], outward


def degrees(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip(np.einsum("nd,nd->n", found, expected), -1, 1)))


@given(st.integers(0, 1000), st.floats(0.01, 100))
@settings(max_examples=10)
def test_normals_of_a_sphere_point_outwards(seed: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    turn, shift = Rotation.from_quat(rng.normal(size=4)), rng.normal(size=3)
    outward = turn.apply(sphere(300).normals.copy())
    normals, reliable = estimate_normals(radius * outward + shift)
    assert reliable.all()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    assert degrees(normals, outward).max() < 10


def test_normals_of_a_bent_sheet_are_on_one_side() -> None:
    # Three quarters of a tube: for some points, inwards is away from the centroid.
    points, outward = cylinder(40, 6)
    angle = np.arctan2(points[:, 1], points[:, 0])
    kept = angle < np.pi / 2
    normals, _ = estimate_normals(points[kept])
    side = np.einsum("nd,nd->n", normals, outward[kept])
    assert (side > 0.8).all()


def test_normals_of_a_plane_are_equal() -> None:
    grid = np.stack(np.meshgrid(np.arange(6.0), np.arange(5.0)), axis=-1).reshape(-1, 2)
    flat, reliable = estimate_normals(grid)
    np.testing.assert_array_equal(flat, np.tile([0, 0, 1], (30, 1)))
    assert reliable.all()
    turn = Rotation.from_euler("xyz", [20, 40, 60], degrees=True)
    space = turn.apply(np.column_stack([grid, np.zeros(30)]))
    normals, reliable = estimate_normals(space)
    assert reliable.all()
    across = turn.apply([0, 0, 1])
    np.testing.assert_allclose(np.abs(normals @ across), 1, atol=1e-9)
    assert len({float(sign) for sign in np.sign(normals @ across)}) == 1


def test_relabelling_points_relabels_normals() -> None:
    points = sphere(120).normals
    order = np.random.default_rng(0).permutation(120)
    np.testing.assert_allclose(
        estimate_normals(points[order])[0], estimate_normals(points)[0][order], atol=1e-9
    )


@pytest.mark.parametrize("n_points", [1, 2, 3, 12])
def test_normals_of_collinear_points_are_unreliable(n_points: int) -> None:
    line = np.outer(np.arange(n_points), [1.0, 2.0, 3.0])
    normals, reliable = estimate_normals(line)
    assert not reliable.any()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)


@pytest.mark.parametrize("positions", [np.zeros((4, 4)), np.zeros(4), [[0, 0, np.nan]]])
def test_invalid_positions_are_rejected(positions: object) -> None:
    with pytest.raises(InputError, match="normals need finite points"):
        estimate_normals(positions)
