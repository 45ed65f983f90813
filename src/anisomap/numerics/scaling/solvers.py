"""Ways down the stress: majorisation, L-BFGS, and the choice between them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

from anisomap.numerics.scaling.stress import COINCIDENT, Objective, Problem, is_compiled, objective

Floats = NDArray[np.float64]

MEMORY = 10
"""Steps that L-BFGS remembers."""

GUIDED = 5
"""First steps that L-BFGS takes as majorisation does, which choose the valley."""

QUIET = 3
"""L-BFGS may pause for a step: so many together must lower the stress too little."""

TRIALS = 10
"""Lengths tried of one step."""

BOTH_UP_TO = 100
"""So few points have many minima and cost next to nothing: both ways are gone."""

COARSE = 1e-7
"""In float32, where sums of many pairs differ by 1e-8, stop when steps lower them by less."""

NEGLIGIBLE = 1e-30
"""Raw stress below this share of the distances' own squares is none."""


class Descent(NamedTuple):
    """Where a way led: positions (N, k), the raw stress of each step, and whether it settled."""

    positions: Floats
    trace: list[float]
    converged: bool


class _Place(NamedTuple):
    positions: Floats
    raw: float
    gradient: Floats


class _Turn(NamedTuple):
    """A step, how the gradient changed along it, and the product of both."""

    step: Floats
    change: Floats
    product: float


def choose(problem: Problem, start: Floats, tolerance: float, max_iterations: int) -> Descent:
    """Descend by L-BFGS; of few points majorise, too, and take what is lower.

    Of many, go most of the way in float32, which costs half.
    """
    if len(start) <= BOTH_UP_TO:
        found = descend(problem, start, tolerance, max_iterations)
        other = majorise(problem, start, tolerance, max_iterations)
        return other if other.trace[-1] < found.trace[-1] else found
    coarse = problem.single() if is_compiled(len(start)) else None
    if coarse is None:
        return descend(problem, start, tolerance, max_iterations)
    return _in_two_stages(coarse, problem, start, tolerance, max_iterations)


def _in_two_stages(
    coarse: Problem, problem: Problem, start: Floats, tolerance: float, max_iterations: int
) -> Descent:
    first = descend(coarse, start, max(tolerance, COARSE), max_iterations, single=True)
    left = max_iterations + 1 - len(first.trace)
    second = descend(problem, first.positions, tolerance, left)
    # A stress in float32 may be a millionth too low: that of the same place is known exactly now.
    before = np.maximum(first.trace[:-1], second.trace[0]).tolist()
    return Descent(second.positions, before + second.trace, second.converged)


def descend(
    problem: Problem,
    start: Floats,
    tolerance: float,
    max_iterations: int,
    *,
    single: bool = False,
) -> Descent:
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
        return follow(
            stress,
            start,
            scale,
            squares=problem.weighted_squares(),
            tolerance=tolerance,
            max_iterations=max_iterations,
        )


def follow(
    stress: Objective,
    start: Floats,
    scale: Floats,
    *,
    squares: float,
    tolerance: float,
    max_iterations: int,
) -> Descent:
    """Lower any stress by L-BFGS, as `descend` does that of all pairs.

    Parameters
    ----------
    stress : callable
    start : ndarray of shape (N, k)
    scale : ndarray of shape (N, 1)
        First guess of the curvature.
    squares : float
        Of the distances, weighted: what a raw stress is negligible beside.
    tolerance, max_iterations
        See `anisomap.numerics.scaling.mds.SmacofOptions`.

    Returns
    -------
    Descent
    """
    negligible = NEGLIGIBLE * squares
    turns: deque[_Turn] = deque(maxlen=MEMORY)
    here = _Place(start, *stress(start))
    trace = [here.raw]
    converged = here.raw == 0
    while not converged and len(trace) <= max_iterations:
        there = _lower(stress, here, _direction(here.gradient, scale, turns))
        if there is None:
            converged = not turns
            turns.clear()
            continue
        if len(trace) > GUIDED:
            _remember(turns, here, there, scale)
        here = there
        trace.append(here.raw)
        quiet = len(trace) > QUIET and trace[-1 - QUIET] - here.raw <= tolerance * here.raw
        converged = quiet or here.raw <= negligible
    return Descent(here.positions, trace, converged)


def _direction(gradient: Floats, scale: Floats, turns: deque[_Turn]) -> Floats:
    step = gradient.copy()
    shares = []
    for turn in reversed(turns):
        shares.append(np.vdot(turn.step, step) / turn.product)
        step -= shares[-1] * turn.change
    step /= scale
    if turns:
        step *= turns[-1].product / np.vdot(turns[-1].change, turns[-1].change / scale)
    for turn, share in zip(turns, reversed(shares), strict=True):
        step += (share - np.vdot(turn.change, step) / turn.product) * turn.step
    return step


def _lower(stress: Objective, here: _Place, step: Floats) -> _Place | None:
    """Go along a step as far as lowers the stress well; None if nothing does."""
    promised = float(np.vdot(step, here.gradient))
    length = 1.0
    for _ in range(TRIALS if promised > 0 else 0):
        positions = here.positions - length * step
        there = _Place(positions, *stress(positions))
        if there.raw <= here.raw - 1e-4 * length * promised:
            return there
        # Where the parabola through both stresses and the slope is lowest, within bounds.
        bend = 2 * (there.raw - here.raw + length * promised)
        length *= min(0.5, max(0.1, length * promised / bend))
    return None


def _remember(turns: deque[_Turn], here: _Place, there: _Place, scale: Floats) -> None:
    turn = there.positions - here.positions, there.gradient - here.gradient
    product = float(np.vdot(*turn))
    # Without curvature along the step it would turn the next one uphill.
    if product > 1e-10 * np.vdot(turn[1], turn[1] / scale):
        turns.append(_Turn(*turn, product))


def majorise(problem: Problem, start: Floats, tolerance: float, max_iterations: int) -> Descent:
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
    return Descent(positions, trace, converged)


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


SOLVERS = {"auto": choose, "lbfgs": descend, "majorization": majorise}
"""By name; each takes a problem, a start, the tolerance, and the most iterations."""
