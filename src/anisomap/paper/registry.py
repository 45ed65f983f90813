"""All experiments, in the order of the page: the paper's, then what the paper only mentions."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from anisomap.paper import reconstructions
from anisomap.paper.experiment import Experiment

EXPERIMENTS: Mapping[str, Experiment] = MappingProxyType(
    {one.name: one for one in (*reconstructions.EXPERIMENTS,)}
)
"""By name, which is also that of the folder that an experiment leaves."""
