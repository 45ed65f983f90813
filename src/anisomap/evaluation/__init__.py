"""Comparison of maps with true positions: Mantel r, alignment and neighbourhoods."""

from anisomap.evaluation.alignment import Alignment, align
from anisomap.evaluation.difference import Difference, compare_maps
from anisomap.evaluation.mantel_r import PERMUTATIONS, Mantel, mantel, partial_mantel
from anisomap.evaluation.mds_diagnostics import (
    Shepard,
    ShiftTest,
    shepard,
    shift_test,
    stress_per_point,
)
from anisomap.evaluation.neighbourhood import median_spacing, neighbour_agreement
from anisomap.evaluation.scoring import Score, score

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
