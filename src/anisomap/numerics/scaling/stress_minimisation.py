"""From distances to positions: Torgerson's classical scaling and SMACOF."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.graph.connectivity import components
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.graph.metric import check_semi_metric, metricise
from anisomap.numerics.precision import Reals
from anisomap.numerics.scaling.classical import torgerson
from anisomap.numerics.scaling.solvers import SOLVERS
from anisomap.numerics.scaling.stress import Problem

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class SmacofOptions:
    """When to stop SMACOF, and how to get there.

    Parameters
    ----------
    tolerance : float
        Stop when an iteration (of L-BFGS, three together) lowers the raw stress by less than this
        share of it. Relative, so that the unit of the distances does not matter.
    max_iterations : int
        Stop after so many iterations at the latest.
    solver : {"auto", "lbfgs", "majorization"}
        ``"majorization"`` is SMACOF as published, which creeps where a map is flat; ``"lbfgs"``
        takes some ten times fewer iterations. ``"auto"`` is L-BFGS, and up to 100 points, where
        minima are many, the better of both.
    """

    tolerance: float = 1e-8
    max_iterations: int = 3000
    solver: str = "auto"

    def __post_init__(self) -> None:
        if self.solver not in SOLVERS:
            raise InputError(
                f"there is no solver {self.solver!r}; choose from {', '.join(SOLVERS)}"
            )
        if not self.tolerance >= 0:
            raise InputError(f"the tolerance is {self.tolerance}; it must be at least 0")
        if self.max_iterations < 0:
            raise InputError(f"max_iterations is {self.max_iterations}; it must be at least 0")


@dataclass(frozen=True, eq=False)
class Scaling:
    """What SMACOF found.

    Attributes
    ----------
    positions : ndarray of shape (N, k)
        Centred on the origin.
    raw_stress : float
        Sum over i < j of w_ij (d_ij - D_ij)^2 of `positions`, in squared units of the distances.
    spread : float
        Sum over i < j of w_ij d_ij^2 of `positions`.
    trace : ndarray of shape (iterations + 1,)
        Raw stress of the start and after each iteration; never rises.
    converged : bool
        Whether the tolerance was met before the iterations ran out.
    """

    positions: NDArray[np.float64]
    raw_stress: float
    spread: float
    trace: NDArray[np.float64]
    converged: bool

    @property
    def stress(self) -> float:
        """Stress-1 of `positions` (Borg & Groenen 2005, eq. 3.9); 0 if all of them coincide."""
        return float(np.sqrt(self.raw_stress / self.spread)) if self.spread > 0 else 0.0


def smacof(
    distances: ArrayLike,
    *,
    dimensions: int = 3,
    start: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    options: SmacofOptions | None = None,
) -> Scaling:
    """Find the configuration whose distances fit best: the least raw stress.

    Parameters
    ----------
    distances : array_like of shape (N, N)
        Symmetric, non-negative, zero diagonal. Infinite where a distance is unknown.
    dimensions : int
        Number of coordinates, k >= 1; given by `start` where there is one.
    start : array_like of shape (N, k), optional
        Where to set out from; Torgerson's scaling unless given (unknown distances are replaced by
        shortest paths for it).
    weights : array_like of shape (N, N), optional
        How much each distance counts: symmetric, non-negative, the diagonal is not looked at. 0
        is unknown; 1 everywhere unless given.
    options : SmacofOptions, optional

    Returns
    -------
    Scaling

    Raises
    ------
    InputError
        If shapes disagree, a matrix is not symmetric, a distance or weight is negative, the start
        is not finite, or the known distances leave separate pieces.

    Notes
    -----
    De Leeuw (1977); Borg & Groenen (2005), chapter 8. No iteration raises the weighted stress,
    whatever the solver. From 500 points on the stress and its gradient are worked out by compiled
    loops.
    """
    chosen = options or SmacofOptions()
    targets = check_semi_metric(distances, copy=False)
    problem = Problem(targets, _check_weights(weights, targets))
    known = targets if problem.all_alike else _known(problem)
    if start is None:
        start = torgerson(known if np.isfinite(known.max()) else metricise(known), dimensions)
    positions = _check_start(start, len(targets))
    positions -= positions.mean(axis=0)  # far from the origin float32 would not tell points apart
    if not problem.all_alike:
        problem = replace(problem, targets=np.where(np.isinf(targets), 0, targets))
    find = SOLVERS[chosen.solver]
    positions, trace, converged = find(problem, positions, chosen.tolerance, chosen.max_iterations)
    if not converged and chosen.max_iterations:
        logger.info("SMACOF stopped after %d iterations, still improving", len(trace) - 1)
    history = np.array(trace)
    positions = positions - positions.mean(axis=0)
    positions.setflags(write=False)
    history.setflags(write=False)
    return Scaling(
        positions=positions,
        raw_stress=trace[-1],
        spread=problem.weighted_squares(positions),
        trace=history,
        converged=bool(converged),
    )


def _known(problem: Problem) -> Reals:
    """Give the known distances, the others infinite, if they hold everything together."""
    known = problem.targets.copy()
    known[problem.weights <= 0] = np.inf
    np.fill_diagonal(known, 0)
    n_pieces = components(known).max() + 1
    if n_pieces > 1:
        raise InputError(
            f"the known distances leave {n_pieces} separate pieces: scale each by itself"
        )
    return known


def _check_weights(weights: ArrayLike | None, targets: Reals) -> Reals:
    if weights is None and np.isfinite(targets.max()):
        return np.ones((1, len(targets)), targets.dtype)
    if weights is None:
        checked = np.ones_like(targets)
    else:
        checked = as_symmetric(weights, "weight").astype(targets.dtype, copy=False)
        if checked.shape != targets.shape:
            raise InputError(f"weights {checked.shape} do not fit distances {targets.shape}")
        if (checked < 0).any() or not np.isfinite(checked).all():
            raise InputError("weights must be finite and at least 0")
    np.fill_diagonal(checked, 0)
    checked[np.isinf(targets)] = 0
    return checked


def _check_start(start: ArrayLike, n_points: int) -> NDArray[np.float64]:
    positions = np.array(start, dtype=np.float64)
    if positions.ndim != 2 or len(positions) != n_points or not positions.shape[1]:
        raise InputError(f"the start has shape {positions.shape}; it must be ({n_points}, k)")
    if not np.isfinite(positions).all():
        raise InputError("the start holds NaN or infinite coordinates")
    return positions
