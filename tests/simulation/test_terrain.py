"""Terrain: heights, distances and readings against brute force and MuJoCo."""

import numpy as np
import pytest

from anisomap.simulation.physics.locomotion import Terrain, bumpy_terrain
from anisomap.simulation.physics.models import add_ground, new_model


def height(terrain, places):
    """Interpolate the height at places (n, 2); constant beyond the edges."""
    scaled = (places[:, :2] + terrain.half_width) / terrain.cell
    last = len(terrain.heights) - 1
    scaled = np.clip(scaled, 0, last)
    column, row = np.minimum(scaled.astype(np.intp), last - 1).T
    right, up = scaled[:, 0] - column, scaled[:, 1] - row
    corner, beyond = terrain.heights[row, column], terrain.heights[row + 1, column + 1]
    third = np.where(
        right >= up, terrain.heights[row, column + 1], terrain.heights[row + 1, column]
    )
    most, least = np.maximum(right, up), np.minimum(right, up)
    return corner + most * (third - corner) + least * (beyond - third)


def ground(seed=0, roughness=0.3):
    return bumpy_terrain(2.0, 0.25, roughness, 0.6, np.random.default_rng(seed))


def test_cells_have_the_diagonal_of_mujoco():
    mujoco = pytest.importorskip("mujoco", reason="needs the extra 'simulation'")
    terrain = ground(2)
    spec = new_model(0.001, 0, "EULER")
    add_ground(spec, terrain.heights, terrain.half_width)
    model = spec.compile()
    state = mujoco.MjData(model)
    mujoco.mj_forward(model, state)
    places = np.random.default_rng(5).uniform(-1.9, 1.9, size=(200, 2))
    seen = []
    for place in places:
        start = np.array([*place, 5.0])
        hit = np.zeros(1, dtype=np.int32)
        seen.append(5 - mujoco.mj_ray(model, state, start, [0, 0, -1.0], None, 1, -1, hit, None))
    np.testing.assert_allclose(height(terrain, places), seen, atol=1e-6)
    # The other diagonal gives different heights, so the comparison above is sensitive to it.
    flipped = Terrain(terrain.heights[:, ::-1], terrain.cell)
    mirrored = height(flipped, places * [-1, 1])
    assert np.abs(mirrored - seen).max() > 1e-3


def test_the_ground_has_the_given_roughness_and_correlation_length():
    terrain = bumpy_terrain(20.0, 0.2, 0.1, 0.8, np.random.default_rng(0))
    heights = terrain.heights
    assert np.sqrt(np.mean(heights**2)) == pytest.approx(0.1)
    assert abs(heights.mean()) < 1e-12
    shift = round(0.8 / 0.2)
    correlation = np.corrcoef(heights[:, :-shift].ravel(), heights[:, shift:].ravel())[0, 1]
    assert correlation == pytest.approx(np.exp(-0.25), abs=0.08)
    assert terrain.half_width >= 20
