"""Landmark MDS of a connected graph, followed by a joint refinement of all sensors."""

from __future__ import annotations

import logging
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from anisomap.numerics.compiled.parallel import load_loops, parallel_map
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions, smacof
from anisomap.numerics.scaling.stress_solvers import Floats, SolverResult, minimise_lbfgs

logger = logging.getLogger(__name__)

MIN_TOLERANCE = 1e-7  # of the refinement: path lengths are stored in float32
SOURCES_PER_TASK = 64  # landmarks from which paths are computed together; chosen by hand
ROWS_PER_BLOCK = 4096  # sensors that are triangulated together; bounds memory
N_TASKS = 32  # parallel; fixed, so that sums are the same on every machine


class Targets(NamedTuple):
    """Landmarks, distance of each sensor from each, and distances of adjacent sensors, (N, N)."""

    landmarks: NDArray[np.int64]
    rows: NDArray[np.float32]
    edges: csr_array[Any, tuple[int, int]]

    @property
    def share(self) -> float:
        """Share of a sensor's pairs that involve landmarks: the weight of an edge."""
        return len(self.landmarks) / len(self.rows)


def refine(targets: Targets, start: Floats, tolerance: float, max_iterations: int) -> SolverResult:
    """Minimise the raw stress of the pairs with landmarks and of the edges. start (N, k).

    The L pairs of each sensor with landmarks represent its N - 1 pairs, so their weight is N / L,
    and that of an edge is 1 (both times L / N).
    """
    n_points, n_landmarks = targets.rows.shape
    weight = n_landmarks + targets.share * np.diff(targets.edges.indptr)
    weight[targets.landmarks] += n_points
    cuts = np.linspace(0, n_points, N_TASKS + 1).astype(int).tolist()
    edges = targets.edges.indptr.astype(np.int64), targets.edges.indices, targets.edges.data
    loops = load_loops("stress")
    with parallel_map(n_points) as map_tasks:

        def stress(positions: Floats) -> tuple[float, Floats]:
            exact = np.ascontiguousarray((positions - positions.mean(axis=0)).T)
            points = exact.astype(np.float32)
            anchors = np.ascontiguousarray(points[:, targets.landmarks])
            slopes, anchor_slopes = np.zeros_like(exact), np.zeros((N_TASKS, *anchors.shape))

            def add(task: int) -> float:
                rows = cuts[task], cuts[task + 1]
                near = loops.add_edges_stress(exact, edges, targets.share, slopes, rows)
                both = slopes, anchor_slopes[task]
                far = loops.add_rows_stress(points, anchors, targets.rows, rows, both)
                return float(near + far)

            raw = sum(map_tasks(add, range(N_TASKS)))
            slopes[:, targets.landmarks] += anchor_slopes.sum(axis=0)
            return raw, np.ascontiguousarray(2 * slopes.T)

        blocks = np.array_split(targets.rows, N_TASKS)
        squares = sum(float(np.square(rows, dtype=np.float64).sum()) for rows in blocks)
        return minimise_lbfgs(
            stress,
            start,
            2 * weight[:, None],
            squares=squares,
            tolerance=tolerance,
            max_iterations=max_iterations,
        )


def stress_of(targets: Targets, positions: Floats) -> tuple[float, float]:
    """Return the raw stress of the pairs with landmarks, and the sum of their squared distances."""
    raw = squared_sum = 0.0
    anchors = positions[targets.landmarks]
    for begin in range(0, len(positions), 1024):
        part = positions[begin : begin + 1024]
        squares = ((part[:, None] - anchors) ** 2).sum(axis=2)
        squared_sum += float(squares.sum())
        raw += float(((np.sqrt(squares) - targets.rows[begin : begin + 1024]) ** 2).sum())
    return raw, squared_sum


class PlacedComponent(NamedTuple):
    """Positions (n, k) of a component, and sums of (d - D)^2 and d^2 over pairs with landmarks."""

    positions: NDArray[np.float64]
    raw_stress: float
    spread: float
    converged: bool
    iterations: int


def place_component(
    graph: csr_array[Any, tuple[int, int]],
    dimensions: int,
    n_landmarks: int,
    options: SmacofOptions,
    rng: np.random.Generator,
) -> PlacedComponent:
    """Compute the positions of the sensors of a connected graph. graph (n, n).

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
    """Compute the lengths of the shortest paths from landmarks to all sensors. graph (N, N)."""
    sources = np.asarray(landmarks, dtype=np.int64)
    # Neighbours follow one another, so that a sweep extends paths far. The result is the same in
    # any order.
    order = reverse_cuthill_mckee(graph, symmetric_mode=True).astype(np.int64)
    edges = (
        graph.indptr.astype(np.int64),
        graph.indices.astype(np.int64),
        graph.data.astype(np.float32),
    )
    found = np.empty((graph.shape[0], len(sources)), dtype=np.float32)
    # Landmarks that are adjacent in this order are close, so their sweeps converge together.
    ranked = np.argsort(np.argsort(order)[sources], kind="stable")

    def relax(begin: int) -> None:
        chosen = ranked[begin : begin + SOURCES_PER_TASK]
        tile = np.empty((len(found), len(chosen)), dtype=np.float32)
        load_loops("graphs").relax_from(tile, sources[chosen], order, edges)
        found[:, chosen] = tile

    with parallel_map(len(found)) as map_tasks:
        map_tasks(relax, range(0, len(sources), SOURCES_PER_TASK))
    return found


def triangulate(rows: NDArray[np.float32], landmarks: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute positions from distances to landmarks. rows (N, L), landmarks (L, k) -> (N, k).

    De Silva & Tenenbaum (2004), "Sparse multidimensional scaling using landmark points", section
    3.2: ``y = -1/2 X^+ (d^2 - |x|^2)`` with centred landmarks X.
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
