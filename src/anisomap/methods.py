"""The named methods: each a chain of stages that turns readings into a metric.

After these stages, all methods scale the metric into space (`anisomap.reconstruction`)::

    readings --similarity--> S --dissimilarity--> M --metric--> D --scaling--> positions

To add a similarity or a method, add one line to `SIMILARITIES` or `METHODS`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.binning import DEFAULT_BINS
from anisomap.numerics.dissimilarity import (
    information_distance,
    regularised_reciprocal,
    symmetric,
)
from anisomap.numerics.graph import (
    check_semi_metric,
    metricise,
    neighbour_graph,
    smallest_connected_neighbour_graph,
)
from anisomap.numerics.scaling import SmacofOptions
from anisomap.numerics.similarity import co_activation, mutual_information, pearson, spearman

logger = logging.getLogger(__name__)

Matrix: TypeAlias = NDArray[np.float64]

DEFAULT_METHOD = "r-anisomap"


@dataclass(frozen=True)
class MethodOptions:
    """Parameters of the methods; each method uses those that its stages have.

    Parameters
    ----------
    mu : float
        Regularisation of the reciprocal, at least 0; with 0, unrelated sensors are infinitely far
        apart and separate pieces come out as separate maps.
    bins : int
        Bins a sensor for entropies, at least 2.
    n_neighbours : int, optional
        Neighbours of a sensor in ISOMAP's graph; the smallest number that connects everything
        unless given.
    smacof : SmacofOptions
        When to stop scaling.
    fewest_sensors : int
        Refuse to make a map whose largest piece holds fewer sensors: two always fit.
    """

    mu: float = 1.0
    bins: int = DEFAULT_BINS
    n_neighbours: int | None = None
    smacof: SmacofOptions = field(default_factory=SmacofOptions)
    fewest_sensors: int = 3


@dataclass(frozen=True)
class Similarity:
    """A pairwise statistic: ``compute(readings, options)`` gives the (N, N) similarity."""

    summary: str
    compute: Callable[[ArrayLike, MethodOptions], Matrix]


@dataclass(frozen=True)
class Method:
    """A recipe: the name of a similarity, and how it becomes a dissimilarity and then a metric."""

    summary: str
    similarity: str
    dissimilarity: Callable[[Matrix, MethodOptions], Matrix]
    metric: Callable[[Matrix], Matrix]


@dataclass(frozen=True, eq=False)
class Stages:
    """What a method computes before it scales; None where a later stage was given instead.

    Attributes
    ----------
    similarity, dissimilarity, metric : ndarray of shape (n, n) or None
        Of the sensors that take part, in their order.
    """

    similarity: Matrix | None
    dissimilarity: Matrix | None
    metric: Matrix


SIMILARITIES: Mapping[str, Similarity] = MappingProxyType(
    {
        "pearson": Similarity("linear correlation", lambda x, _: pearson(x)),
        "spearman": Similarity("correlation of ranks", lambda x, _: spearman(x)),
        "co-activation": Similarity(
            "correlation of being touched at all (phi)", lambda x, _: co_activation(x)
        ),
        "mutual-information": Similarity(
            "mutual information of binned readings",
            lambda x, options: mutual_information(x, options.bins),
        ),
    }
)


def _reciprocal(similarity: Matrix, options: MethodOptions) -> Matrix:
    return regularised_reciprocal(similarity, options.mu)


def _information_distance(similarity: Matrix, _: MethodOptions) -> Matrix:
    return information_distance(similarity)


def _neighbour_edges(similarity: Matrix, options: MethodOptions) -> Matrix:
    """Information distance between neighbours, and no edge between any others."""
    if options.n_neighbours is None:
        joined, n_neighbours = smallest_connected_neighbour_graph(similarity)
        logger.info("%d neighbours connect every sensor", n_neighbours)
    else:
        joined = neighbour_graph(similarity, options.n_neighbours)
    edges = np.where(joined, information_distance(similarity), np.inf)
    np.fill_diagonal(edges, 0)
    return edges


def _as_it_is(dissimilarity: Matrix) -> Matrix:
    return dissimilarity


def _anisomap(similarity: str, summary: str) -> Method:
    return Method(summary, similarity, _reciprocal, metricise)


PAPER_METHODS = ("r-anisomap", "i-anisomap", "information-distance", "isomap")
"""The methods of McGregor et al. (2011), in the order of its Figure 3's best to worst."""

METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "r-anisomap": _anisomap("pearson", "ANISOMAP on linear correlation"),
        "i-anisomap": _anisomap("mutual-information", "ANISOMAP on mutual information"),
        "information-distance": Method(
            "information distance, scaled as it is",
            "mutual-information",
            _information_distance,
            _as_it_is,
        ),
        "isomap": Method(
            "ISOMAP: shortest paths of information distance between neighbours",
            "mutual-information",
            _neighbour_edges,
            metricise,
        ),
        "spearman-anisomap": _anisomap("spearman", "ANISOMAP on correlation of ranks"),
        "co-activation-anisomap": _anisomap("co-activation", "ANISOMAP on being touched at all"),
    }
)


def find_method(name: str) -> Method:
    """Look a method up.

    Raises
    ------
    InputError
        If there is none of that name; the message lists those that there are.
    """
    if name not in METHODS:
        raise InputError(f"there is no method {name!r}; choose from {', '.join(METHODS)}")
    return METHODS[name]


def compute_stages(
    readings: ArrayLike | None,
    method: str = DEFAULT_METHOD,
    options: MethodOptions | None = None,
    *,
    similarity: ArrayLike | None = None,
    dissimilarity: ArrayLike | None = None,
    metric: ArrayLike | None = None,
) -> Stages:
    """Compute what a method scales: similarity, dissimilarity and metric.

    Parameters
    ----------
    readings : array_like of shape (T, N), or None
        Finite readings of sensors that vary; not looked at if a stage is given.
    method : str
        A name in `METHODS`.
    options : MethodOptions, optional
    similarity, dissimilarity, metric : array_like of shape (N, N), optional
        A stage that is known already; those before it are not computed.

    Returns
    -------
    Stages

    Raises
    ------
    InputError
        If the method is unknown, or there are neither readings nor a stage.
    """
    recipe = find_method(method)
    chosen = options or MethodOptions()
    if metric is not None:
        return Stages(None, None, check_semi_metric(metric))
    if dissimilarity is not None:
        checked = check_semi_metric(dissimilarity)
        return Stages(None, checked, recipe.metric(checked))
    if similarity is None:
        if readings is None:
            raise InputError("there is nothing to map: give a recording, or a precomputed stage")
        logger.info("comparing all pairs of sensors (%s)", recipe.similarity)
        similarity = SIMILARITIES[recipe.similarity].compute(readings, chosen)
    alike = symmetric(similarity, "similarity")
    apart = recipe.dissimilarity(alike, chosen)
    logger.info("finding shortest paths")
    return Stages(alike, apart, recipe.metric(apart))
