"""A graph of sensors and those most like them, without chance links."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from anisomap.large.landmarks.correlations import Links
from anisomap.large.landmarks.options import loops
from anisomap.large.landmarks.sketch import Sketch
from anisomap.numerics.graph.connectivity import labels_by_size
from anisomap.numerics.graph.dissimilarity import NUMERICAL_ZERO

SHARED = 0.3
"""Share of their neighbours that two sensors have in common at least if they lie side by side."""

WEAK = 0.4
"""Links below this share of the best that either of their sensors has are not followed."""

STRONG = 0.7
"""From this share on they are followed even where chance may make them."""

FEWEST_MEETINGS = 3.0
"""Meetings beyond those that chance explains on average: so few are an anecdote."""

_BEST_OF_ONE = 0.75  # times the best of all pairs is what the best of one sensor's pairs reaches


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


def join(links: Links, known: Sketch, neighbours: int) -> Joined:
    """Join each sensor to those with the highest r, where there is no sign of chance.

    Parameters
    ----------
    links : Links
        Pairs that were looked at.
    known : Sketch
    neighbours : int
        Sensors that each is joined to; it may be joined to more, being their neighbour.

    Returns
    -------
    Joined

    Notes
    -----
    A chance link is a short cut from one end of the skin to another, and a thousand sensors span so
    many pairs that some are alike by chance. Three signs tell: r is much lower than the best that
    either sensor has (from such neighbours, a detour over nearer ones is no longer); r is no higher
    than chance may make it (`chance_level`; that of a sensor that was hardly touched may be its
    best, and is kept); or the sensors have hardly any neighbour in common (on a line they share
    half of them, in a plane a third or more).
    """
    n_sensors = len(known.mean)
    best = np.zeros(n_sensors)
    np.maximum.at(best, links.firsts, links.r)
    np.maximum.at(best, links.seconds, links.r)
    share = links.r / np.maximum(np.minimum(best[links.firsts], best[links.seconds]), 1e-300)
    usable = (links.r >= NUMERICAL_ZERO) & (share >= WEAK)
    chance = chance_level(links, known, meetings=0)
    usable &= ((share >= STRONG) & (links.r >= _BEST_OF_ONE * chance)) | (
        links.r >= chance_level(links, known)
    )
    near = links.chosen(usable)
    near = near.chosen(_among_best(near, n_sensors, neighbours))
    edges = near.chosen(_borne_out(near, n_sensors))
    return Joined(edges, pieces_of(edges, n_sensors))


def _borne_out(links: Links, n_sensors: int) -> NDArray[np.bool_]:
    """Tell which links join sensors that have neighbours in common."""
    graph = as_graph(links, np.arange(1.0, len(links.r) + 1), n_sensors)
    starts = np.repeat(np.arange(n_sensors), np.diff(graph.indptr))
    ends, offsets = graph.indices.astype(np.int64), graph.indptr.astype(np.int64)
    shared = np.zeros(len(ends), dtype=np.int64)
    loops().count_shared(offsets, ends, starts, shared)
    degrees = np.diff(offsets)
    enough = shared >= SHARED * (np.minimum(degrees[starts], degrees[ends]) - 1)
    found = np.zeros(len(links.r), dtype=bool)
    found[graph.data[enough].astype(np.int64) - 1] = True
    return found


def chance_level(
    links: Links, known: Sketch, meetings: float = FEWEST_MEETINGS
) -> NDArray[np.float64]:
    """Tell which r the best of all unrelated pairs may reach by chance.

    Parameters
    ----------
    links : Links
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
    duration = known.away / touched
    deviations = np.sqrt(2 * np.log(max(n_sensors * (n_sensors - 1) / 2, 2)))
    together = (duration[links.firsts] + duration[links.seconds]) / known.n_frames
    contacts = np.sqrt(touched[links.firsts] * touched[links.seconds])
    return np.asarray(deviations * np.sqrt(together) + meetings / contacts)


def lengths_of(links: Links, edges: Links, mu: float) -> NDArray[np.float64]:
    """Give the length of every edge: the regularised reciprocal of its r.

    Parameters
    ----------
    links : Links
        All pairs that were looked at: the smallest positive r is one of theirs.
    edges : Links
    mu : float
        See `anisomap.numerics.graph.dissimilarity.regularised_reciprocal`.

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
    return labels_by_size(connected_components(graph, directed=False)[1])


def _among_best(links: Links, n_sensors: int, neighbours: int) -> NDArray[np.bool_]:
    """Tell which pairs are among the best of either of their sensors."""
    whose = np.concatenate([links.firsts, links.seconds])
    order = np.lexsort((-np.tile(links.r, 2), whose))
    begins = np.searchsorted(whose[order], np.arange(n_sensors))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order)) - begins[whose[order]]
    return np.asarray((rank < neighbours).reshape(2, -1).any(axis=0))
