"""Raw stress of a configuration and its gradient, in numpy or compiled."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from anisomap.numerics.compiled.parallel import MIN_COMPILED_ROWS, load_loops, parallel_map
from anisomap.numerics.precision import Reals, row_blocks

Floats = NDArray[np.float64]

COINCIDENT = 1e-150
"""Distance below which points coincide: the direction between them is rounding error."""

N_PARTS = 16
"""Number of parts of the pairs; fixed, so that sums do not depend on the number of threads."""

SPATIAL = 3
"""Number of coordinates of the faster loop; missing ones are 0."""

FLOAT32_RANGE = 1e9
"""Distances up to this, and down to its inverse, have squares within float32."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Distances to fit, and their weights.

    targets (N, N): Symmetric, finite; 0 where unknown.
    weights (N, N): Symmetric; 0 where unknown and on the diagonal. One row of ones if all weights
        are equal.
    compiled: Whether to use compiled loops; by default from 500 points on.
    """

    targets: Reals
    weights: Reals
    compiled: bool | None = None

    @property
    def equal_weights(self) -> bool:
        """Whether all distances have the same weight."""
        return len(self.weights) < len(self.targets)

    @property
    def is_compiled(self) -> bool:
        """Whether the stress is computed by compiled loops."""
        large = len(self.targets) >= MIN_COMPILED_ROWS
        return large if self.compiled is None else self.compiled

    def single(self) -> Problem | None:
        """Return the problem in float32; None if values are outside its range."""
        # The smallest maximum weight of a point is included: no point may lose all its weight.
        smallest = float(self.weights.max(axis=1).min(initial=1))
        extremes = [smallest, *(float(m.max(initial=0)) for m in (self.targets, self.weights))]
        if not all(1 / FLOAT32_RANGE < extreme < FLOAT32_RANGE for extreme in extremes):
            return None
        return Problem(
            self.targets.astype(np.float32, copy=False),
            self.weights.astype(np.float32, copy=False),
            self.compiled,
        )

    def weight_of_points(self) -> Floats:
        """Sum the weights of each point's distances, shape (N, 1)."""
        if self.equal_weights:
            return np.full((len(self.targets), 1), len(self.targets) - 1.0)
        return np.asarray(self.weights.sum(axis=1, keepdims=True, dtype=np.float64))

    def weighted_squares(self, positions: Floats | None = None) -> float:
        """Sum w_ij d_ij^2 over i < j; d are distances of `positions`, by default the targets."""
        if positions is not None and self.equal_weights:  # Huygens' theorem
            centred = positions - positions.mean(axis=0)
            return len(positions) * float(np.vdot(centred, centred))
        if self.equal_weights:
            blocks = (self.targets[rows] for rows in row_blocks(len(self.targets)))
            return sum(float(np.vdot(block, block)) for block in blocks) / 2
        total = 0.0
        for rows in row_blocks(len(self.targets)):
            lengths = self.targets[rows] if positions is None else cdist(positions[rows], positions)
            total += float(np.vdot(self.weights[rows] * lengths, lengths.astype(np.float64)))
        return total / 2


Objective = Callable[[Floats], tuple[float, Floats]]
"""Function of positions (N, k) that returns their raw stress and its gradient (N, k)."""


@contextmanager
def objective(problem: Problem, *, single: bool = False) -> Iterator[Objective]:
    """Provide the raw stress and its gradient as a function of positions.

    Borg & Groenen (2005), section 8.6: the gradient is ``2 (V X - B(X) X)``, for point i
    ``2 sum_j w_ij (1 - D_ij / d_ij) (x_i - x_j)``.
    """
    if not problem.is_compiled:
        # New matrices would take longer to allocate than to compute.
        workspace = np.empty((3, *problem.targets.shape))
        yield lambda positions: plain_stress(problem, positions, workspace)
        return
    n_points = len(problem.targets)
    loops = load_loops("stress")
    with parallel_map(n_points) as map_threads:
        # Row i has N - 1 - i pairs; parts have about equal numbers of pairs, and even first rows.
        cuts = n_points * (1 - np.sqrt(1 - np.arange(N_PARTS + 1) / N_PARTS))
        edges = (2 * np.round(cuts / 2)).astype(int).tolist()
        edges[-1] = n_points

        def compiled_stress(positions: Floats) -> tuple[float, Floats]:
            n_axes = positions.shape[1]
            points = np.zeros((max(n_axes, SPATIAL), n_points), np.float32 if single else float)
            points[:n_axes] = positions.T
            add_stress = loops.add_spatial_stress if n_axes <= SPATIAL else loops.add_stress
            slopes = np.zeros((N_PARTS, *points.shape), points.dtype)

            def add(part: int) -> float:
                rows = (edges[part], edges[part + 1])
                return float(
                    add_stress(points, problem.targets, problem.weights, rows, slopes[part])
                )

            raw = sum(map_threads(add, range(N_PARTS)))
            slope = np.zeros((n_points, n_axes))
            for first, part in zip(edges[:-1], slopes, strict=True):
                slope[first:] += part[:n_axes, first:].T  # earlier points are in earlier parts
            return raw, 2 * slope

        yield compiled_stress


def plain_stress(
    problem: Problem, positions: Floats, workspace: Floats | None = None
) -> tuple[float, Floats]:
    """Return the raw stress and its gradient, computed with (N, N) matrices.

    They overwrite `workspace`, of shape (3, N, N), if it is given.
    """
    n_points, k = positions.shape
    distances, excess, factors = (
        np.empty((3, n_points, n_points)) if workspace is None else workspace
    )
    cdist(positions, positions, out=distances)
    np.subtract(distances, problem.targets, out=excess)
    np.multiply(problem.weights, excess, out=factors)
    raw = float(np.vdot(factors, excess)) / 2
    np.fill_diagonal(distances, 1.0)
    if distances.min(initial=1.0) > COINCIDENT:
        factors /= distances
    else:
        apart = distances > COINCIDENT
        np.divide(factors, distances, out=factors, where=apart)
        factors *= apart
    sums = factors @ np.column_stack([positions, np.ones(n_points)])
    return raw, 2 * (sums[:, k:] * positions - sums[:, :k])
