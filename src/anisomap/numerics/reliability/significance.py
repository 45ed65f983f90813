"""Statistically significant links between sensors, and sensors that differ from all others."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.special import ndtr, ndtri

from anisomap.numerics.compiled.parallel import load_loops
from anisomap.numerics.neighbours import labels_by_size, tree_edges
from anisomap.numerics.precision import Reals, as_reals, row_blocks
from anisomap.numerics.reliability.sampling_noise import typical_variance

MIN_SHARED = 0.3
"""Minimum share of the neighbours that adjacent sensors have in common.

It is slightly below the geometric values: a half on a line, a third or more in a plane.
"""


def count_shared_neighbours(graph: csr_array[Any, tuple[int, int]]) -> NDArray[np.int64]:
    """Count the common neighbours of the two ends of each edge. graph (N, N)."""
    shared = np.zeros(graph.nnz, dtype=np.int64)
    offsets, ends = graph.indptr.astype(np.int64), graph.indices.astype(np.uint32)
    load_loops("graphs").count_shared(offsets, ends, shared)
    return shared


_MIN_BRIDGE = 1.2
"""Minimum strength of a link between components, relative to the strongest unrelated link.

Tuned on simulated skins, seeds 101-105: see `significant_components`.
"""

MIN_FILTERED_SENSORS = 500
"""Number of sensors above which insignificant links of a component are removed; by hand."""

MIN_LINK = 1.5
"""Minimum strength of a significant link, relative to the strongest unrelated link; by hand."""

_GREATEST_R = 1 - 1e-6  # correlations of more than this are equal to it; float32 resolves 6e-8

MAX_ROUNDS = 4
"""Maximum number of rounds that remove links without shared neighbours; chosen by hand."""

MIN_COVERED, MIN_LINKS = 0.95, 8
"""Minimum share of the sensors that significant links connect, and minimum median per sensor.

With fewer, contacts are too small or the recording is too short to distinguish links. Chosen by
hand.
"""

MAX_PRODUCTS = 1e10
"""Sum of the squared numbers of links per sensor above which shared neighbours are not counted.

