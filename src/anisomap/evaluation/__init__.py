"""Comparison of maps with true positions: Mantel r, alignment and neighbourhoods."""

from anisomap.evaluation.difference import Difference, compare_maps
from anisomap.evaluation.mantel_r import (
    PERMUTATIONS,
    Mantel,
    Shepard,
    ShiftTest,
    mantel,
    partial_mantel,
    shepard,
    shift_test,
    stress_per_point,
)
from anisomap.evaluation.scoring import (
    Alignment,
    Score,
    align,
    median_spacing,
    neighbour_agreement,
    score,
)

__all__ = [
    "PERMUTATIONS",
    "Alignment",
    "Difference",
    "Mantel",
    "Score",
    "Shepard",
    "ShiftTest",
    "align",
    "compare_maps",
    "mantel",
    "median_spacing",
    "neighbour_agreement",
    "partial_mantel",
    "score",
    "shepard",
    "shift_test",
    "stress_per_point",
]
