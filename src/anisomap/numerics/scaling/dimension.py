"""Number of dimensions of a metric, from the elbow of the stress."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from anisomap.numerics.graph.connectivity import components
from anisomap.numerics.precision import Reals
from anisomap.numerics.scaling.stress_minimisation import SmacofOptions, smacof

MAX_DIMENSIONS = 3
"""Skins lie in space; the stress of one dimension more shows what chance explains."""

FLAT_ELBOW, SPATIAL_ELBOW = 1.17, 1.25
"""Elbow at 3 dimensions below which 2 suffice, and from which 3 are required.

At most 1.144 on flat skins, simulated (seeds 1 to 3, 300 to 2,000 frames) and real, and at least
1.19 on bodies that are curved in two directions, such as a hemisphere.
"""

PLANE_ELBOW = 1.18
"""Minimum elbow at 2 dimensions of a flat skin.

At least 1.20 on flat skins, real ones included; 1.15 or less on points in 5 and 6 dimensions.
"""

DISTINCT_PLANE, WEAK_FLAT_ELBOW = 3.0, 1.09
"""Elbow at 2 dimensions below which the elbow at 3 has to be smaller, and its limit there.

Where stimuli reach far, no dimension fits well. Simulated flat skins with an elbow at 2 dimensions
of less than 3 had at most 1.08 at 3 dimensions, and bodies at least 1.106 (seeds 1 to 9).
"""

LINE_ELBOW, LINE_STRESS = 5.0, 0.1
"""Minimum elbow at 1 dimension, and maximum Stress-1 in it, of sensors along a line.

At least 7.8 and at most .083 on simulated lines; at most 2.8 and at least .14 on skins that are
less than four times as long as wide.
"""

_FLOOR = 0.01  # Stress-1 that counts as perfect; bounds the elbows of exact distances
_MIN_POINTS = 8  # fewer have hardly more distances than coordinates in 4 dimensions
_MAX_POINTS = 1000  # regularly sampled; their 500,000 distances determine the stress
# With 1e-8, elbows differ by less than .0003 (eight recordings, real and simulated).
_SOLVER = SmacofOptions(solver="lbfgs", tolerance=1e-6)


@dataclass(frozen=True)
class DimensionChoice:
    """Number of dimensions of a metric.

    dimensions: 2 or 3; 3 if it is not clear.
    clear: Whether the metric shows the number of dimensions.
    line: Whether one dimension appears to suffice.
    stress: Stress-1 in 1 to 4 dimensions; empty if there are fewer than 8 points.
    """

    dimensions: int = MAX_DIMENSIONS
    clear: bool = False
    line: bool = False
    stress: tuple[float, ...] = ()

    def elbow(self, dimensions: int) -> float:
        """Return how much more the last of some dimensions lowers the stress than the next one."""
        if not self.stress:
            return float("nan")
        s = np.hypot((1.0, *self.stress), _FLOOR)  # in 0 dimensions, Stress-1 is 1
        return float(s[dimensions - 1] * s[dimensions + 1] / s[dimensions] ** 2)


def choose_dimensions(metric: ArrayLike, weights: Reals | None = None) -> DimensionChoice:
    """Choose between 2 and 3 dimensions by the elbow of the stress.

    metric (N, N), weights (N, N).

    More dimensions always lower the stress (Kruskal 1964, Psychometrika 29: 1-27,
    doi:10.1007/BF02289565). The fourth fits only errors, as skins lie in space, and the third is
    required if it lowers the stress by clearly more than the fourth does.

    Lengths along a surface do not change if it is bent without stretching (Gauss's theorema
    egregium), so half a cylinder spans 2 dimensions, like a sheet that is rolled out.
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
    stress = tuple(
        smacof(
            lengths[inside],
            dimensions=k,
            weights=None if weights is None else weights[inside],
            options=_SOLVER,
        ).stress
        for k in range(1, MAX_DIMENSIONS + 2)
    )
    found = DimensionChoice(stress=stress)
    if stress[0] <= LINE_STRESS and found.elbow(1) >= LINE_ELBOW:
        return DimensionChoice(2, clear=True, line=True, stress=stress)
    if found.elbow(3) >= SPATIAL_ELBOW:
        return DimensionChoice(3, clear=True, stress=stress)
    limit = FLAT_ELBOW if found.elbow(2) >= DISTINCT_PLANE else WEAK_FLAT_ELBOW
    if found.elbow(3) < limit and found.elbow(2) >= PLANE_ELBOW:
        return DimensionChoice(2, clear=True, stress=stress)
    return found
