"""Alignment of a map with the truth: Procrustes analysis with scaling and reflection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.procrustes import Similarity, fit_similarity


@dataclass(frozen=True, eq=False)
class Alignment:
    """The similarity transform that best aligns a configuration with the truth.

    ``aligned = scale * positions @ rotation.T + translation``, in the units of the truth. If
    dimensions differ, the smaller configuration is padded with zeros.

    Attributes
    ----------
    rotation : ndarray of shape (k, k)
        Orthogonal; its determinant is -1 if `reflected`.
    scale : float
        Units of the truth per unit of the map.
    translation : ndarray of shape (k,)
        In units of the truth.
    reflected : bool
        Whether a mirror image fits better. Readings do not determine handedness.
    aligned : ndarray of shape (N, k)
        The map in the frame of the truth.
    errors : ndarray of shape (N,)
        Distance of each sensor from its true position.
    """

    rotation: NDArray[np.float64]
    scale: float
    translation: NDArray[np.float64]
    reflected: bool
    aligned: NDArray[np.float64]
    errors: NDArray[np.float64]

    @property
    def rms(self) -> float:
        """Root mean square of `errors`, in units of the truth."""
        return float(np.sqrt(np.mean(self.errors**2)))

    def apply(self, positions: ArrayLike) -> NDArray[np.float64]:
        """Transform other points of the map, such as sensors without a true position.

        Parameters
        ----------
        positions : array_like of shape (n, k) or fewer columns
            In the frame and units of the map; padded with zeros as the map was.

        Returns
        -------
        ndarray of shape (n, k)
            In the frame and units of the truth; NaN where `positions` are NaN.

        Raises
        ------
        InputError
            If the points have more dimensions than the alignment.
        """
        points = np.array(positions, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] > len(self.translation):
            raise InputError(
                f"positions must have shape (n, k) with k at most {len(self.translation)}, got "
                f"{points.shape}"
            )
        fit = Similarity(self.rotation, self.scale, self.translation)
        return fit.apply(_padded(points, len(self.translation)))


def align(positions: ArrayLike, truth: ArrayLike) -> Alignment:
    """Align a configuration with the truth by rotation, scaling, translation and reflection.

    Parameters
    ----------
    positions, truth : array_like of shape (N, k), (N, l)
        The same sensors in the same order.

    Returns
    -------
    Alignment
        The least-squares optimum (ordinary Procrustes analysis with scaling and reflection).

    Raises
    ------
    InputError
        If the numbers of sensors differ, or a configuration is a single point.

    Notes
    -----
    Schoenemann & Carroll (1970), Psychometrika 35: 245-255. A flat configuration in space equals
    its mirror image and is never reported as reflected.
    """
    x, y = np.array(positions, dtype=np.float64), np.array(truth, dtype=np.float64)
    if x.ndim != 2 or y.ndim != 2 or len(x) != len(y):
        raise InputError(
            f"positions and truth must have the same number of rows, got {x.shape} and {y.shape}"
        )
    dimensions = max(x.shape[1], y.shape[1])
    x, y = _padded(x, dimensions), _padded(y, dimensions)
    if (x == x[0]).all() or (y == y[0]).all():
        raise InputError("all positions coincide, so an alignment is undefined")
    fit = fit_similarity(x, y)
    aligned = fit.apply(x)
    return Alignment(
        rotation=fit.rotation,
        scale=fit.scale,
        translation=fit.translation,
        reflected=fit.reflected,
        aligned=aligned,
        errors=np.linalg.norm(aligned - y, axis=1),
    )


def _padded(points: NDArray[np.float64], dimensions: int) -> NDArray[np.float64]:
    return np.pad(points, ((0, 0), (0, dimensions - points.shape[1])))
