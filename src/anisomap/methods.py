"""The named methods: each a chain of stages that turns readings into a metric.

After these stages, all methods scale the metric into space (`anisomap.reconstruction`), and some
refine what comes out by the similarity::

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
from numpy.typing import ArrayLike

from anisomap.errors import InputError
from anisomap.numerics.contacts import ContactOptions
from anisomap.numerics.covariogram.objective import CovariogramOptions
from anisomap.numerics.graph.connectivity import (
    neighbour_graph,
    smallest_connected_neighbour_graph,
)
from anisomap.numerics.graph.dissimilarity import (
    as_symmetric,
    direct_dissimilarity,
    information_distance,
    regularised_reciprocal,
)
from anisomap.numerics.graph.metric import check_semi_metric, metricise
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.blending import blended_correlation
from anisomap.numerics.reliability.sampling_noise import sampling_variance
from anisomap.numerics.reliability.significance import remove_insignificant_links
from anisomap.numerics.scaling.stress_minimisation import SmacofOptions
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.numerics.similarity.correlation import co_activation, pearson, spearman
from anisomap.numerics.similarity.information import mutual_information
from anisomap.refinement import Evidence, Refined, refine_by_contacts, refine_by_covariogram

logger = logging.getLogger(__name__)

Matrix: TypeAlias = Reals
DEFAULT_METHOD = "covariogram"

_ROUNDING = 1e-6
_MOSTLY_KNOWN = 0.6


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
    covariogram : CovariogramOptions
        Of the method of that name.
    contacts : ContactOptions
        Of the method "contact-fit".
    part : bool
        Whether the covariogram method parts sensors that nothing beyond chance holds together.
    independent_frames : float
        How many independent frames correlations are taken to come from, above 0, where there are
        no readings to tell: the fewer, the less they are believed.
    even_spacing : bool
        Declare that neighbours are evenly spaced, for methods that can make use of it: see
        `Method.takes_even_spacing`. A map says so where it rests on it.
    fewest_sensors : int
        Refuse to make a map whose largest piece holds fewer sensors: two always fit.
    """

    mu: float = 1.0
    bins: int = DEFAULT_BINS
    n_neighbours: int | None = None
    smacof: SmacofOptions = field(default_factory=SmacofOptions)
    covariogram: CovariogramOptions = field(default_factory=CovariogramOptions)
    contacts: ContactOptions = field(default_factory=ContactOptions)
    part: bool = True
    independent_frames: float = 500.0
    even_spacing: bool = False
    fewest_sensors: int = 3

    def __post_init__(self) -> None:
        if not (np.isfinite(self.mu) and self.mu >= 0):
            raise InputError(f"mu is {self.mu}; it must be a number of at least 0")
        if not (np.isfinite(self.independent_frames) and self.independent_frames > 0):
            raise InputError(
                f"independent_frames is {self.independent_frames}; it must be a number above 0"
            )


@dataclass(frozen=True)
class Similarity:
    """A pairwise statistic: ``compute(readings, options)`` gives the (N, N) similarity."""

    summary: str
    compute: Callable[[ArrayLike, MethodOptions], Matrix]


Refine: TypeAlias = Callable[[Evidence, Matrix, Matrix, MethodOptions], Refined]


@dataclass(frozen=True)
class Method:
    """A recipe: which similarity, and how it becomes a dissimilarity, a metric, and places.

    Attributes
    ----------
    summary : str
    similarity : str
        A key of `SIMILARITIES`.
    dissimilarity : callable
        ``dissimilarity(evidence, options)`` gives M, shape (n, n).
    metric : callable
        ``metric(M)`` gives D.
    refine : callable, optional
        ``refine(evidence, D, positions, options)`` gives better positions than scaling D does.
    takes_even_spacing : bool
        Whether `refine` can make use of evenly spaced neighbours.
    """

    summary: str
    similarity: str
    dissimilarity: Callable[[Evidence, MethodOptions], Matrix]
    metric: Callable[[Matrix], Matrix]
    refine: Refine | None = None
    takes_even_spacing: bool = False


@dataclass(frozen=True, eq=False)
class Stages:
    """What a method computes before it scales; None where a later stage was given instead.

    Attributes
    ----------
    evidence : Evidence or None
    dissimilarity, metric : ndarray of shape (n, n) or None
        Of the sensors that take part, in their order.
    """

    evidence: Evidence | None
    dissimilarity: Matrix | None
    metric: Matrix

    @property
    def similarity(self) -> Matrix | None:
        """How alike the sensors are, shape (n, n); None where a later stage was given."""
        return None if self.evidence is None else self.evidence.similarity


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
        "blended-correlation": Similarity(
            "linear correlation where it is reliable, else of ranks",
            lambda x, _: blended_correlation(x),
        ),
    }
)


def _reciprocal(evidence: Evidence, options: MethodOptions) -> Matrix:
    return regularised_reciprocal(evidence.similarity, options.mu)


def _information_distance(evidence: Evidence, _: MethodOptions) -> Matrix:
    return information_distance(evidence.similarity)


