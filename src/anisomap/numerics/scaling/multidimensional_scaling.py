"""Classical scaling.

Metric scaling by minimising the raw stress (SMACOF).
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh
from scipy.linalg.blas import dsymv, ssymv
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

from anisomap.base.defaults import MAX_ITERATIONS, TOLERANCE
from anisomap.errors import InputError
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.graph.metric import check_semi_metric, metricise
from anisomap.numerics.graph.neighbour_graphs import components
from anisomap.numerics.precision import Reals
from anisomap.numerics.scaling.stress_solvers import SOLVERS, Problem

DENSE_LIMIT = 200
"""Maximum number of points for which a full eigendecomposition is faster than an iterative one."""

Eigen: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64]]
Product: TypeAlias = Callable[[NDArray[np.float64]], Reals]

_NEARLY_GREATEST = 1 - 1e-6  # magnitudes above this share differ by rounding only


def torgerson(distances: ArrayLike, dimensions: int) -> NDArray[np.float64]:
    """Classical scaling: positions from the leading eigenvectors of the inner products.

    Parameters
    ----------
    distances : array_like of shape (N, N)
        Finite, symmetric, zero diagonal.
    dimensions : int
        Number of coordinates, k >= 1.

    Returns
    -------
    ndarray of shape (N, k)
        Centred; columns are orthogonal, by decreasing spread. The entry of greatest magnitude of
        each column is positive, so that runs agree; of equal ones, as on symmetric skins, the
        first. Columns with eigenvalues of 0 or less are 0.

    Raises
    ------
    InputError
        If the distances are not finite, not symmetric or negative, or `dimensions` is less than 1.

    Notes
    -----
    Torgerson (1952), Psychometrika 17: 401-419; Borg & Groenen (2005), chapter 12. For many points
    double centring is applied as a linear operator, and eigenvectors are computed iteratively.
    """
    squares = np.square(check_semi_metric(distances, copy=False))
    if dimensions < 1:
        raise InputError(f"dimensions must be at least 1, got {dimensions}")
    if not np.isfinite(squares.max()):
        raise InputError("distances must be finite; scale each connected component separately")
    n_points = len(squares)
    if n_points <= max(DENSE_LIMIT, 2 * dimensions + 1):
        found = _leading_dense(squares, min(dimensions, n_points))
        return _principal_coordinates(found, dimensions)
    double = squares.dtype == np.float64
    # symv reads only one triangle; reading the matrix takes most of the time.
    multiply = partial(dsymv if double else ssymv, 1.0, squares.T)
    leading = leading_eigenvectors(multiply, n_points, dimensions, single=not double)
    return _principal_coordinates(leading or _leading_dense(squares, dimensions), dimensions)


def classical_scaling(multiply: Product, n_points: int, dimensions: int) -> NDArray[np.float64]:
    """Scale as `torgerson`, given products with the squared distances in float32, -> (N, k)."""
    found = leading_eigenvectors(multiply, n_points, dimensions, single=True)
    if found is None:
        raise InputError("the distances have no leading eigenvectors: do all points coincide?")
    return _principal_coordinates(found, dimensions)


def _principal_coordinates(found: Eigen, dimensions: int) -> NDArray[np.float64]:
    """Scale eigenvectors (N, k) by the roots of their eigenvalues, and choose their signs."""
    values, vectors = found
    order = np.argsort(values)[::-1]
    columns = vectors[:, order] * np.sqrt(np.maximum(values[order], 0))
    magnitudes = np.abs(columns)
    first = (magnitudes >= _NEARLY_GREATEST * magnitudes.max(axis=0)).argmax(axis=0)
    peaks = columns[first, np.arange(columns.shape[1])]
    columns = columns * np.where(peaks < 0, -1.0, 1.0)
    return np.pad(columns, ((0, 0), (0, dimensions - columns.shape[1])))


def _leading_dense(squares: Reals, count: int) -> Eigen:
    rows = squares.mean(axis=0, dtype=np.float64)
    inner = -(squares - np.add.outer(rows, rows) + rows.mean()) / 2
    values, vectors = eigh(inner, subset_by_index=[len(inner) - count, len(inner) - 1])
    return values, vectors


def leading_eigenvectors(
    multiply: Product, n_points: int, count: int, *, single: bool
) -> Eigen | None:
    """Find the leading eigenvectors of double-centred squares; None if they do not converge.

    multiply: Returns the product of the squared distances, (N, N), with a vector (N,).
    single: Whether products are in float32.
    """

    def double_centred(vector: NDArray[np.float64]) -> NDArray[np.float64]:
        product = multiply(vector - vector.mean()).astype(np.float64, copy=False)
        return np.asarray((product - product.mean()) / -2)

    operator = LinearOperator((n_points, n_points), matvec=double_centred, dtype=np.float64)
    # A fixed start, since ARPACK's own is random.
    start = np.random.default_rng(0).standard_normal(n_points)
    try:
        # Machine precision, or the precision of products in float32.
        found = eigsh(operator, k=count, which="LA", v0=start, tol=1e-5 if single else 0)
    except ArpackError:  # no convergence, or the matrix is zero: all points coincide
        return None
    return found[0], found[1]


logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class SmacofOptions:
    """Stopping criteria and solver of stress minimisation.

    Parameters
    ----------
    tolerance : float
        Relative decrease of the raw stress per iteration (of L-BFGS, in three iterations) below
        which iterations stop. Independent of the unit of the distances.
    max_iterations : int
        Maximum number of iterations.
    solver : {"auto", "lbfgs", "majorization"}
        ``"majorization"`` is SMACOF as published, which converges slowly where the stress is flat.
        ``"lbfgs"`` takes about a tenth of the iterations. ``"auto"`` is L-BFGS; for up to 100
        points, where minima are many, it is the better result of both; from 1,000 points on, it
        stops at a tolerance of 1e-5, with Stress-1 within 0.1 % of the minimum.

    Raises
    ------
    InputError
        If a value is out of range, or the solver is unknown.
    """

    tolerance: float = TOLERANCE
    max_iterations: int = MAX_ITERATIONS
    solver: str = "auto"

    def __post_init__(self) -> None:
        if self.solver not in SOLVERS:
            raise InputError(f"unknown solver {self.solver!r}; choose from {', '.join(SOLVERS)}")
        if not self.tolerance >= 0:
            raise InputError(f"tolerance must be at least 0, got {self.tolerance}")
        if self.max_iterations < 0:
            raise InputError(f"max_iterations must be at least 0, got {self.max_iterations}")


@dataclass(frozen=True, eq=False)
class Scaling:
    """Result of stress minimisation.

    Attributes
    ----------
    positions : ndarray of shape (N, k)
        Centred on the origin.
    raw_stress : float
        Sum over i < j of w_ij (d_ij - D_ij)^2, in squared units of the distances.
    spread : float
        Sum over i < j of w_ij d_ij^2.
    trace : ndarray of shape (iterations + 1,)
        Raw stress of the start and after each iteration; never increases.
    converged : bool
        Whether the tolerance was met within the maximum number of iterations.
    """

    positions: NDArray[np.float64]
    raw_stress: float
    spread: float
    trace: NDArray[np.float64]
    converged: bool

    @property
    def stress(self) -> float:
        """Stress-1 (Borg & Groenen 2005, eq. 3.9); 0 if all positions coincide."""
        return float(np.sqrt(self.raw_stress / self.spread)) if self.spread > 0 else 0.0


def smacof(
    distances: ArrayLike,
    *,
    dimensions: int = 3,
    start: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    options: SmacofOptions | None = None,
) -> Scaling:
    """Find a configuration with minimal raw stress.

    Parameters
    ----------
    distances : array_like of shape (N, N)
        Symmetric, non-negative, zero diagonal; infinite where unknown.
    dimensions : int
        Number of coordinates, k >= 1; ignored if `start` is given.
    start : array_like of shape (N, k), optional
        Initial configuration; by default classical scaling, with shortest paths in place of
        unknown distances.
    weights : array_like of shape (N, N), optional
        Symmetric, non-negative; 0 where unknown. The diagonal is ignored. 1 by default.
    options : SmacofOptions, optional

    Returns
    -------
    Scaling

    Raises
    ------
    InputError
        If shapes disagree, a matrix is not symmetric, a distance or weight is negative, the start
        is not finite, or the known distances do not connect all points.

    Notes
    -----
    De Leeuw (1977); Borg & Groenen (2005), chapter 8. No iteration of any solver increases the
    weighted stress. From 500 points on the stress is computed by compiled loops.
    """
    chosen = options or SmacofOptions()
    targets = check_semi_metric(distances, copy=False)
    problem = Problem(targets, _check_weights(weights, targets))
    known = targets if problem.equal_weights else _connected_targets(problem)
    if start is None:
        start = torgerson(known if np.isfinite(known.max()) else metricise(known), dimensions)
    positions = _check_start(start, len(targets))
    positions -= positions.mean(axis=0)  # float32 could not resolve points far from the origin
    if not problem.equal_weights:
        problem = replace(problem, targets=np.where(np.isinf(targets), 0, targets))
    solve = SOLVERS[chosen.solver]
    positions, trace, converged = solve(problem, positions, chosen.tolerance, chosen.max_iterations)
    if not converged and chosen.max_iterations:
        logger.info("stress minimisation did not converge in %d iterations", len(trace) - 1)
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


def _connected_targets(problem: Problem) -> Reals:
    """Return the distances, infinite where unknown; raise unless they connect all points."""
    known = problem.targets.copy()
    known[problem.weights <= 0] = np.inf
    np.fill_diagonal(known, 0)
    n_components = components(known).max() + 1
    if n_components > 1:
        raise InputError(
            f"the known distances form {n_components} connected components; scale each separately"
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
            raise InputError(f"weights have shape {checked.shape}; they must be {targets.shape}")
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
        raise InputError("the start has NaN or infinite coordinates")
    return positions
