"""Joint fit of a covariogram and of the sensor positions to all correlations.

A covariogram is the covariance of two points as a function of their distance (geostatistics). It is
fitted together with the positions, to correlations with correlated errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg.blas import dtrsv, strsv
from scipy.linalg.lapack import dpotrf, spotrf
from scipy.optimize import Bounds, isotonic_regression, minimize
from scipy.spatial.distance import pdist, squareform

from anisomap.base.immutable import Immutable
from anisomap.numerics.covariogram.objective import (
    DEFAULT_COVARIOGRAM,
    CovariogramOptions,
    Objective,
    Problem,
    solve_amplitude_and_offset,
)
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.precision import Floats, Reals

_MAX_RANGE_SENSORS = 4000  # sensors for the estimate of the range; bounds time and memory
_RANGE_CORRELATIONS = (0.15, 0.45)  # around 1 / e; pairs with these are about one range apart
_MIN_SINGLE = 100  # minimum sensors for float32 matrices; with fewer, they save little time
# Relative displacement by the next step at convergence; positions then correlate with the minimum
# by 1 - 5e-7.
_DISPLACEMENT = 1e-3

_MAX_CURVATURE = 6001  # coordinates; with more, factorisation takes longer than it saves
_EXPONENT_BOUNDS = (0.3, 4.0)  # wider than all fitted values; chosen by hand
# Iterations with one curvature, and coordinates from which there are more: a curvature takes cubic
# time. With 30 or 40, a retina and Nao's torso took two thirds of the time that they took with 20,
# and flat skins as long; with 80, a sphere of 2,000 took four fifths.
_ROUND, _LONGER = 40, 3000
_DAMPING = 1e-2  # of the diagonal, for directions without curvature; .001 to .03 took equal time
_LEAST_DAMPING = 1e-6  # of the mean of the diagonal
_SINGLE = 1000  # coordinates from which the curvature is factorised in float32, for speed
_MEMORY = 40  # pairs of differences in L-BFGS: all iterations with one curvature
_LINE_SEARCH = 6  # evaluations; more are needed only if rounding in float32 hides the decrease
_TOO_EXACT = 1e-12  # relative decrease that is never met before convergence


@dataclass(frozen=True, eq=False)
class Covariogram(Immutable):
    """A fitted covariogram, ``amplitude exp(-d^exponent) + offset``, and the positions.

    positions (N, k): Centred; in units of the covariogram's range.
    objective: Minimum of the objective of `fit_covariogram`.
    converged: Whether the tolerance was met before the iterations ran out.
    factor: Triangular factor of the curvature near the positions; (1, 1) if it was not computed.
    """

    positions: Reals
    amplitude: float
    exponent: float
    offset: float
    objective: float
    iterations: int
    converged: bool
    factor: Reals

    def at(self, distances: ArrayLike) -> Reals:
        """Return the expected correlation at distances in units of `positions`."""
        d = np.asarray(distances, dtype=np.float64)
        return np.asarray(self.amplitude * np.exp(-(d**self.exponent)) + self.offset)


def fit_covariogram(
    similarity: ArrayLike,
    start: ArrayLike,
    metric: ArrayLike,
    *,
    noise: float,
    known: ArrayLike | None = None,
    options: CovariogramOptions | None = None,
    least_tolerance: float = 0.0,
    least_prior: float = 0.0,
    near: Covariogram | None = None,
) -> Covariogram:
    """Fit positions so that a single decreasing function of distance explains all correlations.

    similarity (N, N): Correlations S in [-1, 1], symmetric; the diagonal is ignored.
    start (N, k): Initial positions in any unit.
    metric (N, N): Distances D in the unit of `start`, which determine the positions of sensors that
        correlations do not determine; infinite where unknown, but not for all.
    noise: Sampling variance s^2 of a correlation, above 0: see `sampling_variance`.
    known (N, N): Mask of the known correlations; all by default.
    least_tolerance, least_prior: Minima of the `tolerance` and the `prior_weight` of the options.
    near: A fit to nearly the same correlations, at the same positions in its own unit. The search
        starts from its unit, exponent and curvature.

    Minimises over positions x and the covariogram's amplitude a, exponent b and offset c ::

        1/2 tr(R W R W) + s^2 sum_{i<j} (lambda g^(2h) (d_ij / (g D_ij) - 1)^2
                                         - alpha log (d_ij / u^(1-h)))
        R_ij = a exp(-d_ij^b) + c - S_ij,  R_ii = 0,  g = mean of d_ij / D_ij,  u^2 = mean of d_ij^2

    with lambda the `prior_weight` and alpha the `repulsion` of `CovariogramOptions`. h is 1 for up
    to 200 sensors, and ``(200 / N)^2`` for N sensors: the scale of a map is a single number, which
    must not be determined by the priors of all pairs.

    Errors of correlations are correlated: to second order, the log-likelihood of a covariance S
    under the model C is ``-T/4 tr(R C^-1 R C^-1)`` (Wishart). W replaces C^-1. It is
    ``(S + ridge I)^-1`` without the component of a signal common to all sensors, such as a hum or a
    change of posture: ``W - W11'W / 1'W1``. For given distances, a and c solve two linear
    equations, so L-BFGS searches only positions and exponent (variable projection; Golub &
    Pereyra 1973, SIAM Journal on Numerical Analysis 10: 413-432). Both priors scale with the noise
    and vanish as recordings grow.

    The residuals of more than `CovariogramOptions.max_whitened` sensors are not whitened: W is
    proportional to ``I - 11'/N``, which takes quadratic time.
    """
    chosen = options or DEFAULT_COVARIOGRAM
    correlation = as_symmetric(similarity, "similarity")
    positions = np.array(start, dtype=np.float64)
    lengths = as_symmetric(metric, "metric")
    mask = np.ones(correlation.shape, dtype=bool) if known is None else np.array(known, dtype=bool)
    positions -= positions.mean(axis=0)
    if near is None:
        unit = _estimate_range(correlation, positions, mask)
    else:
        unit = float(np.linalg.norm(positions) / np.linalg.norm(near.positions))
    positions /= unit
    np.fill_diagonal(mask, val=False)
    precision = np.float32 if len(positions) >= _MIN_SINGLE else np.float64
    prior = max(chosen.prior_weight, least_prior)
    problem = Problem(correlation, lengths / unit, mask, noise, prior, chosen, precision)
    objective = Objective(problem)
    tolerance = max(chosen.tolerance, least_tolerance)
    found = minimise(objective, positions, tolerance, chosen.max_iterations, near)
    terms = objective.terms(found.positions, found.log_exponent)
    amplitude, offset = solve_amplitude_and_offset(terms.products)
    return Covariogram(
        positions=found.positions - found.positions.mean(axis=0),
        amplitude=amplitude,
        exponent=float(np.exp(found.log_exponent)),
        offset=offset,
        objective=found.value,
        iterations=found.iterations,
        converged=found.converged,
        factor=found.factor,
    )


def _estimate_range(similarity: Reals, positions: Reals, known: NDArray[np.bool_]) -> float:
    """Return the median distance of pairs with a correlation of about 1 / e."""
    step = -(-len(positions) // _MAX_RANGE_SENSORS)
    distances = pdist(positions[::step])
    similar, pairs = (squareform(one[::step, ::step], checks=False) for one in (similarity, known))
    lowest, highest = _RANGE_CORRELATIONS
    one_range = pairs & (similar > lowest) & (similar < highest)
    chosen = distances[one_range] if one_range.any() else distances[pairs]
    unit = float(np.median(chosen)) if chosen.size else 0.0
    return unit if unit > 0 else 1.0


class Minimum(NamedTuple):
    """A minimum of the objective, and the factor of the latest curvature; positions (N, k)."""

    positions: Reals
    log_exponent: float
    value: float
    iterations: int
    converged: bool
    factor: Reals


def minimise(
    objective: Objective,
    start: Reals,
    tolerance: float,
    max_iterations: int,
    near: Covariogram | None = None,
) -> Minimum:
    """Minimise the objective over positions and exponent. start (N, k).

    Long waves of a map hardly change the objective, so that L-BFGS would take hundreds of
    iterations. It therefore searches over y with ``x = x_0 + U^-1 y``, where U'U is the damped
    Gauss-Newton matrix at x_0, which is computed again every 40 iterations, or 80. The curvature by
    y is nearly the identity.
    """
    factor, exponent = (np.ones((1, 1)), 1.0) if near is None else (near.factor, near.exponent)
    found = Minimum(start, float(np.log(exponent)), np.inf, 0, converged=False, factor=factor)
    while not found.converged and found.iterations < max_iterations:
        steps = max_iterations - found.iterations
        if start.size < _MAX_CURVATURE:
            steps = min(_ROUND * max(1, start.size // _LONGER), steps)
            if near is None or found.iterations:
                dtype = np.float32 if start.size >= _SINGLE else np.float64
                factor = _factor(
                    objective.gauss_newton_matrix(found.positions, found.log_exponent, dtype)
                )
        found = _search(objective, found, factor, tolerance, steps)
    return found


def _search(
    objective: Objective, start: Minimum, factor: Reals, tolerance: float, max_iterations: int
) -> Minimum:
    """Search by L-BFGS over y, see `minimise`; over ``x - x_0`` if there is no factor U."""
    origin = np.append(start.positions.T.ravel(), start.log_exponent)
    slope, before, converged = np.zeros_like(origin), np.inf, False
    # The factor is triangular, so that y[-1] is proportional to the log exponent.
    bounds = np.full((2, len(origin)), [[-np.inf], [np.inf]])
    bounds[:, -1] = (np.log(_EXPONENT_BOUNDS) - origin[-1]) * factor[-1, -1]

    def solved(y: Floats, *, transposed: bool = False) -> Floats:
        """Return U^-1 y, or U'^-1 y if transposed."""
        if len(factor) < len(y):
            return y
        solve = strsv if factor.dtype == np.float32 else dtrsv
        # The factor is C-contiguous: BLAS takes its transpose, which is lower triangular.
        return np.asarray(solve(factor.T, y, lower=True, trans=not transposed), float)

    def at(y: Floats) -> tuple[Reals, float]:
        """Return positions, (N, k), and the log exponent."""
        parameters = origin + solved(y)
        by_axes = parameters[:-1].reshape(start.positions.shape[::-1])
        return np.ascontiguousarray(by_axes.T), float(parameters[-1])

    def value_and_slope(y: Floats) -> tuple[float, Floats]:
        nonlocal slope
        positions, log_exponent = at(y)
        value, own = objective.value_and_slope(positions, log_exponent)
        by_axes = own[:-1].reshape(positions.shape).T
        slope = solved(np.append(by_axes.ravel(), own[-1]).astype(np.float64), transposed=True)
        return value, slope

    def check(intermediate_result: Any) -> None:
        nonlocal before, converged
        value, y = float(intermediate_result.fun), intermediate_result.x
        decrease, before = before - value, value
        if decrease > tolerance * max(abs(value), 1.0):
            return
        # An exponent at its bound does not move, for any slope of the objective.
        free = np.append(slope[:-1], slope[-1] * np.all(np.abs(bounds[:, -1] - y[-1]) > 0))
        # Without the curvature, the length of the next step is unknown.
        displacement = _DISPLACEMENT if start.positions.size < _MAX_CURVATURE else np.inf
        if np.linalg.norm(solved(free)[:-1]) < displacement * np.linalg.norm(at(y)[0]):
            converged = True
            raise StopIteration

    ended: Any = minimize(
        value_and_slope,
        np.zeros_like(origin),
        jac=True,
        method="L-BFGS-B",
        bounds=Bounds(*bounds),
        callback=check,
        options={
            "maxiter": max_iterations,
            "maxfun": 2 * max_iterations + 20,
            "maxcor": min(_MEMORY, max_iterations),
            "maxls": _LINE_SEARCH,
            "ftol": _TOO_EXACT,
            "gtol": 0.0,
        },
    )
    # A search that ends early without convergence cannot decrease the objective any further.
    converged = converged or ended.nit < max_iterations
    iterations = start.iterations + int(ended.nit)
    return Minimum(*at(ended.x), float(ended.fun), iterations, converged, factor)


