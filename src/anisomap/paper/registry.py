"""All experiments, in the order of the page: the paper's figures, then additional analyses."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from anisomap.paper import claims
from anisomap.paper.experiment import Experiment
from anisomap.paper.experiments import (
    accuracy,
    bodies_and_scenarios,
    bombarded_bodies,
    dimensionality,
    failing_sensor,
    hardware_patch,
    sample_data,
    sensitivity,
    shape_distortion,
    unlike_responses,
)

_IN_ORDER = (
    claims.EXPERIMENT,
    bombarded_bodies.FIGURE_1,
    hardware_patch.FIGURE_2,
    hardware_patch.REAL_SKIN,
    *accuracy.EXPERIMENTS,
    shape_distortion.FIGURE_4,
    *bodies_and_scenarios.EXPERIMENTS,
    shape_distortion.FIGURE_7,
    *bombarded_bodies.SUPPLEMENTARY,
    *hardware_patch.SUPPLEMENTARY,
    *sample_data.EXPERIMENTS,
    accuracy.BINS,
    failing_sensor.EXPERIMENT,
    *unlike_responses.EXPERIMENTS,
    *sensitivity.EXPERIMENTS,
    dimensionality.EXPERIMENT,
)

EXPERIMENTS: Mapping[str, Experiment] = MappingProxyType({one.name: one for one in _IN_ORDER})
"""By name, which is also the name of the folder of its results."""
