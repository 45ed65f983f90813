"""Distances, normals and outlines of solids against closed forms and brute force."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from anisomap.errors import InputError
from anisomap.numerics.surfaces import Mesh, TriangleSearch, nearest_on_triangles
from anisomap.simulation import solids
from anisomap.simulation.solids import Solid

seeds = st.integers(0, 2**32 - 1)
PRIMITIVES = {
    "sphere": (solids.ball(0.7), 4 / 3 * np.pi * 0.7**3),
    "capsule": (
        solids.capsule(0.3, (0, 0, -0.6), (0, 0, 0.6)),
        np.pi * 0.3**2 * 1.2 + 4 / 3 * np.pi * 0.3**3,
    ),
    "cylinder": (solids.cylinder(0.5, 0.9), np.pi * 0.5**2 * 1.8),
    "box": (solids.box((0.4, 0.7, 0.2)), 8 * 0.4 * 0.7 * 0.2),
}
"""Solids of each kind, and their volumes."""


@pytest.mark.parametrize("kind", PRIMITIVES)
@given(seed=seeds)
@settings(max_examples=15)
def test_the_gradient_of_distance_is_one_along_the_normal(kind, seed):
    solid, _ = PRIMITIVES[kind]
    points = np.random.default_rng(seed).uniform(-1.5, 1.5, size=(30, 3))
    outside = points[solid.distance(points) > 0.01]
    normals = solids.surface_normals([solid], outside)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    rise = solid.distance(outside + 0.05 * normals) - solid.distance(outside)
    np.testing.assert_allclose(rise, 0.05, rtol=1e-6)
    np.testing.assert_allclose(solid.distance(solids.project([solid], outside)), 0, atol=1e-9)
    np.testing.assert_allclose(
        replace(solid, centre=np.array([0.1, 0.2, 0.3])).scaled(2.5).distance(2.5 * outside),
        2.5 * solid.distance(outside - [0.1, 0.2, 0.3]),
    )


@pytest.mark.parametrize("kind", PRIMITIVES)
def test_outlines_are_closed_oriented_outwards_and_within_reach(kind):
    solid, volume = PRIMITIVES[kind]
    outline = solid.outline
    corners = outline.vertices[outline.faces]
    signed = np.einsum("fd,fd->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert signed.sum() == pytest.approx(volume, rel=0.02)
    edges = np.sort(outline.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    moved = replace(solid, centre=np.array([0.3, -0.2, 0.1]))
    furthest = np.linalg.norm(moved.outline.vertices, axis=1).max()
    assert furthest <= moved.reach + 1e-12
    assert moved.reach == pytest.approx(furthest, rel=0.01)


@settings(max_examples=20)
@given(seeds, st.sampled_from([1.0, 30.0, 1000.0]))
def test_distance_is_exact_with_triangles_of_mixed_size(seed, largest):
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


def test_distance_from_a_sliver_is_exact():
    sliver = np.array([[0, 0, 0], [1e6, 0, 0], [0, 1e-6, 0], [0, 0, 1e-6]])
    search = TriangleSearch(Mesh(sliver, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    points = [[5e5, 3, 4], [-3.0, 0, 4], [1e6 + 1, 0, 0]]
    assert search.signed_distance(np.array(points)) == pytest.approx([5, 5, 1])


@given(seed=seeds)
@settings(max_examples=5)
def test_a_union_is_as_near_as_the_nearest_of_its_solids(seed):
    rng = np.random.default_rng(seed)
    cube = solids.mesh(solids.box((0.3, 0.2, 0.1)).outline)
    parts = [
        replace(
            part,
            rotation=Rotation.from_quat(rng.normal(size=4)).as_matrix(),
            centre=rng.uniform(-2, 2, size=3),
        )
        for part in (*(solid for solid, _ in PRIMITIVES.values()), *[cube] * 9)
    ]
    points = rng.uniform(-3, 3, size=(200, 3))
    nearest = np.min([part.distance(points) for part in parts], axis=0)
    np.testing.assert_allclose(solids.union_distance(parts, points), nearest, atol=1e-12)


@pytest.mark.parametrize("length", [1e200, np.inf, np.nan])
def test_solids_that_overflow_are_refused(length):
    with pytest.raises(InputError, match="a cylinder must be within 1e"):
        Solid("cylinder", (1.0, length))
    with pytest.raises(InputError, match="a sphere must"):
        solids.ball(1.0, (0, length, 0))
