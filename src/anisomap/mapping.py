"""From readings to a configuration, stage by stage, with what a diagnosis of the map uses again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.defaults import DEFAULT_METHOD
from anisomap.dimensions import (
    AUTO,
    SPATIAL,
    DimensionPlan,
    Dimensions,
    plan_dimensions,
)
from anisomap.evidence import PairStatistics, compare
from anisomap.methods import METHODS, Method, find_method
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.precision import Reals
from anisomap.options import MethodOptions
from anisomap.recording import Recording
from anisomap.scaling import Configuration, configure, of_positions, refine_components

_MOSTLY = 0.5  # least share of a common signal that hides how many dimensions a skin has


@dataclass(frozen=True, eq=False)
class Stages:
    """The stages of a map.

    pairs: Of the n mapped sensors.
    """

    pairs: PairStatistics
    configuration: Configuration
    plan: DimensionPlan


def compute_stages(
    runs: Sequence[Recording], recipe: Method, dimensions: Dimensions, options: MethodOptions
) -> Stages:
    """Compute the configuration of all sensors of some recordings."""
    refined = bool(recipe.refinements)
    with limited_blas(max(run.n_sensors for run in runs)):
        pairs = compare(runs, recipe.similarity_of(runs), bins=options.bins, with_noise=refined)
        metric = recipe.metric(_dissimilarity_of(pairs, recipe, options))
        if dimensions == AUTO and recipe.dissimilarity != METHODS[DEFAULT_METHOD].dissimilarity:
            plan = _plan_by_default_method(runs, options)
        else:
            plan = _plan(dimensions, pairs, metric, examine=refined)
        configuration, plan = configure(
            plan, metric, pairs, steps=recipe.refinements, options=options, weights=pairs.weights
        )
    return Stages(pairs, configuration, plan)


def configure_pairs(
    pairs: PairStatistics,
    recipe: Method,
    dimensions: int,
    options: MethodOptions,
    *,
    start: NDArray[np.float64] | None = None,
) -> Configuration:
    """Compute the configuration of sensors of which all pairs were compared.

    start (n, k): Positions near the result, which replace the scaling.
    """
    with limited_blas(len(pairs.similarity)):
        metric = recipe.metric(_dissimilarity_of(pairs, recipe, options))
        if start is not None:
            given = of_positions(start, metric)
            return refine_components(recipe.refinements, pairs, metric, given, options)
        plan = plan_dimensions(dimensions, None)
        return configure(
            plan, metric, pairs, steps=recipe.refinements, options=options, weights=pairs.weights
        )[0]


def dissimilarities(
    pairs: PairStatistics, method: str = DEFAULT_METHOD, options: MethodOptions | None = None
) -> Reals:
    """Compute the dissimilarity M of all pairs of sensors from their similarity S.

    Parameters
    ----------
    pairs : PairStatistics
        From `anisomap.evidence.compare`.
    method : str
        A key of `METHODS`.
    options : MethodOptions, optional

    Returns
    -------
    ndarray of shape (n, n)
        A semi-metric, infinite for unknown and unrelated pairs.

    Raises
    ------
    InputError
        If there is no such method, or it requires correlations and the similarity is not one.

    Notes
    -----
    McGregor et al. (2011), section "ANISOMAP", step 1, doi:10.1371/journal.pone.0026561.
    """
    return _dissimilarity_of(pairs, find_method(method), options or MethodOptions())


def _dissimilarity_of(pairs: PairStatistics, recipe: Method, options: MethodOptions) -> Reals:
    """Compute `dissimilarities` by a method."""
    dissimilarity = recipe.dissimilarity(pairs, options)
    if not pairs.known.all():
        dissimilarity[~pairs.known] = np.inf
        np.fill_diagonal(dissimilarity, 0)
    return dissimilarity


def _plan(
    dimensions: Dimensions, pairs: PairStatistics, metric: Reals, *, examine: bool = True
) -> DimensionPlan:
    """Plan the dimensions, which are not clear if the mean over sensors is mostly common."""
    examined = None if pairs.common_share > _MOSTLY else metric
    return plan_dimensions(dimensions, examined, pairs.weights, examine=examine)


def _plan_by_default_method(runs: Sequence[Recording], options: MethodOptions) -> DimensionPlan:
    """Choose dimensions by the default method, which examines contacts if the skin looks flat."""
    recipe = METHODS[DEFAULT_METHOD]
    pairs = compare(runs, recipe.similarity_of(runs), bins=options.bins, with_noise=True)
    metric = recipe.metric(_dissimilarity_of(pairs, recipe, options))
    plan = _plan(AUTO, pairs, metric)
    if plan.dimensions == SPATIAL:
        return plan
    return configure(
        plan, metric, pairs, steps=recipe.refinements, options=options, weights=pairs.weights
    )[1]
