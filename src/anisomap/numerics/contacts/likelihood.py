"""Ordinal regression model of readings on the distance from a contact.

Maximum-likelihood location of contacts, and leave-one-out predictions of their readings.

Gauss-Newton steps of the sensors with contacts eliminated, as in bundle adjustment.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator, cg

from anisomap.numerics.contacts.detection import Contacts

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

    thresholds (L,): Increasing; the first is 0.
    softness: Width of the transition between levels, above 0.
    radius, radius_sd: Mean and standard deviation of R over contacts.
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

    inside (M,) -> (M,).

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

    levels, inside (M,), weights (M,).
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


# Levenberg-Marquardt parameters, chosen by hand; lengths in sensor spacings.
_TOLERANCE_LOCALISATION = 1e-5  # largest gain in a log-likelihood at convergence
_INITIAL_DAMPING = 1e-2
_MIN_DAMPING = 1e-6
_PRIOR_PRECISION = 1e-3  # of 1 / softness^2; keeps undetermined centres in place
_MAX_LEVERAGE = 0.8  # of a reading on its contact; bounds leave-one-out steps
_MAX_SHIFT = 1.5  # of a leave-one-out prediction
_MIN_DISTANCE = 1e-6  # keeps directions finite


@dataclass(frozen=True, eq=False)
class LocatedContacts:
    """Contacts at given states, with the derivatives of their log-likelihoods.

    states (E, k + 1): Centre y and radius R of each contact.
    scores (E,): Log-likelihood of each contact's readings and radius.
    gradients (E, k + 1): Gradient of the scores by the states, nearly 0 after `locate`.
    precisions (E, k + 1, k + 1): Negative Hessian of the scores (Gauss-Newton), positive definite.
    inside (M,): Distance of each sensor inside the radius, ``u = R - |p - y|``; negative outside.
    by_axis (k, M): Coordinates of ``(p - y) / |p - y|``.
    slopes, curvatures (M,): Derivatives of the readings' log-likelihoods by u; see
        `level_log_likelihood`.
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

    positions (N, k), states (E, k + 1).
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
        unfinished = np.abs(gain) >= _TOLERANCE_LOCALISATION
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

    Returns (M,).

    One Newton step from the fit to all readings: with the direction n, the contact's precision C
    and ``h = n' C^-1 n``, u becomes ``u - h slope / (1 - h curvature)``.
    """
    inverse = np.linalg.inv(fitted.precisions)[contacts.contact_index]
    n = fitted.directions
    leverage = np.einsum("mi,mij,mj->m", n, inverse, n)
    shift = leverage * fitted.slopes / (1 - np.minimum(leverage * fitted.curvatures, _MAX_LEVERAGE))
    return np.asarray(fitted.inside - np.clip(shift, -_MAX_SHIFT, _MAX_SHIFT))


_DAMPING = 0.01  # of the curvature's diagonal; chosen by hand
_TOLERANCE_BUNDLE_ADJUSTMENT = (
    1e-3  # relative, of conjugate gradients: a step is corrected by the next one
)
_MAX_ITERATIONS_BUNDLE_ADJUSTMENT = 1000  # of conjugate gradients


class ReducedSystem:
    """Gradient and curvature of the total score by the positions, with contacts re-optimised.

    weights (E,): Weight of each contact, at least 0; those of weight 0 are excluded.

    Row m of P is the gradient of u_m by all positions, and row m of Q that by all contacts; h are
    the curvatures, g the slopes, C the contacts' precisions and c their gradients. Second
    derivatives of u are neglected (Gauss-Newton). Eliminating the contacts, with the weight w of
    the contact of each reading, leaves the Schur complement (Triggs et al. 2000, Bundle Adjustment
    - A Modern Synthesis, section 6.1) ::

        gradient   P' w (g - h Q C^-1 c)
        curvature  P' w (h - h Q C^-1 Q' h) P
    """

    def __init__(
        self, contacts: Contacts, located: LocatedContacts, weights: ArrayLike, n_sensors: int
    ) -> None:
        self._located = located
        by_contact = np.asarray(weights, dtype=np.float64)
        self._w = by_contact[contacts.contact_index]
        k = located.states.shape[1] - 1
        self._n_sensors, self._k = n_sensors, k
        self._by_position = _block_rows(-located.directions[:, :k], contacts.sensors, n_sensors)
        self._by_contact = _block_rows(located.directions, contacts.contact_index, len(by_contact))

    @cached_property
    def _inverse(self) -> Matrix:
        return np.asarray(np.linalg.inv(self._located.precisions))

    def _contact_response(self, contact_gradients: Matrix) -> Matrix:
        """``h Q C^-1 c`` for any c of shape (E, k + 1)."""
        steps = np.einsum("eij,ej->ei", self._inverse, contact_gradients)
        return np.asarray(self._located.curvatures * (self._by_contact @ steps.ravel()))

    @property
    def gradient(self) -> Matrix:
        """Gradient of the score by the positions, shape (N k,)."""
        response = self._contact_response(self._located.gradients)
        return np.asarray(self._by_position.T @ (self._w * (self._located.slopes - response)))

    def curvature(self, steps: Matrix) -> Matrix:
        """Multiply the curvature by displacements of all sensors; both of shape (N k,)."""
        along = self._located.curvatures * (self._by_position @ steps.ravel())
        gradients = (self._by_contact.T @ along).reshape(self._located.gradients.shape)
        response = self._contact_response(gradients)
        return np.asarray(self._by_position.T @ (self._w * (along - response)))

    def step(self, deviations: Matrix, *, contact_weight: float, prior_sd: float) -> Matrix:
        """Return the damped Gauss-Newton step of the score plus the prior around the start.

        deviations (N, k) -> (N, k).
        """
        prior_precision = prior_sd**-2
        blocks = self._diagonal_blocks * contact_weight
        damping = _DAMPING * (np.einsum("nii->ni", blocks) + prior_precision).ravel()
        regularised = blocks + np.eye(self._k) * prior_precision
        conditioner = np.linalg.inv(regularised)

        def precondition(steps: Matrix) -> Matrix:
            parts = steps.reshape(self._n_sensors, self._k)
            return np.asarray(np.einsum("nij,nj->ni", conditioner, parts).ravel())

        def multiply(steps: Matrix) -> Matrix:
            flat = steps.ravel()
            return np.asarray(
                contact_weight * self.curvature(flat) + (prior_precision + damping) * flat
            )

        size = self._n_sensors * self._k
        target = contact_weight * self.gradient - prior_precision * deviations.ravel()
        found, _ = cg(
            LinearOperator((size, size), multiply, dtype=np.float64),
            target,
            rtol=_TOLERANCE_BUNDLE_ADJUSTMENT,
            maxiter=_MAX_ITERATIONS_BUNDLE_ADJUSTMENT,
            M=LinearOperator((size, size), precondition, dtype=np.float64),
        )
        return np.asarray(found.reshape(self._n_sensors, self._k))

    @cached_property
    def _diagonal_blocks(self) -> Matrix:
        """Curvature by each position with contacts fixed, shape (N, k, k)."""
        weighted = self._by_position.multiply((self._w * self._located.curvatures)[:, None])
        whole = csr_array(self._by_position.T @ weighted).tocoo()
        blocks = np.zeros((self._n_sensors, self._k, self._k))
        rows, columns = whole.coords
        blocks[rows // self._k, rows % self._k, columns % self._k] = whole.data
        return blocks


def _block_rows(values: Matrix, owners: NDArray[np.intp], n_owners: int) -> csr_array:
    """Place the values of row m in the columns of its owner: (M, q) to (M, n_owners q)."""
    n_rows, width = values.shape
    columns = owners[:, None] * width + np.arange(width)
    ends = np.arange(n_rows + 1) * width
    return csr_array((values.ravel(), columns.ravel(), ends), shape=(n_rows, n_owners * width))
