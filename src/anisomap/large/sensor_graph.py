"""Graph of each sensor's most similar sensors, without coincidental links."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from anisomap.large.sketch import SensorPairs, Sketch, correlations, pairs_of
from anisomap.numerics.graph.dissimilarity import NUMERICAL_ZERO
from anisomap.numerics.graph.neighbour_graphs import labels_by_size, most_similar
from anisomap.numerics.reliability.significance import MIN_SHARED, count_shared_neighbours

logger = logging.getLogger(__name__)

# Chosen by hand on simulated skins and the recordings of docs/explanation/large-recordings.md.
MIN_RELATIVE_R = 0.4
"""Minimum r of a link, as a share of the smaller of its sensors' highest r."""

STRONG_RELATIVE_R = 0.7
"""Share of the highest r from which links need only nearly be significant."""

EXTRA_COINCIDENCES = 3.0
"""Coincident contacts beyond their expected number, which is unreliable if small."""

N_OUTSIDE = 8
"""Number of sensors outside its component with which each sensor is compared."""

MAX_BRIDGE_PASSES = 3
"""Maximum number of passes over the frames in search of links between components."""

_SENSOR_OVER_ALL = 0.75  # expected maximum r of one sensor's pairs over that of all pairs


class SensorGraph(NamedTuple):
    """A graph that links sensors to their most similar sensors.

    component: Connected component of each sensor, by decreasing size, ties by the first sensor.
    """

    edges: SensorPairs
    component: NDArray[np.intp]


def build_graph(pairs: SensorPairs, sketch: Sketch, n_neighbours: int) -> SensorGraph:
    """Link each sensor to those with the highest r, and reject pairs that may be coincidental.

    Among the many pairs of thousands of sensors, some are similar by coincidence; as links they
    would be shortcuts across the skin. A link is rejected if r is much lower than the highest r of
    either sensor, since a path over nearer sensors is as short; if r is not significant
    (`largest_null_r`), unless it is close to the highest r of a rarely touched sensor; or if the
    sensors share too few neighbours (`MIN_SHARED`).
    """
    n_sensors = len(sketch.mean)
    best = np.zeros(n_sensors)
    np.maximum.at(best, pairs.firsts, pairs.r)
    np.maximum.at(best, pairs.seconds, pairs.r)
    share = pairs.r / np.maximum(np.minimum(best[pairs.firsts], best[pairs.seconds]), 1e-300)
    usable = (pairs.r >= NUMERICAL_ZERO) & (share >= MIN_RELATIVE_R)
    null = largest_null_r(pairs, sketch, coincidences=0)
    usable &= ((share >= STRONG_RELATIVE_R) & (pairs.r >= _SENSOR_OVER_ALL * null)) | (
        pairs.r >= largest_null_r(pairs, sketch)
    )
    near = pairs.select(usable)
    near = near.select(_among_best(near, n_sensors, n_neighbours))
    edges = near.select(_share_neighbours(near, n_sensors))
    return SensorGraph(edges, component_labels(edges, n_sensors))


def _share_neighbours(pairs: SensorPairs, n_sensors: int) -> NDArray[np.bool_]:
    """Return the mask of pairs that share enough neighbours in the graph of all pairs."""
    graph = adjacency_matrix(pairs, np.arange(1.0, len(pairs.r) + 1), n_sensors)
    shared = count_shared_neighbours(graph)
    starts, ends = graph.tocoo().coords
    degrees = np.diff(graph.indptr)
    enough = shared >= MIN_SHARED * (np.minimum(degrees[starts], degrees[ends]) - 1)
    found = np.zeros(len(pairs.r), dtype=bool)
    found[graph.data[enough].astype(np.int64) - 1] = True
    return found


