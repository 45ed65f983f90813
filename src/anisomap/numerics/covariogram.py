"""Positions at which one falling function of distance explains all correlations at once.

A covariogram is the covariance of two places as a function of their distance. Here the function and
the places are fitted together, to correlations whose errors are themselves correlated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from anisomap.errors import InputError
from anisomap.numerics.blocks import overlapping_blocks
from anisomap.numerics.dissimilarity import symmetric
from anisomap.numerics.precision import Reals

Matrix: TypeAlias = Reals

_ENOUGH = 4000  # sensors, to tell how far correlations reach
_HALF_WAY = (0.15, 0.45)
"""Pairs that are correlated so much are about one range of the covariogram apart."""

_EXPONENTS = (0.3, 4.0)
_NEAREST = 1e-6  # of a range
_AMPLITUDES = (1e-3, 10.0)
_SMALLEST_EIGENVALUE = 0.5


@dataclass(frozen=True)
class CovariogramOptions:
    """Parameters of the fit; the defaults were chosen on simulated skins, once for all.

    Parameters
    ----------
    loyalty : float
        Weight of the metric that the fit sets out from, at least 0, in units of the noise.
    repulsion : float
        Weight of the force that keeps sensors apart and unfolds the map, at least 0, in units of
        the noise.
    ridge : float
        Variance, above 0, that is added to every reading before correlations are whitened, as a
        share of its own.
    tolerance : float
        Stop when a step lowers the objective by less than this share of it.
    max_iterations : int
        Stop after so many steps at the latest.
    block : int
        Most sensors whose correlations are whitened together; more are fitted in overlapping
        blocks.
    """

    loyalty: float = 1.0
    repulsion: float = 0.1
    ridge: float = 1.0
    tolerance: float = 1e-9
    max_iterations: int = 300
    block: int = 500

    def __post_init__(self) -> None:
        for name in ("loyalty", "repulsion", "tolerance"):
            if not (np.isfinite(value := getattr(self, name)) and value >= 0):
                raise InputError(f"{name} is {value}; it must be at least 0")
        if not (np.isfinite(self.ridge) and self.ridge > 0):
            raise InputError(f"ridge is {self.ridge}; it must be above 0")
        if self.max_iterations < 0:
            raise InputError(f"max_iterations is {self.max_iterations}; it must be at least 0")
        if self.block < 3:
            raise InputError(f"block is {self.block}; a block holds at least 3 sensors")


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
        `anisomap.numerics.evidence.sampling_variance`.
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
    blocks that span the whole skin.
    """
    chosen = options or CovariogramOptions()
    alike = symmetric(similarity, "similarity")
    places = np.array(start, dtype=np.float64)
    apart = symmetric(metric, "metric")
    mask = np.ones(alike.shape, dtype=bool) if known is None else np.array(known, dtype=bool)
    _check(alike, places, apart, mask, noise)
    unit = _range(alike, places, mask)
    places = (places - places.mean(axis=0)) / unit
    np.fill_diagonal(mask, val=False)
    problem = _Problem(alike, apart / unit, mask, noise, chosen)
    blocks = [_Block(sensors, problem) for sensors in overlapping_blocks(places, chosen.block)]
    shape = places.shape

    def objective(parameters: Matrix) -> tuple[float, Matrix]:
        return _objective(blocks, parameters[:-1].reshape(shape), float(parameters[-1]))

    bounds = [(None, None)] * places.size + [(np.log(_EXPONENTS[0]), np.log(_EXPONENTS[1]))]
    found = minimize(
        objective,
        np.append(places.ravel(), 0.0),
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={
            "maxiter": chosen.max_iterations,
            "maxfun": 2 * chosen.max_iterations + 20,
            "maxcor": 20,
            "ftol": chosen.tolerance,
        },
    )
    places = found.x[:-1].reshape(shape)
    terms = [block.terms(places, float(found.x[-1])) for block in blocks]
    amplitude, offset = _linear(np.sum([term.products for term in terms], axis=0))
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


@dataclass(frozen=True, eq=False)
class _Problem:
    """What is to be explained, in units of the covariogram's range."""

    similarity: Matrix
    metric: Matrix
    known: NDArray[np.bool_]
    noise: float
    options: CovariogramOptions


@dataclass(frozen=True, eq=False)
class _Terms:
    """What one block adds, at given positions: whitened products, and matrices for the gradient.

    With ``<A, B> = tr(A W B W)``, `products` holds <E,E>, <E,O>, <E,S>, <O,O>, <O,S>, <S,S> of
    the model's shape E, the offset's O (ones where known) and the similarity S.
    """

    products: Matrix
    shape: Matrix
    whitened_shape: Matrix
    distances: Matrix
    logarithms: Matrix
    powers: Matrix


