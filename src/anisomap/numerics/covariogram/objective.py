"""Objective of the covariogram fit: whitened residuals of correlations, summed over blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotri

from anisomap.errors import InputError
from anisomap.numerics.compiled.parallel import MapFunction, serial_map
from anisomap.numerics.covariogram.pairs import (
    CompiledPairs,
    Decay,
    Pairs,
    Vector,
    Weights,
    pack,
)
from anisomap.numerics.precision import Reals

Matrix: TypeAlias = Reals

_AMPLITUDE_BOUNDS = (1e-3, 10.0)  # below, the function is flat; above, all pairs exceed its range

_ROWS = 50  # of a product at a time; with 40 to 80, products of 250 rows took equal time
_MIN_EIGENVALUE = 0.5  # of the ridge; chosen by hand, for similarities that are not correlations


@dataclass(frozen=True)
class CovariogramOptions:
    """Parameters of the covariogram fit, tuned on simulated skins, seeds 101 to 103.

    ``docs/explanation/covariogram.md`` gives the error without each part.

    Parameters
    ----------
    prior_weight : float
        Weight of the prior towards the initial metric, at least 0, in units of the noise.
    repulsion : float
        Weight of the logarithmic repulsion that unfolds the map, at least 0, in units of the noise.
    ridge : float
        Variance added to each sensor before correlations are whitened, relative to its own
        variance; above 0.
    tolerance : float
        Relative decrease of the objective below which the fit stops, if the next step would also
        move positions by less than 5e-5; 100 times as large with several blocks, and 1e-3.
    max_iterations : int
        Maximum number of L-BFGS iterations.
    block : int
        Maximum number of sensors that are whitened together, at least 3. More are
        fitted in overlapping blocks of half this size, since whitening takes cubic time. For 1,200
        and 2,000 sensors, blocks of 150 to 500 gave equally good maps.

    Raises
    ------
    InputError
        If a value is out of range.
    """

    prior_weight: float = 1.0
    repulsion: float = 0.1
    ridge: float = 1.0
    tolerance: float = 1e-7
    max_iterations: int = 300
    block: int = 500

    def __post_init__(self) -> None:
        for name in ("prior_weight", "repulsion", "tolerance"):
            if not (np.isfinite(value := getattr(self, name)) and value >= 0):
                raise InputError(f"{name} must be finite and at least 0, got {value}")
        if not (np.isfinite(self.ridge) and self.ridge > 0):
            raise InputError(f"ridge must be finite and above 0, got {self.ridge}")
        if self.max_iterations < 0:
            raise InputError(f"max_iterations must be at least 0, got {self.max_iterations}")
        if self.block < 3:
            raise InputError(f"block must be at least 3, got {self.block}")


@dataclass(frozen=True, eq=False)
class Problem:
    """Data and parameters of the fit, with lengths in units of the covariogram's range.

    Matrices of blocks are multiplied in the given precision. Compiled loops need float32.
    """

    similarity: Matrix
    metric: Matrix
    known: NDArray[np.bool_]
    noise: float
    options: CovariogramOptions
    precision: type[np.floating] = np.float64
    compiled: bool = False


@dataclass(frozen=True, eq=False)
class BlockTerms:
    """Contribution of one block at given positions.

    With ``<A, B> = tr(A W B W)``, `products` are <E,E>, <E,O>, <E,S>, <O,O>, <O,S>, <S,S> for the
    shape E of the covariogram, the offset O (1 where a pair is known) and the similarity S.
    `whitened_shape` has the pairs of W E W.
    """

    products: Matrix
    decay: Decay
    whitened_shape: Vector


@dataclass(frozen=True, eq=False)
class BlockCurvature:
    """Contribution of one block of n sensors to `curvature.gauss_newton_matrix`.

    Attributes
    ----------
    coordinates : dict of (int, int) to ndarray of shape (n, n)
        Products of the derivatives by coordinate p of one sensor and q >= p of another.
    cross : ndarray of shape (3, k, n)
        Products of the derivatives by amplitude, offset and log exponent with those by coordinates.
    linear : ndarray of shape (3, 3)
        Products of the derivatives by amplitude, offset and log exponent.
    """

    coordinates: dict[tuple[int, int], Matrix]
    cross: Matrix
    linear: Matrix


class Block:
    """Contribution of some sensors to the objective, with its constant matrices."""

    def __init__(self, sensors: NDArray[np.intp], problem: Problem) -> None:
        inside = np.ix_(sensors, sensors)
        self.sensors, self._options = sensors, problem.options
        known = problem.known[inside]
        similarity = np.where(known, problem.similarity[inside], 0.0).astype(np.float64)
        # Inverted in float64; all other matrices take half the time in float32.
        self._whitening = _whitening(similarity, problem.options.ridge).astype(problem.precision)
        similarity, offset = similarity.astype(problem.precision), known.astype(problem.precision)
        inverse_metric = 1 / pack(problem.metric[inside]).astype(np.float64)
        kind = CompiledPairs if problem.compiled else Pairs
        self._pairs = pairs = kind(
            known=pack(offset),
            similarity=pack(similarity),
            whitened_known=self._whitened_offset(offset),
            whitened_similarity=self._whitened(similarity),
            inverse_metric=inverse_metric.astype(problem.precision),
            n_sensors=len(sensors),
        )
        self._fixed_products = (
            pairs.product(pairs.known, pairs.whitened_known),
            pairs.product(pairs.known, pairs.whitened_similarity),
            pairs.product(pairs.similarity, pairs.whitened_similarity),
        )
        self._noise = problem.noise
        self._latest: tuple[Matrix, float, BlockTerms] | None = None

    def terms(self, positions: Matrix, log_exponent: float) -> BlockTerms:
        """Evaluate the block at positions of all sensors, shape (N, k)."""
        points = positions[self.sensors]
        # A curvature is followed by a search from the same positions, and the reverse.
        if self._latest is not None:
            before, exponent, terms = self._latest
            if exponent == log_exponent and np.array_equal(before, points):
                return terms
        terms = self._evaluate(points, log_exponent)
        self._latest = points, log_exponent, terms
        return terms

    def _evaluate(self, points: Matrix, log_exponent: float) -> BlockTerms:
        pairs = self._pairs
        decayed = pairs.decay(points, log_exponent)
        whitened = self._whitened(pairs.unpack(decayed.shape))
        others = (whitened, pairs.whitened_known, pairs.whitened_similarity)
        products = [pairs.product(decayed.shape, other) for other in others]
        return BlockTerms(np.array([*products, *self._fixed_products]), decayed, whitened)

    def gradient(
        self, terms: BlockTerms, positions: Matrix, exponent: float, amplitude: float, offset: float
    ) -> tuple[float, Matrix, float]:
        """Return the value, and the gradient by the positions and by the log exponent."""
        options = self._options
        prior, repulsion = self._noise * options.prior_weight, self._noise * options.repulsion
        weights = Weights(amplitude, exponent, offset, prior, repulsion)
        found = self._pairs.slope(terms.decay, terms.whitened_shape, weights)
        by_positions = self._pairs.gradient(found.force, positions[self.sensors])
        return found.value, by_positions, found.by_exponent

    def curvature(
        self, terms: BlockTerms, positions: Matrix, exponent: float, amplitude: float
    ) -> BlockCurvature:
        """Return the products of the derivatives of the residuals, and curvatures of the priors."""
        points, weights, decayed = positions[self.sensors], self._whitening, terms.decay
        unpack, options = self._pairs.unpack, self._options
        n_axes = points.shape[1]
        steep = -amplitude * exponent * decayed.steepness
        slopes = unpack(steep / decayed.squares)
        apart = [np.subtract.outer(axis, axis).astype(weights.dtype) for axis in points.T]
        derivatives = [slopes * axis for axis in apart]
        products = [derivative @ weights for derivative in derivatives]
        # The second derivative of the repulsion is taken along the line between two sensors only,
        # where it is positive; likewise the mean ratio of distances is taken as constant.
        bend = 2 * options.prior_weight * self._pairs.inverse_metric**2
        bend += options.repulsion / decayed.squares
        radial = unpack(bend * (self._noise / decayed.squares))
        coordinates = {}
        for p in range(n_axes):
            for q in range(p, n_axes):
                pairs = radial * apart[p] * apart[q]
                found = products[p] @ derivatives[q].T
                found *= weights
                found += products[p] * products[q].T
                found *= 2
                found -= pairs
                found[np.diag_indices_from(found)] += pairs.sum(axis=1)
                coordinates[p, q] = found
        linear_terms = (decayed.shape, self._pairs.known, steep * decayed.logarithms)
        by_exponent = self._whitened(unpack(linear_terms[2]))
        whitened = (terms.whitened_shape, self._pairs.whitened_known, by_exponent)
        cross = [[2 * (d * w).sum(axis=1) for d in derivatives] for w in map(unpack, whitened)]
        linear = [[self._pairs.product(a, b) for b in whitened] for a in linear_terms]
        return BlockCurvature(coordinates, np.array(cross), np.array(linear))

    def _whitened_offset(self, offset: Matrix) -> Vector:
        if np.count_nonzero(offset) < offset.size - len(offset):
            return self._whitened(offset)
        return self._times_weights(self._whitening.sum(axis=1)[:, None] - self._whitening)

    def _whitened(self, matrix: Matrix) -> Vector:
        """Return the pairs of W A W for a symmetric matrix A."""
        return self._times_weights(self._whitening @ matrix)

    def _times_weights(self, product: Matrix) -> Vector:
        """Return the pairs of P W, which is symmetric."""
        weights, n_sensors = self._whitening, len(product)
        whitened = np.empty_like(weights)
        # Only blocks that reach above the diagonal are computed.
        for first, last in pairwise([*range(0, n_sensors, _ROWS), n_sensors]):
            np.matmul(product[first:last], weights[:, first:], out=whitened[first:last, first:])
        return pack(whitened)


def objective(
    blocks: Sequence[Block],
    positions: Matrix,
    log_exponent: float,
    map_blocks: MapFunction = serial_map,
) -> tuple[float, Matrix]:
    """Return the objective and its gradient.

    Parameters
    ----------
    blocks : sequence of Block
    positions : ndarray of shape (N, k)
    log_exponent : float
        Logarithm of the covariogram's exponent.
    map_blocks : callable
        Applies a function to every block.

    Returns
    -------
    value : float
    gradient : ndarray of shape (N k + 1,)
        By the coordinates, then by the log exponent.
    """
    terms = map_blocks(lambda block: block.terms(positions, log_exponent), blocks)
    products = np.sum([term.products for term in terms], axis=0)
    amplitude, offset = solve_amplitude_and_offset(products)
    exponent = float(np.exp(log_exponent))
    slopes = map_blocks(
        lambda pair: pair[0].gradient(pair[1], positions, exponent, amplitude, offset),
        zip(blocks, terms, strict=True),
    )
    value, by_exponent = 0.0, 0.0
    by_positions = np.zeros_like(positions)
    for block, (part, by_position, by_log_exponent) in zip(blocks, slopes, strict=True):
        value += part
        by_positions[block.sensors] += by_position
        by_exponent += by_log_exponent
    return value, np.append(by_positions.ravel(), by_exponent)


def solve_amplitude_and_offset(products: Matrix) -> tuple[float, float]:
    """Return the amplitude and offset that minimise the whitened residual."""
    ee, eo, es, oo, os, _ = products
    determinant = ee * oo - eo * eo
    without_offset = es / ee if ee > 0 else 0.0
    amplitude = (
        (es * oo - eo * os) / determinant if determinant > 1e-12 * ee * oo else without_offset
    )
    amplitude = float(np.clip(amplitude, *_AMPLITUDE_BOUNDS))
    return amplitude, float((os - amplitude * eo) / oo) if oo > 0 else 0.0


def _whitening(similarity: Matrix, ridge: float) -> Matrix:
    """Return W of `fit_covariogram`, shape (n, n): the regularised inverse without the mean."""
    covariance = _with_ridge(similarity, ridge)
    factor, failed = dpotrf(covariance, overwrite_a=True)
    if failed:
        # Not positive definite: pairs are unknown, or the similarity is not a correlation.
        values, vectors = np.linalg.eigh(_with_ridge(similarity, ridge))
        inverse = (vectors / np.maximum(values, _MIN_EIGENVALUE * ridge)) @ vectors.T
        inverse = (inverse + inverse.T) / 2
    else:
        upper = np.triu(dpotri(factor, overwrite_c=True)[0])  # below it, LAPACK leaves the factor
        inverse = upper + upper.T
        inverse[np.diag_indices_from(inverse)] /= 2
    shared = inverse.sum(axis=1)
    total = shared.sum()
    if total > 0:
        inverse -= np.outer(shared, shared) / total
    return np.asarray(inverse)


def _with_ridge(similarity: Matrix, ridge: float) -> Matrix:
    """Return the covariance in the order of Fortran, in which LAPACK overwrites it."""
    covariance = np.array(similarity, order="F")
    np.fill_diagonal(covariance, 1 + ridge)
    return covariance
