"""The raw stress of a configuration and its gradient: plainly for few points, compiled for many."""

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
"""Points so close pull each other nowhere: which way would be rounding error."""

PIECES = 16
"""Pieces that the pairs are shared out to. A fixed number: sums are the same on every machine."""

SINGLE_RANGE = 1e9
"""Distances up to this, and down to its inverse, can be squared in float32."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Distances to be fitted.

    Attributes
    ----------
    targets : ndarray of shape (N, N)
        Symmetric, finite; 0 where unknown.
    weights : ndarray of shape (N, N) or (1, N)
        Symmetric; 0 where unknown and on the diagonal. Or one row of ones, if all count alike.
    """

    targets: Reals
    weights: Reals

    @property
    def all_alike(self) -> bool:
        """Whether every distance counts alike."""
        return len(self.weights) < len(self.targets)

    def single(self) -> Problem | None:
        """Give the same in float32, which holds and does twice as much; None if it leaves that."""
        of_points = float(self.weights.max(axis=1).min(initial=1))  # none may vanish
        extremes = [of_points, *(float(m.max(initial=0)) for m in (self.targets, self.weights))]
        if not all(1 / SINGLE_RANGE < extreme < SINGLE_RANGE for extreme in extremes):
            return None
        return Problem(
            self.targets.astype(np.float32, copy=False), self.weights.astype(np.float32, copy=False)
        )

    def weight_of_points(self) -> Floats:
        """Sum the weights of each point's distances, shape (N, 1)."""
        if self.all_alike:
            return np.full((len(self.targets), 1), len(self.targets) - 1.0)
        return np.asarray(self.weights.sum(axis=1, keepdims=True, dtype=np.float64))

    def weighted_squares(self, positions: Floats | None = None) -> float:
        """Sum w_ij d_ij^2 over i < j: of the distances between positions, or of the targets."""
        if positions is not None and self.all_alike:  # Huygens: by the distances from the middle
            apart = positions - positions.mean(axis=0)
            return len(positions) * float(np.vdot(apart, apart))
        if self.all_alike:
            return sum(float(np.vdot(row, row)) for row in self.targets) / 2
        total = 0.0
        for rows in row_blocks(len(self.targets)):
            lengths = self.targets[rows] if positions is None else cdist(positions[rows], positions)
            total += float(np.vdot(self.weights[rows] * lengths, lengths.astype(np.float64)))
        return total / 2


Objective = Callable[[Floats], tuple[float, Floats]]
"""From positions (N, k) to their raw stress and its gradient (N, k)."""


def is_compiled(n_points: int) -> bool:
    """Tell whether the stress of so many points is worked out by compiled loops."""
    return n_points >= MIN_COMPILED_ROWS


@contextmanager
def objective(problem: Problem, *, single: bool = False) -> Iterator[Objective]:
    """Give the raw stress with its gradient as a function of positions.

    Parameters
    ----------
    problem : Problem
    single : bool
        Reckon in float32, twice as fast: stresses are right to about 1e-6, and from one place to
        the next to 1e-8. The problem must be in float32. Few points take no notice.

    Notes
    -----
    Borg & Groenen (2005), section 8.6: the gradient is ``2 (V X - B(X) X)``, that is, point i gets
    ``2 sum_j w_ij (1 - D_ij / d_ij) (x_i - x_j)``.
    """
    n_points = len(problem.targets)
    if not is_compiled(n_points):
        yield lambda positions: plain_stress(problem, positions)
        return
    with parallel_map(n_points) as spread_over:
        # Row i has N - 1 - i pairs: cut so that pieces have about equally many.
        cuts = n_points * (1 - np.sqrt(1 - np.arange(PIECES + 1) / PIECES))
        edges = np.round(cuts).astype(int).tolist()

        def compiled_stress(positions: Floats) -> tuple[float, Floats]:
            points = np.ascontiguousarray(positions.T, np.float32 if single else np.float64)
            slopes = np.zeros((PIECES, *points.shape), points.dtype)

            def add(piece: int) -> float:
                rows = (edges[piece], edges[piece + 1])
                return float(
                    load_loops("stress").add_stress(
                        points, problem.targets, problem.weights, rows, slopes[piece]
                    )
                )

            raw = sum(spread_over(add, range(PIECES)))
            return raw, np.ascontiguousarray(2 * slopes.sum(axis=0, dtype=np.float64).T)

        yield compiled_stress


def plain_stress(problem: Problem, positions: Floats) -> tuple[float, Floats]:
    """Give the raw stress and its gradient by whole matrices."""
    distances = cdist(positions, positions)
    excess = distances - problem.targets
    weighted = problem.weights * excess
    raw = float(np.vdot(weighted, excess)) / 2
    pulls = np.divide(
        weighted, distances, out=np.zeros_like(distances), where=distances > COINCIDENT
    )
    return raw, 2 * (pulls.sum(axis=1)[:, None] * positions - pulls @ positions)
