"""Locomotion: motion on the ground without sliding, and its readings.

The motion is chaotic. Tolerances are at least twice the largest deviation over ten seeds.
"""

import numpy as np
import pytest

from anisomap.errors import AnisomapWarning
from anisomap.simulation.bodies import BODIES, cylinder, sphere
from anisomap.simulation.options import options_for
from anisomap.simulation.physics.locomotion import LocomotionOptions, locomotion, simulate_journey

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


def test_sliding_gives_a_warning():
    with pytest.warns(AnisomapWarning, match="increase friction"):
        locomotion(sphere(), 200, LocomotionOptions(friction=0.01), np.random.default_rng(0))


def test_untouched_sensors_give_a_warning():
    with pytest.warns(AnisomapWarning, match="of the sensors touched the ground"):
        locomotion(sphere(), 5, LocomotionOptions(), np.random.default_rng(0))
