"""Stroke paths over the skin, and placement of a stimulus in contact."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from anisomap.simulation.bodies import BODIES, sphere
from anisomap.simulation.options import options_for
from anisomap.simulation.solids import support
from anisomap.simulation.strokes import (
    Cluster,
    StrokeOptions,
    draw_strokes,
    sample_skin,
    settle,
)

seeds = st.integers(0, 2**32 - 1)


@cache
def made(name):
    return BODIES[name]()


@cache
def path_on(name, n_frames=1000, seed=1, **given):
    rng = np.random.default_rng(seed)
    options = options_for(StrokeOptions, made(name), given)
    return draw_strokes(sample_skin(made(name), rng), n_frames, options, rng)


@pytest.mark.parametrize(
    "name",
    [pytest.param(b, marks=() if b in ("sphere", "hand") else pytest.mark.slow) for b in BODIES],
)
def test_a_path_stays_on_the_skin_and_reaches_all_sensors(name):
    body, path = made(name), path_on(name)
    assert len(path.points) == 1000
    assert np.abs(body.distance(path.points)).max() < 1e-3 * body.reach
    for directions in (path.normals, path.headings):
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, rtol=1e-9)
    assert np.abs(np.einsum("td,td->t", path.normals, path.headings)).max() < 1e-9
    away = KDTree(path.points).query(body.positions)[0]
    assert np.max(away) < body.spacing
    # The path avoids parts without sensors: the back of a plate, the ends of a cylinder.
    from_sensors = KDTree(body.positions).query(path.points)[0]
    assert np.max(from_sensors) < 2.5 * body.spacing


@pytest.mark.parametrize("name", ["sphere", "plane", "hand"])
def test_a_path_is_continuous_except_while_lifted(name):
    path = path_on(name)
    stride = 2.0 * 0.05 * made(name).reach
    moved = np.linalg.norm(np.diff(path.points, axis=0), axis=1)
    top = (path.lifts[:-1] == 1) & (path.lifts[1:] == 1)
    assert top.any()
    assert moved[~top].max() < 2 * stride
    assert np.median(moved[(path.lifts[1:] == 0) & (path.lifts[:-1] == 0)]) > 0.8 * stride
    assert np.abs(np.diff(path.lifts)).max() < 0.34
    assert np.abs(np.diff(path.presses)).max() < 0.2


def test_strokes_are_lines_or_circles_in_all_directions():
    lines = path_on("plane", circle_share=0.0, lift_share=0.0)
    circles = path_on("plane", circle_share=1.0, lift_share=0.0)
    turns = []
    for path in (lines, circles):
        angle = np.arctan2(path.headings[:, 1], path.headings[:, 0])
        turns.append(np.abs((np.diff(angle) + np.pi) % (2 * np.pi) - np.pi))
    assert np.median(turns[0]) < 1e-9
    assert np.median(turns[1]) > 0.1
    histogram = np.histogram(np.arctan2(*lines.headings[:, :2].T), bins=8, range=(-np.pi, np.pi))
    assert histogram[0].min() > 0.03 * len(lines.points)
    assert (lines.lifts == 0).mean() > 0.9
    assert lines.n_strokes > 50


def test_a_path_over_one_sensor_is_finite():
    body, rng = sphere(1), np.random.default_rng(1)
    path = draw_strokes(sample_skin(body, rng), 50, StrokeOptions(), rng)
    assert np.isfinite(path.points).all()


@pytest.mark.parametrize("name", ["sphere", "hand", "holed-plate"])
def test_a_settled_ball_has_the_given_depth(name):
    body = made(name)
    rng = np.random.default_rng(4)
    skin = sample_skin(body, rng)
    path = draw_strokes(skin, 150, options_for(StrokeOptions, body), rng)
    radius = 0.3 * body.reach
    depths = 0.1 * body.reach * path.presses
    cluster = Cluster(np.zeros((150, 1, 3)), np.array([radius]))
    centres = cluster.placed(path, settle(skin, path, cluster, depths))[:, 0]
    error = (radius - body.distance(centres) - depths) / body.reach
    assert error.min() > -1e-3
    assert error.max() < 1e-2  # reached between the fingers of the hand only
    assert np.median(np.abs(error)) < 1e-6


def test_a_settled_capsule_touches_a_sphere_with_its_middle():
    rng = np.random.default_rng(5)
    body = sphere()
    skin = sample_skin(body, rng)
    path = draw_strokes(skin, 200, StrokeOptions(), rng)
    axes = 0.4 * np.cross(path.normals, path.headings)[:, None]
    cluster = Cluster(np.zeros_like(axes), np.array([0.2]), axes)
    heights = settle(skin, path, cluster, 0.1 * path.presses)
    np.testing.assert_allclose(heights, 0.2 - 0.1 * path.presses, atol=1e-9)


@settings(max_examples=40)
@given(seeds, st.sampled_from(["sphere", "tube", "hand", "holed-plate"]))
def test_the_support_is_the_furthest_point_of_the_surface(seed, name):
    rng, body = np.random.default_rng(seed), made(name)
    directions = rng.standard_normal((5, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    turn = Rotation.random(rng=rng).as_matrix()
    turned = [solid.moved(turn, (0.3, 0.1, -0.2)) for solid in body.solids]
    drawn = np.vstack([solid.outline.vertices for solid in turned])
    furthest = (directions @ drawn.T).max(axis=1)
    found = support(turned, directions)
    # The outline of a round solid lies slightly inside it.
    assert (found >= furthest - 1e-9).all()
    assert (found <= furthest + 5e-3 * body.reach).all()
    moved = [replace(solid, centre=solid.centre + 1.0) for solid in turned]
    np.testing.assert_allclose(support(moved, directions), found + directions.sum(axis=1))
