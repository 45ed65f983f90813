"""Raw stress of the paths from landmarks and of the edges, and its minimisation."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from anisomap.large.landmarks.options import loops
from anisomap.numerics.compiled.parallel import parallel_map
from anisomap.numerics.scaling.lbfgs import SolverResult, minimise_lbfgs
from anisomap.numerics.scaling.stress import Floats

N_TASKS = 32
"""Number of parallel tasks; fixed, so that sums are the same on every machine."""


class Targets(NamedTuple):
    """Distances that the positions should reproduce.

    Attributes
    ----------
    landmarks : ndarray of int, shape (L,)
    rows : ndarray of float32, shape (N, L)
        Distance of each sensor from each landmark.
    edges : csr_array of shape (N, N)
        Distances of adjacent sensors.
    """

    landmarks: NDArray[np.int64]
    rows: NDArray[np.float32]
    edges: csr_array[Any, tuple[int, int]]

    @property
    def share(self) -> float:
        """Share of a sensor's pairs that involve landmarks: the weight of an edge."""
        return len(self.landmarks) / len(self.rows)


def refine(targets: Targets, start: Floats, tolerance: float, max_iterations: int) -> SolverResult:
    """Minimise the raw stress of the pairs with landmarks and of the edges.

    Parameters
    ----------
    targets : Targets
    start : ndarray of shape (N, k)
    tolerance, max_iterations
        See `anisomap.numerics.scaling.stress_minimisation.SmacofOptions`.

    Returns
    -------
    SolverResult
        The stress never increases.

    Notes
    -----
    The exact map minimises the stress over all pairs. Here the L pairs of each sensor with
    landmarks represent its N - 1 pairs, so their weight is N / L, and that of an edge is 1 (both
    times L / N).
    """
    n_points, n_landmarks = targets.rows.shape
    degrees = np.diff(targets.edges.indptr)
    weight = n_landmarks + targets.share * degrees
    weight[targets.landmarks] += n_points
    with parallel_map(n_points) as map_tasks:

        def stress(positions: Floats) -> tuple[float, Floats]:
            return _stress(targets, positions, map_tasks)

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


def _stress(targets: Targets, positions: Floats, map_tasks: Any) -> tuple[float, Floats]:
    n_points, dimensions = positions.shape
    middle = positions.mean(axis=0)
    exact = np.ascontiguousarray((positions - middle).T)
    points = exact.astype(np.float32)
    anchors = np.ascontiguousarray(points[:, targets.landmarks])
    slopes = np.zeros((dimensions, n_points))
    anchor_slopes = np.zeros((N_TASKS, *anchors.shape))
    cuts = np.linspace(0, n_points, N_TASKS + 1).astype(int).tolist()
    edges = targets.edges.indptr.astype(np.int64), targets.edges.indices, targets.edges.data

    def add(task: int) -> float:
        rows = cuts[task], cuts[task + 1]
        near = loops().add_edges_stress(exact, edges, targets.share, slopes, rows)
        both = slopes, anchor_slopes[task]
        far = loops().add_rows_stress(points, anchors, targets.rows, rows, both)
        return float(near + far)

    raw = sum(map_tasks(add, range(N_TASKS)))
    slopes[:, targets.landmarks] += anchor_slopes.sum(axis=0)
    return raw, np.ascontiguousarray(2 * slopes.T)
