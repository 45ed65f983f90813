"""Mantel r with its null distribution, and diagnostics of multidimensional scaling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist, pdist, squareform

from anisomap.errors import InputError
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.sensor_map import SensorMap

PERMUTATIONS = 10_000
"""Size of the null distribution, as in Figure 3 of the paper."""

NULL_QUANTILES = (0.0, 0.25, 0.5, 0.75, 0.95, 1.0)
"""Levels of the quantiles by which a null distribution is summarised."""

_NULL_ROUNDING = 1e-5  # of sums of float32 products
_ROUNDING = 1e-12  # of the share of variance that another matrix leaves unexplained

MIN_SENSORS_COMPARED = 4
"""Minimum number of sensors: three would give a correlation over three distances only."""


@dataclass(frozen=True, eq=False, repr=False)
class Mantel:
    """Mantel r of two distance matrices, and its null distribution.

    Attributes
    ----------
    r : float
        Pearson correlation over the pairs i < j, in [-1, 1]. The paper's distance-correlation.
    null : ndarray of shape (permutations,)
        Mantel r after random permutations of the sensors of the first matrix.
    n_sensors : int
        Number of sensors compared.
    """

    r: float
    null: NDArray[np.float64]
    n_sensors: int

    def __repr__(self) -> str:
        null = f", p={self.p_value:.2g}" if self.null.size else ""
        return f"<Mantel: r={self.r:.4f}{null}, {self.n_sensors} sensors>"

    @property
    def p_value(self) -> float:
        """Share of permutations with at least this r, the identity included; NaN without a null.

        Values of r that differ only by rounding count as equal.
        """
        if not self.null.size:
            return float("nan")
        return float(
            (np.count_nonzero(self.null >= self.r - _NULL_ROUNDING) + 1) / (self.null.size + 1)
        )

    def quantiles(self) -> dict[float, float]:
        """Minimum, quartiles, 95 % quantile and maximum of the null; empty without a null."""
        if not self.null.size:
            return {}
        return dict(
            zip(NULL_QUANTILES, np.quantile(self.null, NULL_QUANTILES).tolist(), strict=True)
        )


def mantel(
    first: SensorMap | ArrayLike,
    second: SensorMap | ArrayLike,
    *,
    permutations: int = PERMUTATIONS,
    rng: np.random.Generator | int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Mantel:
    """Correlate the distances of two configurations of the same sensors.

    Parameters
    ----------
    first, second : SensorMap or array_like
        A map, positions of shape (N, k), or distances of shape (N, N). All sensors are compared:
        for maps with several components or unplaced sensors, use `anisomap.score`.
    permutations : int
        Size of the null distribution; 0 skips it.
    rng : numpy.random.Generator or int, optional
        Generator of the permutations, or its seed; seed 0 by default.
    progress : callable, optional
        Called with the completed share, from 0 to 1.

    Returns
    -------
    Mantel

    Raises
    ------
    InputError
        If the sizes differ, fewer than 4 sensors are compared, a distance is not finite, or all
        distances of one side are equal.

    Notes
    -----
    McGregor et al. (2011), section "Results"; Mantel (1967), Cancer Research 27: 209-220. Sensors
    are relabelled, not pairs: the distances of one configuration constrain each other.
    """
    a, b = _same_sensors(first, second)
    n_sensors = len(a)
    a, b = _standardised(a), _standardised(b)
    null = np.empty(permutations)
    # float32 suffices for the null and is twice as fast.
    a32, b32 = a.astype(np.float32), b.astype(np.float32)
    generator = np.random.default_rng(0 if rng is None else rng)
    report_every = max(1, permutations // 100)
    with limited_blas(n_sensors):
        for i in range(permutations):
            order = generator.permutation(n_sensors)
            null[i] = np.vdot(a32[order].take(order, axis=1), b32) / 2
            if progress is not None and i % report_every == 0:
                progress(i / permutations)
    null.setflags(write=False)
    r = float(np.clip(np.vdot(a, b) / 2, -1, 1))
    return Mantel(r=r, null=null, n_sensors=n_sensors)


def partial_mantel(
    first: SensorMap | ArrayLike,
    second: SensorMap | ArrayLike,
    third: SensorMap | ArrayLike,
    *,
    permutations: int = PERMUTATIONS,
    rng: np.random.Generator | int | None = None,
) -> Mantel:
    """Correlate the distances of two configurations, with those of a third held constant.

    It tells, for instance, whether a map agrees with another beyond what both owe to a layout.

    Parameters
    ----------
    first, second, third : SensorMap or array_like
        See `mantel`.
    permutations : int
        Size of the null distribution; 0 skips it.
    rng : numpy.random.Generator or int, optional
        Generator of the permutations, or its seed; seed 0 by default.

    Returns
    -------
    Mantel
        With the partial correlation.

    Raises
    ------
    InputError
        As `mantel`, or if the third configuration determines one of the others.

    Notes
    -----
    Smouse, Long & Sokal (1986), Systematic Zoology 35: 627-632, doi:10.2307/2413122:
    ``(r12 - r13 r23) / sqrt((1 - r13^2) (1 - r23^2))``. The sensors of the first are relabelled, as
    by ``mantel.partial`` of R's package vegan.
    """
    a, b, c = (_standardised(matrix) for matrix in _same_sensors(first, second, third))
    r23 = float(np.vdot(b, c)) / 2
    generator = np.random.default_rng(0 if rng is None else rng)

    def partial(relabelled: NDArray[np.float64]) -> float:
        r12, r13 = float(np.vdot(relabelled, b)) / 2, float(np.vdot(relabelled, c)) / 2
        unexplained = (1 - r13**2) * (1 - r23**2)
        return (r12 - r13 * r23) / np.sqrt(unexplained) if unexplained > _ROUNDING else np.nan

    r = partial(a)
    if not np.isfinite(r):
        raise InputError("the third configuration determines one of the others: nothing is left")
    orders = (generator.permutation(len(a)) for _ in range(permutations))
    null = np.array([partial(a[order].take(order, axis=1)) for order in orders])
    null.setflags(write=False)
    return Mantel(r=float(np.clip(r, -1, 1)), null=null, n_sensors=len(a))


def _same_sensors(*configurations: SensorMap | ArrayLike) -> list[NDArray[np.float64]]:
    """Return the distances of configurations of the same sensors."""
    found = [_distances(configuration) for configuration in configurations]
    if not all(np.isfinite(matrix).all() for matrix in found):
        raise InputError("distances must be finite; leave out sensors without a position")
    sizes = [len(matrix) for matrix in found]
    if len(set(sizes)) > 1:
        raise InputError(
            "all configurations must have the same sensors, got "
            f"{', '.join(map(str, sizes[:-1]))} and {sizes[-1]}"
        )
    if sizes[0] < MIN_SENSORS_COMPARED:
        raise InputError(f"Mantel r requires at least 4 sensors, got {sizes[0]}")
    return found


def _distances(configuration: SensorMap | ArrayLike) -> NDArray[np.float64]:
    if isinstance(configuration, SensorMap):
        return _between(configuration.positions)
    values = np.asarray(configuration, dtype=np.float64)
    if values.ndim != 2:
        raise InputError(
            f"expected positions of shape (N, k) or distances of shape (N, N), got {values.shape}"
        )
    if values.shape[0] != values.shape[1] or values.shape[0] < MIN_SENSORS_COMPARED:
        return _between(values)
    if not np.allclose(values, values.T) or np.diag(values).any():
        raise InputError("a distance matrix must be symmetric with a zero diagonal")
    return values


def _between(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(squareform(pdist(positions)))


def _standardised(distances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centre and scale the pairs so that half the inner product of two matrices is Pearson's r."""
    pairs = squareform(distances, checks=False)
    centred = pairs - pairs.mean()
    norm = np.linalg.norm(centred)
    if norm <= 1e-12 * np.linalg.norm(pairs):
        raise InputError("all distances are equal, so a correlation is undefined")
    return np.asarray(squareform(centred / norm))


