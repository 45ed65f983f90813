"""Ordinal regression model of readings on the distance from a contact."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize

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
    where, per_width = np.asarray(levels), 0.5 / profile.softness
    edges = np.concatenate([[-_FAR], profile.thresholds, [_FAR]]) * per_width
    scaled = np.asarray(inside, dtype=np.float64) * per_width
    # With A = 2 a - 1 = tanh(logit / 2), which takes a fifth of the time of a logistic function.
    at_least = np.tanh(scaled - edges[:-1][where])
    above = np.tanh(scaled - edges[1:][where])
    share, total = _with_outliers((at_least - above) / 2, len(profile.thresholds))
    slope = (at_least + above) * share
    slope *= -per_width
    curvature = np.square(at_least, out=at_least)
    curvature += np.square(above, out=above)
    np.subtract(2, curvature, out=curvature)
    curvature *= share
    curvature *= per_width**2
    return np.log(total, out=total), slope, curvature


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
    readings = ReadingsByLevel.of(
        np.asarray(levels)[used],
        np.asarray(inside, dtype=np.float64)[used],
        counts[used] / counts.sum(),
        len(profile.thresholds),
    )
    steps = np.maximum(np.diff(profile.thresholds), 1e-3 * profile.softness)
    start = np.concatenate([profile.thresholds[:1], np.log(steps), [np.log(profile.softness)]])
    found = minimize(
        negative_log_likelihood,
        start,
        args=(readings,),
        jac=True,
        method="L-BFGS-B",
        bounds=[(None, None), *[_LOG_LENGTHS] * len(steps), _LOG_LENGTHS],
        options={"maxiter": _MAX_ITERATIONS, "ftol": _TOLERANCE},
    )
    thresholds, softness = _unpack(found.x)
    return Profile(thresholds, softness, profile.radius, profile.radius_sd)


@dataclass(frozen=True, eq=False)
class ReadingsByLevel:
    """Distances and weights of readings, one array for each level from 0 on."""

    inside: list[Matrix]
    weights: list[Matrix]

    @classmethod
    def of(cls, levels: Indices, inside: Matrix, weights: Matrix, n_levels: int) -> ReadingsByLevel:
        """Group readings by their levels, from 0 to `n_levels`."""
        order = levels.argsort(kind="stable")
        ends = np.cumsum(np.bincount(levels, minlength=n_levels + 1))[:-1]
        return cls(np.split(inside[order], ends), np.split(weights[order], ends))


def negative_log_likelihood(parameters: Matrix, readings: ReadingsByLevel) -> tuple[float, Matrix]:
    """Return the mean negative log-likelihood and its gradient by the unconstrained parameters.

    The parameters are the first threshold and the logarithms of the further steps and of the
    softness. The weights of the readings add up to 1.
    """
    thresholds, softness = _unpack(parameters)
    n_levels, per_width = len(thresholds), 0.5 / softness
    by_threshold, by_softness, score = np.zeros(n_levels), 0.0, 0.0
    for level, (inside, weights) in enumerate(zip(readings.inside, readings.weights, strict=True)):
        edges = {i: (inside - thresholds[i]) * per_width for i in _bounds(level, n_levels)}
        sides = {i: np.tanh(one) for i, one in edges.items()}
        # Half the difference of 1 below the lowest, and -1 above the highest threshold.
        regular = (sides.get(level - 1, 1.0) - sides.get(level, -1.0)) / 2
        _, total = _with_outliers(np.asarray(regular), n_levels)
        score += float(weights @ np.log(total))
        scale = weights * (0.25 * (1 - OUTLIER_SHARE)) / total
        for i, side in sides.items():
            change = scale * (1 - side * side)
            sign = 1.0 if i == level else -1.0
            by_threshold[i] += sign * float(change.sum())
            by_softness += sign * 2 * float(change @ edges[i])
    by_step = np.cumsum(by_threshold[::-1])[::-1] / softness
    by_step[1:] *= np.exp(parameters[1:-1])
    return -score, -np.append(by_step, by_softness)


def _bounds(level: int, n_levels: int) -> Iterator[int]:
    """Yield the indices of the thresholds below and above a level."""
    if level:
        yield level - 1
    if level < n_levels:
        yield level


def _unpack(parameters: Matrix) -> tuple[Matrix, float]:
    steps = np.append(parameters[0], np.exp(parameters[1:-1]))
    return np.cumsum(steps), float(np.exp(parameters[-1]))


def _with_outliers(within: Matrix, n_levels: int) -> tuple[Matrix, Matrix]:
    """Return the posterior probability that a reading is not an outlier, and its probability.

    Given the probability of its level if it is not an outlier.
    """
    regular = np.maximum(within, _MIN_PROBABILITY)
    regular *= 1 - OUTLIER_SHARE
    total = regular + OUTLIER_SHARE / (n_levels + 1)
    regular /= total
    return regular, total
