"""All stages that are timed: to add one, write a function that gives its races, and a line here."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType

from benchmarks.paths import metricising_races, torgerson_races
from benchmarks.race import Race, Setting
from benchmarks.scalings import smacof_races
from benchmarks.similarities import (
    co_activation_races,
    information_races,
    pearson_races,
    spearman_races,
)
from benchmarks.wholes import whole_races

STAGES: Mapping[str, tuple[str, Callable[[Setting], Iterator[Race]]]] = MappingProxyType(
    {
        "pearson": ("Similarity", pearson_races),
        "spearman": ("Similarity", spearman_races),
        "co-activation": ("Similarity", co_activation_races),
        "mutual-information": ("Similarity", information_races),
        "metricising": ("Shortest paths", metricising_races),
        "torgerson": ("Scaling", torgerson_races),
        "smacof": ("Scaling", smacof_races),
        "whole": ("Whole maps", whole_races),
    }
)
"""By the name that ``--stages`` takes: the panel of the picture, and what gives the races."""
