"""Distances, normals and outlines of solids against closed forms and brute force."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from anisomap.errors import InputError
from anisomap.numerics.triangles import TriangleSearch
from anisomap.scene import Mesh
from anisomap.simulation.geometry import solids
from anisomap.simulation.geometry.solids import Solid

seeds = st.integers(0, 2**32 - 1)
PRIMITIVES: dict[str, Callable[[], Solid]] = {
    "sphere": lambda: solids.ball(0.7),
    "capsule": lambda: solids.capsule(0.3, (0, 0, -0.6), (0, 0, 0.6)),
    "cylinder": lambda: solids.cylinder(0.5, 0.9),
    "box": lambda: solids.box((0.4, 0.7, 0.2)),
}


def surface(solid: Solid, n_points: int = 4000) -> np.ndarray:
    corners = solid.outline.vertices[solid.outline.faces]
    weights = np.random.default_rng(0).dirichlet(np.ones(3), size=n_points)
    chosen = np.random.default_rng(1).integers(len(corners), size=n_points)
    return np.einsum("nc,ncd->nd", weights, corners[chosen])


@pytest.mark.parametrize("kind", PRIMITIVES)
@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_distance_is_at_most_that_to_any_point_of_the_surface(kind: str, seed: int) -> None:
    solid = PRIMITIVES[kind]()
    rng = np.random.default_rng(seed)
    moved = solid.moved(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    points = rng.uniform(-2, 2, size=(30, 3))
    sampled = surface(moved)
    nearest = np.linalg.norm(points[:, None] - sampled, axis=2).min(axis=1)
    distance = np.abs(moved.distance(points))
    coarse = 0.01  # maximum depth of the outline below the surface of a round solid
    assert (distance <= nearest + coarse).all()
    assert (distance >= nearest - 0.2).all()


@pytest.mark.parametrize("kind", PRIMITIVES)
@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_the_gradient_of_distance_is_one_along_the_normal(kind: str, seed: int) -> None:
    solid = PRIMITIVES[kind]()
    points = np.random.default_rng(seed).uniform(-1.5, 1.5, size=(30, 3))
    outside = points[solid.distance(points) > 0.01]
    normals = solids.surface_normals([solid], outside)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    step = 0.05
    np.testing.assert_allclose(
        solid.distance(outside + step * normals) - solid.distance(outside), step, rtol=1e-6
    )
    np.testing.assert_allclose(solid.distance(solids.project([solid], outside)), 0, atol=1e-9)


def test_distance_from_a_mesh_of_a_box_agrees_with_the_box() -> None:
    exact = solids.box((0.4, 0.7, 0.05))
    triangles = TriangleSearch(exact.outline)
    points = np.random.default_rng(3).uniform(-1, 1, size=(3000, 3))
    np.testing.assert_allclose(
        triangles.signed_distance(points), exact.distance(points), atol=1e-12
    )


@pytest.mark.parametrize("kind", PRIMITIVES)
def test_outlines_are_closed_and_oriented_outwards(kind: str) -> None:
    outline = PRIMITIVES[kind]().outline
    corners = outline.vertices[outline.faces]
    volume = np.einsum("fd,fd->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    exact = {
        "sphere": 4 / 3 * np.pi * 0.7**3,
        "capsule": np.pi * 0.3**2 * 1.2 + 4 / 3 * np.pi * 0.3**3,
        "cylinder": np.pi * 0.5**2 * 1.8,
        "box": 8 * 0.4 * 0.7 * 0.2,
    }[kind]
    assert volume == pytest.approx(exact, rel=0.02)
    edges = np.sort(outline.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


@pytest.mark.parametrize("kind", PRIMITIVES)
def test_reach_is_that_of_the_furthest_point(kind: str) -> None:
    solid = PRIMITIVES[kind]().moved(np.eye(3), (0.3, -0.2, 0.1))
    furthest = np.linalg.norm(solid.outline.vertices, axis=1).max()
    assert furthest <= solid.reach + 1e-12
    assert solid.reach == pytest.approx(furthest, rel=0.01)


def test_scaling_scales_distances() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    for make in PRIMITIVES.values():
        solid = make().moved(np.eye(3), (0.1, 0.2, 0.3))
        np.testing.assert_allclose(
            solid.scaled(2.5).distance(2.5 * points), 2.5 * solid.distance(points)
        )


def test_invalid_meshes_raise_an_error() -> None:
    pytest.importorskip("trimesh", reason="needs the extra 'simulation'")
    box = solids.box((1, 1, 1)).outline
    assert solids.mesh(box.vertices, box.faces).distance([[2.0, 0, 0]])[0] == pytest.approx(1)
    inside_out = solids.mesh(box.vertices, box.faces[:, ::-1])
    assert inside_out.distance([[0.0, 0, 0]])[0] == pytest.approx(-1)
    with pytest.raises(InputError, match="is not closed: 3 of its 18 edges"):
        solids.mesh(box.vertices, box.faces[1:])
    with pytest.raises(InputError, match="has no area"):
        solids.mesh(0 * box.vertices, box.faces)
    with pytest.raises(InputError, match="has no area"):
        solids.mesh(box.vertices, np.empty((0, 3), dtype=int))


def test_a_mesh_is_immutable() -> None:
    with pytest.raises(ValueError, match="read-only"):
        Mesh(np.zeros((3, 3)), [[0, 1, 2]]).vertices[0] = 1


@pytest.mark.parametrize("length", [1e200, np.inf, np.nan])
def test_solids_that_overflow_are_refused(length):
    with pytest.raises(InputError, match="a cylinder must have a size and centre of at most 1e"):
        Solid("cylinder", (1.0, length))
    with pytest.raises(InputError, match="a sphere must"):
        solids.ball(1.0, (0, length, 0))
