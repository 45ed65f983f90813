"""The named methods, and the parameters of their stages.

A method is a chain of stages::

    readings --similarity--> S --dissimilarity--> M --metric--> D --scaling--> positions

and some methods refine the positions by S. To add a method, add one line to `METHODS`; to add a
similarity, add one line to `anisomap.method.evidence.SIMILARITIES`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.errors import InputError
from anisomap.method.evidence import PairStatistics
from anisomap.method.options import MethodOptions
from anisomap.method.refinements import (
    Step,
    by_contacts,
    by_covariogram,
    by_even_spacing,
    by_heights,
    by_paths,
    only_contacts,
)
from anisomap.numerics.contacts.contact_agreement import shows_single_contacts
from anisomap.numerics.graph.dissimilarity import (
    direct_dissimilarity,
    information_distance,
    regularised_reciprocal,
)
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.graph.neighbour_graphs import (
    neighbour_graph,
    smallest_connected_neighbour_graph,
)
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.sampling_noise import remove_insignificant_links
from anisomap.recording import Recording

logger = logging.getLogger(__name__)

_MIN_KNOWN = 0.6  # share of known pairs below which partial correlations miss too much


@dataclass(frozen=True)
class Method:
    """The stages of a named method.

    Attributes
    ----------
    summary : str
        Description in one line, for lists of methods.
    similarity : str
        A key of `anisomap.method.evidence.SIMILARITIES`.
    dissimilarity : callable
        ``dissimilarity(pairs, options)`` returns M, shape (n, n).
    metric : callable
        ``metric(M)`` returns D.
    refinements : mapping of str to callable
        Steps that refine the positions of one component, in order: see
        `anisomap.method.refinements`. Empty if the scaled positions are the result.
    contact_similarity : str, optional
        Similarity that takes the place of `similarity` for readings that are on or off and show
        one contact at a time.
    """

    summary: str
    similarity: str
    dissimilarity: Callable[[PairStatistics, MethodOptions], Reals]
    metric: Callable[[Reals], Reals]
    refinements: Mapping[str, Step] = field(default_factory=dict)
    contact_similarity: str | None = None

    @property
    def takes_even_spacing(self) -> bool:
        """Whether a step can use declared even spacing of neighbours."""
        return by_even_spacing in self.refinements.values()

    def dissimilarity_of(self, pairs: PairStatistics, options: MethodOptions) -> Reals:
        """Compute M, shape (n, n), infinite for unknown pairs."""
        dissimilarity = self.dissimilarity(pairs, options)
        if not pairs.known.all():
            dissimilarity[~pairs.known] = np.inf
            np.fill_diagonal(dissimilarity, 0)
        return dissimilarity

    def similarity_of(self, runs: Sequence[Recording]) -> str:
        """Return the key of the similarity for some recordings."""
        if self.contact_similarity is None:
            return self.similarity
        single = all(shows_single_contacts(run.readings) for run in runs)
        return self.contact_similarity if single else self.similarity


def _reciprocal(pairs: PairStatistics, options: MethodOptions) -> Reals:
    return regularised_reciprocal(pairs.similarity, options.regularisation)


def _information_distance(pairs: PairStatistics, _: MethodOptions) -> Reals:
    return information_distance(pairs.similarity)


def _direct(pairs: PairStatistics, options: MethodOptions) -> Reals:
    pairs.check_correlations()
    if pairs.known.mean() < _MIN_KNOWN:
        return regularised_reciprocal(pairs.similarity, options.regularisation)
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


def _anisomap(similarity: str, summary: str) -> Method:
    return Method(summary, similarity, _reciprocal, metricise)


PAPER_METHODS = ("r-anisomap", "i-anisomap", "information-distance", "isomap")
"""The methods of McGregor et al. (2011)."""

METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "covariogram": Method(
            "positions at which one function of distance explains all correlations, averaged with "
            "a fit of contacts where they are compact",
            "blended-correlation",
            _direct,
            metricise,
            {
                "covariogram": by_covariogram,
                "even-spacing": by_even_spacing,
                "heights": by_heights,
                "paths": by_paths,
                "contacts": by_contacts,
            },
            contact_similarity="contact-agreement",
        ),
        "contact-fit": Method(
            "the covariogram map, refined by a fit of the contacts that caused the readings",
            "blended-correlation",
            _direct,
            metricise,
            {
                "covariogram": by_covariogram,
                "heights": by_heights,
                "paths": by_paths,
                "contacts": only_contacts,
            },
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
    """Return the metric, (n, n), from which the number of dimensions can be chosen."""
    default = METHODS[DEFAULT_METHOD]
    if pairs is None or recipe.dissimilarity == default.dissimilarity:
        return metric
    if recipe.similarity == "mutual-information":
        return None
    return default.metric(default.dissimilarity_of(pairs, options))


def check_even_spacing(method: str, options: MethodOptions, *, readings: bool) -> None:
    """Check that declared even spacing can be used."""
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
