"""A graph of sensors and those most like them, without chance links."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from anisomap.numerics.approximate.candidates import loops
from anisomap.numerics.approximate.correlations import Links
from anisomap.numerics.approximate.sketch import Sketch
from anisomap.numerics.dissimilarity import NUMERICAL_ZERO

SHARED = 0.15
"""Share of their neighbours that two sensors have in common at least if they lie side by side."""

_FEWEST_MEETINGS = 3.0


class Joined(NamedTuple):
    """Sensors joined to those most like them.

    Attributes
    ----------
    links : Links
        The edges.
    pieces : ndarray of int, shape (N,)
        Which piece each sensor is in: 0 is the largest; of equal ones, the one that holds the first
        sensor comes first.
    """

    links: Links
    pieces: NDArray[np.intp]


def join(links: Links, n_sensors: int, neighbours: int) -> Joined:
    """Join each sensor to those with the highest r, where others bear the link out.

    Parameters
    ----------
    links : Links
        Pairs that were looked at; those without a positive r are no edges.
    n_sensors : int
    neighbours : int
        Sensors that each is joined to; it may be joined to more, being their neighbour.

    Returns
    -------
    Joined

    Notes
    -----
    Sensors that lie side by side have neighbours in common: half of them on a line, a third or
    more in a plane. One that is like others by chance only (its wire broken, say) is like sensors
    from all over the skin, and as an edge such a link would be a short cut from one end to the
    other: so edges whose ends share fewer than 15 % of their neighbours are left out.
    """
    near = links.chosen(_among_best(links, n_sensors, neighbours))
    graph = as_graph(near, near.r, n_sensors)
    starts = np.repeat(np.arange(n_sensors), np.diff(graph.indptr))
    ends, offsets = graph.indices.astype(np.int64), graph.indptr.astype(np.int64)
    shared = np.zeros(len(ends), dtype=np.int64)
    loops().count_shared(offsets, ends, starts, shared)
    degrees = np.diff(offsets)
    borne_out = shared >= SHARED * (np.minimum(degrees[starts], degrees[ends]) - 1)
    once = starts < ends
    order = np.lexsort((near.seconds, near.firsts))  # as the graph has its edges
    edges = Links(*(column[order] for column in near)).chosen(borne_out[once])
    return Joined(edges, pieces_of(edges, n_sensors))


def chance_level(links: Links, known: Sketch) -> NDArray[np.float64]:
    """Tell which r the best of all unrelated pairs may reach by chance.

    Parameters
    ----------
    links : Links
    known : Sketch
        How often, and for how long, sensors were touched.

    Returns
    -------
    ndarray of shape (P,)

    Notes
    -----
    Two sensors that are touched c and c' times in T frames, for d and d' frames each, meet about
    ``c c' (d + d') / T`` times by chance, and r grows by ``(c c')^(-1/2)`` with each. So its
    standard deviation is ``((d + d') / T)^(1/2)``, as of so many independent frames; of P pairs the
    best is ``(2 log P)^(1/2)`` deviations off. Three meetings more are allowed for, since few
    events are spread wider than many.
    """
    n_sensors = len(known.mean)
    duration = known.away / known.contacts
    deviations = np.sqrt(2 * np.log(max(n_sensors * (n_sensors - 1) / 2, 2)))
    together = (duration[links.firsts] + duration[links.seconds]) / known.n_frames
    contacts = np.sqrt(known.contacts[links.firsts] * known.contacts[links.seconds])
    return np.asarray(deviations * np.sqrt(together) + _FEWEST_MEETINGS / contacts)


def lengths_of(links: Links, edges: Links, mu: float) -> NDArray[np.float64]:
    """Give the length of every edge: the regularised reciprocal of its r.

    Parameters
    ----------
    links : Links
        All pairs that were looked at: the smallest positive r is one of theirs.
    edges : Links
    mu : float
        See `anisomap.numerics.dissimilarity.regularised_reciprocal`.

    Returns
    -------
    ndarray of shape (E,)
    """
    smallest = float(links.r.min(where=links.r >= NUMERICAL_ZERO, initial=1.0))
    return np.asarray(1 / (edges.r + mu * smallest))


def as_graph(
    edges: Links, lengths: NDArray[np.float64], n_sensors: int
) -> csr_array[np.float64, tuple[int, int]]:
    """Give edges as a symmetric sparse matrix of their lengths, columns in increasing order."""
    ends = np.concatenate([edges.firsts, edges.seconds])
    others = np.concatenate([edges.seconds, edges.firsts])
    graph = csr_array((np.tile(lengths, 2), (ends, others)), shape=(n_sensors, n_sensors))
    graph.sort_indices()
    return graph


def pieces_of(edges: Links, n_sensors: int) -> NDArray[np.intp]:
    """Tell which sensors hang together; see `Joined.pieces`."""
    graph = as_graph(edges, np.ones(len(edges.r)), n_sensors)
    labels = connected_components(graph, directed=False)[1]
    sizes = np.bincount(labels)
    first_seen = np.unique(labels, return_index=True)[1]
    order = np.lexsort((first_seen, -sizes))
    return np.argsort(order)[labels]


def _among_best(links: Links, n_sensors: int, neighbours: int) -> NDArray[np.bool_]:
    """Tell which pairs are among the best of either of their sensors."""
    whose = np.concatenate([links.firsts, links.seconds])
    r = np.tile(links.r, 2)
    order = np.lexsort((-r, whose))
    begins = np.searchsorted(whose[order], np.arange(n_sensors))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order)) - begins[whose[order]]
    best = (rank < neighbours) & (r >= NUMERICAL_ZERO)
    return np.asarray(best.reshape(2, -1).any(axis=0))