def bridge_components(
    graph: SensorGraph, sketch: Sketch, chunks: Callable[[], Iterable[NDArray[Any]]]
) -> tuple[SensorGraph, SensorPairs]:
    """Link connected components by significant r.

    Links between components may be missing from the graph, since the sensors of a rigid plate are
    more similar to each other than to any sensor beside it.
    """
    compared = graph.edges.select(np.zeros(len(graph.edges.r), dtype=bool))
    for _ in range(MAX_BRIDGE_PASSES):
        outside = np.flatnonzero((graph.component > 0) & sketch.varying)
        if not outside.size:
            break
        logger.info("searching links of %d sensors to other components", outside.size)
        found, _ = most_similar(
            sketch.projections, N_OUTSIDE, groups=graph.component, sensors=outside
        )
        links = correlations(chunks(), sketch, pairs_of(found, outside))
        compared = compared.concatenate(links)
        bridges = links.select(links.r >= largest_null_r(links, sketch))
        if not bridges.r.size:
            break
        edges = graph.edges.concatenate(bridges)
        graph = SensorGraph(edges, component_labels(edges, len(sketch.mean)))
    return graph, compared


def largest_null_r(
    pairs: SensorPairs, sketch: Sketch, coincidences: float = EXTRA_COINCIDENCES
) -> NDArray[np.float64]:
    """Return, for each pair, the expected maximum r if no sensors were related.

    Returns (P,).

    Two sensors touched c and c' times in T frames, for d and d' frames each, are touched together
    about ``c c' (d + d') / T`` times by coincidence, and each time raises r by ``(c c')^(-1/2)``.
    The null standard deviation of r is therefore ``((d + d') / T)^(1/2)``, as of ``T / (d + d')``
    independent frames; the maximum of P pairs is ``(2 log P)^(1/2)`` standard deviations.
    """
    n_sensors = len(sketch.mean)
    touched = np.maximum(sketch.contacts, 1)
    duration = sketch.active_frames / touched
    deviations = np.sqrt(2 * np.log(max(n_sensors * (n_sensors - 1) / 2, 2)))
    together = (duration[pairs.firsts] + duration[pairs.seconds]) / sketch.n_frames
    contacts = np.sqrt(touched[pairs.firsts] * touched[pairs.seconds])
    return np.asarray(deviations * np.sqrt(together) + coincidences / contacts)


def edge_lengths(pairs: SensorPairs, edges: SensorPairs, mu: float) -> NDArray[np.float64]:
    """Return the length of every edge, the regularised reciprocal of its r. Returns (E,)."""
    smallest = float(pairs.r.min(where=pairs.r >= NUMERICAL_ZERO, initial=1.0))
    return np.asarray(1 / (edges.r + mu * smallest))


def adjacency_matrix(
    edges: SensorPairs, lengths: NDArray[np.float64], n_sensors: int
) -> csr_array[np.float64, tuple[int, int]]:
    """Return the symmetric sparse matrix of edge lengths, with sorted column indices."""
    ends = np.concatenate([edges.firsts, edges.seconds])
    others = np.concatenate([edges.seconds, edges.firsts])
    graph = csr_array((np.tile(lengths, 2), (ends, others)), shape=(n_sensors, n_sensors))
    graph.sort_indices()
    return graph


def component_labels(edges: SensorPairs, n_sensors: int) -> NDArray[np.intp]:
    """Return the connected component of each sensor; see `SensorGraph.component`."""
    graph = adjacency_matrix(edges, np.ones(len(edges.r)), n_sensors)
    return labels_by_size(connected_components(graph, directed=False)[1])


def _among_best(links: SensorPairs, n_sensors: int, neighbours: int) -> NDArray[np.bool_]:
    """Return the mask of pairs that are among the best of either sensor."""
    owners = np.concatenate([links.firsts, links.seconds])
    order = np.lexsort((-np.tile(links.r, 2), owners))
    begins = np.searchsorted(owners[order], np.arange(n_sensors))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order)) - begins[owners[order]]
    return np.asarray((rank < neighbours).reshape(2, -1).any(axis=0))
