"""Graph of the most similar sensors: sketches of readings, r of selected pairs, and links.

Links that may be coincidental are left out.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from anisomap.errors import InputError
from anisomap.numerics.compiled.parallel import load_loops, parallel_map
from anisomap.numerics.graph.dissimilarity import NUMERICAL_ZERO
from anisomap.numerics.graph.neighbour_graphs import NO_SENSOR, most_similar
from anisomap.numerics.neighbours import labels_by_size
from anisomap.numerics.precision import Floats
from anisomap.numerics.ranges import at_least, check_ranges
from anisomap.numerics.reliability.sampling_noise import MIN_SHARED, count_shared_neighbours
from anisomap.numerics.signals import count_contacts

logger = logging.getLogger(__name__)

N_TASKS = 64  # more than the usual number of cores, for an even load


@dataclass(frozen=True)
class ApproximateOptions:
    """Accuracy of an approximate map, and its random seed.

    The defaults were chosen on simulated skins; ``docs/explanation/large-recordings.md``
    gives the accuracy.

    Parameters
    ----------
    n_neighbours : int
        Number of sensors with the highest r that each sensor is linked to, at least 3.
    n_candidates : int
        Number of sensors for which r with each sensor is computed, at least `n_neighbours`.
    sketch_size : int
        Length of the random projection of a sensor's readings, at least 16. The standard error of r
        between two sketches is about ``sketch_size ** -0.5``.
    n_landmarks : int
        Number of sensors from which shortest paths to all others are computed, at least 8. In
        connected components that are not larger, all sensors are landmarks.
    seed : int
        Seed of the projection and of the choice of landmarks, at least 0.

    Raises
    ------
    InputError
        If a value is too small.
    """

    n_neighbours: int = 20
    n_candidates: int = 48
    sketch_size: int = 512
    n_landmarks: int = 1000
    seed: int = 0

    def __post_init__(self) -> None:
        least = {"n_neighbours": 3, "sketch_size": 16, "n_landmarks": 8, "seed": 0}
        check_ranges(self, {name: at_least(low, whole=True) for name, low in least.items()})
        check_ranges(self, {"n_candidates": at_least(self.n_neighbours, whole=True)})


@dataclass(frozen=True, eq=False)
class Sketch:
    """Summary of T frames of N sensors.

    mean, deviation (N,): Exact moments of the readings; the deviation is that of the population.
    contacts: Number of excursions from the first reading, on the side with more of them.
    active_frames: Number of frames on that side, or of all others if these are fewer.
    projections: Sketches: the expected inner product of two rows, over random signs, is r.
    """

    n_frames: int
    mean: Floats
    deviation: Floats
    varying: NDArray[np.bool_]
    contacts: NDArray[np.int64]
    active_frames: NDArray[np.int64]
    projections: NDArray[np.float32]


def compute_sketch(chunks: Iterable[NDArray[Any]], size: int, rng: np.random.Generator) -> Sketch:
    """Sketch the standardised readings of every sensor.

    Each frame is added, with a random sign, to one of s components: the count sketch of Charikar,
    Chen & Farach-Colton (2004), Theoretical Computer Science 312: 3-15. Inner products are
    unbiased, with a variance of at most ``(1 + r^2) / s`` (Weinberger et al. 2009,
    arXiv:0902.2206).
    """
    # Separate streams, so that the result does not depend on how frames are divided into chunks.
    draw_component, draw_sign = rng.spawn(2)
    n_frames, first = 0, np.empty(0)
    for chunk in chunks:
        if not n_frames:
            # All sums are of readings relative to the first frame, which is mostly at rest.
            n_sensors, first = chunk.shape[1], chunk[0].astype(np.float64)
            sums, squares = np.zeros((2, n_sensors))
            varying = np.zeros(n_sensors, dtype=bool)
            # Rows: above and below the first reading.
            beyond, crossings = np.zeros((2, 2, n_sensors), dtype=np.int64)
            was_beyond = np.zeros((2, n_sensors), dtype=bool)
            weights = np.zeros(size)  # sketch of a constant reading of 1
            projections = np.zeros((size, n_sensors), dtype=np.float32)
        components = draw_component.integers(size, size=len(chunk))
        signs = np.where(draw_sign.random(len(chunk)) < 0.5, -1.0, 1.0)
        values = chunk - first
        n_frames += len(chunk)
        sums += values.sum(axis=0)
        squares += np.einsum("ti,ti->i", values, values)
        varying |= values.any(axis=0)
        for side, is_beyond in enumerate((values > 0, values < 0)):
            beyond[side] += np.count_nonzero(is_beyond, axis=0)
            seen = np.concatenate([was_beyond[side, None], is_beyond])
            crossings[side] += count_contacts(seen) - was_beyond[side]
            was_beyond[side] = is_beyond[-1]
        used, rows = np.unique(components, return_inverse=True)
        entries = (signs.astype(np.float32), (rows, np.arange(len(chunk))))
        projection = csr_array(entries, shape=(len(used), len(chunk)))
        projections[used] += projection @ values.astype(np.float32)
        weights += np.bincount(components, signs, minlength=size)
    if not n_frames:
        raise InputError("the recording has no frames")
    shift = sums / n_frames
    deviation = np.sqrt(np.maximum(squares / n_frames - shift**2, 0))
    varying &= deviation > 0
    scale = np.divide(n_frames**-0.5, deviation, out=np.zeros_like(deviation), where=varying)
    active = np.where(crossings[1] > crossings[0], beyond[1], beyond[0])
    sketches = np.ascontiguousarray(projections.T)
    sketches -= np.outer(shift, weights).astype(np.float32)
    sketches *= scale[:, None].astype(np.float32)
    return Sketch(
        n_frames=n_frames,
        mean=first + shift,
        deviation=deviation,
        varying=varying,
        contacts=crossings.max(axis=0),
        active_frames=np.minimum(active, n_frames - active),
        projections=sketches,
    )


class SensorPairs(NamedTuple):
    """Pairs of sensors i < j, each once, in increasing order, and r of each."""

    firsts: NDArray[np.int64]
    seconds: NDArray[np.int64]
    r: Floats

    def concatenate(self, others: SensorPairs) -> SensorPairs:
        """Append other pairs."""
        return SensorPairs(
            np.concatenate([self.firsts, others.firsts]),
            np.concatenate([self.seconds, others.seconds]),
            np.concatenate([self.r, others.r]),
        )

    def select(self, mask: NDArray[np.bool_]) -> SensorPairs:
        """Return the pairs where a mask is true."""
        return SensorPairs(self.firsts[mask], self.seconds[mask], self.r[mask])

    def best(self, n_sensors: int) -> Floats:
        """Return the highest r of each sensor, -inf without a pair, shape (N,)."""
        best = np.full(n_sensors, -np.inf)
        for sensors in (self.firsts, self.seconds):
            np.maximum.at(best, sensors, self.r)
        return best


def pairs_of(
    found: NDArray[np.int64], sensors: ArrayLike | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """List the pairs of sensors and their candidates, each pair once."""
    owners = np.arange(len(found)) if sensors is None else np.asarray(sensors, dtype=np.int64)
    pairs = np.stack([np.repeat(owners, found.shape[1]), found.ravel()])
    pairs = np.sort(pairs[:, pairs[1] != NO_SENSOR], axis=0)
    base = int(pairs.max(initial=0)) + 1
    firsts, seconds = np.divmod(np.unique(pairs[0] * base + pairs[1]), base)
    return firsts, seconds


def correlations(
    chunks: Iterable[NDArray[Any]],
    sketch: Sketch,
    pairs: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> SensorPairs:
    """Compute Pearson r of pairs of sensors."""
    totals = np.zeros(len(pairs[0]))
    scale = np.divide(1, sketch.deviation, out=np.zeros(len(sketch.mean)), where=sketch.varying)
    bounds = np.linspace(0, len(totals), N_TASKS + 1).astype(int).tolist()
    add = load_loops("similarity").add_pair_products
    with parallel_map(len(sketch.mean)) as map_tasks:
        for chunk in chunks:
            still = (chunk == chunk[0]).all(axis=0)
            values = np.ascontiguousarray(chunk.T)
            series = ((values - sketch.mean[:, None]) * scale[:, None]).astype(np.float32)

            map_tasks(partial(add, series, still, pairs, totals), pairwise(bounds))
    return SensorPairs(*pairs, np.clip(totals / sketch.n_frames, -1, 1))


# Chosen by hand on simulated skins and the recordings of docs/explanation/large-recordings.md.
MIN_RELATIVE_R = 0.4  # of a link, as a share of the smaller of its sensors' highest r
STRONG_RELATIVE_R = 0.7  # from which links need only nearly be significant
EXTRA_COINCIDENCES = 3.0  # contacts beyond their expected number, which is unreliable if small
N_OUTSIDE = 8  # sensors outside its component with which each sensor is compared
MAX_BRIDGE_PASSES = 3  # over the frames, in search of links between components
_SENSOR_OVER_ALL = 0.75  # expected maximum r of one sensor's pairs over that of all pairs


def build_graph(pairs: SensorPairs, sketch: Sketch, n_neighbours: int) -> SensorPairs:
    """Link each sensor to those with the highest r, and reject pairs that may be coincidental.

    A link is rejected if r is much lower than the highest r of either sensor, since a path over
    nearer sensors is as short; if r is not significant (`largest_null_r`), unless it is close to
    the highest r of a rarely touched sensor; or if the sensors share too few neighbours.
    """
    n_sensors = len(sketch.mean)
    best = np.maximum(pairs.best(n_sensors), 0)
    share = pairs.r / np.maximum(np.minimum(best[pairs.firsts], best[pairs.seconds]), 1e-300)
    usable = (pairs.r >= NUMERICAL_ZERO) & (share >= MIN_RELATIVE_R)
    null = largest_null_r(pairs, sketch, coincidences=0)
    usable &= ((share >= STRONG_RELATIVE_R) & (pairs.r >= _SENSOR_OVER_ALL * null)) | (
        pairs.r >= largest_null_r(pairs, sketch)
    )
    near = pairs.select(usable)
    near = near.select(_among_best(near, n_sensors, n_neighbours))
    return near.select(_share_neighbours(near, n_sensors))


def _share_neighbours(pairs: SensorPairs, n_sensors: int) -> NDArray[np.bool_]:
    """Return the mask of pairs that share enough neighbours in the graph of all pairs."""
    graph = adjacency_matrix(pairs, np.arange(1.0, len(pairs.r) + 1), n_sensors)
    shared = count_shared_neighbours(graph)
    starts, ends = graph.tocoo().coords
    degrees = np.diff(graph.indptr)
    enough = shared >= MIN_SHARED * (np.minimum(degrees[starts], degrees[ends]) - 1)
    return np.isin(np.arange(1, len(pairs.r) + 1), graph.data[enough])


def bridge_components(
    edges: SensorPairs, sketch: Sketch, chunks: Callable[[], Iterable[NDArray[Any]]]
) -> tuple[SensorPairs, NDArray[np.intp], SensorPairs]:
    """Link connected components by significant r, which the graph may lack.

    Return the edges, the component of each sensor, and the pairs that were compared.
    """
    component = component_labels(edges, len(sketch.mean))
    compared = edges.select(np.zeros(len(edges.r), dtype=bool))
    for _ in range(MAX_BRIDGE_PASSES):
        outside = np.flatnonzero((component > 0) & sketch.varying)
        if not outside.size:
            break
        logger.info("searching links of %d sensors to other components", outside.size)
        found, _ = most_similar(sketch.projections, N_OUTSIDE, groups=component, sensors=outside)
        links = correlations(chunks(), sketch, pairs_of(found, outside))
        compared = compared.concatenate(links)
        bridges = links.select(links.r >= largest_null_r(links, sketch))
        if not bridges.r.size:
            break
        edges = edges.concatenate(bridges)
        component = component_labels(edges, len(sketch.mean))
    return edges, component, compared


def largest_null_r(
    pairs: SensorPairs, sketch: Sketch, coincidences: float = EXTRA_COINCIDENCES
) -> Floats:
    """Return, for each pair, the expected maximum r if no sensors were related.

    Two sensors touched c and c' times in T frames, for d and d' frames each, are touched together
    about ``c c' (d + d') / T`` times by coincidence, and each time raises r by ``(c c')^(-1/2)``.
    The null standard deviation of r is ``((d + d') / T)^(1/2)``, and the maximum of P pairs is ``(2
    log P)^(1/2)`` of them.
    """
    n_sensors = len(sketch.mean)
    touched = np.maximum(sketch.contacts, 1)
    duration = sketch.active_frames / touched
    deviations = np.sqrt(2 * np.log(max(n_sensors * (n_sensors - 1) / 2, 2)))
    together = (duration[pairs.firsts] + duration[pairs.seconds]) / sketch.n_frames
    contacts = np.sqrt(touched[pairs.firsts] * touched[pairs.seconds])
    return np.asarray(deviations * np.sqrt(together) + coincidences / contacts)


def edge_lengths(pairs: SensorPairs, edges: SensorPairs, mu: float) -> Floats:
    """Return the length of every edge, the regularised reciprocal of its r. Returns (E,)."""
    smallest = float(pairs.r.min(where=pairs.r >= NUMERICAL_ZERO, initial=1.0))
    return np.asarray(1 / (edges.r + mu * smallest))


def adjacency_matrix(
    edges: SensorPairs, lengths: Floats, n_sensors: int
) -> csr_array[np.float64, tuple[int, int]]:
    """Return the symmetric sparse matrix of edge lengths, with sorted column indices."""
    ends = np.concatenate([edges.firsts, edges.seconds])
    others = np.concatenate([edges.seconds, edges.firsts])
    graph = csr_array((np.tile(lengths, 2), (ends, others)), shape=(n_sensors, n_sensors))
    graph.sort_indices()
    return graph


def component_labels(edges: SensorPairs, n_sensors: int) -> NDArray[np.intp]:
    """Return the component of each sensor, (N,), by decreasing size, ties by the first sensor."""
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