Contacts then cover so much of the skin that a few steps connect any two sensors.
"""


def remove_insignificant_links(
    dissimilarity: Reals,
    similarity: ArrayLike,
    variance: ArrayLike,
    *,
    split_unrelated: bool = True,
) -> Reals:
    """Make dissimilarities infinite between components and along insignificant links.

    dissimilarity (N, N), similarity (N, N), variance (N, N) -> (N, N).
    """
    n_sensors = len(dissimilarity)
    component = np.zeros(n_sensors, dtype=np.intp)
    if split_unrelated:
        component = significant_components(similarity, variance)
    if component.any():
        dissimilarity[np.not_equal.outer(component, component)] = np.inf
    correlation, noise = np.asarray(similarity), np.asarray(variance)
    for label in np.flatnonzero(np.bincount(component) > MIN_FILTERED_SENSORS):
        inside = ... if not component.any() else np.ix_(component == label, component == label)
        kept = significant_links(correlation[inside], noise[inside])
        np.fill_diagonal(kept, val=True)
        dissimilarity[inside] = np.where(kept, dissimilarity[inside], np.inf)
    return dissimilarity


def significant_components(similarity: ArrayLike, variance: ArrayLike) -> NDArray[np.intp]:
    """Label the components connected by statistically significant links.

    similarity (N, N), variance (N, N).

    Components grow along the strongest links, as in single linkage, where the strength of a link
    is Fisher's z of its correlation, ``artanh r``, in standard deviations of unrelated sensors
    (Fisher 1921, Metron 1: 3-32). A correlation is bounded, and so is its ratio to its standard
    deviation, however clear the relation is; few long contacts would leave no link significant.
    The strongest of m independent links between unrelated sensors is about ``sqrt(2 log m)``; a
    component of n sensors has m = n (N - n) links to the others. Links are significant from 1.2
    times this strength on. On simulated and real skins of 500 frames and more, the weakest link
    needed to connect a skin was at least 1.22 times as strong. Between two skins touched
    independently (500 to 2000 frames), the strongest was 0.8 to 1.2 times as strong; with few
    large contacts, or some hundred frames, it was up to 2.9 times as strong: such skins may be
    merged.
    """
    links = standardised_correlation(similarity, variance, by_z=True)
    n_sensors = len(links)
    if n_sensors < 2:
        return np.zeros(n_sensors, dtype=np.intp)
    component, sizes = np.arange(n_sensors), np.ones(n_sensors, dtype=np.intp)
    for i, j in _strongest_first(links):
        one, other = component[i], component[j]
        smaller = int(min(sizes[one], sizes[other]))
        if links[i, j] >= _MIN_BRIDGE * _expected_maximum(smaller * (n_sensors - smaller)):
            component[component == other] = one
            sizes[one] += sizes[other]
    return labels_by_size(component)


def significant_links(similarity: ArrayLike, variance: ArrayLike) -> NDArray[np.bool_]:
    """Select the links that show that two sensors of a large skin are close.

    Among a million pairs of sensors, some hundreds are correlated by coincidence, and each shortens
    paths across the skin. A link is significant if it is 1.5 times as strong as the strongest of P
    unrelated pairs, ``sqrt(2 log P)`` standard deviations, and if its sensors have enough
    neighbours in common (`MIN_SHARED`). The maximum spanning tree of the links is kept as far as
    it joins components. If too few significant links remain (`MIN_COVERED`, `MIN_LINKS`), all
    links are kept.
    """
    links = standardised_correlation(similarity, variance)
    n_sensors = len(links)
    n_pairs = n_sensors * (n_sensors - 1) // 2
    strong = links >= MIN_LINK * _expected_maximum(n_pairs)
    np.fill_diagonal(strong, val=False)
    kept = links_with_shared_neighbours(strong)
    graph: Any = csr_array(kept)
    component = connected_components(graph, directed=False)[1]
    covered = np.bincount(component).max() / n_sensors
    if covered < MIN_COVERED or np.median(np.count_nonzero(kept, axis=1)) < MIN_LINKS:
        return ~np.eye(n_sensors, dtype=bool)
    for i, j in _strongest_first(links):
        if component[i] != component[j]:
            component[component == component[j]] = component[i]
            kept[i, j] = kept[j, i] = True
    return kept


def links_with_shared_neighbours(
    links: NDArray[np.bool_], max_products: float = MAX_PRODUCTS
) -> NDArray[np.bool_]:
    """Remove links between sensors with too few common neighbours, repeatedly."""
    kept = links
    for _ in range(MAX_ROUNDS):
        degree = np.count_nonzero(kept, axis=1)
        if float(np.vdot(degree, degree)) > max_products:
            return kept
        graph: Any = csr_array(kept)
        shared = count_shared_neighbours(graph)
        start, end = graph.tocoo().coords
        enough = shared >= MIN_SHARED * np.minimum(degree[start], degree[end])
        if enough.all():
            return kept
        kept = np.zeros_like(links)
        kept[start[enough], end[enough]] = True
    return kept


def standardised_correlation(
    similarity: ArrayLike, variance: ArrayLike, *, by_z: bool = False
) -> Reals:
    """Divide correlations, or their Fisher's z, by their standard deviations, shape (N, N).

    The variance of ``z = artanh r``, of all r, is that of r between unrelated sensors. Each
    variance is at least the median variance, since that of sensors with few contacts is
    underestimated.
    """
    links, noise = as_reals(similarity), np.asarray(variance)
    least = typical_variance(noise)
    for rows in row_blocks(len(links)):
        part = links[rows]
        if by_z:
            np.arctanh(np.clip(part, -_GREATEST_R, _GREATEST_R, out=part), out=part)
        part /= np.sqrt(np.maximum(noise[rows], least))
    return links


def _expected_maximum(n_links: int) -> float:
    """Return the asymptotic maximum of `n_links` independent standard normal variables."""
    return math.sqrt(2 * math.log(max(2, n_links)))


def _strongest_first(links: Reals) -> list[tuple[int, int]]:
    """List the edges of the maximum spanning tree of links by decreasing strength."""
    edges = ((links[new, joined], joined, new) for new, joined in tree_edges(links))
    return [(i, j) for _, i, j in sorted(edges, reverse=True)]


FALSE_ALARMS = 0.05
"""Expected number of healthy sensors of a recording that are outlying, and at most one in 1,000."""

_LEAST_P = 1e-3
_LEAST_SPREAD = 0.4  # of the logarithms of levels: sensors of one skin differ by a factor of 1.5
_MIN_COMPARED = 8  # from which a distribution is fitted
_NORMAL_MAD = 0.6745  # median absolute deviation of a normal distribution

LEAST_RATIO = float(np.exp(-_LEAST_SPREAD * ndtri(_LEAST_P)))
"""Ratio to the median that every outlying level exceeds."""


def outlying(levels: NDArray[np.float64], variance: ArrayLike = 0.0) -> NDArray[np.bool_]:
    """Return whether each of n positive levels is too high among the others, (n,).

    variance: Sampling variance of the logarithm of each level.

    Logarithms of the levels of healthy sensors are normal, with the median and the median absolute
    deviation of all.
    """
    if len(levels) < _MIN_COMPARED:
        return np.zeros(len(levels), dtype=bool)
    logarithm = np.log(levels)
    beyond = logarithm - np.median(logarithm)
    spread = max(float(np.median(np.abs(beyond))) / _NORMAL_MAD, _LEAST_SPREAD)
    deviation = np.sqrt(spread**2 + np.asarray(variance))
    return np.asarray(ndtr(-beyond / deviation) < min(_LEAST_P, FALSE_ALARMS / len(levels)))
