"""Solvers of stress minimisation: majorisation, L-BFGS, and the choice between them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

from anisomap.numerics.scaling.lbfgs import NEGLIGIBLE, SolverResult, minimise_lbfgs
from anisomap.numerics.scaling.stress import COINCIDENT, Floats, Problem, objective

MAX_BOTH = 100
"""Maximum number of points for which both solvers run: both are fast, and minima are many."""

FLOAT32_TOLERANCE = 1e-7
"""Minimum tolerance in float32, where sums over many pairs have a relative error of 1e-8."""

MIN_LARGE = 1000
"""Number of points from which the choice of solver stops at `LARGE_TOLERANCE`."""

LARGE_TOLERANCE = 1e-5
"""Minimum tolerance for large problems, whose stress decreases slowly and hardly for long.

On rubbed, flat and round skins of 1,000 sensors, Stress-1 was within .02 % of that with 1e-7, and
distances correlated with those by 1 - 1e-6, in a third of the iterations.
"""


def minimise_auto(
    problem: Problem, start: Floats, tolerance: float, max_iterations: int
) -> SolverResult:
    """Minimise by L-BFGS; for up to 100 points also by majorisation, and take the lower stress.

    Compiled problems are first minimised in float32, which takes half the time; from 1,000 points
    on, only in float32, and to a tolerance of 1e-5 at least.
    """
    if len(start) <= MAX_BOTH:
        found = lbfgs(problem, start, tolerance, max_iterations)
        other = majorise(problem, start, tolerance, max_iterations)
        return other if other.trace[-1] < found.trace[-1] else found
    coarse = problem.single() if problem.is_compiled else None
    if coarse is None:
        return lbfgs(problem, start, tolerance, max_iterations)
    large = len(start) >= MIN_LARGE
    least = max(tolerance, LARGE_TOLERANCE if large else FLOAT32_TOLERANCE)
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
    """Minimise the raw stress by L-BFGS.

    The first Hessian is twice the total weight of each point. Alone and with equal weights, it
    gives the steps of majorisation. With many minima, the result may differ from that of
    majorisation; its stress is then more often lower.
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
    """Minimise by Guttman transforms, ``X <- V^+ B(X) X`` (Borg & Groenen 2005, eq. 8.28)."""
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
        # B(X) X with b_ij = -w_ij D_ij / d_ij, and 0 where points coincide (eq. 8.25).
        moved = solve(ratios.sum(axis=1)[:, None] * positions - ratios @ positions)
        moved_distances = cdist(moved, moved)
        raw = _raw_stress(problem, moved_distances)
        if raw > trace[-1]:  # rounding at the minimum: keep the better configuration
            converged = True
            break
        converged = trace[-1] - raw <= tolerance * trace[-1] or raw <= negligible
        positions, distances = moved, moved_distances
        trace.append(raw)
    return SolverResult(positions, trace, converged)


def _raw_stress(problem: Problem, distances: Floats) -> float:
    return float((problem.weights * (distances - problem.targets) ** 2).sum()) / 2


def _laplacian_solver(problem: Problem) -> Callable[[Floats], Floats]:
    """Return the map ``Y -> V^+ Y`` for columns Y that sum to zero.

    ``V^+`` is not formed: with equal weights the map divides by N, else ``V + 11'/N`` is factorised
    once.
    """
    n_points = len(problem.targets)
    if problem.equal_weights or n_points == 1:
        return lambda product: product / n_points
    # 11'/N fills the null space of V, common translations, to which B(X) X is orthogonal.
    laplacian = np.diag(problem.weights.sum(axis=1)) - problem.weights
    factor = cho_factor(laplacian + problem.weights.mean())
    return lambda product: np.asarray(cho_solve(factor, product))


SOLVERS = {"auto": minimise_auto, "lbfgs": lbfgs, "majorization": majorise}
"""Solvers by name: functions of a problem, a start, a tolerance and a number of iterations."""
