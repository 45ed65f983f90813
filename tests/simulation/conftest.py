"""Bodies and a bombardment shared by tests."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest

from anisomap.simulation.bodies import BODIES, Body
from anisomap.simulation.bodies.lattice import sphere
from anisomap.simulation.physics.bombardment import BombardmentOptions, Flight, simulate_flight


@dataclass(frozen=True)
class Bombarded:
    body: Body
    options: BombardmentOptions
    flight: Flight


@pytest.fixture(scope="session")
def bombarded() -> Bombarded:
    """The default run: 2,000 frames of a sphere with 60 sensors."""
    pytest.importorskip("mujoco", reason="needs the extra 'simulation'")
    body, options = sphere(), BombardmentOptions()
    return Bombarded(body, options, simulate_flight(body, 2000, options, np.random.default_rng(1)))


@pytest.fixture(scope="session")
def bodies() -> Mapping[str, Body]:
    """All bodies by name, made once."""
    return {name: make() for name, make in BODIES.items()}
