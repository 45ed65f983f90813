"""Multidimensional scaling: classical, by the raw stress (SMACOF), and ordinal."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve, eigh
from scipy.linalg.blas import dsymv, ssymv
from scipy.optimize import OptimizeResult, isotonic_regression, minimize
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh
from scipy.spatial.distance import cdist

from anisomap.base.immutable import Immutable
from anisomap.errors import InputError
from anisomap.numerics.compiled.parallel import load_loops, parallel_map, uses_loops
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.graph.metric import check_semi_metric, metricise
from anisomap.numerics.neighbours import components
from anisomap.numerics.precision import Floats, Reals, row_blocks
from anisomap.numerics.ranges import NOT_NEGATIVE, at_least, check_ranges

logger = logging.getLogger(__name__)

COINCIDENT = 1e-150
"""Distance below which points coincide: the direction between them is rounding error."""

_N_PARTS = 16  # of the pairs; fixed, so that sums do not depend on the number of threads
_SPATIAL = 3  # coordinates of the faster loop; missing ones are 0


@dataclass(frozen=True, eq=False)
class Problem:
    """Distances to fit, and their weights, (N, N) each; 0 where unknown.

    weights: A single row of ones if all weights are equal.
    compiled: Whether to use compiled loops.
    """

    targets: Reals
    weights: Reals
    compiled: bool = False

    def squares(self, positions: Floats | None = None) -> float:
        """Sum w_ij d_ij^2 over i < j; d are distances of `positions`, by default the targets."""
        weights, total = np.broadcast_to(self.weights, self.targets.shape), 0.0
        for rows in row_blocks(len(weights)):
            lengths = self.targets[rows] if positions is None else cdist(positions[rows], positions)
            total += float(np.vdot(weights[rows] * lengths, lengths))
        return total / 2


Objective = Callable[[Floats], tuple[float, Floats]]
"""Function of positions (N, k) that returns their raw stress and its gradient (N, k)."""


def objective(problem: Problem) -> Objective:
    """Return the raw stress and its gradient as a function of positions.

    Borg & Groenen (2005), section 8.6: for point i ``2 sum_j w_ij (1 - D_ij / d_ij) (x_i - x_j)``.
    """
    if not problem.compiled:
        # Allocating new matrices would take longer than computing them.
        workspace = np.empty((3, *problem.targets.shape))
        return lambda positions: plain_stress(problem, positions, workspace)
    n_points = len(problem.targets)
    loops = load_loops("stress")
    # Row i has N - 1 - i pairs; parts have about equal numbers of pairs, and even first rows.
    cuts = n_points * (1 - np.sqrt(1 - np.arange(_N_PARTS + 1) / _N_PARTS))
    edges = (2 * np.round(cuts / 2)).astype(int).tolist()
    edges[-1] = n_points

    def compiled_stress(positions: Floats) -> tuple[float, Floats]:
        n_axes = positions.shape[1]
        points = np.zeros((max(n_axes, _SPATIAL), n_points), problem.targets.dtype)
        points[:n_axes] = positions.T
        add_stress = loops.add_spatial_stress if n_axes <= _SPATIAL else loops.add_stress
        slopes = np.zeros((_N_PARTS, *points.shape), points.dtype)

        def add(part: int) -> float:
            rows = (edges[part], edges[part + 1])
            return float(add_stress(points, problem.targets, problem.weights, rows, slopes[part]))

        raw = sum(parallel_map(add, range(_N_PARTS), n_points))
        slope = np.zeros((n_points, n_axes))
        for first, part in zip(edges[:-1], slopes, strict=True):
            slope[first:] += part[:n_axes, first:].T  # parts add to later points only
        return raw, 2 * slope

    return compiled_stress


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


_CONVERGENCE_STEPS = 3  # the decrease is tested over several steps, since one may be short
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

    Coordinates are multiplied by the root of the Hessian, which makes the Hessian the identity. The
    unit is the length of the first step. L-BFGS-B sets this length to 1, and the slope is 1, too.
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

    def check(intermediate_result: OptimizeResult) -> None:
        nonlocal minimal
        trace.append(float(intermediate_result.fun) * step**2)
        before = trace[-1 - _CONVERGENCE_STEPS] if len(trace) > _CONVERGENCE_STEPS else np.inf
        minimal = trace[-1] <= _NEGLIGIBLE * squares or before - trace[-1] <= tolerance * trace[-1]
        if minimal:
            raise StopIteration

    found = minimize(
        scaled,
        (start * root).ravel(),
        jac=True,
        method="L-BFGS-B",
        callback=check,
        # Iterations end in `check`, since the tolerances of scipy apply to single steps.
        options={"maxiter": max_iterations, "maxfun": 20 * max_iterations, "ftol": 0, "gtol": 0},
    )
    # A search that ends early cannot decrease the stress any further.
    converged = minimal or len(trace) <= max_iterations
    return SolverResult(np.asarray(found.x).reshape(start.shape) / root, trace, converged)


MIN_LARGE = 1000
"""Number of points from which L-BFGS stops at `LARGE_TOLERANCE`."""

LARGE_TOLERANCE = 1e-5
"""Minimum tolerance for large problems: Stress-1 differs by less than .02 % from that with 1e-7."""


def lbfgs(problem: Problem, start: Floats, tolerance: float, max_iterations: int) -> SolverResult:
    """Minimise the raw stress by L-BFGS; the first Hessian is twice the weight of each point."""
    n_points = len(start)
    weights = np.broadcast_to(problem.weights, problem.targets.shape)
    degree = weights.sum(axis=1, keepdims=True, dtype=np.float64) - np.diag(weights)[:, None]
    scale = 2 * degree * n_points / max(n_points - 1, 1)
    return minimise_lbfgs(
        objective(problem),
        start,
        scale,
        squares=problem.squares(),
        tolerance=max(tolerance, LARGE_TOLERANCE if n_points >= MIN_LARGE else 0.0),
        max_iterations=max_iterations,
    )


def majorise(
    problem: Problem, start: Floats, tolerance: float, max_iterations: int
) -> SolverResult:
    """Minimise by Guttman transforms, ``X <- V^+ B(X) X`` (Borg & Groenen 2005, eq. 8.28).

    Half the gradient is ``V X - B(X) X``; a transform subtracts ``V^+`` times this.
    """
    solve = _laplacian_solver(problem)
    negligible = _NEGLIGIBLE * problem.squares()
    stress, positions = objective(problem), start
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
    if len(problem.weights) == 1:
        return lambda product: product / n_points
    # 11'/N fills the null space of V (common translations); B(X) X is orthogonal to it.
    laplacian = np.diag(problem.weights.sum(axis=1)) - problem.weights
    factor = cho_factor(laplacian + problem.weights.mean())
    return lambda product: np.asarray(cho_solve(factor, product))


TOLERANCE, MAX_ITERATIONS = 1e-8, 3000
"""Stopping criteria of the scaling."""

AUTO_SOLVER = "auto"
SOLVERS = {AUTO_SOLVER: lbfgs, "lbfgs": lbfgs, "majorization": majorise}
"""Solvers by name: functions of a problem, a start, a tolerance and a number of iterations."""


DENSE_LIMIT = 200
"""Maximum number of points for which full eigendecomposition is faster than iterative methods."""

Eigen: TypeAlias = tuple[Floats, Floats]
Product: TypeAlias = Callable[[Floats], Reals]

_NEARLY_GREATEST = 1 - 1e-6  # larger relative magnitudes differ from the greatest by rounding only


def torgerson(distances: ArrayLike, dimensions: int) -> Floats:
    """Classical scaling: positions from the leading eigenvectors of the inner products.

    distances (N, N) -> (N, k), centred; columns are orthogonal, by decreasing spread. For
    reproducibility, the entry of greatest magnitude of each column is positive; among equal entries
    (on symmetric skins), the first. Columns with eigenvalues of 0 or less are 0.

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
    # symv reads one triangle only, and reading the matrix takes most of the time.
    multiply = partial(dsymv if double else ssymv, 1.0, squares.T)
    leading = leading_eigenvectors(multiply, n_points, dimensions, single=not double)
    return _principal_coordinates(leading or _leading_dense(squares, dimensions), dimensions)


