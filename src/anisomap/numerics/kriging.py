"""Smooth vector fields interpolated from noisy values at points, with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist


@dataclass(frozen=True)
class Kernel:
    """Covariance of a field of unit variance, and of its noise.

    reach: Length over which the field changes, in units of the points.
    noise: Variance of the noise, relative to that of the field, above 0.
    """

    reach: float
    noise: float

    def between(self, a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariance of the field at points, shape (len(a), len(b)): Matern 3/2."""
        scaled = np.sqrt(3.0) * cdist(a, b) / self.reach
        return np.asarray((1.0 + scaled) * np.exp(-scaled))


def predict_field(
    points: NDArray[np.float64],
    values: NDArray[np.float64],
    where: NDArray[np.float64],
    kernel: Kernel,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Predict a field of mean 0 by simple kriging (Rasmussen & Williams 2006, eq. 2.25 and 2.26).

    Far from all points the prediction is 0, so a correction by the field does no harm there.

    points (n, k), values (n, l), where (m, k) -> values (m, l), variances (m,).
    """
    covariance = kernel.between(points, points)
    covariance[np.diag_indices_from(covariance)] += kernel.noise
    factor = cho_factor(covariance)
    across = kernel.between(where, points)
    found = across @ cho_solve(factor, values)
    explained = np.einsum("mn,nm->m", across, cho_solve(factor, across.T))
    return np.asarray(found), np.clip(1.0 - explained, 0.0, 1.0)
