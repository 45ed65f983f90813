"""Number of dimensions of a map: given, or chosen from the readings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from anisomap.errors import InputError
from anisomap.numerics.graph.neighbour_graphs import components
from anisomap.numerics.precision import Reals
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions, smacof
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
_OF_OBJECTS = {
    _CHOSEN[2]: "a third dimension explains no more than chance",
    _CHOSEN[3]: "two dimensions do not explain the dissimilarities",
    _UNCLEAR: "the dissimilarities do not show the number of dimensions: choose it (-d 2)",
    _LOOKS_FLAT: "a third dimension explains no more than chance: 2 dimensions suffice (-d 2)",
    _LINE: _LINE.replace("sensors", "objects"),
}
"""What is said of objects, which are not on a skin, in place of what is said of sensors."""


FLAT_ELBOW, SPATIAL_ELBOW = 1.17, 1.25
"""Elbow at 3 dimensions below which 2 suffice, and from which 3 are required.

Of 300 simulated skins of 15 shapes (``make dimension``), none was wrong and 22 were not clear.
"""

PLANE_ELBOW = 1.18
"""Minimum elbow at 2 dimensions of a flat skin: 1.15 or less on points in 5 and 6 dimensions."""

DISTINCT, WEAK_FLAT_ELBOW = 3.0, 1.09
"""Elbow at 1 or 2 dimensions below which the elbow at 3 has to be smaller, and its limit there.