N_SHIFTS = 99
"""Default size of the null distribution of `shift_test`: p is at least 0.01."""

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Shepard:
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
class ShiftTest:
    """A statistic of a recording, and of recordings in which sensors are unrelated.

    Attributes
    ----------
    observed : float
    null : ndarray of shape (n_shifts,)
    p_value : float
        Share of the null, the observed value included, that is at least as extreme.
    """

    observed: float
    null: Matrix
    p_value: float


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
    squares = np.where(known, actual - np.where(known, wanted, 0), 0) ** 2
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
    from scipy.optimize import isotonic_regression  # noqa: PLC0415, slow to import

    wanted, actual = _compared(dissimilarities, positions)
    pairs = np.argwhere(np.triu(np.isfinite(wanted), k=1))
    if len(pairs) < 2:
        raise InputError(f"a Shepard diagram requires at least 2 known pairs, got {len(pairs)}")
    first, second = pairs.T
    order = np.lexsort((actual[first, second], wanted[first, second]))
    pairs = pairs[order]
    first, second = pairs.T
    distances = actual[first, second]
    found = Shepard(
        wanted[first, second], distances, np.asarray(isotonic_regression(distances).x), pairs
    )
    for array in (found.dissimilarities, found.distances, found.disparities, found.pairs):
        array.setflags(write=False)
    return found


