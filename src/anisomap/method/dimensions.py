"""Number of dimensions of a map: given, or chosen from the readings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from anisomap.base.immutable import Value
from anisomap.errors import InputError
from anisomap.notes import Note
from anisomap.numerics.neighbours import components
from anisomap.numerics.precision import Reals
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions, smacof
from anisomap.recording import Scalar

AUTO: Literal["auto"] = "auto"
"""Choose between 2 and 3 dimensions from the readings."""

Dimensions: TypeAlias = int | Literal["auto"]
"""Number of coordinates of a map, at least 1, or `AUTO`."""

PLANE, SPATIAL = 2, 3
"""Dimensions of flat skins, and of space. The second is the default if the choice is not clear."""

FLAT_ELBOW, SPATIAL_ELBOW = 1.17, 1.25
"""Elbow at 3 dimensions below which 2 dimensions suffice, and from which 3 are required.

On 300 simulated skins of 15 shapes (benchmark `dimension`), no choice was wrong and 22 were
unclear.
"""

MIN_EXPLAINED = 0.04
"""Minimum gain of a third dimension, as a share of the variance of the correlations: the difference
between the shares that maps in 3 and in 2 dimensions explain. With less, the skin counts as flat.

Measured on 225 recordings of `benchmarks.skins.independent`, without cylinders. With the elbow
alone, 37 choices were wrong and 56 unclear; with this minimum, 18 were wrong and 82 unclear. Of the
116 recordings with a map error below .7 spacings, 13 choices were wrong without it, and 3 with it.
"""

PLANE_ELBOW = 1.18
"""Minimum elbow at 2 dimensions of a flat skin: 1.15 or less on points in 5 and 6 dimensions."""

DISTINCT, WEAK_FLAT_ELBOW = 3.0, 1.09
"""If the elbows at 1 and 2 dimensions are below the first, a flat skin must have an elbow at 3
below the second.