def classical_scaling(multiply: Product, n_points: int, dimensions: int) -> Floats:
    """Scale as `torgerson`, given products with the squared distances in float32, -> (N, k)."""
    found = leading_eigenvectors(multiply, n_points, dimensions, single=True)
    if found is None:
        raise InputError("the distances have no leading eigenvectors: do all points coincide?")
    return _principal_coordinates(found, dimensions)


def _principal_coordinates(found: Eigen, dimensions: int) -> Floats:
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

    def double_centred(vector: Floats) -> Floats:
        product = multiply(vector - vector.mean()).astype(np.float64, copy=False)
        return np.asarray((product - product.mean()) / -2)

    operator = LinearOperator((n_points, n_points), matvec=double_centred, dtype=np.float64)
    # The start is fixed, since ARPACK's default start is random.
    start = np.random.default_rng(0).standard_normal(n_points)
    try:
        # Machine precision, or the precision of products in float32.
        found = eigsh(operator, k=count, which="LA", v0=start, tol=1e-5 if single else 0)
    except ArpackError:  # no convergence, or the matrix is zero: all points coincide
        return None
    return found[0], found[1]


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
        ``"lbfgs"`` takes about a tenth of the iterations; from 1,000 points on, it stops at a
        tolerance of 1e-5, with Stress-1 within 0.1 % of the minimum. ``"auto"`` is
        ``"majorization"`` in the methods of McGregor et al. (2011), for up to 500 sensors, and
        ``"lbfgs"`` elsewhere.

    Raises
    ------
    InputError
        If a value is out of range, or the solver is unknown.
    """

    tolerance: float = TOLERANCE
    max_iterations: int = MAX_ITERATIONS
    solver: str = AUTO_SOLVER

    def __post_init__(self) -> None:
        if self.solver not in SOLVERS:
            raise InputError(f"unknown solver {self.solver!r}; choose from {', '.join(SOLVERS)}")
        check_ranges(self, {"tolerance": NOT_NEGATIVE, "max_iterations": at_least(0, whole=True)})


DEFAULT_SMACOF = SmacofOptions()


@dataclass(frozen=True, eq=False)
class Scaling(Immutable):
    """Result of stress minimisation.

    positions (N, k): Centred on the origin.
    raw_stress: Sum over i < j of w_ij (d_ij - D_ij)^2, in squared units of the distances.
    spread: Sum over i < j of w_ij d_ij^2.
    trace: Raw stress of the start and after each iteration; never increases.
    converged: Whether the tolerance was met within the maximum number of iterations.
    """

    positions: Floats
    raw_stress: float
    spread: float
    trace: Floats
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

    distances (N, N): Symmetric, non-negative, zero diagonal; infinite where unknown. The known
        distances must connect all points.
    dimensions: Number of coordinates, k >= 1; ignored if `start` is given.
    start (N, k): By default classical scaling, with shortest paths in place of unknown distances.
    weights (N, N): Symmetric, non-negative; 0 where unknown. The diagonal is ignored. 1 by default.

    De Leeuw (1977); Borg & Groenen (2005), chapter 8. No iteration of any solver increases the
    weighted stress. Compiled loops compute the stress of many points, see `uses_loops`.
    """
    chosen = options or DEFAULT_SMACOF
    targets = known = check_semi_metric(distances, copy=False)
    shares: Reals = np.ones((1, len(targets)), targets.dtype)
    if weights is not None or not np.isfinite(targets.max()):
        shares = _check_weights(weights, targets)
        known = _connected_targets(targets, shares)
        targets = np.where(np.isinf(targets), 0, targets)
    if start is None:
        start = torgerson(known if np.isfinite(known.max()) else metricise(known), dimensions)
    positions = np.array(start, dtype=np.float64)
    if positions.ndim != 2 or len(positions) != len(targets) or not positions.shape[1]:
        raise InputError(f"the start has shape {positions.shape}; it must be ({len(targets)}, k)")
    if not np.isfinite(positions).all():
        raise InputError("the start has NaN or infinite coordinates")
    positions -= positions.mean(axis=0)  # float32 could not resolve points far from the origin
    problem = Problem(targets, shares, compiled=uses_loops(len(targets)))
    solve = SOLVERS[chosen.solver]
    positions, trace, converged = solve(problem, positions, chosen.tolerance, chosen.max_iterations)
    if not converged and chosen.max_iterations:
        logger.info("stress minimisation did not converge in %d iterations", len(trace) - 1)
    positions = positions - positions.mean(axis=0)
    return Scaling(
        positions=positions,
        raw_stress=trace[-1],
        spread=problem.squares(positions),
        trace=np.array(trace),
        converged=bool(converged),
    )


