"""Correlations of sensors at lags between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

MAX_LAG = 40
"""Greatest lag that is searched, in frames; chosen by hand."""

_N_PARTNERS = 6  # most similar sensors of each sensor, whose lags are compared


@dataclass(frozen=True, eq=False)
class LagCorrelations:
    """Correlations of all pairs: ``at_lag[l, i, j]`` of i(t) and j(t + l), lags from 0 on."""

    at_lag: NDArray[np.float32]

    @classmethod
    def of(cls, parts: Sequence[NDArray[np.float32]]) -> LagCorrelations:
        """Average over parts of equal length."""
        n_frames, n_sensors = parts[0].shape
        # Zeros between the parts keep the frames of one from those of the next: one product.
        gap = np.zeros((MAX_LAG, n_sensors), dtype=np.float32)
        joined = np.concatenate([block for part in parts for block in (part, gap)])
        result = np.empty((MAX_LAG + 1, n_sensors, n_sensors), dtype=np.float32)
        for lag in range(MAX_LAG + 1):
            np.matmul(joined[: len(joined) - lag].T, joined[lag:], out=result[lag])
            result[lag] /= np.float32(len(parts) * (n_frames - lag))
            np.fill_diagonal(result[lag], -1)
        return cls(result)

    @cached_property
    def _highest(self) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
        peak = self.at_lag[0].copy()
        peak_lag = np.zeros(peak.shape, dtype=np.intp)
        for lag, later in enumerate(self.at_lag[1:], 1):
            for signed, found in ((lag, later), (-lag, later.T)):
                higher = found > peak
                np.copyto(peak, found, where=higher)
                peak_lag[higher] = signed
        return peak, peak_lag

    @property
    def peak(self) -> NDArray[np.float32]:
        """Highest correlation of each pair."""
        return self._highest[0]

    @property
    def peak_lag(self) -> NDArray[np.intp]:
        """Lag of the highest correlation; the smallest of equal ones."""
        return self._highest[1]

    def at(
        self, lags: NDArray[np.intp], i: NDArray[np.intp], j: NDArray[np.intp]
    ) -> NDArray[np.float32]:
        """Return the correlations of some pairs at lags of either sign, up to `MAX_LAG`."""
        apart = np.clip(lags, -MAX_LAG, MAX_LAG)
        later = apart >= 0
        return np.asarray(self.at_lag[np.abs(apart), np.where(later, i, j), np.where(later, j, i)])

    def strongest_links(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return pairs: each sensor and the ones that it is most similar to at any lag."""
        count = min(_N_PARTNERS, len(self.peak) - 1)
        partners = np.argsort(-self.peak, axis=1, kind="stable")[:, :count]
        return np.repeat(np.arange(len(self.peak)), count), partners.ravel()

    def along(
        self, links: tuple[NDArray[np.intp], NDArray[np.intp]], lags: NDArray[np.intp]
    ) -> NDArray[np.float32]:
        """Return the correlation of each link if sensors have the given lags."""
        i, j = links
        return self.at(lags[j] - lags[i], i, j)

    def lags_along_tree(self) -> NDArray[np.intp]:
        """Add up the lags of the links of a maximum spanning tree; Prim's algorithm."""
        peak, lag = self.peak, self.peak_lag
        n_sensors = len(peak)
        outside = np.ones(n_sensors, dtype=bool)
        outside[0] = False
        strongest, towards = peak[0].copy(), np.zeros(n_sensors, dtype=np.intp)
        lags = np.zeros(n_sensors, dtype=np.intp)
        for _ in range(n_sensors - 1):
            new = int(np.where(outside, strongest, -np.inf).argmax())
            lags[new] = lags[towards[new]] + lag[towards[new], new]
            outside[new] = False
            closer = (peak[new] > strongest) & outside
            strongest[closer], towards[closer] = peak[new][closer], new
        return lags - int(np.median(lags))
