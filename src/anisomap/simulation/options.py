"""Options of scenarios: fields that validate themselves and scale with the body.

Documented defaults are for the paper's sphere, with a radius of 1 m and a sensor spacing of 0.43 m.
For other bodies, lengths scale with the reach or the sensor spacing of the body.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any, Self

from anisomap.errors import InputError
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


def steps_per_frame(frame_interval: float, longest_step: float) -> int:
    """Return the number of equal physics steps in a frame, each at most `longest_step`."""
    return max(1, math.ceil(frame_interval / longest_step * (1 - 1e-12)))
