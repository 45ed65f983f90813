"""Diagnostics of multidimensional scaling: Shepard diagram, stress per point, tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist

from anisomap.base.immutable import Immutable
from anisomap.errors import InputError
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.scaling.dissimilarity_scaling import monotone_regression

_PERMUTATIONS = 99  # p is at least 0.01

Matrix = NDArray[np.float64]

_ROUNDING = 1e-12  # of the largest distance; smaller residuals are rounding errors


@dataclass(frozen=True, eq=False)
class Shepard(Immutable):
    """Shepard diagram of P pairs of points with known dissimilarities, which increase.

    Attributes
    ----------
    dissimilarities : ndarray of shape (P,)
        In increasing order.
    distances : ndarray of shape (P,)
        Distances of the same pairs in the configuration.
    disparities : ndarray of shape (P,)
        Non-decreasing function of the dissimilarities that is nearest to the distances.
    pairs : ndarray of int, shape (P, 2)
    """

    dissimilarities: Matrix
    distances: Matrix
    disparities: Matrix
    pairs: NDArray[np.intp]

    @property
    def nonmetric_stress(self) -> float:
        """Kruskal's Stress-1 of the disparities; 0 if distances have the order of dissimilarities.

        Kruskal (1964), Psychometrika 29: 1-27.
        """
        residual = np.sum((self.distances - self.disparities) ** 2)
        return float(np.sqrt(residual / np.sum(self.distances**2)))

    @property
    def nonmetric_fit(self) -> float:
        """R squared of the non-metric fit in vegan's stressplot: ``1 - nonmetric_stress ** 2``."""
        return 1 - self.nonmetric_stress**2

    @property
    def linear_fit(self) -> float:
        """Squared correlation of distances and disparities, as in vegan's stressplot."""
        return float(np.corrcoef(self.distances, self.disparities)[0, 1] ** 2)


@dataclass(frozen=True, eq=False)
class NullTest(Immutable):
    """A statistic, and its distribution if nothing relates sensors or objects.

    Attributes
    ----------
    observed : float
    null : ndarray of shape (size,)
    p_value : float
        Share of the null, the observed value included, that is at least as extreme.
    hypothesis : str
        What was done to the data for the null.
    """

    observed: float
    null: Matrix
    p_value: float
    hypothesis: str = ""


def stress_per_point(
    dissimilarities: ArrayLike, positions: ArrayLike, *, weights: ArrayLike | None = None
) -> Matrix:
    """Compute the share of each point in the raw stress of a configuration.

    Parameters
    ----------
    dissimilarities : array_like of shape (N, N)
        Symmetric; infinite where unknown.
    positions : array_like of shape (N, k)
        In the unit of the dissimilarities.
    weights : array_like of shape (N, N), optional
        Weights of the pairs, symmetric; 1 by default.

    Returns
    -------
    ndarray of shape (N,)
        Shares that sum to 1; equal if the fit is perfect. 100 times these are ``spp`` in R's
        package smacof.

    Raises
    ------
    InputError
        If shapes disagree or a matrix is not symmetric.

    Notes
    -----
    Mair, Groenen & de Leeuw (2022), Journal of Statistical Software 102(10),
    doi:10.18637/jss.v102.i10: half of ``w_ij (d_ij - D_ij)^2`` belongs to each point of a pair.
    """
    wanted, actual = _compared(dissimilarities, positions)
    known = np.isfinite(wanted)
    missed = np.where(known, actual - np.where(known, wanted, 0), 0)
    missed[abs(missed) <= _ROUNDING * actual.max(initial=0)] = 0
    squares = missed**2
    if weights is not None:
        squares = squares * _matrix(weights, "weights", len(wanted))
    np.fill_diagonal(squares, 0)
    shares = squares.sum(axis=1)
    total = shares.sum()
    return np.asarray(shares / total if total > 0 else np.full(len(shares), 1 / len(shares)))


def shepard(dissimilarities: ArrayLike, positions: ArrayLike) -> Shepard:
    """Compare the distances of a configuration with the dissimilarities that it represents.

    Parameters
    ----------
    dissimilarities : array_like of shape (N, N)
        Symmetric; infinite where unknown.
    positions : array_like of shape (N, k)

    Returns
    -------
    Shepard

    Raises
    ------
    InputError
        If shapes disagree, the matrix is not symmetric, or fewer than 2 pairs are known.

    Notes
    -----
    Ties of dissimilarity may have different distances (Kruskal's primary approach): they are
    ordered by distance.
    """
    wanted, actual = _compared(dissimilarities, positions)
    pairs = np.argwhere(np.triu(np.isfinite(wanted), k=1))
    if len(pairs) < 2:
        raise InputError(f"a Shepard diagram requires at least 2 known pairs, got {len(pairs)}")
    first, second = pairs.T
    order, disparities = monotone_regression(wanted[first, second], actual[first, second])
    pairs = pairs[order]
    first, second = pairs.T
    return Shepard(wanted[first, second], actual[first, second], disparities, pairs)


def permutation_test(
    dissimilarities: ArrayLike,
    statistic: Callable[[Matrix], float],
    *,
    permutations: int = _PERMUTATIONS,
    rng: np.random.Generator | int | None = None,
    progress: Callable[[float], None] | None = None,
) -> NullTest:
    """Test the stress of dissimilarities against that of the same values on other pairs.

    Parameters
    ----------
    dissimilarities : array_like of shape (N, N)
        Symmetric; infinite where unknown.
    statistic : callable
        ``statistic(dissimilarities)`` returns a number that is small if they fit well, such as the
        stress.
    permutations : int
        Size of the null distribution.
    rng : numpy.random.Generator or int, optional
        Generator of the permutations, or its seed; seed 0 by default.
    progress : callable, optional
        Called with the completed share, from 0 to 1.

    Returns
    -------
    NullTest

    Raises
    ------
    InputError
        If the matrix is not symmetric.

    Notes
    -----
    The known dissimilarities are permuted over the known pairs, as by ``permtest`` of R's package
    smacof (Mair, Borg & Rusch 2016, doi:10.1080/00273171.2016.1235966).
    """
    values = np.asarray(as_symmetric(dissimilarities, "dissimilarities"), dtype=np.float64)
    first, second = np.triu_indices(len(values), k=1)
    known = np.isfinite(values[first, second])
    first, second = first[known], second[known]
    generator = np.random.default_rng(0 if rng is None else rng)
    observed, permuted = float(statistic(values)), list[float]()
    for i in range(permutations):
        other = values.copy()
        other[first, second] = other[second, first] = generator.permutation(values[first, second])
        permuted.append(statistic(other))
        if progress is not None:
            progress((i + 1) / permutations)
    null = np.array(permuted)
    extreme = np.count_nonzero(null <= observed)
    return NullTest(observed, null, (extreme + 1) / (len(null) + 1), "dissimilarities permuted")


def _compared(dissimilarities: ArrayLike, positions: ArrayLike) -> tuple[Matrix, Matrix]:
    """Return dissimilarities, and distances of the positions."""
    points = np.asarray(positions, dtype=np.float64)
    if points.ndim != 2 or not np.isfinite(points).all():
        raise InputError("positions must be finite and of shape (N, k)")
    return _matrix(dissimilarities, "dissimilarities", len(points)), cdist(points, points)


def _matrix(values: ArrayLike, name: str, n_points: int) -> Matrix:
    found = np.asarray(as_symmetric(values, name), dtype=np.float64)
    if len(found) != n_points:
        raise InputError(f"{name} must be of shape ({n_points}, {n_points}), got {found.shape}")
    return found
