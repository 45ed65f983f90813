"""Positions at which one falling function of distance explains all correlations at once.

A covariogram is the covariance of two places as a function of their distance. Here the function and
the places are fitted together, to correlations whose errors are themselves correlated.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.spatial.distance import cdist
from threadpoolctl import threadpool_limits

from anisomap.errors import InputError
from anisomap.numerics.compiled.parallel import MapFunction, is_parallel, parallel_map
from anisomap.numerics.covariogram.blocks import overlapping_blocks
from anisomap.numerics.covariogram.objective import (
    Block,
    CovariogramOptions,
    Problem,
    linear,
    objective,
)
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.precision import Reals

Matrix: TypeAlias = Reals

_ENOUGH = 4000  # sensors, to tell how far correlations reach
_HALF_WAY = (0.15, 0.45)
"""Pairs that are correlated so much are about one range of the covariogram apart."""

_COARSER = 100
_EXPONENTS = (0.3, 4.0)


@dataclass(frozen=True, eq=False)
class Covariogram:
    """A fitted covariogram, ``amplitude exp(-d^exponent) + offset``, and the places it is of.

    Attributes
    ----------
    positions : ndarray of shape (N, k)
        Centred; in units of the covariogram's range.
    amplitude, exponent, offset : float
        Of the function of the distance d.
    objective : float
        What was minimised; see `fit_covariogram`.
    iterations : int
        Steps taken.
    converged : bool
        Whether the tolerance was met before the iterations ran out.
    """

    positions: Matrix
    amplitude: float
    exponent: float
    offset: float
    objective: float
    iterations: int
    converged: bool

    def at(self, distances: ArrayLike) -> Matrix:
        """Give the correlation that is expected at distances, in units of `positions`."""
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
) -> Covariogram:
    """Move sensors to where one falling function of distance explains their correlations best.

    Parameters
    ----------
    similarity : array_like of shape (N, N)
        Correlations S in [-1, 1], symmetric; the diagonal is not looked at.
    start : array_like of shape (N, k)
        Where to set out from, in any unit.
    metric : array_like of shape (N, N)
        Distances D that the map is drawn to where correlations say little, finite, in the unit of
        `start`.
    noise : float
        Sampling variance s^2 of a correlation, above 0: see
        `anisomap.numerics.reliability.sampling_noise.sampling_variance`.
    known : array_like of bool, shape (N, N), optional
        Which correlations are known; all unless given.
    options : CovariogramOptions, optional

    Returns
    -------
    Covariogram

    Raises
    ------
    InputError
        If shapes disagree, the noise is not positive, or something is not finite.

    Notes
    -----
    Minimises over positions x and the function's amplitude a, exponent b and offset c ::

        1/2 tr(R W R W) + s^2 sum_{i<j} (lambda (d_ij / D_ij - g)^2 - alpha log d_ij)
        R_ij = a exp(-d_ij^b) + c - S_ij,  R_ii = 0,  g = mean of d_ij / D_ij

    Errors of correlations are correlated: to second order, the likelihood of a covariance S under
    the model C is ``-T/4 tr(R C^-1 R C^-1)`` (Wishart). W stands for C^-1 and is made from S and a
    ridge, ``(S + ridge I)^-1``, less what it knows of a signal that all sensors share
    (``W - W11'W / 1'W1``): a hum, a change of posture. Given distances, a and c solve two linear
    equations, so only positions and the exponent are searched (variable projection; Golub &
    Pereyra 1973, SIAM Journal on Numerical Analysis 10: 413-432), by L-BFGS. Both priors scale
    with the noise and vanish as recordings grow.

    More than `CovariogramOptions.block` sensors are fitted as a composite likelihood: the sum of
    the same objective over blocks of neighbours, over blocks shifted by half their size, and over
    blocks that span the whole skin. The cores share the blocks.
    """
    chosen = options or CovariogramOptions()
    alike = as_symmetric(similarity, "similarity")
    places = np.array(start, dtype=np.float64)
    apart = as_symmetric(metric, "metric")
    mask = np.ones(alike.shape, dtype=bool) if known is None else np.array(known, dtype=bool)
    _check(alike, places, apart, mask, noise)
    unit = _range(alike, places, mask)
    places = (places - places.mean(axis=0)) / unit
    np.fill_diagonal(mask, val=False)
    problem = Problem(alike, apart / unit, mask, noise, chosen)
    in_one = len(places) <= chosen.block
    size = chosen.block if in_one else max(3, chosen.block // 2)
    blocks = [Block(sensors, problem) for sensors in overlapping_blocks(places, size)]
    bounds = [(None, None)] * places.size + [(np.log(_EXPONENTS[0]), np.log(_EXPONENTS[1]))]
    shape = places.shape
    with _shared_out(len(places)) as spread_over:

        def at(parameters: Matrix) -> tuple[float, Matrix]:
            x, log_exponent = parameters[:-1].reshape(shape), float(parameters[-1])
            return objective(blocks, x, log_exponent, spread_over)

        found = minimize(
            at,
            np.append(places.ravel(), 0.0),
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            options={
                "maxiter": chosen.max_iterations,
                "maxfun": 2 * chosen.max_iterations + 20,
                "maxcor": 20,
                "ftol": chosen.tolerance * (1 if in_one else _COARSER),
            },
        )
    places = found.x[:-1].reshape(shape)
    terms = (block.terms(places, float(found.x[-1])) for block in blocks)
    amplitude, offset = linear(np.sum([term.products for term in terms], axis=0))
    places = places - places.mean(axis=0)
    places.setflags(write=False)
    return Covariogram(
        positions=places,
        amplitude=amplitude,
        exponent=float(np.exp(found.x[-1])),
        offset=offset,
        objective=float(found.fun),
        iterations=int(found.nit),
        converged=bool(found.success),
    )


@contextmanager
def _shared_out(n_sensors: int) -> Iterator[MapFunction]:
    """Let the cores share blocks; linear algebra has one thread meanwhile, or all would fight."""
    with (
        parallel_map(n_sensors) as spread_over,
        threadpool_limits(1 if is_parallel(n_sensors) else None),
    ):
        yield spread_over


def _range(similarity: Matrix, places: Matrix, known: NDArray[np.bool_]) -> float:
    """Give about how far apart sensors are whose correlation has fallen to a third."""
    step = -(-len(places) // _ENOUGH)
    places, similarity, known = places[::step], similarity[::step, ::step], known[::step, ::step]
    distances = cdist(places, places)
    pairs = known & ~np.eye(len(places), dtype=bool)
    half_way = pairs & (similarity > _HALF_WAY[0]) & (similarity < _HALF_WAY[1])
    chosen = distances[half_way] if half_way.any() else distances[pairs]
    unit = float(np.median(chosen)) if chosen.size else 0.0
    return unit if unit > 0 else 1.0


def _check(
    similarity: Matrix, places: Matrix, metric: Matrix, known: NDArray[np.bool_], noise: float
) -> None:
    n_sensors = len(similarity)
    if places.ndim != 2 or len(places) != n_sensors or not places.shape[1]:
        raise InputError(f"the start has shape {places.shape}; it must be ({n_sensors}, k)")
    for what, matrix in (("metric", metric), ("mask of known pairs", known)):
        if matrix.shape != similarity.shape:
            raise InputError(
                f"the {what} has shape {matrix.shape}; it must be {similarity.shape}, as the "
                "similarity"
            )
    n_positive = np.count_nonzero(metric > 0) - np.count_nonzero(np.diag(metric) > 0)
    if n_positive < n_sensors * (n_sensors - 1) or not np.isfinite(metric).all():
        raise InputError("the metric must be finite, and positive between different sensors")
    n_unknown = np.count_nonzero(~np.isfinite(similarity))
    n_unknown -= np.count_nonzero(~np.isfinite(np.diag(similarity)))
    if not np.isfinite(places).all() or n_unknown:
        raise InputError("the start and the similarity must be finite")
    if not (np.isfinite(noise) and noise > 0):
        raise InputError(f"the noise is {noise}; it must be positive")
