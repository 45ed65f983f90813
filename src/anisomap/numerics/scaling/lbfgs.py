"""L-BFGS for stress."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from anisomap.numerics.scaling.stress import Floats, Objective

MEMORY = 10
"""Steps that L-BFGS remembers."""


GUIDED = 5
"""First steps that L-BFGS takes as majorisation does, which choose the valley."""


QUIET = 3
"""L-BFGS may pause for a step: so many together must lower the stress too little."""


TRIALS = 10
"""Lengths tried of one step."""


NEGLIGIBLE = 1e-30
"""Raw stress below this share of the distances' own squares is none."""


class SolverResult(NamedTuple):
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


def minimise_lbfgs(
    stress: Objective,
    start: Floats,
    scale: Floats,
    *,
    squares: float,
    tolerance: float,
    max_iterations: int,
) -> SolverResult:
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
        See `anisomap.numerics.scaling.stress_minimisation.SmacofOptions`.

    Returns
    -------
    SolverResult
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
    return SolverResult(here.positions, trace, converged)


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