def _direct(evidence: Evidence, options: MethodOptions) -> Matrix:
    if evidence.known.mean() < _MOSTLY_KNOWN:
        # Partial correlations take all others into account, of which too many are unknown.
        return regularised_reciprocal(np.where(evidence.known, evidence.similarity, 0), options.mu)
    apart = direct_dissimilarity(evidence.similarity, evidence.noise)
    return remove_insignificant_links(apart, evidence.similarity, evidence.noise, part=options.part)


def _covariogram(
    evidence: Evidence, metric: Matrix, positions: Matrix, options: MethodOptions
) -> Refined:
    return refine_by_covariogram(
        evidence, metric, positions, options.covariogram, evenly_spaced=options.even_spacing
    )


def _contact_fit(
    evidence: Evidence, metric: Matrix, positions: Matrix, options: MethodOptions
) -> Refined:
    mapped = _covariogram(evidence, metric, positions, options)
    return refine_by_contacts(evidence, mapped, options.contacts)


def _neighbour_edges(evidence: Evidence, options: MethodOptions) -> Matrix:
    """Information distance between neighbours, and no edge between any others."""
    similarity = evidence.similarity
    ranked = np.where(evidence.known, similarity, -np.inf)
    if options.n_neighbours is None:
        joined, n_neighbours = smallest_connected_neighbour_graph(ranked)
        logger.info("%d neighbours connect every sensor", n_neighbours)
    else:
        joined = neighbour_graph(ranked, options.n_neighbours)
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
        "covariogram": Method(
            "places at which one function of distance explains all correlations",
            "blended-correlation",
            _direct,
            metricise,
            _covariogram,
            takes_even_spacing=True,
        ),
        "contact-fit": Method(
            "the covariogram map, refined by the contacts that made the readings",
            "blended-correlation",
            _direct,
            metricise,
            _contact_fit,
        ),
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


def check_priors(method: str, options: MethodOptions, *, readings: bool) -> None:
    """Check that what was declared of a skin can be made use of.

    Parameters
    ----------
    method : str
        A name in `METHODS`.
    options : MethodOptions
    readings : bool
        Whether there are readings of all sensors in every frame.

    Raises
    ------
    InputError
        If even spacing was declared to a method that has no use for it, or without readings.
    """
    if not options.even_spacing:
        return
    if not find_method(method).takes_even_spacing:
        able = ", ".join(name for name, known in METHODS.items() if known.takes_even_spacing)
        raise InputError(f"{method} makes no use of even spacing; use {able}, or leave it out")
    if not readings:
        raise InputError(
            "even spacing is worked out from readings of all sensors in the same frames, which a "
            "precomputed stage, unknown pairs, or runs that lack sensors do not give; leave it out"
        )


def compute_stages(
    readings: ArrayLike | None,
    method: str = DEFAULT_METHOD,
    options: MethodOptions | None = None,
    *,
    similarity: ArrayLike | None = None,
    dissimilarity: ArrayLike | None = None,
    metric: ArrayLike | None = None,
    noise: ArrayLike | None = None,
    known: ArrayLike | None = None,
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
    noise : array_like of shape (N, N), optional
        Sampling variance of a given similarity; that of `MethodOptions.independent_frames` unless
        given.
    known : array_like of bool, shape (N, N), optional
        Which pairs of a given similarity are known; paths lead around the others.

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
    if known is not None and similarity is not None:
        told = np.asarray(known, dtype=bool) | np.eye(len(np.asarray(known)), dtype=bool)
        similarity = np.where(told, similarity, 0)  # whatever stands there, NaN among it
    evidence = _gathered(readings, recipe, chosen, similarity, noise)
    if known is not None:
        evidence = evidence.knowing(np.asarray(known, dtype=bool))
    apart = recipe.dissimilarity(evidence, chosen)
    if known is not None:
        apart[~evidence.known] = np.inf
        np.fill_diagonal(apart, 0)
    logger.info("finding shortest paths")
    return Stages(evidence, apart, recipe.metric(apart))


def _gathered(
    readings: ArrayLike | None,
    recipe: Method,
    options: MethodOptions,
    similarity: ArrayLike | None,
    noise: ArrayLike | None,
) -> Evidence:
    values = None
    if similarity is None:
        if readings is None:
            raise InputError("there is nothing to map: give a recording, or a precomputed stage")
        logger.info("comparing all pairs of sensors (%s)", recipe.similarity)
        similarity = SIMILARITIES[recipe.similarity].compute(readings, options)
        if recipe.refine is not None:
            values = np.asarray(readings)
            noise = sampling_variance(values)
    alike = as_symmetric(similarity, "similarity")
    if recipe.refine is not None and np.abs(alike).max(initial=0) > 1 + _ROUNDING:
        raise InputError(
            f"the similarity reaches {np.abs(alike).max():g}, but this method is of correlations, "
            "from -1 to 1; r-anisomap takes any similarity"
        )
    given = (
        np.array(1 / options.independent_frames) if noise is None else as_symmetric(noise, "noise")
    )
    return Evidence(
        alike,
        np.broadcast_to(given, alike.shape),  # what is the same everywhere takes no room
        np.broadcast_to(np.array(True), alike.shape),
        values,
    )
