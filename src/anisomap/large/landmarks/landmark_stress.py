"""All sensors placed together: by their paths from landmarks, and along the edges between them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from anisomap.large.landmarks.options import loops
from anisomap.numerics.compiled.parallel import parallel_map
from anisomap.numerics.scaling.lbfgs import SolverResult, minimise_lbfgs
from anisomap.numerics.scaling.stress import Floats

PIECES = 32
"""Pieces that the sensors are shared out to. A fixed number: sums are the same on every machine."""


class Targets(NamedTuple):
    """Distances that positions are to fit.

    Attributes
    ----------
    landmarks : ndarray of int, shape (L,)
    rows : ndarray of float32, shape (N, L)
        Distance of each sensor from each landmark.
    edges : csr_array of shape (N, N)
        Distances of sensors side by side.
    """

    landmarks: NDArray[np.int64]
    rows: NDArray[np.float32]
    edges: csr_array[Any, tuple[int, int]]

    @property
    def share(self) -> float:
        """Share of all pairs that a landmark's pairs stand for: how much an edge counts."""
        return len(self.landmarks) / len(self.rows)


def refine(targets: Targets, start: Floats, tolerance: float, max_iterations: int) -> SolverResult:
    """Lower the raw stress of the pairs with landmarks and of the edges.

    Parameters
    ----------
    targets : Targets
    start : ndarray of shape (N, k)
    tolerance, max_iterations
        See `anisomap.numerics.scaling.stress_minimisation.SmacofOptions`.

    Returns
    -------
    SolverResult
        No step raises the stress.

    Notes
    -----
    The exact map has the least stress over all pairs. Here each sensor's L pairs with landmarks
    stand for its N - 1, so they count N / L, and an edge, which stands for itself, counts 1 (all
    this times L / N).
    """
    n_points, n_landmarks = targets.rows.shape
    degrees = np.diff(targets.edges.indptr)
    weight = n_landmarks + targets.share * degrees
    weight[targets.landmarks] += n_points
    with parallel_map(n_points) as spread_over:

        def stress(positions: Floats) -> tuple[float, Floats]:
            return _stress(targets, positions, spread_over)

        squares = sum(float(np.square(part, dtype=np.float64).sum()) for part in _parts(targets))
        return minimise_lbfgs(
            stress,
            start,
            2 * weight[:, None],
            squares=squares,
            tolerance=tolerance,
            max_iterations=max_iterations,
        )


def stress_of(targets: Targets, positions: Floats) -> tuple[float, float]:
    """Give the raw stress of the pairs with landmarks, and the sum of their squared distances."""
    raw = spread_out = 0.0
    anchors = positions[targets.landmarks]
    for begin in range(0, len(positions), 1024):
        part = positions[begin : begin + 1024]
        squares = ((part[:, None] - anchors) ** 2).sum(axis=2)
        spread_out += float(squares.sum())
        raw += float(((np.sqrt(squares) - targets.rows[begin : begin + 1024]) ** 2).sum())
    return raw, spread_out


def _parts(targets: Targets) -> list[NDArray[np.float32]]:
    return np.array_split(targets.rows, PIECES)


def _stress(targets: Targets, positions: Floats, spread_over: Any) -> tuple[float, Floats]:
    n_points, dimensions = positions.shape
    middle = positions.mean(axis=0)
    exact = np.ascontiguousarray((positions - middle).T)
    points = exact.astype(np.float32)
    anchors = np.ascontiguousarray(points[:, targets.landmarks])
    slopes = np.zeros((dimensions, n_points))
    pulled = np.zeros((PIECES, *anchors.shape))
    cuts = np.linspace(0, n_points, PIECES + 1).astype(int).tolist()
    edges = targets.edges.indptr.astype(np.int64), targets.edges.indices, targets.edges.data

    def add(piece: int) -> float:
        rows = cuts[piece], cuts[piece + 1]
        near = loops().add_edges_stress(exact, edges, targets.share, slopes, rows)
        both = slopes, pulled[piece]
        far = loops().add_rows_stress(points, anchors, targets.rows, rows, both)
        return float(near + far)

    raw = sum(spread_over(add, range(PIECES)))
    slopes[:, targets.landmarks] += pulled.sum(axis=0)
    return raw, np.ascontiguousarray(2 * slopes.T)