No dimension fits well if stimuli reach far. Elbows at 3 were then at most 1.08 on flat skins, and
1.106 on bodies."""

_FLOOR = 0.01  # Stress-1 of a perfect fit; bounds the elbows of exact distances
_MOST = 0.5
_MIN_POINTS = 8  # fewer have hardly more distances than coordinates in 4 dimensions
_MAX_POINTS = 1000  # regularly sampled; their 500,000 distances determine the stress
_MAX_EXAMINED = 125  # points examined for a note on a given number
# With 1e-8, elbows differ by less than .001 (53 recordings, real and simulated).
_SOLVER = SmacofOptions(solver="lbfgs", tolerance=1e-5)


@dataclass(frozen=True, eq=False)
class DimensionChoice(Value):
    """Number of dimensions of a map, and the reason for it.

    dimensions: The given number; else 2 or 3, and 3 if the metric does not determine it.
    given, examined: Whether the number was given, and whether the metric was examined.
    shown: The number that the metric determines; 0 if it is not clear.
    line: Whether the sensors appear to lie along a line.
    stress: Stress-1 in 1 to 4 dimensions; empty if there are fewer than 8 points.
    """

    dimensions: int = SPATIAL
    given: bool = False
    examined: bool = True
    shown: int = 0
    line: bool = False
    stress: tuple[float, ...] = ()

    def confirmed(self, explained: float) -> DimensionChoice:
        """Return the choice, given the share of the variance that only a map in 3D explains.

        Two dimensions are rejected if the share is at least `MIN_EXPLAINED`, and three if it is
        less. The number is then not clear.
        """
        agrees = (self.shown == SPATIAL) == (explained >= MIN_EXPLAINED)
        return self if agrees else replace(self, dimensions=SPATIAL, shown=0)

    def elbow(self, dimensions: int) -> float:
        """Return the ratio of the factors by which the last and the next dimension lower stress."""
        if not self.stress:
            return float("nan")
        s = np.hypot((1.0, *self.stress), _FLOOR)  # in 0 dimensions, Stress-1 is 1
        return float(s[dimensions - 1] * s[dimensions + 1] / s[dimensions] ** 2)

    def notes(self, *, objects: bool = False) -> tuple[Note, ...]:
        """Return caveats about the number after an examination; none if it is clear.

        objects: Whether the map shows objects, from their dissimilarities.
        """
        if self.given:
            too_many = 0 < self.shown < self.dimensions
            return (Note("looks-flat", objects=objects),) if too_many else ()
        if not self.shown:
            return (Note("unclear-dimensions", objects=objects),)
        return (Note("line", objects=objects),) if self.line else ()

    def facts(self, *, objects: bool = False) -> dict[str, Scalar]:
        """Return the choice and its evidence for the provenance."""
        kind = "two-dimensions" if self.dimensions == 2 else "three-dimensions"
        because = self.notes(objects=objects) or (Note(kind, objects=objects),)
        facts: dict[str, Scalar] = {
            "chosen_dimensions": self.dimensions,
            "dimensions_because": str(because[0]),
        }
        if self.stress:
            facts |= {f"elbow_{k}": round(self.elbow(k), 3) for k in (1, 2, 3)}
        return facts


def plan_dimensions(
    dimensions: Dimensions,
    metric: Reals | None,
    weights: Reals | None = None,
    *,
    common_share: float = 0.0,
) -> DimensionChoice:
    """Choose the number of dimensions of a map, or examine a given number of 3.

    metric (n, n), weights (n, n). Nothing is examined without a metric.
    """
    given = dimensions != AUTO
    if metric is None or dimensions not in (AUTO, SPATIAL):
        number = int(dimensions) if dimensions != AUTO else SPATIAL
        return DimensionChoice(number, given, examined=not given)
    most = _MAX_EXAMINED if given else _MAX_POINTS
    found = choose_dimensions(metric, weights, common_share=common_share, most=most)
    return replace(found, dimensions=SPATIAL, given=True) if given else found


def choose_dimensions(
    metric: ArrayLike,
    weights: Reals | None = None,
    *,
    common_share: float = 0.0,
    most: int = _MAX_POINTS,
) -> DimensionChoice:
    """Choose between 2 and 3 dimensions by the elbow of the stress.

    metric (N, N), weights (N, N). common_share: Share of a common signal of all sensors that was
    subtracted; only the remainder counts as evidence for the third dimension. most: Maximum number
    of points; an even sample of more points is used.

    More dimensions always lower the stress (Kruskal 1964, Psychometrika 29: 1-27,
    doi:10.1007/BF02289565). The fourth fits only errors. The third is required if it lowers the
    stress by clearly more than the fourth. Bending without stretching does not change lengths along
    a surface, so half a cylinder spans 2 dimensions.
    """
    lengths = np.asarray(metric)
    known = lengths if weights is None else np.where(weights > 0, lengths, np.inf)
    largest = np.flatnonzero(components(known) == 0)
    largest = largest[:: -(-len(largest) // most)]
    if len(largest) < _MIN_POINTS:
        return DimensionChoice()
    inside = np.ix_(largest, largest)
    if weights is not None and (components(known[inside]) > 0).any():
        return DimensionChoice()  # the sample is not connected
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
        return DimensionChoice(2, shown=2, line=True, stress=stress)
    if (found.elbow(3) - 1) * (1 - common_share) >= SPATIAL_ELBOW - 1:
        return DimensionChoice(3, shown=3, stress=stress)
    distinct = max(found.elbow(1), found.elbow(2)) >= DISTINCT
    limit = FLAT_ELBOW if distinct else WEAK_FLAT_ELBOW
    if found.elbow(3) < limit and found.elbow(2) >= PLANE_ELBOW:
        return DimensionChoice(2, shown=2, stress=stress)
    return found


def _is_curve(positions: Reals, line: Reals) -> bool:
    """Whether most near neighbours in 2 dimensions, (n, 2), are adjacent in 1 dimension, (n,).

    Of the two nearest sensors, .7 to .95 are adjacent on lines, at most .3 on strips of two rows.
    """
    rank = np.argsort(np.argsort(line, kind="stable"), kind="stable")
    nearest = np.asarray(KDTree(positions).query(positions, k=3)[1])[:, 1:]
    return bool(np.mean(np.abs(rank[nearest] - rank[:, None]) == 1) > _MOST)


def check_dimensions(dimensions: Dimensions) -> None:
    """Check a number of dimensions."""
    if dimensions != AUTO and (not isinstance(dimensions, int | np.integer) or dimensions < 1):
        raise InputError(f"dimensions must be auto or a whole number above 0, got {dimensions!r}")


def check_size(
    dimensions: Dimensions, n_sensors: int, n_frames: int | None, *, least: int, total: int
) -> None:
    """Check that a number of sensors can be mapped into a number of dimensions.

    n_frames: Number of frames, if there are readings: centred and scaled readings of T frames are
        points of a sphere of T - 2 dimensions.
    least: Minimum number of sensors. total: Total number of sensors.
    """
    check_dimensions(dimensions)
    if n_sensors < least:
        raise InputError(f"a map needs {least} sensors that vary, got {n_sensors} of {total}")
    if dimensions != AUTO and dimensions > n_sensors:
        raise InputError(f"a {dimensions}D map needs {dimensions} sensors, got {n_sensors}")
    k = PLANE if dimensions == AUTO else dimensions
    if n_frames is not None and n_frames < k + 2:
        raise InputError(f"a map in {k} dimensions requires {k + 2} frames, got {n_frames}")
