"""Curvature of the objective of the covariogram fit, which makes its minimisation fast.

Minimisation of the objective of the covariogram fit over positions and exponent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsyrk, dtrsv, ssyrk, strsv
from scipy.linalg.lapack import dpotrf, spotrf
from scipy.optimize import Bounds, minimize

from anisomap.numerics.compiled.parallel import (
    MIN_COMPILED_ROWS,
    MapFunction,
    load_loops,
    serial_map,
)
from anisomap.numerics.covariogram.objective import (
    Block,
    CovariogramOptions,
    objective,
    solve_amplitude_and_offset,
)
from anisomap.numerics.precision import Reals

Matrix: TypeAlias = Reals

_MIN_EIGENVALUE = 1e-15  # relative, as in numpy.linalg.pinv


def gauss_newton_matrix(
    blocks: Sequence[Block],
    positions: Matrix,
    log_exponent: float,
    dtype: type[np.floating] = np.float64,
) -> Matrix:
    """Return the Gauss-Newton matrix of the objective by the positions and the log exponent.

    positions (N, k) -> (N k + 1, N k + 1).

    With ``<A, B> = tr(A W B W)`` and the derivatives J of the residuals R, its elements are
    ``<J_p, J_q>``. The derivative by a coordinate of sensor i is not 0 only in row and column i,
    so that all elements take k (k + 3) / 2 products of (n, n) matrices. Amplitude and offset are
    linear; eliminating them is the Schur complement (Golub & Pereyra 1973, SIAM Journal on
    Numerical Analysis 10: 413-432; the approximation of Kaufman 1975, BIT 15: 49-57).
    """
    n_sensors, n_axes = positions.shape
    terms = [block.terms(positions, log_exponent) for block in blocks]
    amplitude, _ = solve_amplitude_and_offset(np.sum([term.products for term in terms], axis=0))
    matrix = np.zeros((positions.size + 1, positions.size + 1), dtype)
    cross, linear = np.zeros((3, n_axes, n_sensors)), np.zeros((3, 3))
    starts = np.arange(n_axes) * n_sensors
    compiled = n_sensors >= MIN_COMPILED_ROWS
    add_block = load_loops("covariogram").add_block if compiled else _add_block
    for block, term in zip(blocks, terms, strict=True):
        part = block.curvature(term, positions, float(np.exp(log_exponent)), amplitude)
        for (p, q), found in part.coordinates.items():
            add_block(matrix, found, starts[p] + block.sensors, starts[q] + block.sensors)
        cross[:, :, block.sensors] += part.cross
        linear += part.linear
    flat = cross.reshape(3, positions.size)
    matrix[:-1, -1] = flat[2]
    matrix[-1, -1] = linear[2, 2]
    # Rows whose outer products are those of the inverse: eigenvectors over roots of eigenvalues.
    values, vectors = np.linalg.eigh(linear[:2, :2])
    kept = values > _MIN_EIGENVALUE * values[-1]
    roots = vectors[:, kept].T / np.sqrt(values[kept])[:, None]
    eliminated = roots @ np.hstack([flat[:2], linear[:2, 2:]])
    # The upper triangle of a C-contiguous matrix is the lower one of its transpose for BLAS.
    rank_update = ssyrk if matrix.dtype == np.float32 else dsyrk
    rank_update(-1.0, eliminated.T, beta=1.0, c=matrix.T, lower=True, overwrite_c=True)
    return matrix


def _add_block(
    matrix: Matrix, block: Matrix, rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> None:
    """Add a block as `anisomap.numerics.compiled.covariogram.add_block`, at sorted indices."""
    if rows[-1] - rows[0] < len(rows) and columns[-1] - columns[0] < len(columns):
        # All sensors are in one block: slices take a tenth of the time of indices.
        matrix[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += block
    else:
        matrix[np.ix_(rows, columns)] += block


Vector: TypeAlias = NDArray[np.float64]
Objective: TypeAlias = Callable[[Vector], tuple[float, Vector]]

MAX_CURVATURE = 6001
"""Maximum number of parameters for which their curvature is factorised.

