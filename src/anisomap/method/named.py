"""The named methods.

A method is a chain of stages::

    readings --similarity--> S --dissimilarity--> M --metric--> D --scaling--> positions

Some methods then refine the positions by S. To add a method, add one line to `METHODS`; to add a
similarity, add one line to `anisomap.method.evidence.SIMILARITIES`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from anisomap.errors import InputError
from anisomap.method.evidence import Evidence
from anisomap.method.refinement import Refinement, refine
from anisomap.numerics.covariogram.objective import DEFAULT_COVARIOGRAM, CovariogramOptions
from anisomap.numerics.graph.dissimilarity import (
    direct_dissimilarity,
    information_distance,
    regularised_reciprocal,
)
from anisomap.numerics.graph.metric import metricise, with_bounded_stems
from anisomap.numerics.graph.neighbour_graphs import (
    neighbour_graph,
    smallest_connected_neighbour_graph,
)
from anisomap.numerics.precision import Reals
from anisomap.numerics.ranges import COUNT, NOT_NEGATIVE, POSITIVE, at_least, check_ranges
from anisomap.numerics.reliability.sampling_noise import remove_insignificant_links
from anisomap.numerics.scaling.multidimensional_scaling import (
    AUTO_SOLVER,
    DEFAULT_SMACOF,
    SmacofOptions,
)
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.numerics.similarity.contact_agreement import shows_single_contacts
from anisomap.recording import Recording

logger = logging.getLogger(__name__)

_PUBLISHED = "majorization"  # the paper's SMACOF

MAX_MAJORIZED = 500
"""Maximum number of sensors that the paper's methods scale by majorization. The paper used it for
up to 169 sensors. For more than 500, it takes minutes, and L-BFGS seconds."""

_ROUNDING = 1e-6  # by which a computed correlation may exceed 1
_MIN_KNOWN = 0.6  # minimum share of known pairs for partial correlations

DEFAULT_MU = 1.0
"""Regularisation of the reciprocal; the paper gives no value, and 0.01 results in equal maps."""

_RANGES = {
    "regularisation": NOT_NEGATIVE,
    "entropy_bins": at_least(2, whole=True),
    "n_neighbours": COUNT,
    "independent_frames": POSITIVE,
    "min_sensors": COUNT,
}


@dataclass(frozen=True)
class MethodOptions:
    """Parameters of the methods; each method uses those of its stages.

    Parameters
    ----------
    regularisation : float
        Regularisation of the reciprocal, mu in the paper, at least 0. With 0, unrelated sensors are
        infinitely far apart, and each component is mapped separately.
    entropy_bins : int
        Bins per sensor for entropies, at least 2.
    n_neighbours : int, optional
        Neighbours per sensor in ISOMAP's graph; by default the smallest number that connects all.
    smacof : SmacofOptions
        Stopping criteria of the scaling.
    covariogram : CovariogramOptions
        Parameters of the method "covariogram".
    independent_frames : float
        Effective sample size of correlations that are given without readings, above 0.
    min_sensors : int
        Minimum number of sensors in the largest component of a map.

    Raises
    ------
    InputError
        If a value is out of range.
    """

    regularisation: float = DEFAULT_MU
    entropy_bins: int = DEFAULT_BINS
    n_neighbours: int | None = None
    smacof: SmacofOptions = DEFAULT_SMACOF
    covariogram: CovariogramOptions = DEFAULT_COVARIOGRAM
    independent_frames: float = 500.0
    min_sensors: int = 3

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)


DEFAULT_OPTIONS = MethodOptions()


Refine: TypeAlias = Callable[..., Refinement | None]


@dataclass(frozen=True)
class Method:
    """The stages of a named method.

    summary: Description in one line, for lists of methods.
    similarity: A key of `anisomap.method.evidence.SIMILARITIES`.
    dissimilarity: ``dissimilarity(evidence, options)`` returns M, (n, n).
    metric: ``metric(M)`` returns D.
    refine: Refines the scaled positions of one component, see `anisomap.method.refinement.refine`.
    contact_similarity: Replaces `similarity` for readings that are on or off and show one contact
        at a time.
    solver: Solver for up to `MAX_MAJORIZED` sensors, if the options do not specify one.
    """

    summary: str
    similarity: str
    dissimilarity: Callable[[Evidence, MethodOptions], Reals]
    metric: Callable[[Reals], Reals]
    refine: Refine | None = None
    contact_similarity: str | None = None
    solver: str = AUTO_SOLVER

    def lengths_of(self, evidence: Evidence, options: MethodOptions) -> Reals:
        """Compute D, shape (n, n); unknown pairs have no edge."""
        dissimilarity = self.dissimilarity(evidence, options)
        if not evidence.known.all():
            dissimilarity[~evidence.known] = np.inf
            np.fill_diagonal(dissimilarity, 0)
        lengths = self.metric(dissimilarity)
        if self.refine is None:
            return lengths
        return with_bounded_stems(lengths, evidence.groups.hidden)

    def scaling_of(self, n_sensors: int, options: SmacofOptions) -> SmacofOptions:
        """Return the options of scaling for a number of sensors."""
        if options.solver != AUTO_SOLVER or n_sensors > MAX_MAJORIZED or self.solver == AUTO_SOLVER:
            return options
        return replace(options, solver=self.solver)

    def similarity_of(self, recording: Recording) -> str:
        """Return the key of the similarity for a recording."""
        if self.contact_similarity is None:
            return self.similarity
        single = all(
            part.on_off and shows_single_contacts(part.readings) for part in recording.parts
        )
        return self.contact_similarity if single else self.similarity


def _reciprocal(evidence: Evidence, options: MethodOptions) -> Reals:
    return regularised_reciprocal(evidence.similarity, options.regularisation)


def _information_distance(evidence: Evidence, _: MethodOptions) -> Reals:
    return information_distance(evidence.similarity)


def _direct(evidence: Evidence, options: MethodOptions) -> Reals:
    largest = np.abs(evidence.similarity).max(initial=0)
    if largest > 1 + _ROUNDING:
        raise InputError(f"correlations must be in [-1, 1], not {largest:g}; r-anisomap allows any")
    if evidence.known.mean() < _MIN_KNOWN:
        return regularised_reciprocal(evidence.similarity, options.regularisation)
    direct = direct_dissimilarity(evidence.similarity, evidence.variance)
    return remove_insignificant_links(
        direct, evidence.similarity, evidence.variance, evidence.groups.related
    )


def _neighbour_edges(evidence: Evidence, options: MethodOptions) -> Reals:
    """Return the information distance between neighbours, infinite for other pairs."""
    similarity = evidence.similarity
    ranked = np.where(evidence.known, similarity, -np.inf)
    if options.n_neighbours is None:
        joined, n_neighbours = smallest_connected_neighbour_graph(ranked)
        logger.debug("%d neighbours connect all sensors", n_neighbours)
    else:
        joined = neighbour_graph(ranked, options.n_neighbours)
    edges = np.where(joined, information_distance(similarity), np.inf)
    np.fill_diagonal(edges, 0)
    return edges


def _anisomap(similarity: str, summary: str, solver: str = AUTO_SOLVER) -> Method:
    return Method(summary, similarity, _reciprocal, metricise, solver=solver)


PAPER_METHODS = ("r-anisomap", "i-anisomap", "information-distance", "isomap")
"""The methods of McGregor et al. (2011)."""

METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "covariogram": Method(
            "positions at which one function of distance explains all correlations",
            "blended-correlation",
            _direct,
            metricise,
            refine,
            contact_similarity="contact-agreement",
        ),
        "r-anisomap": _anisomap("pearson", "ANISOMAP on linear correlation", _PUBLISHED),
        "i-anisomap": _anisomap("mutual-information", "ANISOMAP on mutual information", _PUBLISHED),
        "information-distance": Method(
            "information distance, scaled without shortest paths",
            "mutual-information",
            _information_distance,
            np.asarray,
            solver=_PUBLISHED,
        ),
        "isomap": Method(
            "ISOMAP: shortest paths of information distance between neighbours",
            "mutual-information",
            _neighbour_edges,
            metricise,
            solver=_PUBLISHED,
        ),
        "spearman-anisomap": _anisomap("spearman", "ANISOMAP on rank correlation"),
        "co-activation-anisomap": _anisomap("co-activation", "ANISOMAP on binary contact (phi)"),
    }
)


def find_method(name: str) -> Method:
    """Look up a method by its name, a key of `METHODS`; an error lists all names."""
    if name not in METHODS:
        raise InputError(f"there is no method {name!r}; choose from {', '.join(METHODS)}")
    return METHODS[name]
