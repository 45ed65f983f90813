"""Landmark MDS of a connected graph, followed by a joint refinement of all sensors."""

from __future__ import annotations

import logging
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from anisomap.large.landmarks.landmark_stress import Targets, refine, stress_of
from anisomap.large.landmarks.options import loops
from anisomap.numerics.compiled.parallel import parallel_map
from anisomap.numerics.graph.shortest_paths import bandwidth_order
from anisomap.numerics.scaling.stress_minimisation import SmacofOptions, smacof

logger = logging.getLogger(__name__)

MIN_TOLERANCE = 1e-7
"""Smallest tolerance of the refinement: path lengths are stored in float32."""

SOURCES_PER_TASK = 64
"""Number of landmarks from which paths are computed together; chosen by hand."""

ROWS_PER_BLOCK = 4096
"""Sensors that are triangulated together; bounds the memory of float64 copies."""


class PlacedComponent(NamedTuple):
    """Positions of the sensors of one connected component.

    Attributes
    ----------
    positions : ndarray of shape (n, k)
        Centred on the origin.
    raw_stress, spread : float
        Sums of (d - D)^2 and of d^2 over the pairs of each sensor with each landmark.
    converged : bool
    iterations : int
    """

    positions: NDArray[np.float64]
    raw_stress: float
    spread: float
    converged: bool
    iterations: int


def place_component(
    graph: csr_array[Any, tuple[int, int]],
    dimensions: int,
    *,
    n_landmarks: int,
    options: SmacofOptions,
    rng: np.random.Generator,
) -> PlacedComponent:
    """Compute the positions of the sensors of a connected graph.

    Parameters
    ----------
    graph : csr_array of shape (n, n)
        Lengths of edges, above 0; symmetric and connected.
    dimensions : int
        Number of coordinates, k.
    n_landmarks : int
        Number of sensors drawn as landmarks; all if there are no more.
    options : SmacofOptions
    rng : numpy.random.Generator
        Generator of the choice of landmarks.

    Returns
    -------
    PlacedComponent

    Notes
    -----
    Random landmarks are about as dense as the sensors; de Silva & Tenenbaum (2004) found them as
    good as optimised ones if they are many more than the dimensions.
    """
    n_sensors = graph.shape[0]
    if n_sensors == 1:
        return PlacedComponent(np.zeros((1, dimensions)), 0.0, 0.0, converged=True, iterations=0)
    chosen = np.sort(rng.choice(n_sensors, min(n_landmarks, n_sensors), replace=False))
    logger.info("finding shortest paths from %d landmarks", len(chosen))
    rows = paths_from(chosen, graph)
    lengths = rows[chosen].astype(np.float64)
    anchors = smacof(np.minimum(lengths, lengths.T), dimensions=dimensions, options=options)
    positions = triangulate(rows, anchors.positions)
    positions[chosen] = anchors.positions
    targets = Targets(chosen, rows, graph)
    logger.info("refining %d sensors in %d dimensions", n_sensors, dimensions)
    tolerance = max(options.tolerance, MIN_TOLERANCE)
    found = refine(targets, positions, tolerance, options.max_iterations)
    return PlacedComponent(
        found.positions - found.positions.mean(axis=0),
        *stress_of(targets, found.positions),
        converged=found.converged and anchors.converged,
        iterations=len(found.trace) - 1,
    )


def paths_from(landmarks: ArrayLike, graph: csr_array[Any, tuple[int, int]]) -> NDArray[np.float32]:
    """Compute the lengths of the shortest paths from landmarks to all sensors.

    Parameters
    ----------
    landmarks : array_like of int, shape (L,)
        Indices of sensors.
    graph : csr_array of shape (N, N)
        Lengths of edges, above 0; symmetric.

    Returns
    -------
    ndarray of float32, shape (N, L)
        Infinite where there is no path. The relative rounding error of h edges is about h 1e-7.
    """
    sources = np.asarray(landmarks, dtype=np.int64)
    order = bandwidth_order(graph.indptr, graph.indices)
    edges = (
        graph.indptr.astype(np.int64),
        graph.indices.astype(np.int64),
        graph.data.astype(np.float32),
    )
    found = np.empty((graph.shape[0], len(sources)), dtype=np.float32)
    # Landmarks that are adjacent in this order are close, so their sweeps converge together.
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    ranked = np.argsort(rank[sources], kind="stable")

    def relax(begin: int) -> None:
        chosen = ranked[begin : begin + SOURCES_PER_TASK]
        tile = np.empty((len(found), len(chosen)), dtype=np.float32)
        loops().relax_from(tile, sources[chosen], order, edges)
        found[:, chosen] = tile

    with parallel_map(len(found)) as map_tasks:
        map_tasks(relax, range(0, len(sources), SOURCES_PER_TASK))
    return found


def triangulate(rows: NDArray[np.float32], landmarks: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute positions from distances to landmarks.

    Parameters
    ----------
    rows : ndarray of shape (N, L)
        Distance of each sensor from each landmark.
    landmarks : ndarray of shape (L, k)
        Positions of the landmarks.

    Returns
    -------
    ndarray of shape (N, k)
        In the coordinate frame of the landmarks. Exact if the distances are those of points in k
        dimensions that the landmarks span.

    Notes
    -----
    De Silva & Tenenbaum (2004), "Sparse multidimensional scaling using landmark points", section
    3.2: ``y = -1/2 X^+ (d^2 - |x|^2)`` with centred landmarks X. Squared distances
    ``d^2 = |x|^2 - 2 x y + |y|^2`` are linear in y except for |y|^2, which is the same for all
    landmarks and cancels.
    """
    centre = landmarks.mean(axis=0)
    centred = landmarks - centre
    inverse = np.linalg.pinv(centred, rcond=1e-7)
    squares = (centred**2).sum(axis=1)
    positions = np.empty((len(rows), landmarks.shape[1]))
    for begin in range(0, len(rows), ROWS_PER_BLOCK):
        part = rows[begin : begin + ROWS_PER_BLOCK].astype(np.float64)
        positions[begin : begin + ROWS_PER_BLOCK] = (squares - part**2) @ inverse.T / 2
    return np.asarray(positions + centre)