class _Block:
    """The part of the objective that is about some sensors, with what does not change of it."""

    def __init__(self, sensors: NDArray[np.intp], problem: _Problem) -> None:
        inside = np.ix_(sensors, sensors)
        self.sensors, self._options = sensors, problem.options
        self._known = problem.known[inside]
        self._alike = np.where(self._known, problem.similarity[inside], 0.0)
        self._whitening = _whitening(self._alike, problem.options.ridge)
        self._pairs = ~np.eye(len(sensors), dtype=bool)
        apart = problem.metric[inside]
        self._closeness = np.divide(1.0, apart, out=np.zeros_like(apart), where=self._pairs)
        self._noise = problem.noise / 2  # each pair stands in a matrix twice

    @cached_property
    def whitened_similarity(self) -> Matrix:
        return self._whitened(self._alike)

    @cached_property
    def whitened_offset(self) -> Matrix:
        return self._whitened(self._known.astype(np.float64))

    @cached_property
    def _fixed_products(self) -> tuple[float, float, float]:
        ones = self.whitened_offset[self._known].sum()
        cross = self.whitened_similarity[self._known].sum()
        return float(ones), float(cross), float(np.vdot(self._alike, self.whitened_similarity))

    def terms(self, places: Matrix, log_exponent: float) -> _Terms:
        points = places[self.sensors]
        distances = np.maximum(cdist(points, points), _NEAREST)
        np.fill_diagonal(distances, 1.0)
        logarithms = np.log(distances)
        powers = np.exp(np.exp(log_exponent) * logarithms)
        shape = np.where(self._known, np.exp(-powers), 0.0)
        whitened = self._whitened(shape)
        products = np.array(
            [
                np.vdot(shape, whitened),
                np.vdot(shape, self.whitened_offset),
                np.vdot(shape, self.whitened_similarity),
                *self._fixed_products,
            ]
        )
        return _Terms(products, shape, whitened, distances, logarithms, powers)

    def gradient(
        self, terms: _Terms, places: Matrix, exponent: float, amplitude: float, offset: float
    ) -> tuple[float, Matrix, float]:
        """Give the priors' value, and gradients by positions and by the exponent's logarithm."""
        residual = (
            amplitude * terms.whitened_shape
            + offset * self.whitened_offset
            - self.whitened_similarity
        )
        slope = -amplitude * exponent * residual * terms.shape * terms.powers
        by_exponent = float(np.vdot(slope, terms.logarithms))
        value, pull = self._priors(terms)
        # Each coordinate difference is divided by the distance twice: once of d d/dx, once of db.
        force = (slope / terms.distances + pull) / terms.distances
        np.fill_diagonal(force, 0.0)
        points = places[self.sensors]
        by_places = 2 * (force.sum(axis=1)[:, None] * points - force @ points)
        return value, by_places, by_exponent

    def _priors(self, terms: _Terms) -> tuple[float, Matrix]:
        options = self._options
        ratios = terms.distances * self._closeness
        strays = np.where(self._pairs, ratios - ratios.sum() / self._pairs.sum(), 0.0)
        value = options.loyalty * np.vdot(strays, strays) - options.repulsion * np.sum(
            terms.logarithms
        )
        pull = 2 * options.loyalty * strays * self._closeness - options.repulsion / terms.distances
        return float(self._noise * value), self._noise * pull

    def _whitened(self, matrix: Matrix) -> Matrix:
        return np.asarray(self._whitening @ matrix @ self._whitening)


def _objective(
    blocks: Sequence[_Block], places: Matrix, log_exponent: float
) -> tuple[float, Matrix]:
    terms = [block.terms(places, log_exponent) for block in blocks]
    products = np.sum([term.products for term in terms], axis=0)
    amplitude, offset = _linear(products)
    ee, eo, es, oo, os, ss = products
    value = (
        amplitude**2 * ee
        + offset**2 * oo
        + ss
        + 2 * (amplitude * offset * eo - amplitude * es - offset * os)
    ) / 2
    by_places = np.zeros_like(places)
    by_exponent = 0.0
    for block, term in zip(blocks, terms, strict=True):
        priors, moved, bent = block.gradient(
            term, places, float(np.exp(log_exponent)), amplitude, offset
        )
        value += priors
        by_places[block.sensors] += moved
        by_exponent += bent
    return float(value), np.append(by_places.ravel(), by_exponent)


def _linear(products: Matrix) -> tuple[float, float]:
    """Solve for the amplitude and offset that leave the least whitened residual."""
    ee, eo, es, oo, os, _ = products
    determinant = ee * oo - eo * eo
    alone = es / ee if ee > 0 else 0.0
    amplitude = (es * oo - eo * os) / determinant if determinant > 1e-12 * ee * oo else alone
    # Below, the function does not fall, and above, sensors are out of one another's sight.
    amplitude = float(np.clip(amplitude, *_AMPLITUDES))
    return amplitude, float((os - amplitude * eo) / oo) if oo > 0 else 0.0


def _whitening(similarity: Matrix, ridge: float) -> Matrix:
    covariance = similarity.copy()
    np.fill_diagonal(covariance, 1 + ridge)
    identity = np.eye(len(covariance))
    try:
        inverse = cho_solve(cho_factor(covariance), identity)
    except np.linalg.LinAlgError:
        # Not a matrix of correlations: some pairs are unknown, or it is another similarity.
        values, vectors = np.linalg.eigh(covariance)
        inverse = (vectors / np.maximum(values, _SMALLEST_EIGENVALUE * ridge)) @ vectors.T
    shared = inverse.sum(axis=1)
    total = shared.sum()
    if total > 0:
        inverse = inverse - np.outer(shared, shared) / total
    return np.asarray((inverse + inverse.T) / 2)


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
    pairs = ~np.eye(n_sensors, dtype=bool)
    if not (metric[pairs] > 0).all() or not np.isfinite(metric).all():
        raise InputError("the metric must be finite, and positive between different sensors")
    if not np.isfinite(places).all() or not np.isfinite(similarity[pairs]).all():
        raise InputError("the start and the similarity must be finite")
    if not (np.isfinite(noise) and noise > 0):
        raise InputError(f"the noise is {noise}; it must be positive")
