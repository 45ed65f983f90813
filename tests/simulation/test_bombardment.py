"""Bombardment of the sphere: conservation laws and kinetic theory of gases."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from anisomap.errors import AnisomapWarning, InputError
from anisomap.simulation.bodies.lattice import sphere
from anisomap.simulation.physics.bombardment import (
    BombardmentOptions,
    Flight,
    bombardment,
    simulate_flight,
)
from anisomap.simulation.physics.elastic import ElasticContact
from anisomap.simulation.sensing import read_balls

mujoco = pytest.importorskip("mujoco", reason="needs the extra 'simulation'")

STEP = 0.001


def every_step(n_balls: int, seed: int, n_steps: int, **parameters: Any) -> Flight:
    """Record every step of the physics."""
    options = BombardmentOptions(n_balls=n_balls, timestep=STEP, frame_interval=STEP, **parameters)
    assert options.steps_per_frame == 1
    return simulate_flight(sphere(), n_steps, options, np.random.default_rng(seed))


def wall_gaps(centres: NDArray[np.float64], options: BombardmentOptions) -> NDArray[np.float64]:
    return options.box_half_width - options.ball_radius - np.abs(centres)


def body_gaps(centres: NDArray[np.float64], options: BombardmentOptions) -> NDArray[np.float64]:
    return np.asarray(np.linalg.norm(centres, axis=-1) - 1 - options.ball_radius)


def ball_gaps(centres: NDArray[np.float64], options: BombardmentOptions) -> NDArray[np.float64]:
    return np.array([pdist(balls) for balls in centres]) - 2 * options.ball_radius


def lag_correlation(readings: NDArray[np.float32]) -> float:
    pairs = zip(readings[:-1].T, readings[1:].T, strict=True)
    return float(np.mean([np.corrcoef(now, next_) for now, next_ in pairs], axis=0)[0, 1])


def test_energy_is_conserved(bombarded: Any) -> None:
    flight = bombarded.flight
    start = bombarded.options.n_balls * bombarded.options.speed**2 / 2
    assert flight.energies[0] == pytest.approx(start, rel=1e-12)
    relative = flight.energies / start - 1
    assert np.abs(relative).max() < 0.02
    # Random errors grow by a factor of sqrt(10) over 20,000 frames, and must stay below 2 % there.
    free = flight.overlaps == 0
    assert free.mean() > 0.1
    assert np.abs(relative[free]).max() < 0.02 / np.sqrt(10)
    assert flight.energy_drift < 0.02 / np.sqrt(10)


def test_energy_is_conserved_when_balls_touch_several_objects_at_once() -> None:
    options = BombardmentOptions(n_balls=60, box_half_width=2.0)
    flight = simulate_flight(sphere(), 500, options, np.random.default_rng(4))
    crowded = (ball_gaps(flight.centres, options) < 0).sum(axis=1) > 1
    assert crowded.mean() > 0.5
    assert np.abs(flight.energies / flight.energies[0] - 1).max() < 0.02


def test_nothing_overlaps_at_the_start(bombarded: Any) -> None:
    first, options = bombarded.flight.centres[:1], bombarded.options
    assert wall_gaps(first, options).min() >= 0
    assert body_gaps(first, options).min() > 0
    assert ball_gaps(first, options).min() > 0
    assert bombarded.flight.overlaps[0] == 0


@pytest.mark.parametrize("seed", [2, 3])
def test_balls_stay_inside_the_box_and_outside_the_body_and_each_other(seed: int) -> None:
    n_balls = 40
    flight = every_step(n_balls, seed, 4000)
    options = BombardmentOptions(n_balls=n_balls)
    # Depth is proportional to the square root of the speed, which is bounded by that of one ball
    # (or two colliding balls) with all the energy.
    deepest = options.softness * n_balls**0.25
    assert wall_gaps(flight.centres, options).min() > -deepest
    assert body_gaps(flight.centres, options).min() > -deepest
    assert ball_gaps(flight.centres, options).min() > -deepest * 2**0.25
    assert flight.overlaps.max() < deepest * 2**0.25
    assert flight.overlaps.max() > options.softness / 2


def test_overlaps_agree_with_positions(bombarded: Any) -> None:
    centres, options = bombarded.flight.centres, bombarded.options
    min_gaps = [
        gaps(centres, options).reshape(len(centres), -1).min(axis=1)
        for gaps in (wall_gaps, body_gaps, ball_gaps)
    ]
    np.testing.assert_allclose(
        bombarded.flight.overlaps, np.maximum(0, -np.min(min_gaps, axis=0)), atol=1e-9
    )


def test_momentum_changes_only_at_the_walls_and_the_body() -> None:
    options = BombardmentOptions(n_balls=30)
    flight = every_step(30, 5, 4000)
    momentum = np.diff(flight.centres.sum(axis=1), axis=0) / STEP
    change = np.abs(np.diff(momentum, axis=0)).max(axis=1)
    outside = np.minimum(
        wall_gaps(flight.centres, options).min(axis=(1, 2)),
        body_gaps(flight.centres, options).min(axis=1),
    )
    collided = ball_gaps(flight.centres, options).min(axis=1) < 0
    alone = outside[1:-1] > 0
    assert (alone & collided[1:-1]).sum() > 100
    assert change[alone].max() < 1e-9
    assert change[~alone].max() > 1


def test_a_contact_with_a_wall_is_elastic_and_has_the_expected_depth_and_duration() -> None:
    options = BombardmentOptions(n_balls=1)
    bounces = 0
    for seed in range(8):
        flight = every_step(1, seed, 4000)
        inside = body_gaps(flight.centres, options)[:, 0] > 0.1
        for axis in range(3):
            gap = wall_gaps(flight.centres, options)[:, 0, axis]
            speed = np.abs(np.diff(flight.centres[:, 0, axis])) / STEP
            touching = np.flatnonzero(gap < 0)
            for bounce in np.split(touching, np.flatnonzero(np.diff(touching) > 1) + 1):
                if not bounce.size or bounce[0] < 2 or bounce[-1] + 2 > speed.size:
                    continue
                before, after = speed[bounce[0] - 2], speed[bounce[-1] + 1]
                if before < 0.5 or not inside[bounce].all():
                    continue
                contact = ElasticContact(options.softness, options.speed)
                depth = options.softness * np.sqrt(before / options.speed)
                assert after == pytest.approx(before, rel=2e-3)
                # MuJoCo's impedance does not start at 0, so the spring is slightly stiffer.
                assert -gap[bounce].min() == pytest.approx(depth, rel=0.05)
                # Proportional to depth / speed, so to speed^(-1/2); resolved to two steps.
                duration = contact.duration * np.sqrt(options.speed / before)
                assert bounce.size * STEP == pytest.approx(duration, abs=2 * STEP)
                bounces += 1
    assert bounces > 10


def test_the_density_of_balls_is_uniform(bombarded: Any) -> None:
    """The mean number of balls in range of a sensor agrees with a uniform density."""
    options, centres = bombarded.options, bombarded.flight.centres
    sensing, excluded = options.detection_radius + options.ball_radius, 1 + options.ball_radius
    free = (2 * (options.box_half_width - options.ball_radius)) ** 3 - 4 / 3 * np.pi * excluded**3
    # Volume of the intersection of two balls of radius `sensing` and `excluded`, 1 m apart.
    lens = (
        np.pi
        * (sensing + excluded - 1) ** 2
        * (1 + 2 * (sensing + excluded) - 3 * (sensing - excluded) ** 2)
        / 12
    )
    expected = options.n_balls * (4 / 3 * np.pi * sensing**3 - lens) / free
    sensors = bombarded.body.positions
    in_range = np.array(
        [
            [(np.linalg.norm(balls - s, axis=1) < sensing).sum() for s in sensors]
            for balls in centres
        ]
    )
    # Excluded volume increases the density near surfaces by a few per cent, and 2,000 frames
    # determine the mean to 5 %.
    assert in_range.mean() == pytest.approx(expected, rel=0.25)


def test_velocities_follow_the_maxwell_distribution() -> None:
    flight = every_step(40, 7, 12_000)
    velocities = np.diff(flight.centres, axis=0)[::100].reshape(-1, 3) / STEP
    mean_square = np.mean(velocities**2, axis=0)
    np.testing.assert_allclose(mean_square, 3.0, rtol=0.25)
    # The fourth moment of a normal distribution is three times the square of the second.
    kurtosis = np.mean(velocities**4) / np.mean(velocities**2) ** 2
    assert kurtosis == pytest.approx(3, rel=0.2)


def test_readings_on_the_sphere_are_isotropic(bombarded: Any) -> None:
    body, options = bombarded.body, bombarded.options
    readings = read_balls(
        body.positions, bombarded.flight.centres, options.ball_radius, options.detection_radius
    )
    mean_reading = readings.mean(axis=0)
    assert np.linalg.norm(mean_reading @ body.normals) / mean_reading.sum() < 0.1
    assert mean_reading.std() < 0.25 * mean_reading.mean()
    quadrupole = body.normals.T @ (body.normals * mean_reading[:, None]) / mean_reading.sum()
    np.testing.assert_allclose(quadrupole, np.eye(3) / 3, atol=0.06)


def test_readings_are_stationary(bombarded: Any) -> None:
    options = bombarded.options
    readings = read_balls(
        bombarded.body.positions,
        bombarded.flight.centres,
        options.ball_radius,
        options.detection_radius,
    )
    early, late = readings[:1000], readings[1000:]
    assert lag_correlation(early) > 0.8
    assert lag_correlation(late) == pytest.approx(lag_correlation(early), abs=0.03)
    assert late.mean() == pytest.approx(early.mean(), rel=0.3)
    assert (late == 0).mean() == pytest.approx((early == 0).mean(), abs=0.04)


def test_the_frame_interval_does_not_change_the_physics() -> None:
    coarse = BombardmentOptions(timestep=STEP, frame_interval=0.1)
    fine = BombardmentOptions(timestep=STEP, frame_interval=0.02)
    a = simulate_flight(sphere(), 6, coarse, np.random.default_rng(1)).centres
    b = simulate_flight(sphere(), 26, fine, np.random.default_rng(1)).centres
    np.testing.assert_allclose(b[::5], a, atol=1e-6)


def test_a_longer_run_begins_with_the_shorter_one(bombarded: Any) -> None:
    short = simulate_flight(sphere(), 50, bombarded.options, np.random.default_rng(1))
    np.testing.assert_array_equal(short.centres, bombarded.flight.centres[:50])


@pytest.mark.parametrize(
    ("frame_interval", "timestep", "steps"),
    [(0.05, 0.001, 50), (0.05, 0.0015, 34), (0.3, 0.1 / 80, 240), (0.0004, 0.001, 1)],
)
def test_frames_are_divided_into_equal_steps_no_longer_than_the_timestep(
    frame_interval: float, timestep: float, steps: int
) -> None:
    options = BombardmentOptions(frame_interval=frame_interval, timestep=timestep)
    assert options.steps_per_frame == steps
    assert options.step * steps == pytest.approx(frame_interval)
    assert options.step <= timestep * (1 + 1e-9)


@pytest.mark.parametrize("speed", [0.1, 3.0, 100.0])
@pytest.mark.parametrize("softness", [0.002, 0.02, 0.07])
def test_the_default_step_is_valid_for_all_speeds_and_softnesses(
    speed: float, softness: float
) -> None:
    options = BombardmentOptions(speed=speed, softness=softness, frame_interval=1.0)
    BombardmentOptions(speed=speed, softness=softness, timestep=options.step)
    assert options.step > options.contact.duration / 20


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"n_balls": 0}, "n_balls must be an integer of at least 1, got 0"),
        ({"n_balls": 2.5}, r"n_balls must be an integer of at least 1, got 2\.5"),
        ({"ball_radius": -0.1}, r"ball_radius must be positive, got -0\.1 m"),
        ({"detection_radius": 0.0}, "detection_radius must be positive, got 0 m"),
        ({"box_half_width": float("nan")}, "box_half_width must be positive, got nan"),
        ({"speed": 0.0}, "speed must be positive, got 0 m/s"),
        ({"speed": float("inf")}, "speed must be positive, got inf"),
        ({"frame_interval": -1.0}, "frame_interval must be positive, got -1 s"),
        ({"softness": 0.0}, "softness must be positive, got 0 m"),
        ({"softness": 0.1}, r"softness must be at most 0\.075 m"),
        ({"timestep": 0.0}, "timestep must be positive, got 0 s"),
        ({"timestep": 0.01}, r"timestep must be at most 0\.00175 s"),
        ({"timestep": 0.001, "speed": 30.0}, r"timestep must be at most 0\.000175 s"),
    ],
)
def test_invalid_options_raise_an_error_with_the_valid_range(parameters: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        BombardmentOptions(**parameters)


def test_the_maximum_timestep_given_by_the_error_is_accepted() -> None:
    assert BombardmentOptions(timestep=0.0017).step <= 0.0017


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"ball_radius": 1.1}, r"do not fit between the body.*box_half_width must exceed 3\.2 m"),
        ({"box_half_width": 0.5}, "do not fit between the body"),
        ({"n_balls": 5000}, r"only \d+ of 5000 balls .* use fewer or smaller balls"),
    ],
)
def test_balls_that_do_not_fit_raise_an_error(parameters: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        simulate_flight(sphere(), 1, BombardmentOptions(**parameters), np.random.default_rng(0))


class DampedContact(ElasticContact):
    """MuJoCo's default contact, a damped spring that starts abruptly."""

    @property
    def solref(self) -> list[float]:
        return [0.02, 1.0]

    @property
    def solimp(self) -> list[float]:
        return [0.9, 0.95, 0.001, 0.5, 2.0]


class DampedOptions(BombardmentOptions):
    @property
    def contact(self) -> ElasticContact:
        return DampedContact(self.softness, self.speed)


def test_a_change_of_energy_gives_a_warning() -> None:
    with pytest.warns(AnisomapWarning, match=r"energy of the balls changed by \d+"):
        run = bombardment(sphere(), 200, DampedOptions(), np.random.default_rng(0))
    assert run.facts["energy_drift"] > 0.02
