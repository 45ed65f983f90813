"""Pose of a patch of sensors on its link, from places where it was touched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.numerics.procrustes import (
    SINGULAR,
    Similarity,
    fit_similarity,
    fit_similarity_robustly,
    noise_scale,
)

MIN_PLACES = 6
"""Fewest places: twice the three that determine a pose, so that a wrong one is outvoted."""

_PARAMETERS = 6  # of a pose
FAR = 4.0
"""Noise scales beyond which a place is wrong: 1 in 900 of normal errors in space."""


@dataclass(frozen=True, eq=False)
class PatchPose:
    """A transform from the frame of a patch to that of its link.

    Attributes
    ----------
    similarity : Similarity
        Rigid.
    used : ndarray of bool, shape (C,)
        False for places that contradict the others.
    residuals : ndarray of shape (C,)
        Distances between the two places of each contact, in units of the link.
    sigma : float
        Standard deviation of a coordinate of the places that were used.
    covariance : ndarray of shape (6, 6)
        Of a rotation vector about `centre` and a shift.
    centre : ndarray of shape (3,)
        In the frame of the link.
    """

    similarity: Similarity
    used: NDArray[np.bool_]
    residuals: NDArray[np.float64]
    sigma: float
    covariance: NDArray[np.float64]
    centre: NDArray[np.float64]

    @property
    def freedom(self) -> int:
        """Degrees of freedom of `sigma`."""
        return 3 * int(self.used.sum()) - _PARAMETERS

    def position_covariances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariances of points of the link, shape (n, 3), due to that of the pose.

        The result has the shape (n, 3, 3).
        """
        slopes = _derivatives(points - self.centre)
        return np.asarray(np.einsum("nip,pq,njq->nij", slopes, self.covariance, slopes))


def fit_patch_pose(places: NDArray[np.float64], targets: NDArray[np.float64]) -> PatchPose:
    """Fit the pose of a rigid patch to where it was touched.

    Parameters
    ----------
    places : ndarray of shape (C, 3)
        Centres of contacts in the frame of the patch.
    targets : ndarray of shape (C, 3)
        The same points in the frame of the link.

    Returns
    -------
    PatchPose

    Raises
    ------
    InputError
        If there are fewer than `MIN_PLACES`, or those that agree lie on a line.

    Notes
    -----
    Least squares of a pose have a closed form (Umeyama 1991), so for given weights the global
    minimum is found. Weights are those of `fit_similarity_robustly`; then wrong places are left out
    and the others count alike. The covariance is that of linear least squares at the minimum.
    """
    if len(places) < MIN_PLACES:
        raise InputError(
            f"a pose needs at least {MIN_PLACES} contacts between the patches, got {len(places)}"
        )
    robust = fit_similarity_robustly(places, targets, scaling=False, reflection=False)
    off = np.linalg.norm(robust.apply(places) - targets, axis=1)
    # Rounding errors of exact places must not exclude any.
    least = SINGULAR * float(np.ptp(targets))
    used = off <= FAR * max(noise_scale(off, 3), least)
    x, y = places[used], targets[used]
    widths = np.linalg.svd(x - x.mean(axis=0), compute_uv=False)
    if len(x) < MIN_PLACES or widths[1] <= SINGULAR * widths[0]:
        raise InputError(
            f"the pose is not determined: the {len(x)} contacts that agree are fewer than "
            f"{MIN_PLACES} or lie on a line of the patch; touch more of it, in other postures"
        )
    fit = fit_similarity(x, y, scaling=False, reflection=False)
    placed = fit.apply(x)
    centre = placed.mean(axis=0)
    slopes = _derivatives(placed - centre).reshape(-1, _PARAMETERS)
    errors = (placed - y).ravel()
    sigma = float(np.sqrt(errors @ errors / (len(errors) - _PARAMETERS)))
    return PatchPose(
        similarity=fit,
        used=used,
        residuals=np.linalg.norm(fit.apply(places) - targets, axis=1),
        sigma=sigma,
        covariance=np.asarray(sigma**2 * np.linalg.inv(slopes.T @ slopes), dtype=np.float64),
        centre=centre,
    )


def _derivatives(arms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the derivatives of points by rotation vector and shift, shape (n, 3, 6)."""
    found = np.zeros((len(arms), 3, _PARAMETERS))
    for i, axis in enumerate(np.eye(3)):
        found[:, :, i] = np.cross(axis, arms)
        found[:, i, 3 + i] = 1.0
    return found