def shift_test(
    readings: ArrayLike,
    statistic: Callable[[Matrix], float],
    *,
    n_shifts: int = N_SHIFTS,
    greater: bool = False,
    rng: np.random.Generator | int | None = None,
) -> ShiftTest:
    """Test a statistic of a recording against recordings in which sensors are unrelated.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings, T >= 2.
    statistic : callable
        ``statistic(readings)`` returns a number, such as the stress of a map.
    n_shifts : int
        Size of the null distribution.
    greater : bool
        Whether great values are evidence of relations, as of a correlation; by default small ones
        are, as of stress.
    rng : numpy.random.Generator or int, optional
        Generator of the shifts, or its seed; seed 0 by default.

    Returns
    -------
    ShiftTest

    Raises
    ------
    InputError
        If there are fewer than 2 frames.

    Notes
    -----
    The readings of each sensor are shifted in time by a random number of frames, circularly. This
    keeps their distribution and autocorrelation and removes their relations. Permutations of
    dissimilarities, as in smacof's ``permtest``, or of frames would be too different from any
    recording, and nearly every map significant.

    Examples
    --------
    The stress of a map of related sensors is lower than chance makes it:

    >>> import numpy as np
    >>> from anisomap import reconstruct
    >>> places, touches = np.arange(12), np.random.default_rng(0).uniform(0, 11, (500, 1))
    >>> readings = np.maximum(0, 2 - abs(touches - places))
    >>> found = shift_test(
    ...     readings, lambda x: reconstruct(x, "r-anisomap", 1).stress, n_shifts=19
    ... )
    >>> float(found.p_value)
    0.05
    """
    values = np.asarray(readings, dtype=np.float64)
    if values.ndim != 2 or len(values) < 2:
        raise InputError(
            f"a test by shifts requires readings of shape (T, N) with T >= 2, got {values.shape}"
        )
    generator = np.random.default_rng(0 if rng is None else rng)
    n_frames, n_sensors = values.shape
    observed = float(statistic(values))
    null = np.empty(n_shifts)
    for i in range(n_shifts):
        starts = generator.integers(n_frames, size=n_sensors)
        frames = (np.arange(n_frames)[:, None] + starts) % n_frames
        null[i] = statistic(np.take_along_axis(values, frames, axis=0))
    extreme = np.count_nonzero(null >= observed if greater else null <= observed)
    null.setflags(write=False)
    return ShiftTest(observed, null, (extreme + 1) / (n_shifts + 1))


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
