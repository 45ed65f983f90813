"""Ordinal regression model of readings on the distance from a contact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.special import expit

Matrix = NDArray[np.float64]
Indices = NDArray[np.intp]

OUTLIER_SHARE = 0.02
"""Share of readings that are independent of distance, uniform over levels; chosen by hand."""

_FAR = 1e6  # spacings; effectively infinite, but 0 times it is 0
_MIN_PROBABILITY = 1e-12
_LOG_LENGTHS = (-20.0, 10.0)  # bounds of fitted lengths: far below and above any skin, and finite
_MAX_ITERATIONS = 60  # of L-BFGS, for about ten parameters
_TOLERANCE = 1e-6  # relative, of the negative log-likelihood; each fit starts from the last one


@dataclass(frozen=True, eq=False)
class Profile:
    """Distribution of levels given the distance from a contact.

    The level of a sensor at p depends on its distance inside the radius R of a contact at y,
    ``u = R - |p - y|``: ``P(level >= l) = expit((u - thresholds[l - 1]) / softness)``. All lengths
    are in sensor spacings.

    Attributes
    ----------
    thresholds : ndarray of shape (L,)
        Increasing; the first is 0.
    softness : float
        Width of the transition between levels, above 0.
    radius, radius_sd : float
        Mean and standard deviation of R over contacts.
    """

    thresholds: Matrix
    softness: float
    radius: float
    radius_sd: float

    def scaled(self, factor: float) -> Profile:
        """Return the profile with all lengths multiplied by a factor."""
        return Profile(
            self.thresholds * factor,
            self.softness * factor,
            self.radius * factor,
            self.radius_sd * factor,
        )


def level_log_likelihood(
    levels: ArrayLike, inside: ArrayLike, profile: Profile
) -> tuple[Matrix, Matrix, Matrix]:
    """Return the log-likelihood of levels, and its derivatives by the distance.

    Parameters
    ----------
    levels : array_like of int, shape (M,)
    inside : array_like of shape (M,)
        Distance u of each sensor inside the radius of its contact.
    profile : Profile

    Returns
    -------
    score, slope, curvature : ndarray of shape (M,)
        Log-likelihood, its derivative by u, and a Fisher-like curvature, at least 0.

    Notes
    -----
    With ``a = P(level >= l)``, ``b = P(level >= l + 1)`` and the outlier share e, the score is
    ``log((1 - e)(a - b) + e / (L + 1))``. With the probability w that a reading is no outlier,
    its slope is ``w (1 - a - b) / s`` and its curvature ``w (a (1 - a) + b (1 - b)) / s^2``; the
    derivative of w is omitted, so that the curvature is never negative.
    """
    at_least, above, _, _ = _probabilities(levels, inside, profile.thresholds, profile.softness)
    share, total = _with_outliers(at_least, above, len(profile.thresholds))
    slope = share * (1 - at_least - above) / profile.softness
    bend = at_least * (1 - at_least) + above * (1 - above)
    return np.log(total), slope, share * bend / profile.softness**2


def fit_profile(
    levels: ArrayLike, inside: ArrayLike, weights: ArrayLike, profile: Profile
) -> Profile:
    """Fit thresholds and softness to readings at known distances (maximum likelihood).

    Parameters
    ----------
    levels, inside : array_like of shape (M,)
        As for `level_log_likelihood`. Distances must not come from fits to the same readings:
        with binary readings, the softness would shrink to 0.
    weights : array_like of shape (M,)
        Weight of each reading, at least 0.
    profile : Profile
        Initial parameters.

    Returns
    -------
    Profile
        Its first threshold is the common error of all radii, not 0.
    """
    counts = np.asarray(weights, dtype=np.float64)
    used = counts > 0
    arguments = (np.asarray(levels)[used], np.asarray(inside)[used], counts[used] / counts.sum())
    steps = np.maximum(np.diff(profile.thresholds), 1e-3 * profile.softness)
    start = np.concatenate([profile.thresholds[:1], np.log(steps), [np.log(profile.softness)]])
    found = minimize(
        negative_log_likelihood,
        start,
        args=arguments,
        jac=True,
        method="L-BFGS-B",
        bounds=[(None, None), *[_LOG_LENGTHS] * len(steps), _LOG_LENGTHS],
        options={"maxiter": _MAX_ITERATIONS, "ftol": _TOLERANCE},
    )
    thresholds, softness = _unpack(found.x)
    return Profile(thresholds, softness, profile.radius, profile.radius_sd)


def negative_log_likelihood(
    parameters: Matrix, levels: Indices, inside: Matrix, weights: Matrix
) -> tuple[float, Matrix]:
    """Return the mean negative log-likelihood and its gradient by the unconstrained parameters.

    The parameters are the first threshold and the logarithms of the further steps and of the
    softness.
    """
    thresholds, softness = _unpack(parameters)
    n_levels = len(thresholds)
    at_least, above, lower, upper = _probabilities(levels, inside, thresholds, softness)
    _, total = _with_outliers(at_least, above, n_levels)
    scale = weights * (1 - OUTLIER_SHARE) / total
    falls, rises = scale * at_least * (1 - at_least), scale * above * (1 - above)
    by_threshold = (
        np.bincount(levels + 1, rises, n_levels + 2) - np.bincount(levels, falls, n_levels + 2)
    )[1:-1] / softness
    by_softness = float(rises @ upper - falls @ lower)
    by_step = np.cumsum(by_threshold[::-1])[::-1]
    by_step[1:] *= np.exp(parameters[1:-1])
    return -float(weights @ np.log(total)), -np.append(by_step, by_softness)


def _unpack(parameters: Matrix) -> tuple[Matrix, float]:
    steps = np.append(parameters[0], np.exp(parameters[1:-1]))
    return np.cumsum(steps), float(np.exp(parameters[-1]))


def _probabilities(
    levels: ArrayLike, inside: ArrayLike, thresholds: Matrix, softness: float
) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Return P(level >= l), P(level > l), and their logits."""
    edges = np.concatenate([[-_FAR], thresholds, [_FAR]])
    where, u = np.asarray(levels), np.asarray(inside, dtype=np.float64)
    lower, upper = (u - edges[where]) / softness, (u - edges[where + 1]) / softness
    return expit(lower), expit(upper), lower, upper


def _with_outliers(at_least: Matrix, above: Matrix, n_levels: int) -> tuple[Matrix, Matrix]:
    """Return the posterior probability that a reading is not an outlier, and its probability."""
    regular = (1 - OUTLIER_SHARE) * np.maximum(at_least - above, _MIN_PROBABILITY)
    total = regular + OUTLIER_SHARE / (n_levels + 1)
    return regular / total, total
