"""Comparison of maps with true positions: Mantel r, alignment and neighbourhoods."""

from anisomap.base import PERMUTATIONS
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

__all__ = [
    "PERMUTATIONS",
    "Alignment",
    "Difference",
    "Mantel",
    "Score",
    "align",
    "compare_maps",
    "mantel",
    "median_spacing",
    "neighbour_agreement",
    "score",
]