def _connected_targets(targets: Reals, weights: Reals) -> Reals:
    """Return the distances, infinite where unknown; raise unless known ones connect all points."""
    known = targets.copy()
    known[weights <= 0] = np.inf
    np.fill_diagonal(known, 0)
    n_components = components(known).max() + 1
    if n_components > 1:
        raise InputError(f"known distances form {n_components} components; scale each separately")
    return known


def _check_weights(weights: ArrayLike | None, targets: Reals) -> Reals:
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


_STEPS = 10  # SMACOF steps between two monotone regressions


def ordinal_smacof(
    dissimilarities: ArrayLike,
    *,
    dimensions: int = 3,
    start: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    options: SmacofOptions | None = None,
) -> tuple[Scaling, Floats]:
    """Find a configuration whose distances have the order of dissimilarities.

    Arguments are as in `smacof`. Iterations are the SMACOF steps between all monotone regressions.
    The stress of the scaling is Kruskal's non-metric Stress-1, and the trace contains its squares.
    Disparities, (N, N), are the non-decreasing function of the dissimilarities that is nearest to
    the distances; infinite where unknown.

    Kruskal (1964), Psychometrika 29: 1-27 and 115-129; Borg & Groenen (2005), chapter 9. Monotone
    regressions and steps of SMACOF alternate; neither increases the stress.
    """
    chosen = options or SmacofOptions()
    values = np.asarray(check_semi_metric(dissimilarities), dtype=np.float64)
    scaling = smacof(values, dimensions=dimensions, start=start, weights=weights, options=chosen)
    first, second = np.triu_indices(len(values), k=1)
    share = np.ones(len(first)) if weights is None else np.asarray(weights, float)[first, second]
    kept = np.isfinite(values[first, second]) & (share > 0)
    first, second, share = first[kept], second[kept], share[kept]
    known = values[first, second]
    size = share @ known**2
    steps = replace(chosen, max_iterations=_STEPS, solver="majorization", tolerance=0)
    trace, converged = list[float](), False
    disparities = np.full(values.shape, np.inf)
    np.fill_diagonal(disparities, 0)
    while True:
        distances = cdist(scaling.positions, scaling.positions)[first, second]
        # Tied dissimilarities are ordered by distance: Kruskal's primary approach.
        order = np.lexsort((distances, known))
        fitted = isotonic_regression(distances[order], weights=share[order]).x
        spread = float(share @ distances**2)
        missed = float(share[order] @ (distances[order] - fitted) ** 2)
        trace.append(missed / spread if spread else 0.0)
        converged = len(trace) > 1 and trace[-2] - trace[-1] <= chosen.tolerance * trace[-2]
        if converged or not missed or len(trace) * _STEPS > chosen.max_iterations:
            break
        # The size of the disparities is fixed, since the configuration would shrink otherwise.
        rescaled = fitted * np.sqrt(size / (share[order] @ fitted**2))
        disparities[first[order], second[order]] = rescaled
        disparities[second[order], first[order]] = rescaled
        scaling = smacof(disparities, start=scaling.positions, weights=weights, options=steps)
    disparities[first[order], second[order]] = disparities[second[order], first[order]] = fitted
    converged |= not missed
    done = replace(scaling, raw_stress=missed, spread=spread, trace=np.array(trace))
    return replace(done, converged=converged), disparities


def _by_paths(values: ArrayLike, **settings: Any) -> tuple[Scaling, Floats]:
    metric = np.asarray(metricise(values), dtype=np.float64)
    return smacof(metric, **settings), metric


def _by_values(values: ArrayLike, **settings: Any) -> tuple[Scaling, Floats]:
    return smacof(values, **settings), np.asarray(values, dtype=np.float64)


SCALINGS: Mapping[str, Callable[..., tuple[Scaling, Floats]]] = MappingProxyType(
    {"anisomap": _by_paths, "mds": _by_values, "ordinal": ordinal_smacof}
)
"""Scalings of dissimilarities: by lengths of shortest paths, by the values, or by their order.

Each function takes the arguments of `ordinal_smacof`. It returns a scaling and the distances (N, N)
that the scaling approximates.
"""


def find_scaling(name: str) -> Callable[..., tuple[Scaling, Floats]]:
    """Look up a function by its name, a key of `SCALINGS`."""
    if name not in SCALINGS:
        raise InputError(f"there is no scaling {name!r}; choose from {', '.join(SCALINGS)}")
    return SCALINGS[name]
