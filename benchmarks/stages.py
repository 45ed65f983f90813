"""Registry of the timed stages. To add one, write a function that yields comparisons."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType

from benchmarks.comparison import Comparison, Setting
from benchmarks.paths import compare_metricising, compare_torgerson
from benchmarks.scalings import compare_smacof
from benchmarks.similarities import (
    compare_co_activation,
    compare_information,
    compare_pearson,
    compare_spearman,
)
from benchmarks.whole_maps import compare_whole

STAGES: Mapping[str, tuple[str, Callable[[Setting], Iterator[Comparison]]]] = MappingProxyType(
    {
        "pearson": ("Similarity", compare_pearson),
        "spearman": ("Similarity", compare_spearman),
        "co-activation": ("Similarity", compare_co_activation),
        "mutual-information": ("Similarity", compare_information),
        "metricising": ("Shortest paths", compare_metricising),
        "torgerson": ("Scaling", compare_torgerson),
        "smacof": ("Scaling", compare_smacof),
        "whole": ("Whole maps", compare_whole),
    }
)
"""Panel of the figure and function of each stage, by its name for ``--stages``."""
