"""Comparison of maps with true positions: Mantel r, alignment and neighbourhoods."""

from anisomap.base.defaults import PERMUTATIONS
from anisomap.evaluation.difference import Difference, compare_maps
from anisomap.evaluation.mantel_r import Mantel, mantel
from anisomap.evaluation.scoring import (
    Alignment,
    Score,
    align,
    median_spacing,
    neighbour_agreement,
    score,
)
from anisomap.evaluation.stress import (
    NullTest,
    Shepard,
    permutation_test,
    shepard,
    stress_per_point,
)

__all__ = [
    "PERMUTATIONS",
    "Alignment",
    "Difference",
    "Mantel",
    "NullTest",
    "Score",
    "Shepard",
    "align",
    "compare_maps",
    "mantel",
    "median_spacing",
    "neighbour_agreement",
    "permutation_test",
    "score",
    "shepard",
    "stress_per_point",
]
