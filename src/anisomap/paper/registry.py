"""All experiments, in the order of the page: the paper's, then what the paper only mentions."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from anisomap.paper import claims
from anisomap.paper.experiment import Experiment
from anisomap.paper.experiments import (
    failing_sensor,
    hardware,
    modalities,
    quality,
    reconstructions,
    scenes,
    sensitivity,
    shapes,
    supplement,
)

_IN_ORDER = (
    claims.EXPERIMENT,
    reconstructions.FIGURE_1,
    hardware.FIGURE_2,
    hardware.REAL_SKIN,
    *quality.EXPERIMENTS,
    shapes.FIGURE_4,
    *scenes.EXPERIMENTS,
    shapes.FIGURE_7,
    *reconstructions.SUPPLEMENTARY,
    *hardware.SUPPLEMENTARY,
    *supplement.EXPERIMENTS,
    quality.BINS,
    failing_sensor.EXPERIMENT,
    *sensitivity.EXPERIMENTS,
    *modalities.EXPERIMENTS,
)

EXPERIMENTS: Mapping[str, Experiment] = MappingProxyType({one.name: one for one in _IN_ORDER})
"""By name, which is also that of the folder that an experiment leaves."""
