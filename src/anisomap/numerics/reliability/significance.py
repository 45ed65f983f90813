"""Links between sensors that chance does not explain: what they hold together, and join."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from anisomap.numerics.precision import Reals, as_reals, row_blocks
from anisomap.numerics.reliability.sampling_noise import typical_variance

_BEYOND_CHANCE = 1.2

MIN_FILTERED_SENSORS = 500
"""Of more, only links that chance does not explain are followed."""

FOLLOWED = 1.5
"""Links this many times stronger than the strongest that chance gives may be followed."""

SHARED = 0.3
"""Share of its links that the sensor with fewer has in common with the other, if they are near."""

ROUNDS = 4
"""Times that links are looked through: each leaves fewer that bear one another out by chance."""

TOGETHER, SEVERAL = 0.95, 8
"""Share of a skin that these links must hold together, and how many of a sensor (the median)."""

MOST_PRODUCTS = 1e10
"""With more, contacts cover so much of the skin that a few steps lead anywhere without chance."""


def remove_insignificant_links(
    dissimilarity: Reals, similarity: ArrayLike, variance: ArrayLike, *, part: bool = True
) -> Reals:
    """Take sensors for infinitely far apart where chance alone may have made them alike.

    Parameters
    ----------
    dissimilarity : ndarray of shape (N, N)
        Finite; overwritten.
    similarity : array_like of shape (N, N)
        Correlations.
    variance : array_like of shape (N, N)
        Their sampling variances, above 0.
    part : bool
        Whether sensors may fall into pieces (`significant_components`).

    Returns
    -------
    ndarray of shape (N, N)
        Infinite between pieces and, in those of more than 500 sensors, but for `significant_links`.
    """
    n_sensors = len(dissimilarity)
    pieces = np.zeros(n_sensors, dtype=np.intp)
    if part:
        pieces = significant_components(similarity, variance)
    if pieces.any():
        dissimilarity[np.not_equal.outer(pieces, pieces)] = np.inf
    alike, noise = np.asarray(similarity), np.asarray(variance)
    for label in np.flatnonzero(np.bincount(pieces) > MIN_FILTERED_SENSORS):
        inside = ... if not pieces.any() else np.ix_(pieces == label, pieces == label)
        followed = significant_links(alike[inside], noise[inside])
        np.fill_diagonal(followed, val=True)
        dissimilarity[inside] = np.where(followed, dissimilarity[inside], np.inf)
    return dissimilarity


def significant_components(similarity: ArrayLike, variance: ArrayLike) -> NDArray[np.intp]:
    """Part sensors that are related to one another from those related by chance alone.

    Parameters
    ----------
    similarity : array_like of shape (N, N)
        Correlations.
    variance : array_like of shape (N, N)
        Their sampling variances, above 0.

    Returns
    -------
    ndarray of int, shape (N,)
        Which piece each sensor belongs to; 0 is the largest, then by the first sensor.

    Notes
    -----
    Pieces grow along the strongest links, correlations in units of their noise (as in single
    linkage). Among m independent links the strongest is about ``sqrt(2 log m)`` by chance; a piece
    of n sensors has m = n (N - n) to the rest. Links count from 1.2 times that on: on simulated
    and real skins of 500 frames and more, the weakest link that held a skin together was 1.22.
    Between two skins that were touched independently, the strongest was 0.8 to 1.1, and 1.0 to
    1.4 where few large contacts made many pairs meet by one and the same chance: such skins may
    be taken for one.
    """
    links = standardised_correlation(similarity, variance)
    n_sensors = len(links)
    if n_sensors < 2:
        return np.zeros(n_sensors, dtype=np.intp)
    pieces = DisjointSet(range(n_sensors))
    for strength, i, j in sorted(_strongest_links(links), reverse=True):
        smaller = min(pieces.subset_size(i), pieces.subset_size(j))
        by_chance = math.sqrt(2 * math.log(max(2, smaller * (n_sensors - smaller))))
        if strength >= _BEYOND_CHANCE * by_chance:
            pieces.merge(i, j)
    labels = np.empty(n_sensors, dtype=np.intp)
    ordered = sorted(pieces.subsets(), key=lambda piece: (-len(piece), min(piece)))
    for label, piece in enumerate(ordered):
        labels[list(piece)] = label
    return labels


def significant_links(similarity: ArrayLike, variance: ArrayLike) -> NDArray[np.bool_]:
    """Tell which links are direct evidence that two sensors of a large skin are near.

    Parameters
    ----------
    similarity : array_like of shape (N, N)
        Correlations.
    variance : array_like of shape (N, N)
        Their sampling variances, above 0.

    Returns
    -------
    ndarray of bool, shape (N, N)
        Symmetric, False on the diagonal; they connect all sensors.

    Notes
    -----
    Of a million pairs of sensors some hundreds are alike by chance alone, and each is a short cut
    across the skin: the more sensors, the more of them, and the longer the way that they cut. A
    link is followed if it is 1.5 times as strong as chance makes the strongest of all pairs,
    ``(2 log P)^(1/2)`` standard deviations, and if both sensors have enough links in common: side
    by side on a line they share half of them, in a plane a third or more. Sensors that are left
    without a link keep their strongest. Where so few links are left that they hardly hold the skin
    together (contacts are small, or the recording is short), all are followed.
    """
    links = standardised_correlation(similarity, variance)
    n_sensors = len(links)
    n_pairs = max(2, n_sensors * (n_sensors - 1) // 2)
    strong = links >= FOLLOWED * math.sqrt(2 * math.log(n_pairs))
    np.fill_diagonal(strong, val=False)
    followed = _borne_out(strong)
    graph: Any = csr_array(followed)
    parts = connected_components(graph, directed=False)[1]
    together = np.bincount(parts).max() / n_sensors
    if together < TOGETHER or np.median(np.count_nonzero(followed, axis=1)) < SEVERAL:
        return ~np.eye(n_sensors, dtype=bool)
    groups = DisjointSet(range(n_sensors))
    first = np.unique(parts, return_index=True)[1][parts]
    for sensor, leader in enumerate(first.tolist()):
        groups.merge(leader, sensor)
    for _, i, j in sorted(_strongest_links(links), reverse=True):
        if groups.merge(i, j):
            followed[i, j] = followed[j, i] = True
    return followed


def standardised_correlation(similarity: ArrayLike, variance: ArrayLike) -> Reals:
    """Divide correlations by their standard deviations, which are at least the typical one."""
    links, noise = as_reals(similarity), np.asarray(variance)
    least = typical_variance(noise)
    for rows in row_blocks(len(links)):
        links[rows] /= np.sqrt(np.maximum(noise[rows], least))
    return links


def _borne_out(strong: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Keep the links of sensors that have enough other links in common."""
    kept = strong
    for _ in range(ROUNDS):
        count = np.count_nonzero(kept, axis=1)
        if float(np.vdot(count, count)) > MOST_PRODUCTS:
            return kept
        graph: Any = csr_array(kept, dtype=np.float32)
        common = (graph @ graph).multiply(graph).tocoo()
        enough = common.data >= SHARED * np.minimum(count[common.row], count[common.col])
        if np.count_nonzero(enough) == graph.nnz:
            return kept
        kept = np.zeros_like(strong)
        kept[common.row[enough], common.col[enough]] = True
    return kept


def _strongest_links(links: Reals) -> Iterator[tuple[float, int, int]]:
    """Give the N - 1 strongest links that hold all together: a maximum spanning tree.

    Notes
    -----
    Prim (1957), Bell System Technical Journal 36: 1389-1401.
    """
    strongest, towards = links[0].astype(np.float64), np.zeros(len(links), dtype=np.intp)
    outside = np.ones(len(links), dtype=bool)
    outside[0] = False
    for _ in range(len(links) - 1):
        new = int(np.where(outside, strongest, -np.inf).argmax())
        yield float(strongest[new]), int(towards[new]), new
        outside[new] = False
        stronger = links[new] > strongest
        strongest[stronger] = links[new][stronger]
        towards[stronger] = new
