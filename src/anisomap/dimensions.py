"""Number of dimensions of a map: given, or chosen from the readings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from anisomap.errors import InputError
from anisomap.numerics.precision import Reals
from anisomap.numerics.scaling.multidimensional_scaling import DimensionChoice, choose_dimensions
from anisomap.recording import Scalar

AUTO: Literal["auto"] = "auto"
"""Let the readings choose between 2 and 3 dimensions."""

Dimensions: TypeAlias = int | Literal["auto"]
"""Number of coordinates of a map, at least 1, or `AUTO`."""

SPATIAL = 3
"""Dimensions of a map if the readings do not show their number: those of space."""

_CHOSEN = {
    2: "a third dimension explains no more than chance; a skin that is bent like a sheet of paper "
    "is mapped as if rolled out",
    3: "two dimensions do not explain the readings",
}
_UNCLEAR = (
    "the readings do not show whether the skin is flat, so the map has 3 dimensions: for a flat "
    "skin, choose 2 (-d 2)"
)
_ELONGATED = (
    "contacts appear to be long in one direction, which hides whether the skin is flat, so the map "
    "has 3 dimensions: for a flat skin, choose 2 (-d 2)"
)
_LOOKS_FLAT = (
    "this looks flat: a third dimension explains no more than chance; unless the skin is bent like "
    "a sheet of paper, a map in 2 dimensions (-d 2) is more accurate"
)
_LINE = "the sensors appear to lie along a line: to map them along it, choose 1 dimension (-d 1)"


@dataclass(frozen=True)
class DimensionPlan:
    """The number of dimensions of a map, and why.

    choice: What the metric shows, if it was examined.
    elongated: Whether contacts appear elongated, so that the metric does not show the dimensions.
    """

    dimensions: int
    requested: Dimensions
    choice: DimensionChoice | None = None
    elongated: bool = False

    @property
    def note(self) -> tuple[str, ...]:
        """A caveat for users; empty if the number of dimensions is clear, or was not examined."""
        if self.choice is None:
            return ()
        if self.requested != AUTO:
            flat = self.choice.clear and self.choice.dimensions < self.dimensions
            flat = flat and not self.elongated
            return (_LOOKS_FLAT,) if flat else ()
        if self.elongated:
            return (_ELONGATED,)
        if not self.choice.clear:
            return (_UNCLEAR,)
        return (_LINE,) if self.choice.line else ()

    @property
    def provenance(self) -> dict[str, Scalar]:
        """The choice and its evidence, if the number of dimensions was not given."""
        if self.requested != AUTO or self.choice is None:
            return {}
        because = self.note[0] if self.note else _CHOSEN[self.dimensions]
        facts: dict[str, Scalar] = {
            "chosen_dimensions": self.dimensions,
            "dimensions_because": because,
        }
        if self.choice.stress:
            facts |= {f"elbow_{k}": round(self.choice.elbow(k), 3) for k in (1, 2, 3)}
        return facts

    def revised(self, *, elongated: bool) -> DimensionPlan:
        """Return the plan after the map was refined.

        Where contacts are long in one direction, distances across them appear too small, and the
        metric of a body that rolls looks flat. A chosen flat map then has to be made again.
        """
        # Maps of lines are curves, which look like maps of elongated contacts.
        if self.choice is None or self.choice.line or not elongated:
            return self
        if not self.choice.clear or self.choice.dimensions == SPATIAL:
            return self
        dimensions = SPATIAL if self.requested == AUTO else self.dimensions
        return replace(self, dimensions=dimensions, elongated=True)


def plan_dimensions(
    dimensions: Dimensions,
    metric: Reals | None,
    weights: Reals | None = None,
    *,
    examine: bool = True,
) -> DimensionPlan:
    """Choose the number of dimensions of a map, or examine the given number.

    metric (n, n), weights (n, n).
    """
    if dimensions == AUTO:
        choice = DimensionChoice() if metric is None else choose_dimensions(metric, weights)
        return DimensionPlan(choice.dimensions, AUTO, choice)
    given = DimensionPlan(int(dimensions), int(dimensions))
    if not examine or dimensions != SPATIAL or metric is None:
        return given
    return replace(given, choice=choose_dimensions(metric, weights))


def check_dimensions(dimensions: Dimensions) -> None:
    """Check a number of dimensions."""
    if isinstance(dimensions, str) and dimensions == AUTO:
        return
    if not isinstance(dimensions, int | np.integer) or dimensions < 1:
        raise InputError(
            f"dimensions must be a whole number of at least 1, or auto, got {dimensions!r}"
        )


def given_dimensions(dimensions: Dimensions) -> int:
    """Return the given number of dimensions; 3 in place of ``"auto"``."""
    return SPATIAL if dimensions == AUTO else int(dimensions)
