"""Raw stress of a configuration and its gradient, in numpy or compiled.

Solvers of stress minimisation: majorisation, L-BFGS, and the choice between them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import OptimizeResult, minimize
from scipy.spatial.distance import cdist

from anisomap.numerics.compiled.parallel import MIN_COMPILED_ROWS, load_loops, parallel_map
from anisomap.numerics.precision import Reals, row_blocks

Floats = NDArray[np.float64]

COINCIDENT = 1e-150
"""Distance below which points coincide: the direction between them is rounding error."""

_N_PARTS = 16  # of the pairs; fixed, so that sums do not depend on the number of threads
_SPATIAL = 3  # coordinates of the faster loop; missing ones are 0
_FLOAT32_RANGE = 1e9  # distances up to this, and down to its inverse, have squares within float32


@dataclass(frozen=True, eq=False)
class Problem:
    """Distances to fit, and their weights, (N, N) each; 0 where unknown.

    weights: One row of ones if all weights are equal.
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
        if not all(1 / _FLOAT32_RANGE < extreme < _FLOAT32_RANGE for extreme in extremes):
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

    Borg & Groenen (2005), section 8.6: for point i ``2 sum_j w_ij (1 - D_ij / d_ij) (x_i - x_j)``.
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
        cuts = n_points * (1 - np.sqrt(1 - np.arange(_N_PARTS + 1) / _N_PARTS))
        edges = (2 * np.round(cuts / 2)).astype(int).tolist()
        edges[-1] = n_points

        def compiled_stress(positions: Floats) -> tuple[float, Floats]:
            n_axes = positions.shape[1]
            points = np.zeros((max(n_axes, _SPATIAL), n_points), np.float32 if single else float)
            points[:n_axes] = positions.T
            add_stress = loops.add_spatial_stress if n_axes <= _SPATIAL else loops.add_stress
            slopes = np.zeros((_N_PARTS, *points.shape), points.dtype)

            def add(part: int) -> float:
                rows = (edges[part], edges[part + 1])
                return float(
                    add_stress(points, problem.targets, problem.weights, rows, slopes[part])
                )

            raw = sum(map_threads(add, range(_N_PARTS)))
            slope = np.zeros((n_points, n_axes))
            for first, part in zip(edges[:-1], slopes, strict=True):
                slope[first:] += part[:n_axes, first:].T  # earlier points are in earlier parts
            return raw, 2 * slope

        yield compiled_stress


def plain_stress(
    problem: Problem, positions: Floats, workspace: Floats | None = None
) -> tuple[float, Floats]:
    """Return the raw stress and its gradient, by (N, N) matrices in a workspace, (3, N, N)."""
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


_CONVERGENCE_STEPS = 3  # over which the decrease is tested, since single steps may be short
_NEGLIGIBLE = 1e-30  # share of the squared distances below which raw stress is rounding, (1e-15)^2


class SolverResult(NamedTuple):
    """Positions, the raw stress of the start and after each step, and whether it converged."""

    positions: Floats
    trace: list[float]
    converged: bool


def minimise_lbfgs(
    stress: Objective,
    start: Floats,
    scale: Floats,
    *,
    squares: float,
    tolerance: float,
    max_iterations: int,
) -> SolverResult:
    """Minimise a stress function by L-BFGS, with a diagonal first Hessian. start, scale (N, k | 1).

    In coordinates that are multiplied by the root of the Hessian, it is the identity. Their unit is
    the length of the first step, which L-BFGS-B sets to 1, and the slope there is 1 as well.
    """
    raw, gradient = stress(start)
    trace = [raw]
    minimal = raw <= _NEGLIGIBLE * squares or not gradient.any()
    if minimal or max_iterations == 0:
        return SolverResult(start, trace, minimal)
    root = np.sqrt(scale)
    step = float(np.linalg.norm(gradient / root))
    root /= step

    def scaled(parameters: Floats) -> tuple[float, Floats]:
        raw, gradient = stress(parameters.reshape(start.shape) / root)
        return raw / step**2, (gradient / root / step**2).ravel()

    def is_minimal() -> bool:
        before = trace[-1 - _CONVERGENCE_STEPS] if len(trace) > _CONVERGENCE_STEPS else np.inf
        return trace[-1] <= _NEGLIGIBLE * squares or before - trace[-1] <= tolerance * trace[-1]

    def check(intermediate_result: OptimizeResult) -> None:
        trace.append(float(intermediate_result.fun) * step**2)
        if is_minimal():
            raise StopIteration

    found = minimize(
        scaled,
        (start * root).ravel(),
        jac=True,
        method="L-BFGS-B",
        callback=check,
        # Iterations end in `check`: the tolerances of scipy are those of a single step.
        options={"maxiter": max_iterations, "maxfun": 20 * max_iterations, "ftol": 0, "gtol": 0},
    )
    # A search that ends early cannot decrease the stress any further.
    converged = len(trace) <= max_iterations or is_minimal()
    return SolverResult(np.asarray(found.x).reshape(start.shape) / root, trace, converged)