Where stimuli reach far, no dimension fits well: flat skins had at most 1.08, and bodies 1.106.
"""

_FLOOR = 0.01  # Stress-1 that counts as perfect; bounds the elbows of exact distances
_MOST = 0.5
_MIN_POINTS = 8  # fewer have hardly more distances than coordinates in 4 dimensions
_MAX_POINTS = 1000  # regularly sampled; their 500,000 distances determine the stress
# With 1e-8, elbows differ by less than .001 (53 recordings, real and simulated).
_SOLVER = SmacofOptions(solver="lbfgs", tolerance=1e-5)


@dataclass(frozen=True)
class DimensionChoice:
    """Number of dimensions of a metric.

    dimensions: 2 or 3; 3 if it is not clear.
    clear: Whether the metric shows the number of dimensions.
    line: Whether the sensors appear to lie along a line.
    stress: Stress-1 in 1 to 4 dimensions; empty if there are fewer than 8 points.
    """

    dimensions: int = SPATIAL
    clear: bool = False
    line: bool = False
    stress: tuple[float, ...] = ()

    def elbow(self, dimensions: int) -> float:
        """Return how much more the last of some dimensions lowers the stress than the next one."""
        if not self.stress:
            return float("nan")
        s = np.hypot((1.0, *self.stress), _FLOOR)  # in 0 dimensions, Stress-1 is 1
        return float(s[dimensions - 1] * s[dimensions + 1] / s[dimensions] ** 2)


def choose_dimensions(
    metric: ArrayLike, weights: Reals | None = None, *, common_share: float = 0.0
) -> DimensionChoice:
    """Choose between 2 and 3 dimensions by the elbow of the stress.

    metric (N, N), weights (N, N). common_share: Of the signal that all sensors have in common,
    which was subtracted; only the rest counts as evidence for the third dimension.

    More dimensions always lower the stress (Kruskal 1964, Psychometrika 29: 1-27,
    doi:10.1007/BF02289565). The fourth fits only errors, and the third is required if it lowers the
    stress by clearly more. Lengths along a surface do not change if it is bent without stretching,
    so half a cylinder spans 2 dimensions.
    """
    lengths = np.asarray(metric)
    known = lengths if weights is None else np.where(weights > 0, lengths, np.inf)
    largest = np.flatnonzero(components(known) == 0)
    largest = largest[:: -(-len(largest) // _MAX_POINTS)]
    if len(largest) < _MIN_POINTS:
        return DimensionChoice()
    inside = np.ix_(largest, largest)
    if weights is not None and (components(known[inside]) > 0).any():
        return DimensionChoice()  # the sample lost the pairs that connect it
    one, two, *more = (
        smacof(
            lengths[inside],
            dimensions=k,
            weights=None if weights is None else weights[inside],
            options=_SOLVER,
        )
        for k in range(1, SPATIAL + 2)
    )
    stress = tuple(scaling.stress for scaling in (one, two, *more))
    found = DimensionChoice(stress=stress)
    elongated = found.elbow(1) >= DISTINCT > found.elbow(2)
    if elongated and _is_curve(two.positions, one.positions[:, 0]):
        return DimensionChoice(2, clear=True, line=True, stress=stress)
    if (found.elbow(3) - 1) * (1 - common_share) >= SPATIAL_ELBOW - 1:
        return DimensionChoice(3, clear=True, stress=stress)
    distinct = max(found.elbow(1), found.elbow(2)) >= DISTINCT
    limit = FLAT_ELBOW if distinct else WEAK_FLAT_ELBOW
    if found.elbow(3) < limit and found.elbow(2) >= PLANE_ELBOW:
        return DimensionChoice(2, clear=True, stress=stress)
    return found


def _is_curve(positions: Reals, line: Reals) -> bool:
    """Whether most near neighbours in 2 dimensions, (n, 2), are next to each other in 1, (n,).

    Of the two nearest sensors, .7 to .95 are on lines, and at most .3 on strips of two rows.
    """
    rank = np.argsort(np.argsort(line, kind="stable"), kind="stable")
    nearest = np.asarray(KDTree(positions).query(positions, k=3)[1])[:, 1:]
    return bool(np.mean(np.abs(rank[nearest] - rank[:, None]) == 1) > _MOST)


@dataclass(frozen=True)
class DimensionPlan:
    """The number of dimensions of a map, and why.

    choice: What the metric shows, if it was examined.
    elongated: Whether contacts appear elongated, so that the metric does not show the dimensions.
    objects: Whether it is a map of objects, from their dissimilarities.
    """

    dimensions: int
    requested: Dimensions
    choice: DimensionChoice | None = None
    elongated: bool = False
    objects: bool = False

    @property
    def note(self) -> tuple[str, ...]:
        """A caveat for users; empty if the number of dimensions is clear, or was not examined."""
        if self.choice is None:
            return ()
        if self.requested != AUTO:
            flat = self.choice.clear and self.choice.dimensions < self.dimensions
            flat = flat and not self.elongated
            return self._said(_LOOKS_FLAT) if flat else ()
        if self.elongated:
            return (_ELONGATED,)
        if not self.choice.clear:
            return self._said(_UNCLEAR)
        return self._said(_LINE) if self.choice.line else ()

    def _said(self, text: str) -> tuple[str, ...]:
        return (_OF_OBJECTS[text] if self.objects else text,)

    @property
    def provenance(self) -> dict[str, Scalar]:
        """The choice and its evidence, if the number of dimensions was not given."""
        if self.requested != AUTO or self.choice is None:
            return {}
        (because,) = self.note or self._said(_CHOSEN[self.dimensions])
        facts: dict[str, Scalar] = {
            "chosen_dimensions": self.dimensions,
            "dimensions_because": because,
        }
        if self.choice.stress:
            facts |= {f"elbow_{k}": round(self.choice.elbow(k), 3) for k in (1, 2, 3)}
        return facts

    def revised(self, *, elongated: bool) -> DimensionPlan:
        """Return the plan after the map was refined.

        Distances across elongated contacts appear too small, so that the metric looks flat.
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
    common_share: float = 0.0,
    examine: bool = True,
) -> DimensionPlan:
    """Choose the number of dimensions of a map, or examine the given number.

    metric (n, n), weights (n, n).
    """
    if dimensions == AUTO:
        choice = DimensionChoice()
        if metric is not None:
            choice = choose_dimensions(metric, weights, common_share=common_share)
        return DimensionPlan(choice.dimensions, AUTO, choice)
    given = DimensionPlan(int(dimensions), int(dimensions))
    if not examine or dimensions != SPATIAL or metric is None:
        return given
    return replace(given, choice=choose_dimensions(metric, weights, common_share=common_share))


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
