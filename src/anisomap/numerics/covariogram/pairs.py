"""Functions of the distances of all pairs of some sensors, in numpy or compiled.

Pairs i < j are in the order of `scipy.spatial.distance.pdist`: symmetric matrices take half the
arithmetic so.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist, squareform

from anisomap.numerics.compiled.parallel import load_loops
from anisomap.numerics.precision import Reals

Vector: TypeAlias = Reals

_SQUARE_BOUNDS = (1e-12, 1e30)  # of squared distances in ranges; keep all terms finite in float32
_MAX_LOG_POWER = float(np.log(80))  # of d^b; exp(-80) is nearly the smallest normal float32


class Decay(NamedTuple):
    """Functions of the distance d of each pair, of shape (P,), for an exponent b.

    Attributes
    ----------
    shape : ndarray
        ``exp(-d^b)``; 0 where the correlation is unknown.
    steepness : ndarray
        ``d^b exp(-d^b)``; 0 where the correlation is unknown.
    squares : ndarray
        Squared distances.
    logarithms : ndarray
        ``log d``.
    """

    shape: Vector
    steepness: Vector
    squares: Vector
    logarithms: Vector


class Slope(NamedTuple):
    """Value of the objective, and its derivatives.

    Attributes
    ----------
    value : float
    by_exponent : float
        Derivative by the log exponent.
    force : ndarray of shape (P,)
        Half the derivative by the distance of each pair, over the distance.
    """

    value: float
    by_exponent: float
    force: Vector


class Weights(NamedTuple):
    """Weights of the terms of the objective.

    Attributes
    ----------
    amplitude, exponent, offset : float
        Of the covariogram.
    prior, repulsion : float
        Of the squared deviation of a ratio of distances, and of the logarithm of a distance.
    """

    amplitude: float
    exponent: float
    offset: float
    prior: float
    repulsion: float


@dataclass(frozen=True, eq=False)
class Pairs:
    """Constants of the pairs of n sensors, each of shape (P,), and functions of distances.

    Attributes
    ----------
    known : ndarray
        1 where the correlation is known, else 0.
    similarity : ndarray
        0 where unknown.
    whitened_known, whitened_similarity : ndarray
        The same, whitened: see `anisomap.numerics.covariogram.objective`.
    inverse_metric : ndarray
    n_sensors : int
        Number of sensors, n.
    """

    known: Vector
    similarity: Vector
    whitened_known: Vector
    whitened_similarity: Vector
    inverse_metric: Vector
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

    def slope(self, decayed: Decay, whitened_shape: Vector, weights: Weights) -> Slope:
        """Evaluate the objective and its derivatives by distances and by the log exponent."""
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
        return Slope(value, by_exponent, force)

    def gradient(self, force: Vector, points: Reals) -> Reals:
        """Return the gradient by positions, shape (n, k), of the force of `Slope`."""
        forces = self.unpack(force.astype(np.float64, copy=False))
        return np.asarray(2 * (forces.sum(axis=1)[:, None] * points - forces @ points))

    def product(self, first: Vector, second: Vector) -> float:
        """Sum the products of two symmetric matrices without diagonal, given by their pairs."""
        return 2 * _sum(first * second)

    def unpack(self, values: Vector) -> Reals:
        """Return the symmetric matrix, shape (n, n), of values of pairs; its diagonal is 0."""
        matrix = values.take(self._places)
        np.fill_diagonal(matrix, 0.0)
        return matrix

    @cached_property
    def _places(self) -> NDArray[np.intp]:
        """Place of each pair in the order of pairs, shape (n, n); 0 on the diagonal."""
        return np.asarray(squareform(np.arange(len(self.known))), dtype=np.intp)


class CompiledPairs(Pairs):
    """Pairs in float32, whose functions are compiled."""

    def decay(self, points: Reals, log_exponent: float) -> Decay:
        """Do as `Pairs.decay` does."""
        found = Decay(*(np.empty_like(self.known) for _ in Decay._fields))
        bounds = (*_SQUARE_BOUNDS, _MAX_LOG_POWER)
        axes = np.ascontiguousarray(points.T)
        exponent = float(np.exp(log_exponent))
        self._loops.decay(axes, self.known, exponent, bounds, tuple(found))
        return found

    def slope(self, decayed: Decay, whitened_shape: Vector, weights: Weights) -> Slope:
        """Do as `Pairs.slope` does."""
        force = np.empty_like(self.known)
        data = (
            self.known,
            self.similarity,
            self.whitened_known,
            self.whitened_similarity,
            self.inverse_metric,
        )
        value, by_exponent = self._loops.slope(
            tuple(decayed), whitened_shape, data, tuple(weights), force
        )
        return Slope(value, by_exponent, force)

    def gradient(self, force: Vector, points: Reals) -> Reals:
        """Do as `Pairs.gradient` does."""
        gradient = np.zeros(points.shape[::-1])
        self._loops.pull(force, np.ascontiguousarray(points.T), gradient)
        return gradient.T

    def product(self, first: Vector, second: Vector) -> float:
        """Do as `Pairs.product` does."""
        return float(self._loops.product_of(first, second))

    def unpack(self, values: Vector) -> Reals:
        """Do as `Pairs.unpack` does."""
        matrix = np.empty((self.n_sensors, self.n_sensors), values.dtype)
        self._loops.unpack(values, matrix)
        return matrix

    @cached_property
    def _loops(self) -> Any:
        return load_loops("covariogram")


def pack(matrix: Reals) -> Vector:
    """Return the pairs i < j of a matrix, shape (n, n)."""
    return np.asarray(squareform(matrix, checks=False))


def _sum(values: Vector) -> float:
    """Sum values of pairs: parts in their own precision, which numpy adds pairwise."""
    n_points = round((1 + np.sqrt(1 + 8 * len(values))) / 2)
    rows = values.reshape(n_points - 1 + n_points % 2, -1)
    return float(rows.sum(axis=1).sum(dtype=np.float64))
