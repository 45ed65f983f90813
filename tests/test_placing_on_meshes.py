"""Placing maps on meshes: sensors on the surface, normals, handedness, refusals."""

import numpy as np
import pytest
from benchmarks.placement import outline
from scipy.stats import special_ortho_group

from anisomap import SensorMap, align
from anisomap.errors import InputError
from anisomap.numerics.surfaces import TriangleSearch
from anisomap.placement import Anchors, place
from anisomap.scene import Mesh
from anisomap.simulation import find_body


def mapped(body, seed, noise=0.2):
    """A noisy map of a body in a frame of its own; the noise in spacings."""
    rng = np.random.default_rng(seed)
    noisy = body.positions + rng.normal(0, noise * body.spacing, body.positions.shape)
    turn = special_ortho_group.rvs(3, random_state=rng)
    turn[0] *= rng.choice([-1, 1])
    return SensorMap(17 * noisy @ turn.T + rng.normal(size=3))


@pytest.mark.parametrize("name", ["cylinder", "y-shape"])
def test_three_anchors_place_a_map_on_its_mesh_or_it_is_refused(name):
    found = find_body(name)
    mesh = outline(found)
    surface = TriangleSearch(mesh)
    errors, inside = [], []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        rows = rng.choice(found.n_sensors, 3, replace=False)
        anchors = Anchors(tuple(f"s{i}" for i in rows), found.positions[rows])
        sensor_map = mapped(found, seed)
        try:
            placement = place(sensor_map, anchors, mesh=mesh)
        except InputError as error:
            assert "mirror image" in str(error) or "line" in str(error)  # noqa: PT017
            continue
        placed = placement.map
        assert placed.mirrored == align(sensor_map.positions, found.positions).reflected
        nearest, _ = surface.nearest(placed.positions)
        np.testing.assert_allclose(placed.positions, nearest, atol=1e-2 * found.spacing)
        off = np.linalg.norm(placed.positions - found.positions, axis=1)
        errors.append(np.median(off) / found.spacing)
        inside.append(np.einsum("nd,nd->n", placed.normals, found.normals))
    assert np.median(errors) < 0.6
    assert np.median(np.concatenate(inside)) > 0.9


def test_a_mesh_that_does_not_fit_is_refused():
    found = find_body("sphere")
    mesh, made = outline(found), mapped(found, 0)
    rows = [0, 20, 41, 55, 13]
    anchors = Anchors(tuple(f"s{i}" for i in rows), found.positions[rows])
    flat = SensorMap(made.positions[:, :2])
    for sensor_map, known, vertices, faces, message in (
        (made, anchors, 1000 * mesh.vertices, mesh.faces, "check the unit and frame of the mesh"),
        (made, None, mesh.vertices, mesh.faces, "give at least 3 anchors"),
        (made, anchors, mesh.vertices, np.empty((0, 3), int), "triangles with finite vertices"),
        # The areas overflow.
        (made, anchors, 1e200 * mesh.vertices, mesh.faces, "of a mesh must be at most"),
        (flat, Anchors(anchors.names, anchors.positions[:, :2]), mesh.vertices, mesh.faces,
         "anchors on a mesh must have three coordinates"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=message):
            place(sensor_map, known, mesh=Mesh(vertices, faces))


@pytest.mark.parametrize("name", ["hand", "tube"])
def test_a_mesh_straightens_a_map_that_is_bent_smoothly(name):
    """A similarity leaves most of a bend; the surface tells it."""
    found = find_body(name)
    mesh = outline(found)
    size = np.abs(found.positions).max()
    bent = found.positions * [1, 1.2, 0.9] + 0.15 * found.positions[:, [2, 0, 1]] ** 2 / size
    left = np.median(align(bent, found.positions).errors) / found.spacing
    off = []
    for seed in range(4):
        rows = np.random.default_rng(seed).choice(found.n_sensors, 3, replace=False)
        anchors = Anchors(tuple(f"s{i}" for i in rows), found.positions[rows])
        try:
            placed = place(SensorMap(bent), anchors, mesh=mesh, handedness="same").map
        except InputError:
            continue  # anchors on a line
        distances = np.linalg.norm(placed.positions - found.positions, axis=1)
        off.append(np.median(distances) / found.spacing)
    assert np.median(off) < 0.5 * left
