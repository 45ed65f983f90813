"""How deep a sensor reads so far from a contact: an ordinal model with few unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.special import expit

Matrix = NDArray[np.float64]
Indices = NDArray[np.intp]

OUTLIERS = 0.02
"""Share of readings that follow no distance at all: every level is as likely."""

_FAR = 1e6  # spacings; beyond all readings, yet finite, so that 0 times it is 0
_NARROWEST = 1e-12
_STEPS = 60


@dataclass(frozen=True, eq=False)
class Profile:
    """How readings fall with the distance from a contact.

    A sensor at p reads by how far it lies inside the reach R of a contact at y,
    ``u = R - |p - y|``: ``P(level >= l) = expit((u - thresholds[l - 1]) / softness)``.

    Attributes
    ----------
    thresholds : ndarray of shape (L,)
        Rising; the first is 0.
    softness : float
    reach, spread : float
        Mean and standard deviation of R over contacts.
    """

    thresholds: Matrix
    softness: float
    reach: float
    spread: float

    def scaled(self, factor: float) -> Profile:
        """Give the same profile in another unit of length."""
        return Profile(
            self.thresholds * factor,
            self.softness * factor,
            self.reach * factor,
            self.spread * factor,
        )


def level_terms(
    levels: ArrayLike, inside: ArrayLike, profile: Profile
) -> tuple[Matrix, Matrix, Matrix]:
    """Score readings, and say how the score changes with the distance.

    Parameters
    ----------
    levels : array_like of int, shape (M,)
    inside : array_like of shape (M,)
        How far u each sensor lies inside the reach of its contact.
    profile : Profile

    Returns
    -------
    score, slope, curvature : ndarray of shape (M,)
        The log probability, its derivative by u, and its Fisher-like curvature, at least 0.

    Notes
    -----
    With ``a = P(level >= l)``, ``b = P(level >= l + 1)`` and the outlier share e, the score is
    ``log((1 - e)(a - b) + e / (L + 1))``. With the probability w that a reading is no outlier,
    its slope is ``w (1 - a - b) / s`` and its curvature ``w (a (1 - a) + b (1 - b)) / s^2``, the
    spread of w over readings left out so that it cannot be negative.
    """
    at_least, above, _, _ = _probabilities(levels, inside, profile.thresholds, profile.softness)
    share, whole = _mixed(at_least, above, len(profile.thresholds))
    slope = share * (1 - at_least - above) / profile.softness
    bend = at_least * (1 - at_least) + above * (1 - above)
    return np.log(whole), slope, share * bend / profile.softness**2


def fit_profile(
    levels: ArrayLike, inside: ArrayLike, weights: ArrayLike, profile: Profile
) -> Profile:
    """Fit thresholds and softness to readings whose distances are known (maximum likelihood).

    Parameters
    ----------
    levels, inside : array_like of shape (M,)
        As for `level_terms`. Distances must not come from fits to the same readings: on 0/1
        readings, the softness would shrink to nothing.
    weights : array_like of shape (M,)
        How much each reading counts, at least 0.
    profile : Profile
        Where to set out from.

    Returns
    -------
    Profile
        Its first threshold need not be 0: it tells by how much all reaches are off.
    """
    counts = np.asarray(weights, dtype=np.float64)
    used = counts > 0
    arguments = (np.asarray(levels)[used], np.asarray(inside)[used], counts[used] / counts.sum())
    steps = np.maximum(np.diff(profile.thresholds), 1e-3 * profile.softness)
    start = np.concatenate([profile.thresholds[:1], np.log(steps), [np.log(profile.softness)]])
    found = minimize(
        _loss, start, args=arguments, jac=True, method="L-BFGS-B", options={"maxiter": _STEPS}
    )
    thresholds, softness = _unpacked(found.x)
    return Profile(thresholds, softness, profile.reach, profile.spread)


def _loss(
    parameters: Matrix, levels: Indices, inside: Matrix, weights: Matrix
) -> tuple[float, Matrix]:
    """Mean negative score; by the first threshold, and logarithms of the steps and the softness."""
    thresholds, softness = _unpacked(parameters)
    n_levels = len(thresholds)
    at_least, above, lower, upper = _probabilities(levels, inside, thresholds, softness)
    _, whole = _mixed(at_least, above, n_levels)
    pull = weights * (1 - OUTLIERS) / whole
    falls, rises = pull * at_least * (1 - at_least), pull * above * (1 - above)
    by_threshold = (
        np.bincount(levels + 1, rises, n_levels + 2) - np.bincount(levels, falls, n_levels + 2)
    )[1:-1] / softness
    by_softness = float(rises @ upper - falls @ lower)
    by_step = np.cumsum(by_threshold[::-1])[::-1]
    by_step[1:] *= np.exp(parameters[1:-1])
    return -float(weights @ np.log(whole)), -np.append(by_step, by_softness)


def _unpacked(parameters: Matrix) -> tuple[Matrix, float]:
    steps = np.append(parameters[0], np.exp(parameters[1:-1]))
    return np.cumsum(steps), float(np.exp(parameters[-1]))


def _probabilities(
    levels: ArrayLike, inside: ArrayLike, thresholds: Matrix, softness: float
) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Give P(level >= l), P(level > l), and what they are the logistic functions of."""
    edges = np.concatenate([[-_FAR], thresholds, [_FAR]])
    where, reached = np.asarray(levels), np.asarray(inside, dtype=np.float64)
    lower, upper = (reached - edges[where]) / softness, (reached - edges[where + 1]) / softness
    return expit(lower), expit(upper), lower, upper


def _mixed(at_least: Matrix, above: Matrix, n_levels: int) -> tuple[Matrix, Matrix]:
    """Give the probability of being no outlier, and of the reading as such."""
    regular = (1 - OUTLIERS) * np.maximum(at_least - above, _NARROWEST)
    whole = regular + OUTLIERS / (n_levels + 1)
    return regular / whole, whole
