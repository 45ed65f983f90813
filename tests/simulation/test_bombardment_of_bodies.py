"""Bombardment of all bodies, over long runs, and with balls of several sizes."""

import numpy as np
import pytest

from anisomap.errors import InputError
from anisomap.simulation import simulate
from anisomap.simulation.bodies import BODIES
from anisomap.simulation.options import options_for
from anisomap.simulation.physics.bombardment import BombardmentOptions, simulate_flight

mujoco = pytest.importorskip("mujoco", reason="needs the extra 'simulation'")


def mean_lag_correlation(readings: np.ndarray) -> float:
    centred = readings - readings.mean(axis=0)
    products = (centred[1:] * centred[:-1]).mean(axis=0)
    return float(np.nanmean(products / np.maximum(centred.var(axis=0), 1e-12)))


@pytest.mark.slow
def test_energy_and_autocorrelation_are_stationary_over_20_000_frames() -> None:
    recording = simulate(n_frames=20_000, seed=11)
    assert float(recording.metadata["energy_drift"]) < 0.02
    early, late = (np.asarray(part) for part in np.array_split(recording.readings, 2))
    assert mean_lag_correlation(late) == pytest.approx(mean_lag_correlation(early), abs=0.02)
    assert late.mean() == pytest.approx(early.mean(), rel=0.05)
    # All sensors on a sphere are equally likely to be touched.
    touched = (recording.readings > 0).mean(axis=0)
    assert touched.std() < 0.15 * touched.mean()


@pytest.mark.parametrize("name", BODIES)
def test_contacts_with_every_body_conserve_energy(name: str) -> None:
    body = BODIES[name]()
    unit = body.scaled(1 / body.reach)
    options = options_for(BombardmentOptions, unit)
    flight = simulate_flight(unit, 250, options, np.random.default_rng(5))
    assert flight.energy_drift < 0.02
    centres = flight.centres.reshape(-1, 3)
    near = np.linalg.norm(centres, axis=1) < 1 + options.ball_radius
    assert near.sum() > 20
    # Softness is the depth at the mean speed; the fastest balls penetrate a few times deeper.
    assert unit.distance(centres[near]).min() > options.ball_radius - 4 * options.softness
    assert (flight.overlaps > 0).any()


def test_energy_is_equipartitioned_among_balls_of_different_sizes() -> None:
    body = BODIES["sphere"]()
    options = BombardmentOptions(size_ratio=3.0, n_balls=30)
    assert options.radii.max() / options.radii.min() == pytest.approx(3)
    flight = simulate_flight(body, 1500, options, np.random.default_rng(2))
    assert flight.energy_drift < 0.02
    velocities = np.diff(flight.centres, axis=0) / options.frame_interval
    # A ball that bounced within a frame appears slower, which the median ignores.
    speeds = np.median(np.linalg.norm(velocities, axis=2), axis=0)
    kinetic = options.masses * speeds**2
    small, large = np.array_split(kinetic, 2)
    assert small.mean() == pytest.approx(large.mean(), rel=0.25)
    for ball, radius in enumerate(options.radii):
        away = np.linalg.norm(flight.centres[:, ball], axis=1)
        assert away.min() > 1 + radius - 6 * options.softness


def test_bombardment_scales_with_the_body() -> None:
    large = BODIES["sphere"]()
    small = large.scaled(0.01)
    one, other = (simulate(body, n_frames=60, seed=4) for body in (large, small))
    np.testing.assert_allclose(other.readings, 0.01 * one.readings, atol=1e-6)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"ball_radius": 1.2, "softness": 0.02}, "do not fit between the body"),
        ({"n_balls": 2000}, "fit into a box"),
        ({"size_ratio": 0.5}, "size_ratio must be at least 1, got 0.5"),
        ({"size_ratio": 40.0}, "softness must be at most"),
        ({"timestep": 0.01}, "energy would not be conserved"),
    ],
)
def test_invalid_arguments_raise_an_error(parameters: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        simulate(n_frames=2, **parameters)
