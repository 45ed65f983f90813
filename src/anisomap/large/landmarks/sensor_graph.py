"""A graph of sensors and those most like them, without chance links."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from anisomap.large.landmarks.correlations import SensorPairs, correlations, pairs_of
from anisomap.large.landmarks.sketch import Sketch
from anisomap.numerics.graph.connectivity import labels_by_size
from anisomap.numerics.graph.dissimilarity import NUMERICAL_ZERO
from anisomap.numerics.reliability.shared_neighbours import MIN_SHARED, count_shared_neighbours
from anisomap.numerics.similarity.search import most_similar

logger = logging.getLogger(__name__)

WEAK = 0.4
"""SensorPairs below this share of the best that either of their sensors has are not followed."""

STRONG = 0.7
"""From this share on they are followed even where chance may make them."""

FEWEST_MEETINGS = 3.0
"""Meetings beyond those that chance explains on average: so few are an anecdote."""

STRANGERS = 8
"""Sensors outside its piece that each sensor is compared with."""

ROUNDS = 3
"""Times at most that frames are gone through for bridges: each joins pieces to others."""


_BEST_OF_ONE = 0.75  # times the best of all pairs is what the best of one sensor's pairs reaches


class SensorGraph(NamedTuple):
    """Sensors graph to those most like them.

    Attributes
    ----------
    edges : SensorPairs
        The edges.
    component : ndarray of int, shape (N,)
        Which piece each sensor is in: 0 is the largest; of equal ones, the one that holds the first
        sensor comes first.
    """

    edges: SensorPairs
    component: NDArray[np.intp]


def build_graph(links: SensorPairs, known: Sketch, n_neighbours: int) -> SensorGraph:
    """Join each sensor to those with the highest r, where there is no sign of chance.

    Parameters
    ----------
    links : SensorPairs
        Pairs that were looked at.
    known : Sketch
    n_neighbours : int
        Sensors that each is graph to; it may be graph to more, being their neighbour.

    Returns
    -------
    SensorGraph

    Notes
    -----
    A chance link is a short cut from one end of the skin to another, and a thousand sensors span so
    many pairs that some are alike by chance. Three signs tell: r is much lower than the best that
    either sensor has (from such neighbours, a detour over nearer ones is no longer); r is no higher
    than chance may make it (`largest_null_r`; that of a sensor that was hardly touched may be its
    best, and is kept); or the sensors have hardly any neighbour in common (on a line they share
    half of them, in a plane a third or more).
    """
    n_sensors = len(known.mean)
    best = np.zeros(n_sensors)
    np.maximum.at(best, links.firsts, links.r)
    np.maximum.at(best, links.seconds, links.r)
    share = links.r / np.maximum(np.minimum(best[links.firsts], best[links.seconds]), 1e-300)
    usable = (links.r >= NUMERICAL_ZERO) & (share >= WEAK)
    chance = largest_null_r(links, known, meetings=0)
    usable &= ((share >= STRONG) & (links.r >= _BEST_OF_ONE * chance)) | (
        links.r >= largest_null_r(links, known)
    )
    near = links.select(usable)
    near = near.select(_among_best(near, n_sensors, n_neighbours))
    edges = near.select(_borne_out(near, n_sensors))
    return SensorGraph(edges, component_labels(edges, n_sensors))


def _borne_out(links: SensorPairs, n_sensors: int) -> NDArray[np.bool_]:
    """Tell which links join sensors that have neighbours in common."""
    graph = adjacency_matrix(links, np.arange(1.0, len(links.r) + 1), n_sensors)
    shared = count_shared_neighbours(graph)
    starts, ends = graph.tocoo().coords
    degrees = np.diff(graph.indptr)
    enough = shared >= MIN_SHARED * (np.minimum(degrees[starts], degrees[ends]) - 1)
    found = np.zeros(len(links.r), dtype=bool)
    found[graph.data[enough].astype(np.int64) - 1] = True
    return found


def bridge_components(
    graph: SensorGraph, known: Sketch, chunks: Callable[[], Iterable[NDArray[Any]]]
) -> tuple[SensorGraph, SensorPairs]:
    """Look for links between pieces: r that is beyond what chance gives the best of all pairs.

    Parameters
    ----------
    graph : SensorGraph
    known : Sketch
    chunks : callable
        Opens the frames that were sketched, from the first on.

    Returns
    -------
    graph : SensorGraph
        Pieces that are left have nothing beyond chance in common, as far as their sketches tell.
    looked_at : SensorPairs
        All pairs that r was worked out for on the way.

    Notes
    -----
    Sensors that share a rigid plate are so like one another that their nearest kin are all on it.
    """
    looked_at = graph.edges.select(np.zeros(len(graph.edges.r), dtype=bool))
    for _ in range(ROUNDS):
        outside = np.flatnonzero((graph.component > 0) & known.varying)
        if not outside.size:
            break
        logger.info("looking for relations of %d sensors with other pieces", outside.size)
        found, _ = most_similar(
            known.projections, STRANGERS, groups=graph.component, sensors=outside
        )
        links = correlations(chunks(), known, pairs_of(found, outside))
        looked_at = looked_at.concatenate(links)
        bridges = links.select(links.r >= largest_null_r(links, known))
        if not bridges.r.size:
            break
        edges = graph.edges.concatenate(bridges)
        graph = SensorGraph(edges, component_labels(edges, len(known.mean)))
    return graph, looked_at


def largest_null_r(
    links: SensorPairs, known: Sketch, meetings: float = FEWEST_MEETINGS
) -> NDArray[np.float64]:
    """Tell which r the best of all unrelated pairs may reach by chance.

    Parameters
    ----------
    links : SensorPairs
    known : Sketch
        How often, and for how long, sensors were touched.
    meetings : float
        So many chance meetings more are allowed for, since few events are spread wider than many.

    Returns
    -------
    ndarray of shape (P,)

    Notes
    -----
    Two sensors that are touched c and c' times in T frames, for d and d' frames each, meet about
    ``c c' (d + d') / T`` times by chance, and r grows by ``(c c')^(-1/2)`` with each. So its
    standard deviation is ``((d + d') / T)^(1/2)``, as of so many independent frames; of P pairs the
    best is ``(2 log P)^(1/2)`` deviations off.
    """
    n_sensors = len(known.mean)
    touched = np.maximum(known.contacts, 1)
    duration = known.active_frames / touched
    deviations = np.sqrt(2 * np.log(max(n_sensors * (n_sensors - 1) / 2, 2)))
    together = (duration[links.firsts] + duration[links.seconds]) / known.n_frames
    contacts = np.sqrt(touched[links.firsts] * touched[links.seconds])
    return np.asarray(deviations * np.sqrt(together) + meetings / contacts)


def edge_lengths(links: SensorPairs, edges: SensorPairs, mu: float) -> NDArray[np.float64]:
    """Give the length of every edge: the regularised reciprocal of its r.

    Parameters
    ----------
    links : SensorPairs
        All pairs that were looked at: the smallest positive r is one of theirs.
    edges : SensorPairs
    mu : float
        See `anisomap.numerics.graph.dissimilarity.regularised_reciprocal`.

    Returns
    -------
    ndarray of shape (E,)
    """
    smallest = float(links.r.min(where=links.r >= NUMERICAL_ZERO, initial=1.0))
    return np.asarray(1 / (edges.r + mu * smallest))


def adjacency_matrix(
    edges: SensorPairs, lengths: NDArray[np.float64], n_sensors: int
) -> csr_array[np.float64, tuple[int, int]]:
    """Give edges as a symmetric sparse matrix of their lengths, columns in increasing order."""
    ends = np.concatenate([edges.firsts, edges.seconds])
    others = np.concatenate([edges.seconds, edges.firsts])
    graph = csr_array((np.tile(lengths, 2), (ends, others)), shape=(n_sensors, n_sensors))
    graph.sort_indices()
    return graph


def component_labels(edges: SensorPairs, n_sensors: int) -> NDArray[np.intp]:
    """Tell which sensors hang together; see `SensorGraph.component`."""
    graph = adjacency_matrix(edges, np.ones(len(edges.r)), n_sensors)
    return labels_by_size(connected_components(graph, directed=False)[1])


def _among_best(links: SensorPairs, n_sensors: int, neighbours: int) -> NDArray[np.bool_]:
    """Tell which pairs are among the best of either of their sensors."""
    whose = np.concatenate([links.firsts, links.seconds])
    order = np.lexsort((-np.tile(links.r, 2), whose))
    begins = np.searchsorted(whose[order], np.arange(n_sensors))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order)) - begins[whose[order]]
    return np.asarray((rank < neighbours).reshape(2, -1).any(axis=0))
