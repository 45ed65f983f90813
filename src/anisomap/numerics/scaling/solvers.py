"""Ways down the stress: majorisation, L-BFGS, and the choice between them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

from anisomap.numerics.scaling.lbfgs import NEGLIGIBLE, SolverResult, minimise_lbfgs
from anisomap.numerics.scaling.stress import COINCIDENT, Problem, is_compiled, objective

Floats = NDArray[np.float64]


BOTH_UP_TO = 100
"""So few points have many minima and cost next to nothing: both ways are gone."""

COARSE = 1e-7
"""In float32, where sums of many pairs differ by 1e-8, stop when steps lower them by less."""


def minimise_auto(
    problem: Problem, start: Floats, tolerance: float, max_iterations: int
) -> SolverResult:
    """Descend by L-BFGS; of few points majorise, too, and take what is lower.

    Of many, go most of the way in float32, which costs half.
    """
    if len(start) <= BOTH_UP_TO:
        found = lbfgs(problem, start, tolerance, max_iterations)
        other = majorise(problem, start, tolerance, max_iterations)
        return other if other.trace[-1] < found.trace[-1] else found
    coarse = problem.single() if is_compiled(len(start)) else None
    if coarse is None:
        return lbfgs(problem, start, tolerance, max_iterations)
    return _in_two_stages(coarse, problem, start, tolerance, max_iterations)


def _in_two_stages(
    coarse: Problem, problem: Problem, start: Floats, tolerance: float, max_iterations: int
) -> SolverResult:
    first = lbfgs(coarse, start, max(tolerance, COARSE), max_iterations, single=True)
    left = max_iterations + 1 - len(first.trace)
    second = lbfgs(problem, first.positions, tolerance, left)
    # A stress in float32 may be a millionth too low: that of the same place is known exactly now.
    before = np.maximum(first.trace[:-1], second.trace[0]).tolist()
    return SolverResult(second.positions, before + second.trace, second.converged)


def lbfgs(
    problem: Problem,
    start: Floats,
    tolerance: float,
    max_iterations: int,
    *,
    single: bool = False,
) -> SolverResult:
    """Lower the stress by L-BFGS (Nocedal & Wright 2006, algorithms 7.4 and 7.5).

    Notes
    -----
    Its first guess of the curvature is twice the weight of each point's distances. With that alone
    and all weights equal, its step is majorisation's, so that is what remains where what L-BFGS
    remembers misleads. No step raises the stress. Where there are many minima it may end in another
    than majorisation does, more often a lower one.
    """
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
    """Lower the stress by Guttman transforms, ``X <- V^+ B(X) X`` (Borg & Groenen 2005, 8.28)."""
    targets, weights = problem.targets, problem.weights
    weighted_targets = weights * targets
    solve = _laplacian_solver(problem)
    negligible = NEGLIGIBLE * problem.weighted_squares()
    positions, distances = start, cdist(start, start)
    trace = [_raw_stress(problem, distances)]
    converged = trace[0] == 0
    while not converged and len(trace) <= max_iterations:
        ratios = np.divide(
            weighted_targets, distances, out=np.zeros_like(targets), where=distances > COINCIDENT
        )
        # B(X) X with b_ij = -w_ij D_ij / d_ij, and 0 where points coincide (8.25).
        moved = solve(ratios.sum(axis=1)[:, None] * positions - ratios @ positions)
        moved_distances = cdist(moved, moved)
        raw = _raw_stress(problem, moved_distances)
        if raw > trace[-1]:  # by rounding alone, at the minimum: keep the better configuration
            converged = True
            break
        converged = trace[-1] - raw <= tolerance * trace[-1] or raw <= negligible
        positions, distances = moved, moved_distances
        trace.append(raw)
    return SolverResult(positions, trace, converged)


def _raw_stress(problem: Problem, distances: Floats) -> float:
    return float((problem.weights * (distances - problem.targets) ** 2).sum()) / 2


def _laplacian_solver(problem: Problem) -> Callable[[Floats], Floats]:
    """Give the map ``Y -> V^+ Y`` for columns Y that sum to zero.

    ``V^+`` is never formed: with all weights equal it divides by N, otherwise ``V + 11'/N`` is
    factorised once.
    """
    n_points = len(problem.targets)
    if problem.all_alike or n_points == 1:
        return lambda product: product / n_points
    # 11'/N fills the null space (all points moved alike), which the product B(X) X never enters.
    laplacian = np.diag(problem.weights.sum(axis=1)) - problem.weights
    factor = cho_factor(laplacian + problem.weights.mean())
    return lambda product: np.asarray(cho_solve(factor, product))


SOLVERS = {"auto": minimise_auto, "lbfgs": lbfgs, "majorization": majorise}
"""By name; each takes a problem, a start, the tolerance, and the most iterations."""
