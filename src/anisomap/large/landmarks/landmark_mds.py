"""From the graph of a piece to places: landmarks, their map, all others, and all together."""

from __future__ import annotations

import logging
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from anisomap.large.landmarks.landmark_stress import Targets, refine, stress_of
from anisomap.large.landmarks.options import loops
from anisomap.numerics.compiled.parallel import parallel_map
from anisomap.numerics.scaling.stress_minimisation import SmacofOptions, smacof

logger = logging.getLogger(__name__)

FINEST = 1e-7
"""Tolerance that refining stops at, whatever was asked for: paths are known no better."""

TOGETHER = 64
"""Landmarks that are gone out from together."""

ROWS = 4096
"""Sensors that are placed at a time."""


class PlacedComponent(NamedTuple):
    """Where the sensors of a piece are.

    Attributes
    ----------
    positions : ndarray of shape (n, k)
        Centred on the origin.
    raw_stress, spread : float
        Over the pairs of each sensor with each landmark: sums of (d - D)^2 and of d^2.
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
    """Place the sensors of a connected graph.

    Parameters
    ----------
    graph : csr_array of shape (n, n)
        Lengths of edges, above 0; symmetric, and connected.
    dimensions : int
    n_landmarks : int
        How many sensors are drawn to be landmarks; all, if there are no more.
    options : SmacofOptions
    rng : numpy.random.Generator
        Draws them.

    Returns
    -------
    PlacedComponent

    Notes
    -----
    Landmarks that are drawn at random lie about as densely as sensors do; de Silva & Tenenbaum
    (2004) found them as good as chosen ones where there are many more than dimensions.
    """
    n_sensors = graph.shape[0]
    if n_sensors == 1:
        return PlacedComponent(np.zeros((1, dimensions)), 0.0, 0.0, converged=True, iterations=0)
    chosen = np.sort(rng.choice(n_sensors, min(n_landmarks, n_sensors), replace=False))
    logger.info("finding shortest paths from %d landmarks", len(chosen))
    rows = paths_from(chosen, graph)
    apart = rows[chosen].astype(np.float64)
    anchors = smacof(np.minimum(apart, apart.T), dimensions=dimensions, options=options)
    positions = triangulate(rows, anchors.positions)
    positions[chosen] = anchors.positions
    targets = Targets(chosen, rows, graph)
    logger.info("refining %d sensors in %d dimensions", n_sensors, dimensions)
    found = refine(targets, positions, max(options.tolerance, FINEST), options.max_iterations)
    return PlacedComponent(
        found.positions - found.positions.mean(axis=0),
        *stress_of(targets, found.positions),
        converged=found.converged and anchors.converged,
        iterations=len(found.trace) - 1,
    )


def paths_from(landmarks: ArrayLike, graph: csr_array[Any, tuple[int, int]]) -> NDArray[np.float32]:
    """Find the lengths of the shortest paths from landmarks to all sensors.

    Parameters
    ----------
    landmarks : array_like of int, shape (L,)
        Sensors.
    graph : csr_array of shape (N, N)
        Lengths of edges, above 0; symmetric.

    Returns
    -------
    ndarray of float32, shape (N, L)
        Infinite where there is no path. The length of a path of h edges errs by some h 1e-7 of it.
    """
    sources = np.asarray(landmarks, dtype=np.int64)
    order = reverse_cuthill_mckee(graph, symmetric_mode=True).astype(np.int64)
    edges = (
        graph.indptr.astype(np.int64),
        graph.indices.astype(np.int64),
        graph.data.astype(np.float32),
    )
    found = np.empty((graph.shape[0], len(sources)), dtype=np.float32)
    # Landmarks that follow one another in the order are near: they go the same ways.
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    ranked = np.argsort(place[sources], kind="stable")

    def go(begin: int) -> None:
        chosen = ranked[begin : begin + TOGETHER]
        tile = np.empty((len(found), len(chosen)), dtype=np.float32)
        loops().relax_from(tile, sources[chosen], order, edges)
        found[:, chosen] = tile

    with parallel_map(len(found)) as spread_over:
        spread_over(go, range(0, len(sources), TOGETHER))
    return found


def triangulate(rows: NDArray[np.float32], landmarks: NDArray[np.float64]) -> NDArray[np.float64]:
    """Place sensors by their distances from landmarks.

    Parameters
    ----------
    rows : ndarray of shape (N, L)
        Distance of each sensor from each landmark.
    landmarks : ndarray of shape (L, k)
        Where these are.

    Returns
    -------
    ndarray of shape (N, k)
        In the frame of the landmarks. Where distances are those of points in k dimensions, and the
        landmarks do not lie in fewer, that is where they are.

    Notes
    -----
    De Silva & Tenenbaum (2004), "Sparse multidimensional scaling using landmark points", section
    3.2: ``y = -1/2 X^+ (d^2 - |x|^2)`` with centred landmarks X. Squared distances d^2 = |x|^2 -
    2 x y + |y|^2 are linear in y but for |y|^2, which is the same for all landmarks and so drops
    out.
    """
    middle = landmarks.mean(axis=0)
    centred = landmarks - middle
    inverse = np.linalg.pinv(centred, rcond=1e-7)
    squares = (centred**2).sum(axis=1)
    placed = np.empty((len(rows), landmarks.shape[1]))
    for begin in range(0, len(rows), ROWS):
        part = rows[begin : begin + ROWS].astype(np.float64)
        placed[begin : begin + ROWS] = (squares - part**2) @ inverse.T / 2
    return np.asarray(placed + middle)