MAX_BOTH = 100
"""Maximum number of points for which both solvers run: both are fast, and minima are many."""

_FLOAT32_TOLERANCE = 1e-7  # at least, where sums over many pairs have a relative error of 1e-8

MIN_LARGE = 1000
"""Number of points from which the choice of solver stops at `LARGE_TOLERANCE`."""

LARGE_TOLERANCE = 1e-5
"""Minimum tolerance for large problems: Stress-1 is within .02 % of that with 1e-7."""


def minimise_auto(
    problem: Problem, start: Floats, tolerance: float, max_iterations: int
) -> SolverResult:
    """Minimise by L-BFGS; for up to 100 points also by majorisation, and take the lower stress.

    Compiled problems are first minimised in float32, in half the time; large ones only so.
    """
    if len(start) <= MAX_BOTH:
        found = lbfgs(problem, start, tolerance, max_iterations)
        other = majorise(problem, start, tolerance, max_iterations)
        return other if other.trace[-1] < found.trace[-1] else found
    coarse = problem.single() if problem.is_compiled else None
    if coarse is None:
        return lbfgs(problem, start, tolerance, max_iterations)
    large = len(start) >= MIN_LARGE
    least = max(tolerance, LARGE_TOLERANCE if large else _FLOAT32_TOLERANCE)
    first = lbfgs(coarse, start, least, max_iterations, single=True)
    left = 0 if large else max_iterations + 1 - len(first.trace)
    second = lbfgs(problem, first.positions, tolerance, left)
    # Stresses in float32 may be too low by 1e-6; the trace must not increase to the exact ones.
    before = np.maximum(first.trace[:-1], second.trace[0]).tolist()
    return SolverResult(
        second.positions, before + second.trace, first.converged if large else second.converged
    )


def lbfgs(
    problem: Problem,
    start: Floats,
    tolerance: float,
    max_iterations: int,
    *,
    single: bool = False,
) -> SolverResult:
    """Minimise the raw stress by L-BFGS; the first Hessian is twice the weight of each point."""
    n_points = len(start)
    scale = 2 * problem.weight_of_points() * n_points / max(n_points - 1, 1)
    with objective(problem, single=single) as stress:
        return minimise_lbfgs(
            stress,
            start,
            scale,
            squares=problem.weighted_squares(),
            tolerance=tolerance,
            max_iterations=max_iterations,
        )


def majorise(
    problem: Problem, start: Floats, tolerance: float, max_iterations: int
) -> SolverResult:
    """Minimise by Guttman transforms, ``X <- V^+ B(X) X`` (Borg & Groenen 2005, eq. 8.28).

    Half the gradient is ``V X - B(X) X``, so that a transform subtracts ``V^+`` times it.
    """
    solve = _laplacian_solver(problem)
    negligible = _NEGLIGIBLE * problem.weighted_squares()
    with objective(problem) as stress:
        positions = start
        raw, gradient = stress(start)
        trace, converged = [raw], raw == 0
        while not converged and len(trace) <= max_iterations:
            moved = positions - solve(gradient / 2)
            raw, gradient = stress(moved)
            if raw > trace[-1]:  # rounding at the minimum: keep the better configuration
                return SolverResult(positions, trace, converged=True)
            converged = trace[-1] - raw <= tolerance * trace[-1] or raw <= negligible
            positions = moved
            trace.append(raw)
    return SolverResult(positions, trace, converged)


def _laplacian_solver(problem: Problem) -> Callable[[Floats], Floats]:
    """Return the map ``Y -> V^+ Y`` for columns Y that sum to zero, without forming ``V^+``."""
    n_points = len(problem.targets)
    if problem.equal_weights or n_points == 1:
        return lambda product: product / n_points
    # 11'/N fills the null space of V, common translations, to which B(X) X is orthogonal.
    laplacian = np.diag(problem.weights.sum(axis=1)) - problem.weights
    factor = cho_factor(laplacian + problem.weights.mean())
    return lambda product: np.asarray(cho_solve(factor, product))


SOLVERS = {"auto": minimise_auto, "lbfgs": lbfgs, "majorization": majorise}
"""Solvers by name: functions of a problem, a start, a tolerance and a number of iterations."""
