"""Rubbing: strokes over the skin, a palm in contact with it, and readings."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import KDTree

from anisomap.simulation import SCENARIOS
from anisomap.simulation.bodies import BODIES, cylinder, plane, sphere
from anisomap.simulation.kinematic import (
    StrokeOptions,
    draw_strokes,
    placed,
    read_balls,
    sample_skin,
    settle,
)
from anisomap.simulation.options import options_for

seeds = st.integers(0, 2**32 - 1)


def run(scenario, body, n_frames, seed, **given):
    chosen = SCENARIOS[scenario]
    options = options_for(chosen.options, body, given)
    return chosen.function(body, n_frames, options, np.random.default_rng(seed))


@given(seeds, st.integers(1, 5), st.integers(1, 6))
def test_readings_of_balls_agree_with_the_closed_form(seed, n_sensors, n_balls):
    rng = np.random.default_rng(seed)
    sensors, centres = rng.uniform(-2, 2, (n_sensors, 3)), rng.uniform(-2, 2, (3, n_balls, 3))
    radii, detection = rng.uniform(0.01, 1.5, n_balls), rng.uniform(0.01, 1.5)
    gaps = np.linalg.norm(sensors[:, None] - centres[:, None], axis=3)
    for radius in (radii, 0.3):
        found = read_balls(sensors, centres, radius, detection)
        expected = np.maximum(0, detection - (gaps - radius).min(axis=2))
        np.testing.assert_allclose(found, expected, atol=3e-6)
    normals = rng.normal(size=(n_sensors, 3))
    behind = np.einsum("tnbd,nd->tnb", centres[:, None] - sensors[:, None], normals) <= 0
    found = read_balls(sensors, centres, 0.3, detection, normals)
    depths = np.where(behind, 0, detection - (gaps - 0.3)).max(axis=2)
    np.testing.assert_allclose(found, np.maximum(0, depths), atol=3e-6)


def test_a_default_run_touches_all_sensors_with_sparse_readings():
    touched = run("rubbing", cylinder(), 600, 2).readings > 0
    assert touched.any(axis=0).all()
    assert 0.2 < 1 - touched.mean() < 0.98
    assert 0 < (~touched.any(axis=1)).mean() < 0.5  # some frames have no contact
    assert len(touched) == 600


@pytest.mark.parametrize("make", [sphere, plane])
def test_pressing_deeper_never_lowers_a_reading(make):
    depths = (0.02, 0.06, 0.1)
    runs = [run("rubbing", make(), 100, 4, press_depth=depth).readings for depth in depths]
    for lighter, harder in pairwise(runs):
        assert (harder >= lighter - 1e-6).all()
        assert harder.sum() > lighter.sum()


@cache
def made(name):
    return BODIES[name]()


@cache
def skin_and_path(name, n_frames, seed, **given):
    rng = np.random.default_rng(seed)
    skin = sample_skin(made(name), rng)
    return skin, draw_strokes(skin, n_frames, options_for(StrokeOptions, made(name), given), rng)


def path_on(name, **given):
    return skin_and_path(name, 1000, 1, **given)[1]


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
    angles, curved = (np.unwrap(np.arctan2(*path.headings[:, :2].T)) for path in (lines, circles))
    assert np.median(np.abs(np.diff(angles))) < 1e-9
    assert np.median(np.abs(np.diff(curved))) > 0.1
    sectors = np.histogram(angles % (2 * np.pi), bins=8, range=(0, 2 * np.pi))[0]
    assert sectors.min() > 0.03 * len(lines.points)
    assert (lines.lifts == 0).mean() > 0.9
    assert lines.n_strokes > 50


def test_a_path_over_one_sensor_is_finite():
    rng = np.random.default_rng(1)
    path = draw_strokes(sample_skin(sphere(1), rng), 50, StrokeOptions(), rng)
    assert np.isfinite(path.points).all()


@pytest.mark.parametrize("name", ["sphere", "hand"])
def test_a_settled_ball_has_the_given_depth(name):
    body = made(name)
    skin, path = skin_and_path(name, 150, 4)
    radius = 0.3 * body.reach
    depths = 0.1 * body.reach * path.presses
    offsets = np.zeros((150, 1, 3))
    heights = settle(skin, path, offsets, np.array([radius]), depths)
    centres = placed(path, offsets, heights)[:, 0]
    error = (radius - body.distance(centres) - depths) / body.reach
    assert error.min() > -1e-3
    assert error.max() < 1e-2  # reached between the fingers of the hand only
    assert np.median(np.abs(error)) < 1e-6
