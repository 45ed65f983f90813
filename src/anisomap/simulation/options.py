"""Options of scenarios: fields that validate themselves and scale with the body.

Documented defaults are for the paper's sphere, with a radius of 1 m and a sensor spacing of 0.43 m.
For other bodies, lengths scale with the reach or the sensor spacing of the body.

Return type of scenarios.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.recording import Scalar
from anisomap.scene import Prop
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.bodies.lattice import sphere
from anisomap.simulation.checks import check_between, check_count, check_positive

REACH = "reach"
SPACING = "spacing"


def positive(default: float, unit: str = "", per: str | None = None) -> Any:
    """Declare an option that must be positive.

    Parameters
    ----------
    default : float
        Value for the paper's sphere.
    unit : str
        Unit, for messages.
    per : {"reach", "spacing"}, optional
        Length of the body with which the default scales.
    """
    check = partial(check_positive, unit=unit)
    return field(default=default, metadata={"check": check, "per": per})


def count(default: int) -> Any:
    """Declare an option that must be an integer of at least 1."""
    return field(default=default, metadata={"check": check_count})


def between(default: float, low: float, high: float) -> Any:
    """Declare an option that must lie between `low` and `high`."""
    return field(default=default, metadata={"check": partial(check_between, low=low, high=high)})


@dataclass(frozen=True)
class ScenarioOptions:
    """Base class of the options of a scenario. Subclasses have a field ``frame_interval``.

    Raises
    ------
    InputError
        If an option is outside its range.
    """

    def __post_init__(self) -> None:
        for entry in fields(self):
            if "check" in entry.metadata:
                entry.metadata["check"](entry.name, getattr(self, entry.name))

    def scaled(self, factor: float) -> Self:
        """Scale all lengths by `factor`, as for a larger body or another unit of length."""
        lengths = [entry.name for entry in fields(self) if entry.metadata.get("per")]
        return replace(self, **{name: factor * getattr(self, name) for name in lengths})


def options_for(kind: type[Any], body: Body, given: Mapping[str, Any] | None = None) -> Any:
    """Create the options of a scenario with defaults scaled to a body.

    Parameters
    ----------
    kind : type
        A subclass of `ScenarioOptions`.
    body : Body
    given : mapping of str to number, optional
        Options that replace their defaults.

    Returns
    -------
    ScenarioOptions
        An instance of `kind`.

    Raises
    ------
    InputError
        If an option is unknown or outside its range.
    """
    known = {entry.name: entry for entry in fields(kind)}
    values = dict(given or {})
    for name in values:
        if name not in known:
            raise InputError(
                f"the scenario has no parameter {name!r}; choose from {', '.join(known)}"
            )
    reference = sphere()
    for name, entry in known.items():
        per = entry.metadata.get("per")
        if per and name not in values:
            growth = getattr(body, per) / getattr(reference, per)
            values[name] = entry.default * growth
    return kind(**values)


def count_steps(length: float, longest: float) -> int:
    """Return the number of equal steps in a length, each at most `longest` but for rounding."""
    return max(1, math.ceil(length / longest * (1 - 1e-12)))


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
