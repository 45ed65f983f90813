"""Bombardment: conservation laws and kinetic theory of gases.

The flight of the balls is chaotic: processors differ in the course of a run, but not in what is
conserved. Statistics have a tolerance of twice their largest deviation over ten seeds, or more.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from anisomap.errors import AnisomapWarning
from anisomap.simulation import Body, solids
from anisomap.simulation.bodies import sphere
from anisomap.simulation.bombardment import BombardmentOptions, bombardment, simulate_flight
from anisomap.simulation.kinematic import read_balls
from anisomap.simulation.options import options_for
from anisomap.simulation.physics import add_geom, add_solid, new_model

mujoco = pytest.importorskip("mujoco", reason="needs the extra 'simulation'")

BODY, STEP, DEFAULT = sphere(), 0.001, BombardmentOptions()


def fly(options, n_frames, seed, body=BODY):
    return simulate_flight(body, n_frames, options, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def flight():
    """The default run: 2,000 frames of a sphere with 60 sensors."""
    return fly(DEFAULT, 2000, 1)


@pytest.fixture(scope="module")
def assembly():
    """A solid of each kind. The mesh is a cup."""
    outline = [(0, -0.2), (0.3, -0.2), (0.3, 0.2), (0.2, 0.2), (0.2, -0.15), (0, -0.15)]
    parts = [
        solids.ball(0.2, (0, 0, 0.6)),
        replace(solids.mesh(solids.revolved(outline)), centre=np.array([-0.6, 0, 0])),
        solids.box((0.2, 0.3, 0.15), (0.7, 0.3, 0)),
        solids.capsule(0.12, (0.3, -0.8, 0), (0.8, -0.4, 0.2)),
        replace(solids.cylinder(0.2, 0.3), centre=np.array([0, 0.7, 0])),
    ]
    body = Body("assembly", np.array([[0, 0, 0.8]]), np.array([[0, 0, 1.0]]), parts)
    return body.scaled(1 / body.reach)


def ball_gaps(centres, options):
    return np.array([pdist(balls) for balls in centres]) - 2 * options.ball_radius


def lag_correlation(readings):
    centred = readings - readings.mean(axis=0, dtype=float)
    return float(np.mean((centred[1:] * centred[:-1]).mean(axis=0) / centred.var(axis=0)))


def test_energy_is_conserved(flight):
    start = DEFAULT.n_balls * DEFAULT.speed**2 / 2
    assert flight.energies[0] == pytest.approx(start, rel=1e-12)
    relative = flight.energies / start - 1
    assert np.abs(relative).max() < 0.02
    # Random errors grow by a factor of sqrt(10) over 20,000 frames, and must stay below 2 % there.
    free = flight.overlaps == 0
    assert free.mean() > 0.1
    assert np.abs(relative[free]).max() < 0.02 / np.sqrt(10)
    assert flight.energy_drift < 0.02 / np.sqrt(10)


def test_energy_is_conserved_when_balls_touch_several_objects_at_once():
    options = BombardmentOptions(n_balls=60, box_half_width=2.0)
    flight = fly(options, 200, 4)
    crowded = (ball_gaps(flight.centres, options) < 0).sum(axis=1) > 1
    assert crowded.mean() > 0.5
    assert np.abs(flight.energies / flight.energies[0] - 1).max() < 0.02


def test_contacts_with_solids_of_all_kinds_conserve_energy(assembly):
    options = options_for(BombardmentOptions, assembly, {"box_half_width": 2.0})
    flight = fly(options, 250, 5, assembly)
    assert flight.energy_drift < 0.02
    clearances = assembly.distance(flight.centres.reshape(-1, 3)) - options.ball_radius
    assert (clearances < 0).sum() > 5
    # Softness is the depth at the mean speed; the fastest balls penetrate a few times deeper.
    assert clearances.min() > -4 * options.softness


def test_mujoco_finds_the_contacts_of_the_exact_distance(assembly):
    """MuJoCo replaces a mesh geom by its convex hull, which would fill the cup."""
    spec, radius = new_model(STEP, 0, "EULER"), 0.1
    for solid in assembly.solids:
        add_solid(spec, solid, condim=1)
    ball = spec.worldbody.add_body()
    ball.add_freejoint()
    add_geom(ball, "sphere", (radius,))
    model = spec.compile()
    data = mujoco.MjData(model)
    inside = assembly.solids[1].centre
    points = np.vstack([inside, np.random.default_rng(0).uniform(-1, 1, (600, 3))])
    distances = assembly.distance(points)
    points, distances = points[distances > 0], distances[distances > 0]
    found = []
    for point in points:
        data.qpos[:3] = point
        mujoco.mj_forward(model, data)
        found.append(-data.contact.dist.min(initial=0))
    expected = np.maximum(0, radius - distances)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert expected[0] == 0
    assert (expected > 0).sum() > 20


def test_balls_stay_inside_the_box_and_outside_the_body_and_each_other():
    options = BombardmentOptions(n_balls=30, timestep=STEP, frame_interval=STEP)
    assert options.steps_per_frame == 1
    flight = fly(options, 4000, 5)
    # Depth is proportional to the square root of the speed, which is bounded by that of one ball
    # (or two colliding balls) with all the energy.
    deepest = options.softness * options.n_balls**0.25
    centres, radius = flight.centres, options.ball_radius
    assert (options.box_half_width - radius - np.abs(centres)).min() > -deepest
    assert (np.linalg.norm(centres, axis=2) - 1 - radius).min() > -deepest
    assert ball_gaps(centres, options).min() > -deepest * 2**0.25
    assert options.softness / 2 < flight.overlaps.max() < deepest * 2**0.25


def test_readings_on_the_sphere_are_isotropic_and_stationary(flight):
    radii = DEFAULT.ball_radius, DEFAULT.detection_radius
    readings, normals = read_balls(BODY.positions, flight.centres, *radii), BODY.normals
    mean_reading = readings.mean(axis=0)
    # Of a half that is not reached, these would be 0.5, 1 and 0.
    assert np.linalg.norm(mean_reading @ normals) / mean_reading.sum() < 0.25
    assert mean_reading.std() < 0.5 * mean_reading.mean()
    quadrupole = normals.T @ (normals * mean_reading[:, None]) / mean_reading.sum()
    np.testing.assert_allclose(quadrupole, np.eye(3) / 3, atol=0.1)
    # Springs that slowly gain energy take the correlation to 0.
    early, late = readings[:1000], readings[1000:]
    assert lag_correlation(early) > 0.7
    assert lag_correlation(late) == pytest.approx(lag_correlation(early), abs=0.1)
    assert late.mean() == pytest.approx(early.mean(), rel=0.4)
    assert (late == 0).mean() == pytest.approx((early == 0).mean(), abs=0.05)


def test_the_frame_interval_does_not_change_the_physics():
    coarse, fine = (
        fly(BombardmentOptions(timestep=STEP, frame_interval=interval), n_frames, 1).centres
        for n_frames, interval in ((6, 0.1), (26, 0.02))
    )
    np.testing.assert_allclose(fine[::5], coarse, atol=1e-6)


class DampedOptions(BombardmentOptions):
    @property
    def contact(self):
        """MuJoCo's default contact, a damped spring that starts abruptly."""
        return {"condim": 1, "solref": (0.02, 1.0), "solimp": (0.9, 0.95, 0.001, 0.5, 2.0)}


def test_a_change_of_energy_gives_a_warning():
    with pytest.warns(AnisomapWarning, match=r"energy of the balls changed by \d+"):
        run = bombardment(sphere(), 200, DampedOptions(), np.random.default_rng(0))
    assert run.facts["energy_drift"] > 0.02
