"""Laying a map onto the truth: similarity Procrustes analysis, mirror images included."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError

_SINGULAR = 1e-9


@dataclass(frozen=True, eq=False)
class Alignment:
    """The similarity transform that lays a configuration best onto the truth.

    ``aligned = scale * positions @ rotation.T + translation``, in the units of the truth. Where
    the two have different numbers of dimensions, the smaller is padded with zeros first.

    Attributes
    ----------
    rotation : ndarray of shape (k, k)
        Orthogonal; its determinant is -1 if `reflected`.
    scale : float
        Units of the truth per unit of the map.
    translation : ndarray of shape (k,)
        In units of the truth.
    reflected : bool
        Whether a mirror image fits better. Readings alone cannot tell left from right.
    aligned : ndarray of shape (N, k)
        The map in the frame of the truth.
    errors : ndarray of shape (N,)
        Distance of every sensor from its true place.
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


def align(positions: ArrayLike, truth: ArrayLike) -> Alignment:
    """Lay a configuration onto the truth by rotation, scale, translation and mirror image.

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
    Schoenemann & Carroll (1970), Psychometrika 35: 245-255. A flat configuration is its own
    mirror image in space; it is never called reflected there.
    """
    x, y = np.array(positions, dtype=np.float64), np.array(truth, dtype=np.float64)
    if x.ndim != 2 or y.ndim != 2 or len(x) != len(y):
        raise InputError(f"positions of shapes {x.shape} and {y.shape} are not of the same sensors")
    dimensions = max(x.shape[1], y.shape[1])
    x, y = _padded(x, dimensions), _padded(y, dimensions)
    x_mean, y_mean = x.mean(axis=0), y.mean(axis=0)
    x_centred, y_centred = x - x_mean, y - y_mean
    spread = float(np.vdot(x_centred, x_centred))
    if spread == 0 or not y_centred.any():
        raise InputError("all positions coincide, so nothing can be aligned with them")
    left, singular, right = np.linalg.svd(y_centred.T @ x_centred)
    if np.linalg.det(left @ right) < 0 and singular[-1] <= _SINGULAR * singular[0]:
        left[:, -1] *= -1  # flat: the mirrored and the turned fit are equally good, so turn
    rotation = left @ right
    scale = float(singular @ np.diag(left.T @ rotation @ right.T) / spread)
    translation = y_mean - scale * rotation @ x_mean
    aligned = scale * x @ rotation.T + translation
    return Alignment(
        rotation=rotation,
        scale=scale,
        translation=translation,
        reflected=bool(np.linalg.det(rotation) < 0),
        aligned=aligned,
        errors=np.linalg.norm(aligned - y, axis=1),
    )


def _padded(points: NDArray[np.float64], dimensions: int) -> NDArray[np.float64]:
    return np.pad(points, ((0, 0), (0, dimensions - points.shape[1])))
