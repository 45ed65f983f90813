"""Bodies and a bombardment shared by tests."""

from dataclasses import dataclass

import numpy as np
import pytest

from anisomap.simulation import Body
from anisomap.simulation.bodies import BODIES, sphere
from anisomap.simulation.kinematic import read_balls
from anisomap.simulation.physics.bombardment import BombardmentOptions, Flight, simulate_flight


@dataclass(frozen=True)
class Bombarded:
    body: Body
    options: BombardmentOptions
    flight: Flight
    readings: np.ndarray


@pytest.fixture(scope="session")
def bombarded():
    """The default run: 2,000 frames of a sphere with 60 sensors."""
    pytest.importorskip("mujoco", reason="needs the extra 'simulation'")
    body, options = sphere(), BombardmentOptions()
    flight = simulate_flight(body, 2000, options, np.random.default_rng(1))
    radii = options.ball_radius, options.detection_radius
    return Bombarded(body, options, flight, read_balls(body.positions, flight.centres, *radii))


@pytest.fixture(scope="session")
def bodies():
    """All bodies by name, made once."""
    return {name: make() for name, make in BODIES.items()}
