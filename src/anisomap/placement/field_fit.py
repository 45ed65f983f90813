"""A similarity and a smooth field of corrections, fitted to anchors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.kriging import Kernel
from anisomap.numerics.procrustes import Similarity, fit_similarity

PRIOR_FREEDOM = 4.0
"""Degrees of freedom of the prior of the variance of a map (a scaled inverse chi-squared).

The logarithm of the error of the even maps of `ERROR_EVEN` had a standard deviation of .46; with 4
degrees of freedom it is .40.
"""

# RMS error of a coordinate relative to the size of a map, the root of the summed variance of its
# coordinates. Errors grow with the size of a map more than with its spacing. Medians over 62 maps
# that are not marked as distorted (`SensorMap.uneven`): the iCub hexagon, palm and torso, and
# simulated bodies rubbed, struck and rolled, seeds 201 to 203 and 211; and over those that are: the
# maps of four recordings, plantar, Nao's head and torso, and insole.
ERROR_EVEN, ERROR_UNEVEN = 0.06, 0.25


@dataclass(frozen=True)
class Known:
    """What is known of a map before anchors are used.

    Parameters
    ----------
    spacing : float
        Distance between neighbouring sensors on the map.
    size : float
        Root of the summed variance of the coordinates of the map.
    uneven : bool
        Whether the map is known to be distorted: `SensorMap.uneven`.
    scale_sigma : float
        Standard deviation of the logarithm of the scale; inf if the scale is unknown.
    evidence : float
        Log likelihood ratio of the handedness of the map against its mirror image.
    handedness : bool, optional
        Whether the map is a mirror image, if the user states it.
    """

    spacing: float
    size: float
    uneven: bool = False
    scale_sigma: float = np.inf
    evidence: float = 0.0
    handedness: bool | None = None

    @property
    def sigma(self) -> float:
        """Standard deviation of a coordinate of the map, as assumed before anchors are used."""
        return (ERROR_UNEVEN if self.uneven else ERROR_EVEN) * self.size


def fit_scaled(
    x: NDArray[np.float64], y: NDArray[np.float64], known: Known, reflected: bool
) -> Similarity:
    """Fit a similarity of given handedness; its scale is weighted with what is known of it.

    Parameters
    ----------
    x, y : ndarray of shape (n, k)
        Anchors on the map and on the robot.
    known : Known
    reflected : bool
        Whether the similarity reflects the map.

    Returns
    -------
    Similarity
        From `x` to `y`.
    """
    free = fit_similarity(x, y, reflection=reflected)
    if not np.isfinite(known.scale_sigma):
        return free
    sigma = known.sigma / float(np.sqrt(np.sum((x - x.mean(axis=0)) ** 2)))
    weight = known.scale_sigma**2 / (known.scale_sigma**2 + sigma**2)
    scale = float(np.exp(weight * np.log(max(free.scale, np.finfo(float).tiny))))
    rigid = fit_similarity(scale * x, y, scaling=False, reflection=reflected)
    return Similarity(rigid.rotation, scale, rigid.translation)


def field_kernel(placed: NDArray[np.float64], reach: float, noise: float) -> Kernel:
    """Return the covariance of a field of which the reach is given in sizes of a placed map."""
    size = float(np.sqrt(np.sum(np.var(placed, axis=0))))
    return Kernel(max(reach * size, float(np.finfo(float).tiny)), noise)


@dataclass(frozen=True, eq=False)
class Kriged:
    """Predicted positions.

    Attributes
    ----------
    positions : ndarray of shape (m, k)
        In the frame of the anchors.
    relative : ndarray of shape (m,)
        Variances of a coordinate relative to that of the map.
    squares : float
        Weighted sum of squares of the residuals of the anchors; its expectation is the variance of
        the map times the degrees of freedom.
    """

    positions: NDArray[np.float64]
    relative: NDArray[np.float64]
    squares: float


def krige(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    positions: NDArray[np.float64],
    fit: Similarity,
    known: Known,
    *,
    kernel: Kernel,
    validated: bool = False,
) -> Kriged:
    """Predict positions by universal kriging, with small changes of a similarity as the drift.

    Parameters
    ----------
    x, y : ndarray of shape (n, k)
        Anchors on the map and on the robot.
    positions : ndarray of shape (m, k)
        The map where it is predicted.
    fit : Similarity
        Of the anchors, from `fit_scaled`.
    known : Known
    kernel : Kernel
        Covariance of the field of corrections, in the frame of the anchors.
    validated : bool
        Whether anchors that were left out have shown that the field predicts better; then the
        field makes the variances smaller.

    Returns
    -------
    Kriged

    Notes
    -----
    Chiles & Delfiner (2012), Geostatistics, section 3.4.
    """
    anchors, placed = fit.apply(x), fit.apply(positions)
    centre, k = anchors.mean(axis=0), anchors.shape[1]
    size = float(np.sqrt(np.mean(np.sum((anchors - centre) ** 2, axis=1))))
    here, there = (_derivatives((points - centre) / size) for points in (anchors, placed))
    covariance = kernel.between(anchors, anchors)
    covariance[np.diag_indices_from(covariance)] += kernel.noise
    inverse = np.linalg.inv(covariance)
    across = kernel.between(placed, anchors)
    weights = across @ inverse
    total = 1.0 + kernel.noise
    information = np.einsum("nki,nm,mkj->ij", here, inverse, here)
    residual = y - anchors
    wanted = np.einsum("nki,nm,mk->i", here, inverse, residual)
    if np.isfinite(known.scale_sigma):
        # The last parameter is the change of the scale, of which `known` has prior knowledge.
        sigma = known.sigma * fit.scale / np.sqrt(total)
        precision = (sigma / (size * max(known.scale_sigma, np.finfo(float).eps))) ** 2
        information[-1, -1] += precision
        wanted[-1] -= precision * size * np.log(fit.scale)
    spread = np.linalg.pinv(information, rcond=1e-9)
    drift = spread @ wanted
    rest = residual - here @ drift
    # Without validation, errors are those of a similarity whose errors are independent: a wrong
    # field must not make them smaller.
    even = np.linalg.pinv(np.einsum("nki,nkj->ij", here, here), rcond=1e-9)
    relative = 1.0 + np.einsum("mki,ij,mkj->m", there, even, there) / k
    if validated:
        relative -= np.einsum("mn,mn->m", weights, across) / total
    return Kriged(
        placed + there @ drift + weights @ rest,
        np.maximum(relative, 0.0),
        float(total * np.einsum("nk,nm,mk->", rest, inverse, rest)),
    )


def _derivatives(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return derivatives of points by shift, rotation and scale of a similarity, (n, k, p)."""
    n, k = points.shape
    shift = np.tile(np.eye(k), (n, 1, 1))
    turns = []
    for i in range(k):
        for j in range(i):
            turn = np.zeros((n, k, 1))
            turn[:, i, 0], turn[:, j, 0] = points[:, j], -points[:, i]
            turns.append(turn)
    return np.concatenate([shift, *turns, points[:, :, None]], axis=2)
