"""The named methods, and the parameters of their stages.

A method is a chain of stages::

    readings --similarity--> S --dissimilarity--> M --metric--> D --scaling--> positions

and some methods refine the positions by S. To add a method, add one line to `METHODS`; to add a
similarity, add one line to `anisomap.stages.pairs.SIMILARITIES`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from anisomap.errors import InputError
from anisomap.numerics.contacts import ContactOptions
from anisomap.numerics.contacts.contact_agreement import shows_single_contacts
from anisomap.numerics.covariogram.minimisation import SharedCurvature
from anisomap.numerics.covariogram.objective import CovariogramOptions
from anisomap.numerics.graph.connectivity import (
    neighbour_graph,
    smallest_connected_neighbour_graph,
)
from anisomap.numerics.graph.dissimilarity import (
    direct_dissimilarity,
    information_distance,
    regularised_reciprocal,
)
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.significance import remove_insignificant_links
from anisomap.numerics.scaling.stress_minimisation import SmacofOptions
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.recording import Recording
from anisomap.stages.contact_average import average_with_contacts, refine_by_contacts
from anisomap.stages.pairs import PairStatistics
from anisomap.stages.refinement import Refined, refine_by_covariogram

logger = logging.getLogger(__name__)

DEFAULT_METHOD = "covariogram"

_MIN_KNOWN = 0.6  # share of known pairs below which partial correlations miss too much


@dataclass(frozen=True)
class MethodOptions:
    """Parameters of the methods; each method uses those of its stages.

    Parameters
    ----------
    mu : float
        Regularisation of the reciprocal, at least 0. With 0, unrelated sensors are infinitely far
        apart, and components come out as separate maps.
    bins : int
        Bins per sensor for entropies, at least 2.
    n_neighbours : int, optional
        Neighbours per sensor in ISOMAP's graph; by default the smallest number that connects all.
    smacof : SmacofOptions
        Stopping criteria of the scaling.
    covariogram : CovariogramOptions
        Parameters of the method "covariogram".
    contacts : ContactOptions
        Parameters of the fit of contacts, in "covariogram" and "contact-fit".
    split_unrelated : bool
        Whether the covariogram method separates components without statistically significant
        links.
    independent_frames : float
        Effective sample size of correlations that are given without readings, above 0.
    even_spacing : bool
        Whether neighbours are declared to be evenly spaced, for methods with
        `Method.takes_even_spacing`. A map that relies on the declaration carries a note.
    min_sensors : int
        Minimum number of sensors in the largest component of a map.

    Raises
    ------
    InputError
        If `mu` or `independent_frames` is out of range.
    """

    mu: float = 1.0
    bins: int = DEFAULT_BINS
    n_neighbours: int | None = None
    smacof: SmacofOptions = field(default_factory=SmacofOptions)
    covariogram: CovariogramOptions = field(default_factory=CovariogramOptions)
    contacts: ContactOptions = field(default_factory=ContactOptions)
    split_unrelated: bool = True
    independent_frames: float = 500.0
    even_spacing: bool = False
    min_sensors: int = 3

    def __post_init__(self) -> None:
        for name, least in (("bins", 2), ("n_neighbours", 1), ("min_sensors", 1)):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int | np.integer) and value >= least):
                raise InputError(
                    f"{name} must be a whole number of at least {least}, got {value!r}"
                )
        if not (isinstance(self.mu, int | float) and np.isfinite(self.mu) and self.mu >= 0):
            raise InputError(f"mu must be a finite number of at least 0, got {self.mu}")
        if not (np.isfinite(self.independent_frames) and self.independent_frames > 0):
            raise InputError(
                f"independent_frames must be a finite number above 0, got {self.independent_frames}"
            )


@dataclass(frozen=True)
class Method:
    """The stages of a named method.

    Attributes
    ----------
    summary : str
        Description in one line, for lists of methods.
    similarity : str
        A key of `anisomap.stages.pairs.SIMILARITIES`.
    dissimilarity : callable
        ``dissimilarity(pairs, options)`` returns M, shape (n, n).
    metric : callable
        ``metric(M)`` returns D.
    refine : callable, optional
        ``refine(pairs, D, positions, options)`` refines the positions of one component and returns
        a `Refined`. None if the scaled positions are the result.
    takes_even_spacing : bool
        Whether `refine` can use declared even spacing of neighbours.
    contact_similarity : str, optional
        Similarity that takes the place of `similarity` for readings that are on or off and show
        one contact at a time.
    """

    summary: str
    similarity: str
    dissimilarity: Callable[[PairStatistics, MethodOptions], Reals]
    metric: Callable[[Reals], Reals]
    refine: Callable[[PairStatistics, Reals, Reals, MethodOptions], Refined] | None = None
    takes_even_spacing: bool = False
    contact_similarity: str | None = None

    def similarity_of(self, runs: Sequence[Recording]) -> str:
        """Return the key of the similarity for some recordings."""
        if self.contact_similarity is None:
            return self.similarity
        single = all(shows_single_contacts(run.readings) for run in runs)
        return self.contact_similarity if single else self.similarity


def _reciprocal(pairs: PairStatistics, options: MethodOptions) -> Reals:
    return regularised_reciprocal(pairs.similarity, options.mu)


def _information_distance(pairs: PairStatistics, _: MethodOptions) -> Reals:
    return information_distance(pairs.similarity)


def _direct(pairs: PairStatistics, options: MethodOptions) -> Reals:
    pairs.check_correlations()
    if pairs.known.mean() < _MIN_KNOWN:
        return regularised_reciprocal(pairs.similarity, options.mu)
    direct = direct_dissimilarity(pairs.similarity, pairs.noise)
    return remove_insignificant_links(
        direct, pairs.similarity, pairs.noise, split_unrelated=options.split_unrelated
    )


def _neighbour_edges(pairs: PairStatistics, options: MethodOptions) -> Reals:
    """Information distance between neighbours, infinite between all others."""
    similarity = pairs.similarity
    ranked = np.where(pairs.known, similarity, -np.inf)
    if options.n_neighbours is None:
        joined, n_neighbours = smallest_connected_neighbour_graph(ranked)
        logger.debug("%d neighbours connect all sensors", n_neighbours)
    else:
        joined = neighbour_graph(ranked, options.n_neighbours)
    edges = np.where(joined, information_distance(similarity), np.inf)
    np.fill_diagonal(edges, 0)
    return edges


def _identity(dissimilarity: Reals) -> Reals:
    return dissimilarity


def _covariogram(
    pairs: PairStatistics, metric: Reals, positions: Reals, options: MethodOptions
) -> Refined:
    mapped = refine_without_contacts(pairs, metric, positions, options)
    return average_with_contacts(pairs, mapped, options.contacts)


def _contact_fit(
    pairs: PairStatistics, metric: Reals, positions: Reals, options: MethodOptions
) -> Refined:
    mapped = refine_without_contacts(pairs, metric, positions, options)
    return refine_by_contacts(pairs, mapped, options.contacts)


def refine_without_contacts(
    pairs: PairStatistics,
    metric: Reals,
    positions: Reals,
    options: MethodOptions,
    *,
    with_heights: bool = True,
    curvature: SharedCurvature | None = None,
) -> Refined:
    """Refine one component as the default method does before it fits contacts.

    See `anisomap.stages.refinement.refine_by_covariogram`.
    """
    return refine_by_covariogram(
        pairs,
        metric,
        positions,
        options.covariogram,
        evenly_spaced=options.even_spacing,
        with_heights=with_heights,
        curvature=curvature,
    )


def _anisomap(similarity: str, summary: str) -> Method:
    return Method(summary, similarity, _reciprocal, metricise)


PAPER_METHODS = ("r-anisomap", "i-anisomap", "information-distance", "isomap")
"""The methods of McGregor et al. (2011), in the order of its Figure 3, best to worst."""

METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "covariogram": Method(
            "positions at which one function of distance explains all correlations, averaged with "
            "a fit of contacts where they are compact",
            "blended-correlation",
            _direct,
            metricise,
            _covariogram,
            takes_even_spacing=True,
            contact_similarity="contact-agreement",
        ),
        "contact-fit": Method(
            "the covariogram map, refined by a fit of the contacts that caused the readings",
            "blended-correlation",
            _direct,
            metricise,
            _contact_fit,
            contact_similarity="contact-agreement",
        ),
        "r-anisomap": _anisomap("pearson", "ANISOMAP on linear correlation"),
        "i-anisomap": _anisomap("mutual-information", "ANISOMAP on mutual information"),
        "information-distance": Method(
            "information distance, scaled without shortest paths",
            "mutual-information",
            _information_distance,
            _identity,
        ),
        "isomap": Method(
            "ISOMAP: shortest paths of information distance between neighbours",
            "mutual-information",
            _neighbour_edges,
            metricise,
        ),
        "spearman-anisomap": _anisomap("spearman", "ANISOMAP on rank correlation"),
        "co-activation-anisomap": _anisomap("co-activation", "ANISOMAP on binary contact (phi)"),
    }
)


def find_method(name: str) -> Method:
    """Look up a method by its name, a key of `METHODS`.

    Raises
    ------
    InputError
        If there is no method of that name; the message lists all names.
    """
    if name not in METHODS:
        raise InputError(f"there is no method {name!r}; choose from {', '.join(METHODS)}")
    return METHODS[name]


def examined_metric(
    recipe: Method, pairs: PairStatistics | None, metric: Reals, options: MethodOptions
) -> Reals | None:
    """Return the metric from which the number of dimensions can be chosen.

    Parameters
    ----------
    recipe : Method
    pairs : PairStatistics, optional
        The similarity, if the map starts from one.
    metric : ndarray of shape (n, n)
        That of the method.
    options : MethodOptions

    Returns
    -------
    ndarray of shape (n, n), optional
        The metric of the default method, for which the choice was tuned, where the similarity of
        the method is a correlation; the given one without a similarity; otherwise None.
    """
    default = METHODS[DEFAULT_METHOD]
    if pairs is None or recipe.dissimilarity == default.dissimilarity:
        return metric
    if recipe.similarity == "mutual-information":
        return None
    dissimilarity = default.dissimilarity(pairs, options)
    dissimilarity[~pairs.known] = np.inf
    np.fill_diagonal(dissimilarity, 0)
    return default.metric(dissimilarity)


def check_even_spacing(method: str, options: MethodOptions, *, readings: bool) -> None:
    """Check that declared even spacing can be used.

    Parameters
    ----------
    method : str
        A key of `METHODS`.
    options : MethodOptions
    readings : bool
        Whether there are readings of all sensors in every frame.

    Raises
    ------
    InputError
        If even spacing was declared for a method that cannot use it, or without readings.
    """
    if not options.even_spacing:
        return
    if not find_method(method).takes_even_spacing:
        able = ", ".join(name for name, known in METHODS.items() if known.takes_even_spacing)
        raise InputError(f"{method} does not support even spacing; use {able}, or leave it out")
    if not readings:
        raise InputError(
            "even spacing requires readings of all sensors in the same frames, which precomputed "
            "stages, unknown pairs and runs that lack sensors do not have; leave it out"
        )
