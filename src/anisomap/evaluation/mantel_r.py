"""Mantel r with its null distribution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import pdist, squareform

from anisomap.base.defaults import PERMUTATIONS
from anisomap.base.immutable import Immutable
from anisomap.errors import InputError
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.sensor_map import SensorMap

NULL_QUANTILES = (0.0, 0.25, 0.5, 0.75, 0.95, 1.0)
"""Levels of the quantiles by which a null distribution is summarised."""

_NULL_ROUNDING = 1e-5  # of sums of float32 products
_ROUNDING = 1e-12  # of the share of variance that another matrix leaves unexplained

MIN_SENSORS_COMPARED = 4
"""Minimum number of sensors: three would give a correlation over three distances only."""


@dataclass(frozen=True, eq=False, repr=False)
class Mantel(Immutable):
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
    a, b = (_standardised(matrix) for matrix in _same_sensors(first, second))
    a32, b32 = a.astype(np.float32), b.astype(np.float32)  # suffices, and is twice as fast
    null = _null(lambda one: float(np.vdot(one, b32)) / 2, a32, permutations, rng, progress)
    return Mantel(r=float(np.clip(np.vdot(a, b) / 2, -1, 1)), null=null, n_sensors=len(a))


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

    def partial(relabelled: NDArray[np.float64]) -> float:
        r12, r13 = float(np.vdot(relabelled, b)) / 2, float(np.vdot(relabelled, c)) / 2
        unexplained = (1 - r13**2) * (1 - r23**2)
        return (r12 - r13 * r23) / np.sqrt(unexplained) if unexplained > _ROUNDING else np.nan

    r = partial(a)
    if not np.isfinite(r):
        raise InputError("the third configuration determines one of the others: nothing is left")
    null = _null(partial, a, permutations, rng)
    return Mantel(r=float(np.clip(r, -1, 1)), null=null, n_sensors=len(a))


def _null(
    statistic: Callable[[NDArray[Any]], float],
    matrix: NDArray[Any],
    permutations: int,
    rng: np.random.Generator | int | None,
    progress: Callable[[float], None] | None = None,
) -> NDArray[np.float64]:
    """Compute a statistic of a matrix (N, N) after random permutations of its sensors."""
    generator = np.random.default_rng(0 if rng is None else rng)
    null, report_every = np.empty(permutations), max(1, permutations // 100)
    with limited_blas(len(matrix)):
        for i in range(permutations):
            order = generator.permutation(len(matrix))
            null[i] = statistic(matrix[order].take(order, axis=1))
            if progress is not None and i % report_every == 0:
                progress(i / permutations)
    return null


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
