"""Objective of the covariogram fit: whitened residuals of correlations, summed over blocks.

Symmetric matrices are given by their pairs i < j, in the order of `scipy.spatial.distance.pdist`,
which takes half the arithmetic.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsyrk, ssyrk
from scipy.spatial.distance import pdist, squareform

from anisomap.numerics.compiled.parallel import (
    MIN_COMPILED_ROWS,
    load_loops,
    parallel_map,
)
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
    """Covariogram, and weights of squared deviations of ratios and of logarithms of distances."""

    amplitude: float
    exponent: float
    offset: float
    prior: float
    repulsion: float


@dataclass(frozen=True, eq=False)
class Pairs:
    """Constants of the pairs of n sensors, each of shape (P,), and functions of distances.

    known: 1 where the correlation is known, else 0. similarity: 0 where unknown.
    whitened_known, whitened_similarity: Pairs of W A W for these.
    """

    known: Reals
    similarity: Reals
    whitened_known: Reals
    whitened_similarity: Reals
    inverse_metric: Reals
    n_sensors: int

    def decay(self, points: Reals, log_exponent: float) -> Decay:
        """Evaluate the shape of the covariogram at the distances of points, shape (n, k)."""
        # Arrays are overwritten where possible: new ones take longer than the arithmetic.
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
        # The sum over residuals cancels less than that over the products of their terms.
        value = _sum(np.multiply(residual, force, out=term))
        force *= -weights.amplitude * weights.exponent
        force *= decayed.steepness
        by_exponent = 2 * _sum(np.multiply(force, decayed.logarithms, out=term))
        # Divided by the distance twice: in the derivatives of the distance and of its power.
        force /= decayed.squares
        distances = np.sqrt(decayed.squares, out=residual)
        deviations = np.multiply(distances, self.inverse_metric, out=term)
        deviations -= _sum(deviations) / len(deviations)
        value -= weights.repulsion * _sum(decayed.logarithms)
        pull = deviations * self.inverse_metric
        pull *= weights.prior
        pull /= distances
        force += pull
        value += weights.prior * _sum(np.multiply(deviations, deviations, out=term))
        force -= np.divide(weights.repulsion / 2, decayed.squares, out=term)
        return value, by_exponent, force

    def gradient(self, force: Reals, points: Reals) -> Reals:
        """Return the gradient by positions, shape (n, k), of the force of `slope`."""
        forces = self.unpack(force.astype(np.float64, copy=False))
        return np.asarray(2 * (forces.sum(axis=1)[:, None] * points - forces @ points))

    def product(self, first: Reals, second: Reals) -> float:
        """Sum the products of two symmetric matrices without diagonal, given by their pairs."""
        return 2 * _sum(first * second)

    def unpack(self, values: Reals) -> Reals:
        """Return the symmetric matrix, shape (n, n), of values of pairs; its diagonal is 0."""
        return np.asarray(squareform(values, checks=False))


class CompiledPairs(Pairs):
    """Pairs in float32, whose functions are compiled: faster by half for 1,000 sensors."""

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

    def product(self, first: Reals, second: Reals) -> float:
        """See `Pairs.product`."""
        return float(load_loops("covariogram").product_of(first, second))

    def unpack(self, values: Reals) -> Reals:
        """See `Pairs.unpack`."""
        matrix = np.empty((self.n_sensors, self.n_sensors), values.dtype)
        load_loops("covariogram").unpack(values, matrix)
        return matrix


def pack(matrix: Reals) -> Reals:
    """Return the pairs i < j of a matrix, shape (n, n)."""
    return np.asarray(squareform(matrix, checks=False))


def _sum(values: Reals) -> float:
    """Sum values of pairs: parts in their own precision, which numpy adds pairwise."""
    n_points = round((1 + np.sqrt(1 + 8 * len(values))) / 2)
    rows = values.reshape(n_points - 1 + n_points % 2, -1)
    return float(rows.sum(axis=1).sum(dtype=np.float64))


_AMPLITUDE_BOUNDS = (1e-3, 10.0)  # below, the function is flat; above, all pairs exceed its range

_ROWS = 50  # of a product at a time; with 40 to 80, products of 250 rows took equal time
_MIN_EIGENVALUE = 0.5  # of the ridge; chosen by hand, for similarities that are not correlations
_ROUNDING = 1e-15  # relative, of an eigenvalue that is 0, as in numpy.linalg.pinv


_RANGES = {
    **dict.fromkeys(("prior_weight", "repulsion", "tolerance"), NOT_NEGATIVE),
    "ridge": POSITIVE,
    "max_iterations": at_least(0, whole=True),
    "block": at_least(3, whole=True),
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
        move positions by less than 1e-3; 100 times as large with several blocks.
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
    tolerance: float = 1e-6
    max_iterations: int = 300
    block: int = 500

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)


DEFAULT_COVARIOGRAM = CovariogramOptions()


@dataclass(frozen=True, eq=False)
class Problem:
    """Data and parameters of the fit, with lengths in units of the covariogram's range."""

    similarity: Reals
    metric: Reals
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
    """

    products: Reals
    decay: Decay
    whitened_shape: Reals


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
            whitened_known=self._whitened(offset),
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
        self._latest: tuple[Reals, float, BlockTerms] | None = None

    def terms(self, positions: Reals, log_exponent: float) -> BlockTerms:
        """Evaluate the block at positions of all sensors, shape (N, k)."""
        points = positions[self.sensors]
        # A curvature is followed by a search from the same positions, and the reverse.
        if self._latest is not None:
            before, exponent, terms = self._latest
            if exponent == log_exponent and np.array_equal(before, points):
                return terms
        pairs = self._pairs
        decayed = pairs.decay(points, log_exponent)
        whitened = self._whitened(pairs.unpack(decayed.shape))
        others = (whitened, pairs.whitened_known, pairs.whitened_similarity)
        products = [pairs.product(decayed.shape, other) for other in others]
        terms = BlockTerms(np.array([*products, *self._fixed_products]), decayed, whitened)
        self._latest = points, log_exponent, terms
        return terms

    def gradient(
        self, terms: BlockTerms, positions: Reals, exponent: float, amplitude: float, offset: float
    ) -> tuple[float, Reals, float]:
        """Return the value, and the gradient by the positions and by the log exponent."""
        options = self._options
        prior, repulsion = self._noise * options.prior_weight, self._noise * options.repulsion
        weights = Weights(amplitude, exponent, offset, prior, repulsion)
        value, by_exponent, force = self._pairs.slope(terms.decay, terms.whitened_shape, weights)
        return value, self._pairs.gradient(force, positions[self.sensors]), by_exponent

    def curvature(
        self, terms: BlockTerms, positions: Reals, exponent: float, amplitude: float
    ) -> tuple[dict[tuple[int, int], Reals], Reals, Reals]:
        """Return the contribution to `gauss_newton_matrix`, with the curvatures of the priors.

        These are the products of the derivatives by coordinates p and q >= p of two sensors,
        (n, n) each; of those by amplitude, offset and log exponent with those by coordinates,
        (3, k, n); and of the former with one another, (3, 3).
        """
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
        return coordinates, np.array(cross), np.array(linear)

    def _whitened(self, matrix: Reals) -> Reals:
        """Return the pairs of W A W, which is symmetric as A is."""
        weights, n_sensors = self._whitening, len(matrix)
        product, whitened = weights @ matrix, np.empty_like(weights)
        # Only blocks that reach above the diagonal are computed.
        for first, last in pairwise([*range(0, n_sensors, _ROWS), n_sensors]):
            np.matmul(product[first:last], weights[:, first:], out=whitened[first:last, first:])
        return pack(whitened)


def objective(
    blocks: Sequence[Block],
    positions: Reals,
    log_exponent: float,
) -> tuple[float, Reals]:
    """Return the objective and its gradient. positions (N, k) -> value, gradient (N k + 1,)."""
    terms = parallel_map(lambda block: block.terms(positions, log_exponent), blocks, len(positions))
    products = np.sum([term.products for term in terms], axis=0)
    amplitude, offset = solve_amplitude_and_offset(products)
    exponent = float(np.exp(log_exponent))
    slopes = parallel_map(
        lambda pair: pair[0].gradient(pair[1], positions, exponent, amplitude, offset),
        zip(blocks, terms, strict=True),
        len(positions),
    )
    value, by_exponent = 0.0, 0.0
    by_positions = np.zeros_like(positions)
    for block, (part, by_position, by_log_exponent) in zip(blocks, slopes, strict=True):
        value += part
        by_positions[block.sensors] += by_position
        by_exponent += by_log_exponent
    return value, np.append(by_positions.ravel(), by_exponent)


def gauss_newton_matrix(
    blocks: Sequence[Block],
    positions: Reals,
    log_exponent: float,
    dtype: type[np.floating] = np.float64,
) -> Reals:
    """Return the Gauss-Newton matrix by positions (N, k) and log exponent, (N k + 1, N k + 1).

    With ``<A, B> = tr(A W B W)`` and the derivatives J of the residuals R, its elements are
    ``<J_p, J_q>``; all take k (k + 3) / 2 products of (n, n) matrices, as the derivative by a
    coordinate is not 0 only in one row and column. Amplitude and offset are eliminated by the Schur
    complement (Golub & Pereyra 1973; the approximation of Kaufman 1975, BIT 15: 49-57).
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
        exponent = float(np.exp(log_exponent))
        coordinates, crossed, lines = block.curvature(term, positions, exponent, amplitude)
        for (p, q), found in coordinates.items():
            add_block(matrix, found, starts[p] + block.sensors, starts[q] + block.sensors)
        cross[:, :, block.sensors] += crossed
        linear += lines
    flat = cross.reshape(3, positions.size)
    matrix[:-1, -1] = flat[2]
    matrix[-1, -1] = linear[2, 2]
    # Rows whose outer products are those of the inverse: eigenvectors over roots of eigenvalues.
    values, vectors = np.linalg.eigh(linear[:2, :2])
    kept = values > _ROUNDING * values[-1]
    roots = vectors[:, kept].T / np.sqrt(values[kept])[:, None]
    eliminated = roots @ np.hstack([flat[:2], linear[:2, 2:]])
    # The upper triangle of a C-contiguous matrix is the lower one of its transpose for BLAS.
    rank_update = ssyrk if matrix.dtype == np.float32 else dsyrk
    rank_update(-1.0, eliminated.T, beta=1.0, c=matrix.T, lower=True, overwrite_c=True)
    return matrix


def _add_block(
    matrix: Reals, block: Reals, rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> None:
    """Add a block as `anisomap.numerics.compiled.covariogram.add_block`, at sorted indices."""
    if rows[-1] - rows[0] < len(rows) and columns[-1] - columns[0] < len(columns):
        # All sensors are in one block: slices take a tenth of the time of indices.
        matrix[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += block
    else:
        matrix[np.ix_(rows, columns)] += block


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
