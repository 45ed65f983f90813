"""Mantel r: the correlation of two distance matrices, and its null."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import pdist, squareform

from anisomap.errors import InputError
from anisomap.sensor_map import SensorMap

PERMUTATIONS = 10_000
"""Size of the null distribution, as in the paper (Fig. 3)."""

NULL_QUANTILES = (0.0, 0.25, 0.5, 0.75, 0.95, 1.0)
_NULL_ROUNDING = 1e-5  # of sums of float32 products

FEWEST_SENSORS = 4
"""With three, the three distances of one triangle would be correlated with those of another."""


@dataclass(frozen=True, eq=False)
class Mantel:
    """Mantel r of two distance matrices, and what it would be if the labels meant nothing.

    Attributes
    ----------
    r : float
        Pearson correlation over the pairs i < j, in [-1, 1]. The paper's distance-correlation.
    null : ndarray of shape (permutations,)
        The same after relabelling the sensors of the first matrix at random.
    n_sensors : int
        How many sensors were compared.
    """

    r: float
    null: NDArray[np.float64]
    n_sensors: int

    @property
    def p_value(self) -> float:
        """Share of labellings at least as good, this one counted; NaN without a null.

        Few sensors have few labellings, and some draws are the true one again: what differs from
        r by rounding alone counts as equal to it.
        """
        if not self.null.size:
            return float("nan")
        return float(
            (np.count_nonzero(self.null >= self.r - _NULL_ROUNDING) + 1) / (self.null.size + 1)
        )

    def quantiles(self) -> dict[float, float]:
        """Quantiles of the null: least, quartiles, 95 %, and greatest; empty without a null."""
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
    """Compare two configurations of the same sensors by their distances.

    Parameters
    ----------
    first, second : SensorMap or array_like
        Each a map, positions of shape (N, k), or distances of shape (N, N).
    permutations : int
        How many random labellings make up the null; 0 leaves it out.
    rng : numpy.random.Generator or int, optional
        Source of the labellings, or its seed; 0 unless given, so that a score can be repeated.
    progress : callable, optional
        Told the share done, from 0 to 1, as the null is made.

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
    a, b = _distances(first), _distances(second)
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise InputError("some distances are not finite; compare only sensors that are placed")
    if a.shape != b.shape:
        raise InputError(f"{len(a)} sensors cannot be compared with {len(b)}; give the same ones")
    n_sensors = len(a)
    if n_sensors < FEWEST_SENSORS:
        raise InputError(f"a Mantel r of {n_sensors} sensors says nothing; it takes at least 4")
    a, b = _standardised(a), _standardised(b)
    null = np.empty(permutations)
    # A null needs no more than float32, and half the memory to gather from is twice the speed.
    a32, b32 = a.astype(np.float32), b.astype(np.float32)
    generator = np.random.default_rng(0 if rng is None else rng)
    report_every = max(1, permutations // 100)
    for i in range(permutations):
        order = generator.permutation(n_sensors)
        null[i] = np.vdot(a32[order].take(order, axis=1), b32) / 2
        if progress is not None and i % report_every == 0:
            progress(i / permutations)
    null.setflags(write=False)
    r = float(np.clip(np.vdot(a, b) / 2, -1, 1))
    return Mantel(r=r, null=null, n_sensors=n_sensors)


def _distances(side: SensorMap | ArrayLike) -> NDArray[np.float64]:
    if isinstance(side, SensorMap):
        return _between(side.positions)
    values = np.asarray(side, dtype=np.float64)
    if values.ndim != 2:
        raise InputError(f"shape {values.shape} is neither positions (N, k) nor distances (N, N)")
    if values.shape[0] != values.shape[1] or values.shape[0] < FEWEST_SENSORS:
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
        raise InputError("all distances are equal, so nothing can be correlated with them")
    return np.asarray(squareform(centred / norm))
