"""Kinematic scenarios: strokes over the skin, stimuli in contact with it, and readings."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from anisomap.simulation import SCENARIOS, simulate
from anisomap.simulation.bodies import BODIES, cylinder, plane, sphere
from anisomap.simulation.kinematic import (
    PressingOptions,
    PulsesOptions,
    SelfTouchOptions,
    draw_presses,
    draw_pulses,
    read_balls,
    read_capsules,
    read_half_spaces,
    read_pulses,
)
from anisomap.simulation.options import options_for
from anisomap.simulation.solids import support
from anisomap.simulation.strokes import Cluster, StrokeOptions, draw_strokes, sample_skin, settle

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


@given(seeds)
def test_readings_of_capsules_and_half_spaces_agree_with_sampled_distances(seed):
    rng = np.random.default_rng(seed)
    sensors, radius, detection = rng.uniform(-0.5, 0.5, (4, 3)), 0.3, 0.9
    start, end = rng.uniform(-1, 1, (2, 3))
    axis = start + np.linspace(0, 1, 5001)[:, None] * (end - start)
    nearest = np.linalg.norm(sensors[:, None] - axis, axis=2).min(axis=1) - radius
    found = read_capsules(sensors, start[None, None], end[None, None], radius, detection)
    np.testing.assert_allclose(found[0], np.maximum(0, detection - nearest), atol=1e-3)
    direction = start / np.linalg.norm(start)
    heights = rng.uniform(0, 1.2, 4)
    beside = rng.normal(size=(4, 3))
    beside -= np.outer(beside @ direction, direction)
    below = start + beside - heights[:, None] * direction
    found = read_half_spaces(below, direction[None], np.array([start @ direction]), detection)
    np.testing.assert_allclose(found[0], np.maximum(0, detection - heights), atol=1e-6)


@given(seeds)
def test_pulses_add_up_and_halve_at_the_half_distance(seed):
    rng = np.random.default_rng(seed)
    sensors, places = rng.standard_normal((4, 3)), rng.standard_normal((3, 2, 3))
    strengths = rng.random((3, 2))
    distances = np.linalg.norm(sensors[:, None] - places[:, None], axis=3)
    expected = (strengths[:, None] / (1 + (distances / 0.4) ** 2)).sum(axis=2)
    found = read_pulses(sensors, places, strengths, 0.4)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.parametrize("scenario", ["rubbing", "roller", "pressing", "self-touch"])
def test_a_default_run_touches_all_sensors_with_sparse_readings(scenario):
    touched = run(scenario, cylinder(), 1000, 2).readings > 0
    assert touched.any(axis=0).all()
    assert 0.2 < 1 - touched.mean() < 0.98
    assert 0 < (~touched.any(axis=1)).mean() < 0.5  # some frames have no contact
    assert len(touched) == 1000


@pytest.mark.parametrize(
    ("scenario", "depths"),
    [("rubbing", (0.02, 0.06, 0.1)), ("roller", (0.02, 0.1, 0.18)), ("pressing", (0.05, 0.2, 0.4))],
)
@pytest.mark.parametrize("make", [sphere, plane])
def test_pressing_deeper_never_lowers_a_reading(make, scenario, depths):
    runs = [run(scenario, make(), 100, 4, press_depth=depth).readings for depth in depths]
    for lighter, harder in pairwise(runs):
        assert (harder >= lighter - 1e-6).all()
        assert harder.sum() > lighter.sum()


def test_palms_are_rigid_irregular_and_random():
    pads, other = (run("rubbing", sphere(), 100, seed).props[-1] for seed in (5, 6))
    radii = np.asarray(pads.scales)
    assert not np.allclose(radii, other.scales)
    assert len(np.unique(radii)) == len(radii)
    apart = np.linalg.norm(pads.centres[:, :, None] - pads.centres[:, None], axis=-1)
    np.testing.assert_allclose(apart, np.broadcast_to(apart[0], apart.shape), atol=1e-9)
    assert len(np.unique(apart[0].round(6))) > len(radii)
    # No pad is deeper than the press depth.
    assert (radii + 1 - np.linalg.norm(pads.centres, axis=2)).max() < 0.1 + 1e-9


def test_a_roller_touches_whole_lines_of_sensors():
    body = plane()
    rows = run("roller", body, 400, 7, detection_radius=0.1).readings > 0
    spots = [body.positions[row][:, :2] for row in rows if row.sum() >= 8]
    widths = [np.linalg.svd(each - each.mean(axis=0), compute_uv=False) for each in spots]
    assert len(widths) > 50
    assert np.median([width[0] / max(width[1], 1e-9) for width in widths]) > 2


def test_presses_have_the_given_depth_and_uniform_directions():
    body, options = sphere(), PressingOptions()
    directions, depths = draw_presses(body, 4000, options, np.random.default_rng(8))
    offsets = support(body.solids, directions) - depths
    np.testing.assert_allclose(offsets, 1 - depths)
    assert depths.max() <= options.press_depth
    assert depths.min() == -options.detection_radius
    assert np.linalg.norm(directions.mean(axis=0)) < 0.1
    assert np.abs(np.cov(directions.T) - np.eye(3) / 3).max() < 0.1


def test_sources_are_uniform_outside_the_body():
    body, options = sphere(), PulsesOptions()
    places, strengths = draw_pulses(body, 8000, options, np.random.default_rng(9))
    distance = np.linalg.norm(places, axis=-1)
    assert distance.min() > 1
    assert distance.max() <= options.field_radius
    # For a uniform distribution, half of the sources lie in the inner half of the volume.
    half = ((1 + options.field_radius**3) / 2) ** (1 / 3)
    assert (distance < half).mean() == pytest.approx(0.5, abs=0.05)
    assert np.linalg.norm((places / distance[..., None]).mean(axis=(0, 1))) < 0.1
    assert 0 <= strengths.min() <= strengths.max() <= options.strength


def test_fingertip_and_body_respond_to_the_same_contact():
    body, options = sphere(), SelfTouchOptions()
    recording = simulate(body, "self-touch", n_frames=500, seed=10)
    n = body.n_sensors
    fingers = (f"finger{i}" for i in range(options.n_finger_sensors))
    assert recording.names == (*body.names, *fingers)
    np.testing.assert_array_equal(recording.positions[:n], body.positions)
    beside = np.linalg.norm(recording.positions[n:], axis=1)
    assert beside.min() > body.reach + options.finger_radius
    apart = recording.surface_distances
    on_tip = np.arange(len(apart)) >= n
    np.testing.assert_array_equal(np.isinf(apart), on_tip[:, None] != on_tip)
    body_active, tip_active = recording.readings[:, :n] > 0, recording.readings[:, n:] > 0
    assert tip_active.any(axis=0).all()
    # When the fingertip senses a contact, so does the body: its sensor spacing is below the range.
    assert body_active[tip_active.any(axis=1)].any(axis=1).all()


def test_self_touch_agrees_with_the_closed_form():
    body, options = sphere(), SelfTouchOptions()
    touched = run("self-touch", body, 100, 11)
    finger = touched.props[-1]
    centres, turns = finger.centres, np.asarray(finger.rotations)[:, 0]
    moved = centres + np.einsum("tij,nj->tni", turns, options.finger_radius * options.directions())
    distances = np.linalg.norm(body.positions - centres, axis=2) - options.finger_radius
    on_body = options.detection_radius - distances
    on_tip = options.finger_detection_radius - (np.linalg.norm(moved, axis=2) - 1)
    np.testing.assert_allclose(
        touched.readings, np.maximum(np.hstack([on_body, on_tip]), 0), atol=1e-6
    )
    fixed = np.broadcast_to(body.positions, (100, 60, 3))
    np.testing.assert_allclose(touched.sensors, np.concatenate([fixed, moved], axis=1))


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


@pytest.mark.parametrize("name", ["sphere", "hand", "holed-plate"])
def test_a_settled_ball_has_the_given_depth(name):
    body = made(name)
    skin, path = skin_and_path(name, 150, 4)
    radius = 0.3 * body.reach
    depths = 0.1 * body.reach * path.presses
    cluster = Cluster(np.zeros((150, 1, 3)), np.array([radius]))
    centres = cluster.placed(path, settle(skin, path, cluster, depths))[:, 0]
    error = (radius - body.distance(centres) - depths) / body.reach
    assert error.min() > -1e-3
    assert error.max() < 1e-2  # reached between the fingers of the hand only
    assert np.median(np.abs(error)) < 1e-6


def test_a_settled_capsule_touches_a_sphere_with_its_middle():
    skin, path = skin_and_path("sphere", 200, 5)
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
