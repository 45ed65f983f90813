"""Return type of scenarios."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.recording import Scalar
from anisomap.scene import Prop
from anisomap.simulation.bodies.body import Body

Progress: TypeAlias = Callable[[float], None]
"""Callback that receives the completed share, from 0 to 1."""


def no_progress(share: float) -> None:
    """Ignore progress."""


@dataclass(frozen=True, eq=False)
class ScenarioResult:
    """Readings and geometry of one simulated run.

    Attributes
    ----------
    readings : ndarray of shape (T, N)
        One row per frame, one column per sensor.
    props : tuple of Prop
        Objects to draw.
    facts : mapping of str to str, int, float or bool
        Measured quantities and effective parameters, in addition to the options.
    sensors : ndarray of shape (T, N, 3), optional
        Sensor positions in each frame; T = 1 for sensors that do not move. Defaults to the
        positions on the body.
    body : Body, optional
        Body with the sensors that were read, if the scenario added sensors to the given body.
    """

    readings: NDArray[np.floating]
    props: tuple[Prop, ...]
    facts: Mapping[str, Scalar] = field(default_factory=dict)
    sensors: NDArray[np.float64] | None = None
    body: Body | None = None


def static_props(body: Body) -> tuple[Prop, ...]:
    """Return the props of a body that does not move."""
    return tuple(Prop("body", solid.outline, np.zeros((1, 1, 3))) for solid in body.solids)
