"""Locomotion: the ground, motion on it without sliding, and readings.

The motion is chaotic. Tolerances are at least twice the largest deviation over ten seeds.
"""

import numpy as np
import pytest

from anisomap.errors import AnisomapWarning
from anisomap.simulation.bodies import BODIES, cylinder, sphere
from anisomap.simulation.locomotion import (
    LocomotionOptions,
    Terrain,
    bumpy_terrain,
    locomotion,
    simulate_journey,
)
from anisomap.simulation.options import options_for
from anisomap.simulation.physics import add_ground, new_model

mujoco = pytest.importorskip("mujoco", reason="needs the extra 'simulation'")

FRAMES = 300
short_runs = pytest.mark.filterwarnings("ignore:the body did not roll well")


@pytest.fixture(scope="module", params=["sphere", "cylinder"])
def journey(request):
    body = BODIES[request.param]()
    body = body.scaled(1 / body.reach)
    options = options_for(LocomotionOptions, body)
    return body, options, simulate_journey(body, FRAMES, options, np.random.default_rng(7))


def test_the_body_keeps_moving_and_stays_within_the_ground(journey):
    _, options, travelled = journey
    assert np.mean(travelled.speeds > 0.1 * options.speed) > 0.9
    assert np.abs(travelled.centres[:, :2]).max() < options.half_width
    length = np.linalg.norm(np.diff(travelled.centres, axis=0), axis=1).sum()
    assert length > 0.7 * options.speed * options.frame_interval * FRAMES


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in range(1, 5))]
)
def test_cylinders_stay_within_the_ground_and_lie_flat(seed):
    # A small ground: the turning circle exceeds it. A body that starts inside a bump is thrown up.
    body = cylinder()
    body = body.scaled(1 / body.reach)
    options = LocomotionOptions(half_width=5.0)
    travelled = simulate_journey(body, 300, options, np.random.default_rng(seed))
    axes = travelled.rotations[:, :, 2]
    radius, half_length = body.solids[0].size
    reach = radius * np.sqrt(1 - axes[:, :2] ** 2) + half_length * np.abs(axes[:, :2])
    assert (np.abs(travelled.centres[:, :2]) + reach).max() < options.half_width
    assert np.abs(axes[:, 2]).max() < np.sin(np.radians(45))
    assert np.mean(travelled.speeds > 0.1 * options.speed) > 0.9


def test_the_body_rolls_without_sliding(journey):
    body, _, travelled = journey
    slips = travelled.slips[np.isfinite(travelled.slips)]
    assert len(slips) > 0.5 * FRAMES
    assert np.median(slips) < 0.05
    # A rolling body of radius R turns by distance / R. On bumps, the path along the ground is
    # slightly longer than that of the centre.
    turned = np.einsum("tij,tkj->tik", travelled.rotations[1:], travelled.rotations[:-1])
    angles = np.arccos(np.clip((np.trace(turned, axis1=1, axis2=2) - 1) / 2, -1, 1))
    distance = np.linalg.norm(np.diff(travelled.centres, axis=0), axis=1)
    assert angles.sum() * body.solids[0].size[0] == pytest.approx(distance.sum(), rel=0.15)


def test_the_body_does_not_sink_into_the_ground(journey):
    body, _, travelled = journey
    assert travelled.overlaps.max() < 0.03
    outline = body.solids[0].outline.vertices
    lowest = [
        travelled.terrain.distance(outline @ travelled.rotations[t].T + travelled.centres[t]).min()
        for t in range(0, FRAMES, 20)
    ]
    assert np.min(lowest) > -0.03
    assert np.median(lowest) < 0.02  # a body may briefly lose contact


@pytest.mark.slow
@pytest.mark.parametrize("make", [sphere, cylinder])
def test_all_sensors_touch_the_ground_over_a_run(make):
    body = make()
    run = locomotion(body, 1000, options_for(LocomotionOptions, body), np.random.default_rng(1))
    assert run.facts["share_touched"] == 1
    assert (run.readings > 0).any(axis=0).all()
    assert 0.3 < (run.readings == 0).mean() < 0.95


@short_runs
def test_readings_agree_with_the_distance_from_the_ground(journey):
    body, options, travelled = journey
    run = locomotion(body, 30, options, np.random.default_rng(7))
    sensors = travelled.sensors(body.positions)[:30]
    np.testing.assert_allclose(run.sensors, sensors, atol=1e-12)
    distance = travelled.terrain.distance(sensors.reshape(-1, 3)).reshape(30, -1)
    np.testing.assert_allclose(
        run.readings, np.maximum(0, options.detection_radius - distance), atol=1e-6
    )


@pytest.mark.parametrize(
    ("n_frames", "friction", "message"),
    [(200, 0.01, "increase friction"), (5, 1.0, "of the sensors touched the ground")],
)
def test_sliding_and_untouched_sensors_give_a_warning(n_frames, friction, message):
    with pytest.warns(AnisomapWarning, match=message):
        locomotion(
            sphere(), n_frames, LocomotionOptions(friction=friction), np.random.default_rng(0)
        )


def height(terrain, places):
    """Interpolate the height at places (n, 2) within the ground."""
    scaled = (places + terrain.half_width) / terrain.cell
    column, row = scaled.astype(np.intp).T
    right, up = scaled.T - [column, row]
    heights, is_right = terrain.heights, right >= up
    corner, beyond = heights[row, column], heights[row + 1, column + 1]
    third = np.where(is_right, heights[row, column + 1], heights[row + 1, column])
    most, least = np.maximum(right, up), np.minimum(right, up)
    return corner + most * (third - corner) + least * (beyond - third)


def test_cells_have_the_diagonal_of_mujoco():
    terrain = bumpy_terrain(2.0, 0.25, 0.3, 0.6, np.random.default_rng(2))
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
