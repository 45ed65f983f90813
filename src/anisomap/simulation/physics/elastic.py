"""Contacts that give back all the energy that they take: MuJoCo's, made into springs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_LEMNISCATE = 2.6220575542921198  # a contact of a cubic spring lasts so many times depth / speed
_WIDTH = 3  # x softness: a ball nine times as fast as `speed` would reach it

_IMPEDANCE_AT_SURFACE = 0.0001  # the least that MuJoCo takes
_IMPEDANCE_INSIDE = 0.01


@dataclass(frozen=True)
class ElasticContact:
    """A contact as a spring whose force grows with the cube of depth.

    Parameters
    ----------
    softness : float
        Depth to which what arrives at `speed` presses in. Metres.
    speed : float
        Metres a second.

    Notes
    -----
    Two things make MuJoCo's contacts gain energy, and both are answered by its impedance d (see
    "Solver parameters" in its documentation):

    - With d near 1, the solver prescribes how fast each contact comes apart, whatever else its
      balls touch, which is no sum of springs: when a ball touches two things at once, more than
      half a ball's energy may come or go, however short the step. With d near 0, the forces of
      contacts add up as those of springs do.
    - A linear spring starts abruptly, and the integrator errs by where in a step it starts. With d
      rising from almost 0 in proportion to depth x, the acceleration is
      ``stiffness (x / width)^2 x``, which starts smoothly.

    Measured with 40 balls over 2,000 frames of 0.05 s, steps of 1 ms: the energy strays by up to
    5 % with d near 1, by 3 % with d near 0, and by 0.02 % with d rising.
    """

    softness: float
    speed: float

    @property
    def duration(self) -> float:
        """Seconds that what arrives at `speed` stays."""
        return _LEMNISCATE * self.softness / self.speed

    @property
    def solref(self) -> list[float]:
        """MuJoCo's -stiffness and -damping; energy of motion is all stored at `softness`."""
        width = _WIDTH * self.softness
        return [-2 * (self.speed * width / self.softness**2) ** 2, 0.0]

    @property
    def solimp(self) -> list[float]:
        """MuJoCo's impedance: at the surface and inside, width, and a linear rise."""
        midpoint, power = 0.5, 1.0
        width = _WIDTH * self.softness
        return [_IMPEDANCE_AT_SURFACE, _IMPEDANCE_INSIDE, width, midpoint, power]


def total_energy(data: Any, step: float, masses: NDArray[np.float64]) -> float:
    """Add up kinetic energy and that stored in contacts, for bodies that do not turn.

    Parameters
    ----------
    data : mujoco.MjData
        Just after ``mj_forward``. Every constraint is an `ElasticContact`.
    step : float
        Seconds; the integrator's velocities are half a step behind its positions.
    masses : ndarray of shape (nv,)
        Of what moves along each coordinate. Kilograms.

    Returns
    -------
    float
        Joules. A spring whose force grows with the cube of depth stores a quarter of force times
        depth.
    """
    velocities = data.qvel + step / 2 * data.qacc
    stored = -data.efc_force @ data.efc_pos / 4
    return float(masses @ velocities**2 / 2 + stored)
