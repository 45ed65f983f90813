"""Maximum-likelihood location of contacts, and leave-one-out predictions of their readings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.contacts.detection import Contacts
from anisomap.numerics.contacts.profile import Profile, level_log_likelihood

Matrix = NDArray[np.float64]

# Levenberg-Marquardt parameters, chosen by hand; lengths in sensor spacings.
_TOLERANCE = 1e-5  # largest gain in a log-likelihood at convergence
_INITIAL_DAMPING = 1e-2
_MIN_DAMPING = 1e-6
_PRIOR_PRECISION = 1e-3  # of 1 / softness^2; keeps undetermined centres in place
_MAX_LEVERAGE = 0.8  # of a reading on its contact; bounds leave-one-out steps
_MAX_SHIFT = 1.5  # of a leave-one-out prediction
_MIN_DISTANCE = 1e-6  # keeps directions finite


@dataclass(frozen=True, eq=False)
class LocatedContacts:
    """Contacts at given states, with the derivatives of their log-likelihoods.

    Attributes
    ----------
    states : ndarray of shape (E, k + 1)
        Centre y and radius R of each contact.
    scores : ndarray of shape (E,)
        Log-likelihood of each contact's readings and radius.
    gradients : ndarray of shape (E, k + 1)
        Gradient of the scores by the states, nearly 0 after `locate`.
    precisions : ndarray of shape (E, k + 1, k + 1)
        Negative Hessian of the scores (Gauss-Newton), positive definite.
    inside : ndarray of shape (M,)
        Distance of each sensor inside the radius, ``u = R - |p - y|``; negative outside.
    by_axis : ndarray of shape (k, M)
        Coordinates of ``(p - y) / |p - y|``.
    slopes, curvatures : ndarray of shape (M,)
        Derivatives of the readings' log-likelihoods by u; see `level_log_likelihood`.
    """

    states: Matrix
    scores: Matrix
    gradients: Matrix
    precisions: Matrix
    inside: Matrix
    by_axis: Matrix
    slopes: Matrix
    curvatures: Matrix

    @cached_property
    def directions(self) -> Matrix:
        """Gradient of u by the state, ``((p - y) / |p - y|, 1)``, shape (M, k + 1).

        The negative of its first k components is the gradient by p.
        """
        return np.stack([*self.by_axis, np.ones(len(self.inside))], axis=1)


def evaluate(
    contacts: Contacts, positions: Matrix, states: Matrix, profile: Profile
) -> LocatedContacts:
    """Evaluate the log-likelihoods of contacts at given states, and their derivatives."""
    k = positions.shape[1]
    # Rows of contiguous numbers, one for each coordinate: sums over them take a third of the time.
    by_axis = np.empty((k, len(contacts.sensors)))
    for i, (given, centres) in enumerate(zip(positions.T, states.T[:k], strict=True)):
        by_axis[i] = np.take(np.ascontiguousarray(given), contacts.sensors)
        by_axis[i] -= np.take(np.ascontiguousarray(centres), contacts.contact_index)
    distances = np.sqrt(np.einsum("km,km->m", by_axis, by_axis) + _MIN_DISTANCE**2)
    by_axis /= distances
    inside = np.take(np.ascontiguousarray(states[:, k]), contacts.contact_index) - distances
    score, slopes, curvatures = level_log_likelihood(contacts.levels, inside, profile)
    deviations = (states[:, k] - profile.radius) / profile.radius_sd
    gradients = np.empty(states.shape)
    precisions = np.empty((len(states), k + 1, k + 1))
    gradients[:, k] = contacts.total(slopes) - deviations / profile.radius_sd
    precisions[:, k, k] = contacts.total(curvatures)
    for i, one in enumerate(by_axis):
        gradients[:, i] = contacts.total(slopes * one)
        weighted = curvatures * one
        precisions[:, i, k] = precisions[:, k, i] = contacts.total(weighted)
        for j, other in enumerate(by_axis[: i + 1]):
            precisions[:, i, j] = precisions[:, j, i] = contacts.total(weighted * other)
    prior = np.append(np.full(k, _PRIOR_PRECISION / profile.softness**2), profile.radius_sd**-2)
    precisions += np.diag(prior)
    scores = contacts.total(score) - deviations**2 / 2
    return LocatedContacts(
        states, scores, gradients, precisions, inside, by_axis, slopes, curvatures
    )


def locate(
    contacts: Contacts, positions: Matrix, states: Matrix, profile: Profile, *, steps: int = 12
) -> LocatedContacts:
    """Maximise the likelihood of each contact separately (Levenberg-Marquardt).

    Parameters
    ----------
    contacts : Contacts
    positions : ndarray of shape (N, k)
    states : ndarray of shape (E, k + 1)
        Initial states.
    profile : Profile
    steps : int
        Maximum number of steps.

    Returns
    -------
    LocatedContacts
        No score is lower than at the initial state.
    """
    states = states.copy()
    moving, subset = np.arange(len(states)), contacts
    damping = np.full(len(states), _INITIAL_DAMPING)
    scores, gradients, precisions = _derivatives(evaluate(contacts, positions, states, profile))
    diagonal = np.arange(states.shape[1])
    for _ in range(steps):
        damped = precisions.copy()
        damped[:, diagonal, diagonal] *= 1 + damping[:, None]
        shifted = states[moving] + np.linalg.solve(damped, gradients[:, :, None])[:, :, 0]
        trial = _derivatives(evaluate(subset, positions, shifted, profile))
        gain = trial[0] - scores
        better = gain > 0
        states[moving[better]] = shifted[better]
        for current, tried in zip((scores, gradients, precisions), trial, strict=True):
            current[better] = tried[better]
        damping = np.where(better, np.maximum(damping / 5, _MIN_DAMPING), damping * 6)
        unfinished = np.abs(gain) >= _TOLERANCE
        if not unfinished.any():
            break
        moving, damping, subset = moving[unfinished], damping[unfinished], subset.select(unfinished)
        scores, gradients = scores[unfinished], gradients[unfinished]
        precisions = precisions[unfinished]
    return evaluate(contacts, positions, states, profile)


def _derivatives(located: LocatedContacts) -> tuple[Matrix, Matrix, Matrix]:
    return located.scores, located.gradients, located.precisions


def leave_one_out(contacts: Contacts, fitted: LocatedContacts) -> Matrix:
    """Predict the distance inside of each sensor without its reading in the contact's fit.

    Parameters
    ----------
    contacts : Contacts
    fitted : LocatedContacts

    Returns
    -------
    ndarray of shape (M,)
        See `LocatedContacts.inside`.

    Notes
    -----
    One Newton step from the fit to all readings: with the direction n, the contact's precision C
    and ``h = n' C^-1 n``, u becomes ``u - h slope / (1 - h curvature)``.
    """
    inverse = np.linalg.inv(fitted.precisions)[contacts.contact_index]
    n = fitted.directions
    leverage = np.einsum("mi,mij,mj->m", n, inverse, n)
    shift = leverage * fitted.slopes / (1 - np.minimum(leverage * fitted.curvatures, _MAX_LEVERAGE))
    return np.asarray(fitted.inside - np.clip(shift, -_MAX_SHIFT, _MAX_SHIFT))
