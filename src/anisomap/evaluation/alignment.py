"""Alignment of a map with the truth: Procrustes analysis with scaling and reflection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError

_SINGULAR = 1e-9  # relative singular value below which a configuration is flat


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
    x_mean, y_mean = x.mean(axis=0), y.mean(axis=0)
    x_centred, y_centred = x - x_mean, y - y_mean
    spread = float(np.vdot(x_centred, x_centred))
    if spread == 0 or not y_centred.any():
        raise InputError("all positions coincide, so an alignment is undefined")
    left, singular, right = np.linalg.svd(y_centred.T @ x_centred)
    if np.linalg.det(left @ right) < 0 and singular[-1] <= _SINGULAR * singular[0]:
        left[:, -1] *= -1  # flat: reflection and rotation fit equally well; prefer the rotation
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