Its cubic time grows faster than that of the iterations it saves: about equal from 3,000 sensors.
"""

_EXPONENT_BOUNDS = (0.3, 4.0)  # wider than all fitted values; chosen by hand
# Iterations with one curvature. With 30 or 40, a retina and Nao's torso took two thirds of the
# time that they took with 20, and flat skins as long.
_ROUND = 40
_DAMPING = 1e-2  # of the diagonal, for directions without curvature; .001 to .03 took equal time
_LEAST_DAMPING = 1e-6  # of the mean of the diagonal
_SINGLE = 1000  # parameters from which the curvature is factorised in float32, for speed
_MEMORY = 40  # pairs of differences of L-BFGS: those of all iterations with one curvature
_LINE_SEARCH = 6  # evaluations; more are needed only where float32 hides the decrease
_TOO_EXACT = 1e-12  # relative decrease that is never met before convergence


@dataclass(frozen=True, eq=False)
class Minimum:
    """A minimum of the objective.

    positions (N, k)
    """

    positions: Matrix
    log_exponent: float
    value: float
    iterations: int
    converged: bool


def minimise(
    blocks: Sequence[Block],
    start: Matrix,
    options: CovariogramOptions,
    *,
    tolerance: float,
    displacement: float,
    map_blocks: MapFunction = serial_map,
) -> Minimum:
    """Minimise the objective over positions and exponent.

    start (N, k).

    Objectives with far-reaching correlations are badly conditioned: long waves of the map hardly
    change the objective, and L-BFGS follows them in hundreds of iterations. Here it searches over
    y with ``x = x_0 + U^-1 y``, where U'U is the Gauss-Newton matrix at x_0 (`curvature`), which is
    computed again every 40 iterations. The curvature by y is then nearly the identity.
    """
    n_sensors, n_axes = start.shape

    def positions(parameters: Vector) -> Matrix:
        return np.ascontiguousarray(parameters[:-1].reshape(n_axes, n_sensors).T)

    def value_and_gradient(parameters: Vector) -> tuple[float, Vector]:
        value, slope = objective(blocks, positions(parameters), float(parameters[-1]), map_blocks)
        by_axes = slope[:-1].reshape(n_sensors, n_axes).T
        return value, np.append(by_axes.ravel(), slope[-1]).astype(np.float64)

    if start.size + 1 > MAX_CURVATURE:
        parameters = np.append(start.T.ravel(), 0.0).astype(np.float64)
        found = _unconditioned(value_and_gradient, parameters, options, tolerance)
        return Minimum(
            positions(found.x), float(found.x[-1]), float(found.fun), int(found.nit), found.success
        )
    parameters = np.append(start.T.ravel(), 0.0).astype(np.float64)
    dtype = np.float32 if parameters.size > _SINGLE else np.float64
    value, taken, converged = np.inf, 0, False
    while not converged and taken < options.max_iterations:
        points, exponent = positions(parameters), float(parameters[-1])
        factor = _factor(gauss_newton_matrix(blocks, points, exponent, dtype))
        search = _Search(value_and_gradient, parameters, factor, (tolerance, displacement))
        steps = min(_ROUND, options.max_iterations - taken)
        ended = search.run(steps)
        parameters, value = search.at(ended.x), float(ended.fun)
        taken += int(ended.nit)
        # A search that ends early without convergence cannot decrease the objective any further.
        converged = search.converged or ended.nit < steps
    return Minimum(positions(parameters), float(parameters[-1]), value, taken, bool(converged))


def _unconditioned(
    value_and_gradient: Objective,
    parameters: Vector,
    options: CovariogramOptions,
    tolerance: float,
) -> Any:
    return minimize(
        value_and_gradient,
        parameters,
        jac=True,
        method="L-BFGS-B",
        bounds=_bounds(parameters.size, _log_bounds()),
        options={
            "maxiter": options.max_iterations,
            "maxfun": 2 * options.max_iterations + 20,
            "maxcor": _MEMORY,
            "ftol": tolerance,
        },
    )


class _Search:
    """L-BFGS in coordinates in which the curvature is nearly the identity."""

    def __init__(
        self,
        value_and_gradient: Objective,
        origin: Vector,
        factor: Matrix,
        tolerances: tuple[float, float],
    ) -> None:
        self._objective, self._origin, self._factor = value_and_gradient, origin, factor
        self._tolerance, self._displacement = tolerances
        self._slope = np.zeros_like(origin)
        self._before = np.inf
        self.converged = False

    def _solved(self, y: Vector, *, transposed: bool = False) -> Vector:
        """Return U^-1 y, or U'^-1 y if transposed."""
        solve = strsv if self._factor.dtype == np.float32 else dtrsv
        # The factor is C-contiguous: BLAS takes its transpose, which is lower triangular.
        return np.asarray(solve(self._factor.T, y, lower=True, trans=not transposed))

    def at(self, y: Vector) -> Vector:
        return np.asarray(self._origin + self._solved(y), dtype=np.float64)

    def run(self, max_iterations: int) -> Any:
        # The factor is triangular, so that y[-1] is proportional to the log exponent.
        lowest, highest = (
            float((bound - self._origin[-1]) * self._factor[-1, -1]) for bound in _log_bounds()
        )
        return minimize(
            self._value_and_slope,
            np.zeros_like(self._origin),
            jac=True,
            method="L-BFGS-B",
            bounds=_bounds(self._origin.size, (lowest, highest)),
            callback=self._check,
            options={
                "maxiter": max_iterations,
                "maxfun": 2 * max_iterations + 20,
                "maxcor": min(_MEMORY, max_iterations),
                "maxls": _LINE_SEARCH,
                "ftol": _TOO_EXACT,
                "gtol": 0.0,
            },
        )

    def _value_and_slope(self, y: Vector) -> tuple[float, Vector]:
        value, gradient = self._objective(self.at(y))
        self._slope = np.asarray(self._solved(gradient, transposed=True), dtype=np.float64)
        return value, self._slope

    def _check(self, intermediate_result: Any) -> None:
        value = float(intermediate_result.fun)
        decrease = self._before - value
        self._before = value
        if decrease > self._tolerance * max(abs(value), 1.0):
            return
        step = self._solved(self._slope)[:-1]
        points = self.at(intermediate_result.x)[:-1]
        if np.linalg.norm(step) < self._displacement * np.linalg.norm(points):
            self.converged = True
            raise StopIteration


def _factor(curvature: Matrix) -> Matrix:
    """Return the triangular factor U of a damped curvature U'U, in its place.

    LAPACK takes the upper triangle of a C-contiguous matrix for the lower one of its transpose.
    """
    diagonal = np.diag(curvature).copy()
    damping = _DAMPING * diagonal + _LEAST_DAMPING * diagonal.mean()
    curvature[np.diag_indices_from(curvature)] += damping
    factorise = spotrf if curvature.dtype == np.float32 else dpotrf
    factor, info = factorise(curvature.T, lower=True, clean=False, overwrite_a=True)
    if info:
        raise np.linalg.LinAlgError(f"the curvature is not positive definite in row {info}")
    return np.asarray(factor.T)


def _bounds(n_parameters: int, of_last: tuple[float, float]) -> Bounds:
    """Bound the last parameter only; arrays, since scipy takes milliseconds to convert a list."""
    lowest, highest = np.full(n_parameters, -np.inf), np.full(n_parameters, np.inf)
    lowest[-1], highest[-1] = of_last
    return Bounds(lowest, highest)


def _log_bounds() -> tuple[float, float]:
    return float(np.log(_EXPONENT_BOUNDS[0])), float(np.log(_EXPONENT_BOUNDS[1]))
