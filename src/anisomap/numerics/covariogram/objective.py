"""Objective of the covariogram fit: whitened residuals of correlations, summed over blocks."""

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

_SQUARE_BOUNDS = (1e-12, 1e30)  # of squared distances in ranges; keep all terms finite in float32
_MAX_LOG_POWER = float(np.log(80))  # of d^b; exp(-80) is nearly the smallest normal float32
_AMPLITUDE_BOUNDS = (1e-3, 10.0)  # below, the function is flat; above, all pairs exceed its range

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
        move positions by less than a thousandth; 100 times as large with several blocks.
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

    Matrices of blocks are multiplied in the given precision.
    """

    similarity: Matrix
    metric: Matrix
    known: NDArray[np.bool_]
    noise: float
    options: CovariogramOptions
    precision: type[np.floating] = np.float64


@dataclass(frozen=True, eq=False)
class BlockTerms:
    """Contribution of one block at given positions: whitened products, and gradient matrices.

    With ``<A, B> = tr(A W B W)``, `products` are <E,E>, <E,O>, <E,S>, <O,O>, <O,S>, <S,S> for the
    shape E of the covariogram, the offset O (1 where a pair is known) and the similarity S.
    `squares` are squared distances d^2, `logarithms` log d, and `powers` d^b for the exponent b.
    """

    products: Matrix
    shape: Matrix
    whitened_shape: Matrix
    squares: Matrix
    logarithms: Matrix
    powers: Matrix


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
        self._known = problem.known[inside]
        similarity = np.where(self._known, problem.similarity[inside], 0.0).astype(np.float64)
        # Inverted in float64; all other matrices take half the time in float32.
        self._whitening = _whitening(similarity, problem.options.ridge).astype(problem.precision)
        self._similarity = similarity.astype(problem.precision)
        self._offset = self._known.astype(problem.precision)
        metric = problem.metric[inside].astype(np.float64)
        pairs = ~np.eye(len(sensors), dtype=bool)
        inverse = np.divide(1.0, metric, out=np.zeros_like(metric), where=pairs)
        self._inverse_metric = inverse.astype(problem.precision)
        self._noise = problem.noise / 2  # each pair occurs twice in a matrix
        self._latest: tuple[Matrix, float, BlockTerms] | None = None

    @cached_property
    def whitened_similarity(self) -> Matrix:
        """W S W, with the similarity S of the block."""
        return self._whitened(self._similarity)

    @cached_property
    def whitened_offset(self) -> Matrix:
        """W O W, with the offset O: 1 where a pair is known, else 0."""
        return self._whitened(self._offset)

    @cached_property
    def _fixed_products(self) -> tuple[float, float, float]:
        return (
            _dot(self._offset, self.whitened_offset),
            _dot(self._offset, self.whitened_similarity),
            _dot(self._similarity, self.whitened_similarity),
        )

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
        # Matrices are overwritten where possible: new ones take longer than the arithmetic.
        squares = cdist(points, points, "sqeuclidean")
        np.clip(squares, *_SQUARE_BOUNDS, out=squares)
        squares = squares.astype(self._whitening.dtype, copy=False)
        np.fill_diagonal(squares, 1.0)
        logarithms = np.log(squares)
        logarithms *= 0.5
        powers = logarithms * float(np.exp(log_exponent))
        np.minimum(powers, _MAX_LOG_POWER, out=powers)
        np.exp(powers, out=powers)
        shape = np.negative(powers)
        np.exp(shape, out=shape)
        shape *= self._offset
        whitened = self._whitened(shape)
        products = np.array(
            [
                _dot(shape, whitened),
                _dot(shape, self.whitened_offset),
                _dot(shape, self.whitened_similarity),
                *self._fixed_products,
            ]
        )
        return BlockTerms(products, shape, whitened, squares, logarithms, powers)

    def gradient(
        self, terms: BlockTerms, positions: Matrix, exponent: float, amplitude: float, offset: float
    ) -> tuple[float, Matrix, float]:
        """Return the value, and the gradient by the positions and by the log exponent."""
        residual = amplitude * terms.shape
        residual += offset * self._offset
        residual -= self._similarity
        slope = amplitude * terms.whitened_shape
        slope += offset * self.whitened_offset
        slope -= self.whitened_similarity
        # The sum over residuals cancels less than that over the products of their terms.
        value = _dot(residual, slope) / 2
        slope *= -amplitude * exponent
        slope *= terms.shape
        slope *= terms.powers
        by_exponent = _dot(slope, terms.logarithms)
        # Divided by the distance twice: in the derivatives of the distance and of its power.
        slope /= terms.squares
        priors, slope_of_priors = self._priors(terms)
        slope += slope_of_priors
        np.fill_diagonal(slope, 0.0)
        force, points = slope.astype(np.float64, copy=False), positions[self.sensors]
        by_positions = 2 * (force.sum(axis=1)[:, None] * points - force @ points)
        return value + priors, by_positions, by_exponent

    def curvature(
        self, terms: BlockTerms, positions: Matrix, exponent: float, amplitude: float
    ) -> BlockCurvature:
        """Return the products of the derivatives of the residuals, and curvatures of the priors."""
        points, weights = positions[self.sensors], self._whitening
        n_axes = points.shape[1]
        slope = -amplitude * exponent * terms.shape * terms.powers / terms.squares
        apart = [np.subtract.outer(axis, axis).astype(weights.dtype) for axis in points.T]
        derivatives = [slope * axis for axis in apart]
        products = [derivative @ weights for derivative in derivatives]
        options = self._options
        # The second derivative of the repulsion is taken along the line between two sensors only,
        # where it is positive; likewise the mean ratio of distances is taken as constant.
        radial = 2 * options.prior_weight * self._inverse_metric**2
        radial += options.repulsion / terms.squares
        radial *= 2 * self._noise / terms.squares
        np.fill_diagonal(radial, 0.0)
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
        by_exponent = -amplitude * exponent * terms.shape * terms.powers * terms.logarithms
        others = (terms.shape, self._offset, by_exponent)
        whitened = (terms.whitened_shape, self.whitened_offset, self._whitened(by_exponent))
        cross = np.array([[2 * (d * w).sum(axis=1) for d in derivatives] for w in whitened])
        linear = np.array([[_dot(one, other) for other in whitened] for one in others])
        return BlockCurvature(coordinates, cross, linear)

    def _priors(self, terms: BlockTerms) -> tuple[float, Matrix]:
        """Return the priors, and their derivatives by the distances, over the distances."""
        options = self._options
        distances = np.sqrt(terms.squares)
        deviations = distances * self._inverse_metric
        n_sensors = len(deviations)
        deviations -= _sum(deviations) / (n_sensors * (n_sensors - 1))
        np.fill_diagonal(deviations, 0.0)
        value = options.prior_weight * _dot(deviations, deviations)
        value -= options.repulsion * _sum(terms.logarithms)
        slope = deviations
        slope *= 2 * options.prior_weight * self._noise
        slope *= self._inverse_metric
        slope /= distances
        slope -= options.repulsion * self._noise / terms.squares
        return self._noise * value, slope

    def _whitened(self, matrix: Matrix) -> Matrix:
        """Return W A W for a symmetric matrix A, of which three quarters are computed."""
        weights, half = self._whitening, len(matrix) // 2
        product = weights @ matrix
        whitened = np.empty_like(weights)
        np.matmul(product[:half], weights, out=whitened[:half])
        np.matmul(product[half:], weights[:, half:], out=whitened[half:, half:])
        whitened[half:, :half] = whitened[:half, half:].T
        return whitened


def _sum(matrix: Matrix) -> float:
    """Sum all elements; rows in their own precision, which numpy adds pairwise."""
    return float(matrix.sum(axis=1).sum(dtype=np.float64))


def _dot(first: Matrix, second: Matrix) -> float:
    """Sum the products of the elements of two matrices, as `_sum` does."""
    return _sum(first * second)


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
    covariance = similarity.copy()
    np.fill_diagonal(covariance, 1 + ridge)
    identity = np.eye(len(covariance))
    try:
        inverse = cho_solve(cho_factor(covariance), identity)
    except np.linalg.LinAlgError:
        # Not positive definite: pairs are unknown, or the similarity is not a correlation.
        values, vectors = np.linalg.eigh(covariance)
        inverse = (vectors / np.maximum(values, _MIN_EIGENVALUE * ridge)) @ vectors.T
    shared = inverse.sum(axis=1)
    total = shared.sum()
    if total > 0:
        inverse = inverse - np.outer(shared, shared) / total
    return np.asarray((inverse + inverse.T) / 2)
