"""What a covariogram is fitted by: whitened residuals of correlations, summed over blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

from anisomap.errors import InputError
from anisomap.numerics.compiled.parallel import MapFunction, serial_map
from anisomap.numerics.precision import Reals

Matrix: TypeAlias = Reals

_NEAREST = 1e-6  # of a range
_AMPLITUDES = (1e-3, 10.0)
_SMALLEST_EIGENVALUE = 0.5


@dataclass(frozen=True)
class CovariogramOptions:
    """Parameters of the fit; the defaults were chosen on simulated skins, once for all.

    Parameters
    ----------
    prior_weight : float
        Weight of the metric that the fit sets out from, at least 0, in units of the noise.
    repulsion : float
        Weight of the force that keeps sensors apart and unfolds the map, at least 0, in units of
        the noise.
    ridge : float
        Variance, above 0, that is added to every reading before correlations are whitened, as a
        share of its own.
    tolerance : float
        Stop when a step lowers the objective by less than this share of it; in blocks, by less
        than a hundred times that.
    max_iterations : int
        Stop after so many steps at the latest.
    block : int
        Most sensors whose correlations are whitened together; more are fitted in overlapping
        blocks of half as many. Whitening takes time in cubes: blocks of 150 to 500 of 1,200 and
        2,000 sensors made equally good maps.
    """

    prior_weight: float = 1.0
    repulsion: float = 0.1
    ridge: float = 1.0
    tolerance: float = 1e-9
    max_iterations: int = 300
    block: int = 500

    def __post_init__(self) -> None:
        for name in ("prior_weight", "repulsion", "tolerance"):
            if not (np.isfinite(value := getattr(self, name)) and value >= 0):
                raise InputError(f"{name} is {value}; it must be at least 0")
        if not (np.isfinite(self.ridge) and self.ridge > 0):
            raise InputError(f"ridge is {self.ridge}; it must be above 0")
        if self.max_iterations < 0:
            raise InputError(f"max_iterations is {self.max_iterations}; it must be at least 0")
        if self.block < 3:
            raise InputError(f"block is {self.block}; a block holds at least 3 sensors")


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be explained, in units of the covariogram's range."""

    similarity: Matrix
    metric: Matrix
    known: NDArray[np.bool_]
    noise: float
    options: CovariogramOptions


@dataclass(frozen=True, eq=False)
class Terms:
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


class Block:
    """The part of the objective that is about some sensors, with what does not change of it."""

    def __init__(self, sensors: NDArray[np.intp], problem: Problem) -> None:
        inside = np.ix_(sensors, sensors)
        self.sensors, self._options = sensors, problem.options
        self._known = problem.known[inside]
        self._alike = np.where(self._known, problem.similarity[inside], 0.0).astype(np.float64)
        self._whitening = _whitening(self._alike, problem.options.ridge)
        self._pairs = ~np.eye(len(sensors), dtype=bool)
        apart = problem.metric[inside].astype(np.float64)
        self._closeness = np.divide(1.0, apart, out=np.zeros_like(apart), where=self._pairs)
        self._noise = problem.noise / 2  # each pair stands in a matrix twice

    @cached_property
    def whitened_similarity(self) -> Matrix:
        """The similarity S of the block, as W S W."""
        return self._whitened(self._alike)

    @cached_property
    def whitened_offset(self) -> Matrix:
        """The offset's ones O, where a pair is known, as W O W."""
        return self._whitened(self._known.astype(np.float64))

    @cached_property
    def _fixed_products(self) -> tuple[float, float, float]:
        ones = self.whitened_offset[self._known].sum()
        cross = self.whitened_similarity[self._known].sum()
        return float(ones), float(cross), float(np.vdot(self._alike, self.whitened_similarity))

    def terms(self, places: Matrix, log_exponent: float) -> Terms:
        """Work out what the block adds with all sensors at `places`, shape (N, k)."""
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
        return Terms(products, shape, whitened, distances, logarithms, powers)

    def gradient(
        self, terms: Terms, places: Matrix, exponent: float, amplitude: float, offset: float
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

    def _priors(self, terms: Terms) -> tuple[float, Matrix]:
        options = self._options
        ratios = terms.distances * self._closeness
        strays = np.where(self._pairs, ratios - ratios.sum() / self._pairs.sum(), 0.0)
        value = options.prior_weight * np.vdot(strays, strays) - options.repulsion * np.sum(
            terms.logarithms
        )
        pull = (
            2 * options.prior_weight * strays * self._closeness
            - options.repulsion / terms.distances
        )
        return float(self._noise * value), self._noise * pull

    def _whitened(self, matrix: Matrix) -> Matrix:
        return np.asarray(self._whitening @ matrix @ self._whitening)


def objective(
    blocks: Sequence[Block],
    places: Matrix,
    log_exponent: float,
    spread_over: MapFunction = serial_map,
) -> tuple[float, Matrix]:
    """Give what is minimised, and its gradient.

    Parameters
    ----------
    blocks : sequence of Block
    places : ndarray of shape (N, k)
    log_exponent : float
        Logarithm of the covariogram's exponent.
    spread_over : callable
        Goes through the blocks.

    Returns
    -------
    value : float
    gradient : ndarray of shape (N k + 1,)
        By the coordinates, and by the exponent's logarithm.
    """
    terms = spread_over(lambda block: block.terms(places, log_exponent), blocks)
    products = np.sum([term.products for term in terms], axis=0)
    amplitude, offset = linear(products)
    ee, eo, es, oo, os, ss = products
    value = (
        amplitude**2 * ee
        + offset**2 * oo
        + ss
        + 2 * (amplitude * offset * eo - amplitude * es - offset * os)
    ) / 2
    exponent = float(np.exp(log_exponent))
    slopes = spread_over(
        lambda pair: pair[0].gradient(pair[1], places, exponent, amplitude, offset),
        zip(blocks, terms, strict=True),
    )
    by_places = np.zeros_like(places)
    by_exponent = 0.0
    for block, (priors, moved, bent) in zip(blocks, slopes, strict=True):
        value += priors
        by_places[block.sensors] += moved
        by_exponent += bent
    return float(value), np.append(by_places.ravel(), by_exponent)


def linear(products: Matrix) -> tuple[float, float]:
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
