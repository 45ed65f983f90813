"""Objective of the covariogram fit: whitened residuals of correlations.

Symmetric matrices are represented by their pairs i < j, in the order of
`scipy.spatial.distance.pdist`, which halves the arithmetic.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsyrk, ssyrk
from scipy.spatial.distance import pdist, squareform

from anisomap.numerics.compiled.parallel import load_loops, uses_loops
from anisomap.numerics.graph.dissimilarity import invert_definite
from anisomap.numerics.precision import Reals
from anisomap.numerics.ranges import NOT_NEGATIVE, POSITIVE, at_least, check_ranges

_SQUARE_BOUNDS = (1e-12, 1e30)  # of squared distances in ranges; keep all terms finite in float32
_MAX_LOG_POWER = float(np.log(80))  # of d^b; exp(-80) is nearly the smallest normal float32


class Decay(NamedTuple):
    """Functions of the distance d of each pair, of shape (P,), for an exponent b.

    shape: ``exp(-d^b)``; 0 where the correlation is unknown.
    steepness: ``d^b exp(-d^b)``; 0 where the correlation is unknown.
    squares: Squared distances.
    logarithms: ``log d``.
    """

    shape: Reals
    steepness: Reals
    squares: Reals
    logarithms: Reals


class Weights(NamedTuple):
    """Covariogram, and weights of squared deviations of ratios and of logarithms of distances.

    by_scale: Weight of the changes of both by the scale of the map.
    n_lengths: Number of finite distances of the metric.
    """

    amplitude: float
    exponent: float
    offset: float
    prior: float
    repulsion: float
    by_scale: float
    n_lengths: float


@dataclass(frozen=True, eq=False)
class Pairs:
    """Constants of the pairs of n sensors, each of shape (P,), and functions of distances.

    known: 1 where the correlation is known, else 0. similarity: 0 where unknown.
    whitened_known, whitened_similarity: Pairs of W A W for both.
    """

    known: Reals
    similarity: Reals
    whitened_known: Reals
    whitened_similarity: Reals
    inverse_metric: Reals

    def decay(self, points: Reals, log_exponent: float) -> Decay:
        """Evaluate the shape of the covariogram at the distances of points, shape (n, k)."""
        # Arrays are overwritten if possible: allocating arrays takes longer than the arithmetic.
        exact = pdist(points, "sqeuclidean")
        np.clip(exact, *_SQUARE_BOUNDS, out=exact)
        squares = exact.astype(self.known.dtype, copy=False)
        logarithms = np.log(squares)
        logarithms *= 0.5
        steepness = logarithms * float(np.exp(log_exponent))
        np.minimum(steepness, _MAX_LOG_POWER, out=steepness)
        np.exp(steepness, out=steepness)
        shape = np.negative(steepness)
        np.exp(shape, out=shape)
        shape *= self.known
        steepness *= shape
        return Decay(shape, steepness, squares, logarithms)

    def slope(
        self, decayed: Decay, whitened_shape: Reals, weights: Weights
    ) -> tuple[float, float, Reals]:
        """Return the objective, its derivative by the log exponent, and the force, (P,).

        The force is half the derivative by the distance of each pair, over the distance.
        """
        residual = weights.amplitude * decayed.shape
        term = weights.offset * self.known
        residual += term
        residual -= self.similarity
        force = weights.amplitude * whitened_shape
        np.multiply(self.whitened_known, weights.offset, out=term)
        force += term
        force -= self.whitened_similarity
        # The sum over residuals has less cancellation than a sum over products of their terms.
        value = self.product(residual, force) / 2
        force *= -weights.amplitude * weights.exponent
        force *= decayed.steepness
        by_exponent = self.product(force, decayed.logarithms)
        # The distance is a divisor twice: in the derivatives of the distance and of its power.
        force /= decayed.squares
        distances, count = np.sqrt(decayed.squares, out=residual), len(force)
        deviations = np.multiply(distances, self.inverse_metric, out=term)
        n_lengths = weights.n_lengths
        mean, free = float(deviations.sum(dtype=np.float64)) / n_lengths, 1 - weights.by_scale
        deviations /= mean
        deviations -= 1
        prior = weights.prior * mean ** (2 * weights.by_scale)
        pull = np.divide(self.inverse_metric, distances, out=distances)
        pull *= prior / mean
        # The deviation from an infinite distance is -1, which must not count.
        variance = (self.product(deviations, deviations) / 2 - count) / n_lengths + 1
        value += prior * n_lengths * variance
        deviations -= free * variance
        pull *= deviations
        force += pull
        size = float(decayed.squares.sum(dtype=np.float64)) / count
        log_distances = float(decayed.logarithms.sum(dtype=np.float64))
        value -= weights.repulsion * (log_distances - free * count / 2 * np.log(size))
        force -= np.divide(weights.repulsion / 2, decayed.squares, out=term)
        force += weights.repulsion / 2 * free / size
        return value, by_exponent, force

    def gradient(self, force: Reals, points: Reals) -> Reals:
        """Return the gradient by positions, shape (n, k), of the force of `slope`."""
        forces = squareform(force.astype(np.float64, copy=False))
        return np.asarray(2 * (forces.sum(axis=1)[:, None] * points - forces @ points))

    def product(self, first: Reals, second: Reals) -> float:
        """Sum the products of two symmetric matrices without diagonal, given by their pairs."""
        parts = np.einsum("ij,ij->i", _rows(first), _rows(second))
        return 2 * float(parts.sum(dtype=np.float64))


class CompiledPairs(Pairs):
    """Pairs in float32 with compiled functions: faster by half for 1,000 sensors."""

    def decay(self, points: Reals, log_exponent: float) -> Decay:
        """See `Pairs.decay`."""
        found = Decay(*(np.empty_like(self.known) for _ in Decay._fields))
        bounds = (*_SQUARE_BOUNDS, _MAX_LOG_POWER)
        axes = np.ascontiguousarray(points.T)
        exponent = float(np.exp(log_exponent))
        load_loops("covariogram").decay(axes, self.known, exponent, bounds, tuple(found))
        return found

    def slope(
        self, decayed: Decay, whitened_shape: Reals, weights: Weights
    ) -> tuple[float, float, Reals]:
        """See `Pairs.slope`."""
        force = np.empty_like(self.known)
        data = (
            self.known,
            self.similarity,
            self.whitened_known,
            self.whitened_similarity,
            self.inverse_metric,
        )
        value, by_exponent = load_loops("covariogram").slope(
            tuple(decayed), whitened_shape, data, tuple(weights), force
        )
        return value, by_exponent, force

    def gradient(self, force: Reals, points: Reals) -> Reals:
        """See `Pairs.gradient`."""
        gradient = np.zeros(points.shape[::-1])
        load_loops("covariogram").pull(force, np.ascontiguousarray(points.T), gradient)
        return gradient.T


def _rows(values: Reals) -> Reals:
    """Arrange values of pairs in rows of equal length."""
    n_points = round((1 + np.sqrt(1 + 8 * len(values))) / 2)
    return values.reshape(n_points - 1 + n_points % 2, -1)


_AMPLITUDE_BOUNDS = (1e-3, 10.0)  # the function is flat below; all pairs exceed its range above

_ROWS = 50  # of a product at a time; with 40 to 80, products of 250 rows took equal time
_MIN_EIGENVALUE = 0.5  # of the ridge; chosen by hand, for similarities that are not correlations
# Weight of residuals that are not whitened, relative to whitened residuals of unrelated sensors:
# for the correlations of eight skins, it was .43 to .71.
_NOT_WHITENED = 0.5
# Number of sensors whose pairs limit the changes of both priors by the scale of a map: the scale is
# one number. Without the limit, the priors of all pairs dominated the covariogram, with exponents
# of .8 instead of 2 on spheres of 400 to 2,000. With 0 to 100, skins of up to 250 lose .004 of r.
_MAX_SCALED = 200
_ROUNDING = 1e-15  # relative, of an eigenvalue that is 0, as in numpy.linalg.pinv


_RANGES = {
    **dict.fromkeys(("prior_weight", "repulsion", "tolerance"), NOT_NEGATIVE),
    "ridge": POSITIVE,
    "max_iterations": at_least(0, whole=True),
    "max_whitened": at_least(0, whole=True),
}


@dataclass(frozen=True)
class CovariogramOptions:
    """Parameters of the covariogram fit, tuned on simulated skins, seeds 101 to 103.

    ``docs/development/accuracy.md`` gives the error without each step of the method.

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
        move positions by less than 1e-3.
    max_iterations : int
        Maximum number of L-BFGS iterations.
    max_whitened : int
        Maximum number of sensors whose residuals are whitened, which takes cubic time. With
        more sensors, only their mean is removed.

    Raises
    ------
    InputError
        If a value is out of range.
    """

    prior_weight: float = 1.0
    repulsion: float = 0.1
    ridge: float = 1.0
    tolerance: float = 1e-6
    max_iterations: int = 300
    max_whitened: int = 500

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)


DEFAULT_COVARIOGRAM = CovariogramOptions()


@dataclass(frozen=True, eq=False)
class Problem:
    """Data and parameters of the fit, with lengths in units of the covariogram's range.

    prior: Replaces the `prior_weight` of the options.
    """

    similarity: Reals
    metric: Reals
    known: NDArray[np.bool_]
    noise: float
    prior: float
    options: CovariogramOptions
    precision: type[np.floating] = np.float64


class Terms(NamedTuple):
    """Residuals at given positions.

    With ``<A, B> = tr(A W B W)``, `products` are <E,E>, <E,O>, <E,S>, <O,O>, <O,S>, <S,S> for the
    shape E of the covariogram, the offset O (1 where a pair is known) and the similarity S.
    """

    products: Reals
    decay: Decay
    whitened_shape: Reals


class Objective:
    """The objective of the covariogram fit, with its constant matrices."""

    def __init__(self, problem: Problem) -> None:
        self._prior = problem.noise * problem.prior
        self._repulsion = problem.noise * problem.options.repulsion
        similarity = np.where(problem.known, problem.similarity, 0.0).astype(np.float64)
        self._scale = _NOT_WHITENED / (1 + problem.options.ridge)
        self._n_sensors = n = len(similarity)
        loops = uses_loops(n)
        self._by_scale = min(1.0, (_MAX_SCALED / n) ** 2)
        self._weights: Reals | None = None
        if n <= problem.options.max_whitened:
            # The inversion requires float64; all other operations take half the time in float32.
            weights = _whitening(similarity, problem.options.ridge)
            self._weights = weights.astype(problem.precision)
        elif not loops:
            self._weights = (self._scale * (np.eye(n) - 1 / n)).astype(problem.precision)
        known, similarity = (
            squareform(one.astype(problem.precision), checks=False)
            for one in (problem.known, similarity)
        )
        inverse_metric = 1 / squareform(problem.metric, checks=False).astype(np.float64)
        self._n_lengths = float(np.count_nonzero(inverse_metric))
        self._pairs = pairs = (CompiledPairs if loops else Pairs)(
            *(known, similarity, self._whitened(known), self._whitened(similarity)),
            inverse_metric=inverse_metric.astype(problem.precision),
        )
        self._fixed_products = (
            pairs.product(pairs.known, pairs.whitened_known),
            pairs.product(pairs.known, pairs.whitened_similarity),
            pairs.product(pairs.similarity, pairs.whitened_similarity),
        )
        self._latest: tuple[Reals, float, Terms] | None = None

    def terms(self, positions: Reals, log_exponent: float) -> Terms:
        """Evaluate the residuals at positions, shape (n, k)."""
        # A search starts from the positions of the latest curvature, and vice versa.
        if self._latest is not None:
            before, exponent, terms = self._latest
            if exponent == log_exponent and np.array_equal(before, positions):
                return terms
        pairs = self._pairs
        decayed = pairs.decay(positions, log_exponent)
        whitened = self._whitened(decayed.shape)
        others = (whitened, pairs.whitened_known, pairs.whitened_similarity)
        products = [pairs.product(decayed.shape, other) for other in others]
        terms = Terms(np.array([*products, *self._fixed_products]), decayed, whitened)
        self._latest = positions, log_exponent, terms
        return terms

    def value_and_slope(self, positions: Reals, log_exponent: float) -> tuple[float, Reals]:
        """Return the objective and its gradient. positions (n, k) -> value, gradient (n k + 1,)."""
        terms = self.terms(positions, log_exponent)
        amplitude, offset = solve_amplitude_and_offset(terms.products)
        exponent = float(np.exp(log_exponent))
        priors = self._prior, self._repulsion, self._by_scale, self._n_lengths
        weights = Weights(amplitude, exponent, offset, *priors)
        value, by_exponent, force = self._pairs.slope(terms.decay, terms.whitened_shape, weights)
        by_positions = self._pairs.gradient(force, positions)
        return value, np.append(by_positions.ravel(), by_exponent)

    def gauss_newton_matrix(
        self, positions: Reals, log_exponent: float, dtype: type[np.floating] = np.float64
    ) -> Reals:
        """Return the Gauss-Newton matrix by positions (n, k) and log exponent, (n k + 1, n k + 1).

        With ``<A, B> = tr(A W B W)`` and the derivatives J of the residuals R, its elements are
        ``<J_p, J_q>``. They take k (k + 3) / 2 products of (n, n) matrices, since the derivative by
        a coordinate is 0 except in one row and column. Amplitude and offset are eliminated by the
        Schur complement (Golub & Pereyra 1973; the approximation of Kaufman 1975, BIT 15: 49-57).
        The upper triangle is complete.
        """
        n_sensors, n_axes = positions.shape
        terms, pairs = self.terms(positions, log_exponent), self._pairs
        amplitude, _ = solve_amplitude_and_offset(terms.products)
        decayed = terms.decay
        steep = -amplitude * float(np.exp(log_exponent)) * decayed.steepness
        slopes = squareform(steep / decayed.squares)
        apart = [np.subtract.outer(axis, axis).astype(slopes.dtype) for axis in positions.T]
        derivatives = [slopes * axis for axis in apart]
        if self._weights is None:
            means = [one.mean(axis=1, keepdims=True) for one in derivatives]
            products = [self._scale * (a - b) for a, b in zip(derivatives, means, strict=True)]
        else:
            products = [derivative @ self._weights for derivative in derivatives]
        # Only the second derivative of the repulsion along the line between two sensors is used,
        # which is positive. The mean ratio of distances is treated as constant.
        bend = 2 * self._prior * pairs.inverse_metric**2 + self._repulsion / decayed.squares
        radial = squareform(bend / decayed.squares)
        matrix = np.zeros((positions.size + 1, positions.size + 1), dtype)
        for p in range(n_axes):
            for q in range(p, n_axes):
                found = self._curved(products[p], derivatives[q], products[q])
                radially = radial * apart[p] * apart[q]
                found -= radially
                found[np.diag_indices_from(found)] += radially.sum(axis=1)
                rows, columns = (slice(i * n_sensors, (i + 1) * n_sensors) for i in (p, q))
                matrix[rows, columns] = found
        linear_terms = (decayed.shape, pairs.known, steep * decayed.logarithms)
        by_exponent = self._whitened(linear_terms[2])
        whitened = (terms.whitened_shape, pairs.whitened_known, by_exponent)
        cross = [[2 * (d * w).sum(axis=1) for d in derivatives] for w in map(squareform, whitened)]
        flat = np.array(cross, dtype=np.float64).reshape(3, positions.size)
        linear = np.array([[pairs.product(a, b) for b in whitened] for a in linear_terms])
        matrix[:-1, -1] = flat[2]
        matrix[-1, -1] = linear[2, 2]
        # Sum of outer products of rows is the inverse: eigenvectors divided by roots of values.
        values, vectors = np.linalg.eigh(linear[:2, :2])
        kept = values > _ROUNDING * values[-1]
        roots = vectors[:, kept].T / np.sqrt(values[kept])[:, None]
        eliminated = roots @ np.hstack([flat[:2], linear[:2, 2:]])
        # The upper triangle of a C-contiguous matrix is the lower one of its transpose for BLAS.
        rank_update = ssyrk if matrix.dtype == np.float32 else dsyrk
        rank_update(-1.0, eliminated.T, beta=1.0, c=matrix.T, lower=True, overwrite_c=True)
        return matrix

    def _curved(self, product: Reals, derivative: Reals, other: Reals) -> Reals:
        """Return the curvature by two coordinates of all sensors, (n, n), without the priors.

        product, other (n, n): A W and B W, of the derivatives A and B. derivative (n, n): B.
        """
        if self._weights is not None:
            found = product @ derivative.T
            found *= self._weights
            found += product * other.T
        else:  # off the diagonal, W is -1 / n, which hardly changes the sum
            found = product * other.T
            sums = self._scale * np.einsum("ij,ij->i", product, derivative)
            found[np.diag_indices_from(found)] += sums
        found *= 2
        return np.asarray(found)

    def _whitened(self, values: Reals) -> Reals:
        """Return the pairs of W A W, which is symmetric like A, for A given by its pairs."""
        weights, n_sensors = self._weights, self._n_sensors
        if weights is None:
            centred = np.empty_like(values)
            load_loops("covariogram").centre(values, n_sensors, self._scale**2, centred)
            return centred
        matrix = squareform(values)
        product, whitened = weights @ matrix, np.empty_like(weights)
        # Only parts of products above the diagonal are needed.
        for first, last in pairwise([*range(0, n_sensors, _ROWS), n_sensors]):
            np.matmul(product[first:last], weights[:, first:], out=whitened[first:last, first:])
        return np.asarray(squareform(whitened, checks=False))


def solve_amplitude_and_offset(products: Reals) -> tuple[float, float]:
    """Return the amplitude and offset that minimise the whitened residual."""
    ee, eo, es, oo, os, _ = products
    determinant = ee * oo - eo * eo
    without_offset = es / ee if ee > 0 else 0.0
    amplitude = (
        (es * oo - eo * os) / determinant if determinant > 1e-12 * ee * oo else without_offset
    )
    amplitude = float(np.clip(amplitude, *_AMPLITUDE_BOUNDS))
    return amplitude, float((os - amplitude * eo) / oo) if oo > 0 else 0.0


def _whitening(similarity: Reals, ridge: float) -> Reals:
    """Return W of `fit_covariogram`, shape (n, n): the regularised inverse without the mean."""
    covariance = similarity.copy()
    np.fill_diagonal(covariance, 1 + ridge)
    inverse = invert_definite(covariance.copy())
    if inverse is None:
        # Not positive definite: pairs are unknown, or the similarity is not a correlation.
        values, vectors = np.linalg.eigh(covariance)
        inverse = (vectors / np.maximum(values, _MIN_EIGENVALUE * ridge)) @ vectors.T
        inverse = (inverse + inverse.T) / 2
    shared = inverse.sum(axis=1)
    total = shared.sum()
    if total > 0:
        inverse -= np.outer(shared, shared) / total
    return np.asarray(inverse)
