"""Mantel r with its null distribution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import pdist, squareform

from anisomap.base import PERMUTATIONS
from anisomap.base.immutable import Immutable
from anisomap.errors import InputError
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.sensor_map import SensorMap

NULL_QUANTILES = (0.0, 0.25, 0.5, 0.75, 0.95, 1.0)
"""Levels of the quantiles in summaries of a null distribution."""

_NULL_ROUNDING = 1e-5  # of sums of float32 products

MIN_SENSORS_COMPARED = 4
"""Minimum number of sensors: three sensors have only three distances to correlate."""


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
        """Share of permutations, including the identity, with at least this r; NaN without a null.

        Values of r that differ only by rounding count as equal.
        """
        if not self.null.size:
            return float("nan")
        return float(
            (np.count_nonzero(self.null >= self.r - _NULL_ROUNDING) + 1) / (self.null.size + 1)
        )

    def quantiles(self) -> dict[float, float]:
        """Return minimum, quartiles, 95 % quantile and maximum of the null; {} without a null."""
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
        distances in one of the matrices are equal.

    Notes
    -----
    McGregor et al. (2011), section "Results"; Mantel (1967), Cancer Research 27: 209-220. Sensors
    are permuted instead of pairs, since the distances of a configuration constrain each other.
    """
    one, other = _distances(first), _distances(second)
    if not (np.isfinite(one).all() and np.isfinite(other).all()):
        raise InputError("distances must be finite; leave out sensors without a position")
    if len(one) != len(other):
        raise InputError(f"the numbers of sensors must be equal, got {len(one)} and {len(other)}")
    if len(one) < MIN_SENSORS_COMPARED:
        raise InputError(f"Mantel r requires at least 4 sensors, got {len(one)}")
    a, b = _standardised(one), _standardised(other)
    a32, b32 = a.astype(np.float32), b.astype(np.float32)  # suffices, and is twice as fast
    generator = np.random.default_rng(0 if rng is None else rng)
    null, report_every = np.empty(permutations), max(1, permutations // 100)
    with limited_blas(len(a)):
        for i in range(permutations):
            order = generator.permutation(len(a))
            null[i] = np.vdot(a32[order].take(order, axis=1), b32) / 2
            if progress is not None and i % report_every == 0:
                progress(i / permutations)
    return Mantel(r=float(np.clip(np.vdot(a, b) / 2, -1, 1)), null=null, n_sensors=len(a))


def _distances(configuration: SensorMap | ArrayLike) -> NDArray[np.float64]:
    if isinstance(configuration, SensorMap):
        return _between(configuration.positions)
    values = np.asarray(configuration, dtype=np.float64)
    if values.ndim != 2:
        raise InputError(f"expected positions (N, k) or distances (N, N), got {values.shape}")
    if values.shape[0] != values.shape[1] or values.shape[0] < MIN_SENSORS_COMPARED:
        return _between(values)
    if not np.allclose(values, values.T) or np.diag(values).any():
        raise InputError("a distance matrix must be symmetric with a zero diagonal")
    return values


def _between(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(squareform(pdist(positions)))


def _standardised(distances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centre and scale the pairs: half the inner product of two such matrices is Pearson's r."""
    pairs = squareform(distances, checks=False)
    centred = pairs - pairs.mean()
    norm = np.linalg.norm(centred)
    if norm <= 1e-12 * np.linalg.norm(pairs):
        raise InputError("all distances are equal, so a correlation is undefined")
    return np.asarray(squareform(centred / norm))