def _factor(curvature: Reals) -> Reals:
    """Return the triangular factor U of a damped curvature U'U, in its place."""
    diagonal = np.diag(curvature).copy()
    damping = _DAMPING * diagonal + _LEAST_DAMPING * diagonal.mean()
    curvature[np.diag_indices_from(curvature)] += damping
    factorise = spotrf if curvature.dtype == np.float32 else dpotrf
    factor, info = factorise(curvature.T, lower=True, clean=False, overwrite_a=True)
    if info:
        raise np.linalg.LinAlgError(f"the curvature is not positive definite in row {info}")
    return np.asarray(factor.T)


_MAX_SENSORS = 1000  # regularly sampled sensors; 500,000 pairs suffice for a share
_SIGNIFICANT = 2.0  # standard deviations from which a fitted correlation counts as significant
_MIN_VARIANCE_FACTOR = 1e-4  # of correlations of nearly 1; bounds rounding errors
_DISTANCES = 1 << 14  # steps of distance, far below all errors; sums over steps need no sort
_MIN_PAIRS = 30  # fewer significant pairs determine no share; chosen by hand


def unexplained_share(
    similarity: ArrayLike, positions: ArrayLike, noise: float, *, known: ArrayLike | None = None
) -> float:
    """Estimate the share of the variance of correlations that distances do not explain.

    The function is a monotone regression (Barlow et al. 1972). A correlation c has the sampling
    variance ``noise (1 - c^2)^2``; it is subtracted from the squared residuals. Only pairs whose
    fitted correlation exceeds two standard deviations count, since other residuals are noise.
    """
    values, points = np.asarray(similarity), np.asarray(positions)
    step = -(-len(values) // _MAX_SENSORS)
    values, points = values[::step, ::step], points[::step]
    distances = pdist(points)
    correlations = squareform(values.astype(np.float64), checks=False)
    if known is not None and not np.all(known):
        among = squareform(np.asarray(known)[::step, ::step].astype(np.float64), checks=False) > 0
        distances, correlations = distances[among], correlations[among]
    greatest = distances.max(initial=0.0)
    steps = (distances * ((_DISTANCES - 1) / greatest if greatest > 0 else 0)).astype(np.intp)
    counts = np.bincount(steps, minlength=1)
    filled = np.flatnonzero(counts)
    means = np.bincount(steps, correlations, len(counts))[filled] / counts[filled]
    of_steps = np.zeros(len(counts))
    of_steps[filled] = isotonic_regression(means, weights=counts[filled], increasing=False).x
    fitted = of_steps[steps]
    significant = fitted > _SIGNIFICANT * np.sqrt(noise)
    if np.count_nonzero(significant) < _MIN_PAIRS:
        return 0.0
    correlations, fitted = correlations[significant], fitted[significant]
    sampling = noise * np.maximum((1 - fitted**2) ** 2, _MIN_VARIANCE_FACTOR)
    spread = float(((correlations - correlations.mean()) ** 2).sum())
    residual = float(((correlations - fitted) ** 2 - sampling).sum())
    return residual / spread if spread > 0 else 0.0
