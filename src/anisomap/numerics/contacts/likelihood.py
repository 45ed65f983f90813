"""Contacts in readings, and their likelihood given the positions of sensors and the profile."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.sparse import bsr_array, csr_array, eye_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import LinearOperator, cg
from scipy.spatial.distance import cdist

from anisomap.numerics.graph.neighbour_graphs import greatest_of_rows
from anisomap.numerics.neighbours import spanning_tree
from anisomap.numerics.precision import Floats, Reals
from anisomap.numerics.similarity.rest import Rest, estimate_rest

Indices = NDArray[np.intp]

_MIN_DEPTH = 0.02  # of a sensor's range; readings below are at rest
_RANGE_QUANTILE = 0.998  # of all readings; excludes glitches
_MIN_TOUCHES = 5  # readings above rest, for an estimate of the gain
_SAMPLED_FRAMES = 500  # in which readings above rest are counted

# Lengths are in median distances of neighbours on the map.
_N_NEIGHBOURS = 6  # as on a triangular lattice
_MAX_LINK = 2.5  # longer links are kept only in the spanning tree
_REACH = 2.2  # nearer peaks belong to one contact, and nearer sensors at rest bound it
_MIN_RATIO = 1.3  # distance to the second nearest peak over the nearest; ambiguous below
_MAX_TOUCHED = 0.7  # of all sensors; above it a posture or a fault
_MIN_AT_REST = 2  # sensors at rest around a contact, which bound it


@dataclass(frozen=True, eq=False)
class Levels:
    """Readings of some frames as levels, from 0 at rest to `max_level` under the deepest contact.

    values (F, N): Of frames at even intervals.
    max_level: At least 1; each level up to it occurs.
    at_rest: Share of readings within the noise of their sensor's rest.
    gains (N,): Gain of each sensor relative to the median.
    """

    values: NDArray[np.int8]
    max_level: int
    at_rest: float
    gains: Floats


@dataclass(frozen=True, eq=False)
class Contacts:
    """E contacts and their M readings.

    sensors, levels (M,): Of the readings, ordered by contact; 0 for sensors at rest beside it.
    owners (M,): Contact of each reading.
    starts (E,): First reading of each contact.
    max_level: Highest possible level.
    """

    sensors: Indices
    levels: Indices
    owners: Indices
    starts: Indices
    max_level: int

    @cached_property
    def counts(self) -> Indices:
        """Number of readings of each contact, (E,)."""
        return np.diff(self.starts, append=len(self.sensors))

    def spread(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the value of the contact of each reading, (..., E) -> (..., M)."""
        # Indices, such as `owners`, take several times as long.
        return np.repeat(values, self.counts, axis=-1)


def assign_levels(
    readings: ArrayLike,
    n_levels: int,
    *,
    max_gain_spread: float,
    max_touches: float = np.inf,
    rest: Rest | None = None,
) -> Levels:
    """Quantise readings (T, N) above rest into at most `n_levels` levels of about equal counts.

    Of so many frames that about `max_touches` readings are above rest. Sensors whose log gains
    spread by more than `max_gain_spread` are divided by them: 0.9 quantiles of readings above rest.
    """
    values = np.asarray(readings)
    rest = estimate_rest(values) if rest is None else rest
    n_frames, n_sensors = values.shape
    sample = rest.depth(values[:: max(1, n_frames // _SAMPLED_FRAMES)])
    touches = n_frames * n_sensors * np.mean(sample > _MIN_DEPTH * np.median(sample.max(axis=0)))
    values = values[:: max(1, round(touches / max_touches))]
    near = np.maximum(rest.threshold, _MIN_DEPTH * np.ptp(values, axis=0))
    at_rest = float((np.abs(values - rest.value) <= near).mean())
    depths = rest.depth(values)
    ordered = np.sort(depths, axis=0)
    extents = ordered[int(_RANGE_QUANTILE * (len(ordered) - 1))]
    extents = np.where(extents > 0, extents, ordered[-1])
    counts = (depths > _MIN_DEPTH * extents).sum(axis=0)
    gains = ordered[len(ordered) - 1 - counts // 10, np.arange(n_sensors)]
    touched = counts > _MIN_TOUCHES
    typical = np.median(gains[touched]) if touched.any() else 1.0
    gains = np.where(touched, gains / typical, 1.0)
    if np.log(gains).std() > max_gain_spread:
        depths /= gains
        extents = extents / gains
    pressed = depths > _MIN_DEPTH * np.median(extents)
    heights = depths[pressed]
    edges = heights
    if heights.size:
        edges = np.unique(np.quantile(heights, np.arange(1, n_levels) / n_levels))
        edges = edges[edges < heights.max()]
    levels = np.zeros(depths.shape, dtype=np.int8)
    levels[pressed] = 1 + np.searchsorted(edges, heights, side="left")
    return Levels(levels, len(edges) + 1, at_rest, gains)


def find_contacts(levels: Levels, positions: ArrayLike, *, min_sensors: int) -> Contacts | None:
    """Find patches of touched neighbours, and split those with several peaks. positions (N, k).

    A sensor belongs to the nearest peak of its patch, unless others are about as near.
    """
    n_sensors = levels.values.shape[1]
    n_touched = np.count_nonzero(levels.values, axis=1)
    usable = (n_touched >= min_sensors) & (n_touched <= _MAX_TOUCHED * n_sensors)
    values = levels.values[usable]
    rows, sensors = np.nonzero(values)
    n_touches = len(rows)
    if not n_touches:
        return None
    distances, neighbours, link = _neighbourhood(np.asarray(positions, dtype=np.float64))
    # Breaks ties between sensors of equal height, independently of their order.
    uneven = 1e-6 * distances.mean(axis=1) / distances.mean()
    smoothing = neighbours + 2 * eye_array(n_sensors)
    smoothed = (smoothing @ values.T).T / np.asarray(smoothing.sum(axis=1)).ravel() + uneven
    heights = smoothed[rows, sensors]

    # Pairs of touches of one frame, the second within reach of the first.
    numbers = np.full(values.shape, -1, dtype=np.intp)
    numbers[rows, sensors] = np.arange(n_touches)
    touch, beside = _entries(csr_array(distances < _REACH * link), sensors)
    other = numbers[rows[touch], beside]
    both = other >= 0
    first, second = touch[both], other[both]
    adjacent = neighbours.toarray()[sensors[first], sensors[second]] > 0
    links = csr_array(
        (np.ones(np.count_nonzero(adjacent)), (first[adjacent], second[adjacent])),
        shape=(n_touches, n_touches),
    )
    patches = connected_components(links, directed=False)[1].astype(np.intp)
    joined = patches[first] == patches[second]
    highest = heights.copy()
    np.maximum.at(highest, first[joined], heights[second[joined]])

    peaks = np.flatnonzero(heights >= highest)
    peaks = peaks[np.argsort(patches[peaks], kind="stable")]
    n_peaks = np.bincount(patches[peaks])
    ends = np.append(0, np.cumsum(n_peaks))
    of_patch = csr_array((np.ones(len(peaks)), peaks, ends), shape=(len(n_peaks), n_touches))
    first, peaks = _entries(of_patch, patches)
    to_peaks = distances[sensors[first], sensors[peaks]]
    order = np.lexsort((to_peaks, first))
    nearest = np.flatnonzero(np.diff(first, prepend=-1))  # `first` is in order and complete
    second_nearest = to_peaks[order[np.minimum(nearest + 1, len(order) - 1)]]
    clear = (n_peaks[patches] == 1) | (second_nearest > _MIN_RATIO * to_peaks[order[nearest]])
    peaks = peaks[order[nearest]]

    resting = ~both & clear[touch]
    borders = np.unique(peaks[touch[resting]] * n_sensors + beside[resting])
    border_peaks, border_sensors = borders // n_sensors, borders % n_sensors
    complete = (np.bincount(peaks[clear], minlength=n_touches) >= min_sensors) & (
        np.bincount(border_peaks, minlength=n_touches) >= _MIN_AT_REST
    )
    if not complete.any():
        return None
    of_contact = np.concatenate([peaks[clear], border_peaks])
    order = np.argsort(of_contact, kind="stable")
    order = order[complete[of_contact[order]]]
    found, starts, owners = np.unique(of_contact[order], return_index=True, return_inverse=True)
    readers = np.concatenate([sensors[clear], border_sensors])[order]
    return Contacts(
        sensors=readers,
        levels=values[rows[found][owners], readers].astype(np.intp),
        owners=owners,
        starts=starts,
        max_level=levels.max_level,
    )


def _neighbourhood(positions: Floats) -> tuple[Floats, csr_array, float]:
    """Return distances, an adjacency of neighbours and their median distance."""
    distances = cdist(positions, positions)
    n_near = min(_N_NEIGHBOURS, len(distances) - 1)
    adjacency = greatest_of_rows(-distances, n_near + 1)  # and the sensor itself
    np.fill_diagonal(adjacency, val=False)
    adjacency &= adjacency.T
    tree = spanning_tree(distances)
    link = float(np.median(distances[adjacency | tree]))
    adjacency = (adjacency & (distances < _MAX_LINK * link)) | tree
    return distances, csr_array(adjacency.astype(np.float64)), link


def _entries(lists: csr_array, rows: Indices) -> tuple[Indices, Indices]:
    """Return the entries of rows of a sparse matrix: the index into `rows`, and the column."""
    counts = np.diff(lists.indptr)[rows]
    owners = np.repeat(np.arange(len(rows)), counts)
    offsets = np.arange(len(owners)) - np.repeat(np.cumsum(counts) - counts, counts)
    return owners, lists.indices[lists.indptr[rows][owners] + offsets]


_OUTLIER_SHARE = 0.02  # of readings that are independent of distance, uniform over levels; by hand

# Chosen by hand on simulated skins; lengths in sensor spacings.
_FAR = 1e6  # effectively infinite, but 0 times it is 0
_LOG_LENGTHS = (-20.0, 10.0)  # bounds of fitted lengths: far below and above any skin, and finite
_BINS = 200  # of distances up to two radii, narrower than the least softness
_PROFILE_ITERATIONS = 60  # of L-BFGS, for about ten parameters
_PROFILE_TOLERANCE = 1e-4  # relative, of the log-likelihood; each fit starts from the last one
_INITIAL_DAMPING, _DAMPINGS = 1e-2, (1e-6, 1e6)  # of Levenberg-Marquardt steps
_PRIOR_PRECISION = 1e-3  # of 1 / softness^2; keeps undetermined centres in place
_MAX_LEVERAGE = 0.8  # of a reading on its contact; bounds leave-one-out steps
_MAX_SHIFT = 1.5  # of a leave-one-out prediction
_MIN_DISTANCE = 1e-6  # keeps directions finite
_DAMPING = 0.01  # of the curvature's diagonal, for steps of sensors
_STEP_TOLERANCE = 0.02  # relative, of conjugate gradients: a step is corrected by the next one


class Profile(NamedTuple):
    """Distribution of levels given the distance from a contact, in sensor spacings.

    The level of a sensor depends on its distance u inside the radius R of a contact:
    ``P(level >= l) = expit((u - thresholds[l - 1]) / softness)``.

    thresholds (L,): Increasing; the first is 0.
    radius, radius_sd: Mean and standard deviation of R over contacts.
    """

    thresholds: Floats
    softness: float
    radius: float
    radius_sd: float


class LocatedContacts(NamedTuple):
    """Contacts at given states, with the derivatives of their log-likelihoods.

    states (E, k + 1): Centre y and radius R of each contact.
    scores (E,): Log-likelihood of each contact's readings and radius.
    gradients (E, k + 1), precisions (E, k + 1, k + 1): Of the scores by the states: gradient, and
        negative Hessian (Gauss-Newton), positive definite.
    inside (M,): Distance of each sensor inside the radius, ``u = R - |p - y|``.
    directions (k + 1, M): Gradient of u by the state; its first k components are those by -p.
    slopes, curvatures (M,): Derivatives of log-likelihoods by u; see `level_log_likelihood`.
    """

    states: Floats
    scores: Floats
    gradients: Floats
    precisions: Floats
    inside: Floats
    directions: Floats
    slopes: Floats
    curvatures: Floats


_OF_CONTACTS = ("states", "scores", "gradients", "precisions")


def level_log_likelihood(
    levels: ArrayLike, inside: ArrayLike, profile: Profile
) -> tuple[Floats, Floats, Floats]:
    """Return the log-likelihood of levels, and its derivatives by the distance u, each (M,).

    With ``a = P(level >= l)``, ``b = P(level >= l + 1)`` and the outlier share e, the score is
    ``log((1 - e)(a - b) + e / (L + 1))``. With the probability w that a reading is no outlier, its
    slope is ``w (1 - a - b) / s`` and its curvature ``w (a (1 - a) + b (1 - b)) / s^2``, without
    the derivative of w, so that it is never negative.
    """
    u, per_width = np.asarray(inside), 0.5 / profile.softness
    edges = (np.concatenate([[-_FAR], profile.thresholds, [_FAR]]) * per_width).astype(u.dtype)
    scaled = u * per_width
    # With A = 2 a - 1 = tanh(logit / 2), which takes a fifth of the time of a logistic function.
    where = np.asarray(levels)
    at_least, above = (np.tanh(scaled - np.take(part, where)) for part in (edges, edges[1:]))
    regular = (at_least - above) * ((1 - _OUTLIER_SHARE) / 2)
    total = regular + _OUTLIER_SHARE / (len(profile.thresholds) + 1)
    share = np.divide(regular, total, out=regular) * per_width
    slope = -share * (at_least + above)
    curvature = per_width * share * (2 - at_least**2 - above**2)
    return np.log(total), slope, curvature


def evaluate(
    contacts: Contacts, positions: Reals, states: Floats, profile: Profile
) -> LocatedContacts:
    """Evaluate the log-likelihoods of contacts at given states, and their derivatives.

    Arrays with a value for each reading have the data type of the positions.
    """
    k = positions.shape[1]
    # Rows of contiguous numbers, one for each coordinate: sums over them take a third of the time.
    rows = np.ones((k + 1, len(contacts.sensors)), positions.dtype)
    known = contacts.spread(states.T.astype(positions.dtype))
    for row, given, centres in zip(rows, positions.T, known[:k], strict=False):
        np.subtract(np.take(given, contacts.sensors), centres, out=row)
    distances = np.sqrt(np.einsum("km,km->m", rows[:k], rows[:k]) + _MIN_DISTANCE**2)
    rows[:k] /= distances
    inside = known[k] - distances
    score, slopes, curvatures = level_log_likelihood(contacts.levels, inside, profile)
    deviations = (states[:, k] - profile.radius) / profile.radius_sd
    gradients = np.empty(states.shape)
    precisions = np.empty((len(states), k + 1, k + 1))
    for i, row in enumerate(rows):
        gradients[:, i] = np.add.reduceat(slopes * row, contacts.starts)
        weighted = curvatures * row
        for j, other in enumerate(rows[: i + 1]):
            precisions[:, i, j] = np.add.reduceat(weighted * other, contacts.starts)
            precisions[:, j, i] = precisions[:, i, j]
    gradients[:, k] -= deviations / profile.radius_sd
    prior = np.append(np.full(k, _PRIOR_PRECISION / profile.softness**2), profile.radius_sd**-2)
    precisions += np.diag(prior)
    scores = np.add.reduceat(score, contacts.starts) - deviations**2 / 2
    return LocatedContacts(states, scores, gradients, precisions, inside, rows, slopes, curvatures)


def locate(
    contacts: Contacts, positions: Reals, states: Floats, profile: Profile, *, steps: int
) -> LocatedContacts:
    """Maximise the likelihood of each contact separately (Levenberg-Marquardt).

    positions (N, k), states (E, k + 1).
    """
    located = evaluate(contacts, positions, states, profile)
    damping = np.full(len(states), _INITIAL_DAMPING)
    diagonal = np.arange(states.shape[1])
    for _ in range(steps):
        damped = located.precisions.copy()
        damped[:, diagonal, diagonal] *= 1 + damping[:, None]
        moves = np.linalg.solve(damped, located.gradients[:, :, None])[:, :, 0]
        trial = evaluate(contacts, positions, located.states + moves, profile)
        worse = trial.scores <= located.scores
        of_readings = contacts.spread(worse)
        for field, new, old in zip(LocatedContacts._fields, trial, located, strict=True):
            # Masks apply to the last axis: that of readings, or of contacts after transposition.
            if field in _OF_CONTACTS:
                np.copyto(new.T, old.T, where=worse)
            else:
                np.copyto(new, old, where=of_readings)
        located = trial
        damping = np.clip(np.where(worse, damping * 6, damping / 5), *_DAMPINGS)
    return located


class Roots(NamedTuple):
    """Roots of the inverse precisions C of contacts, ``C^-1 = L' L``.

    of_contacts (E, k + 1, k + 1): L, lower triangular.
    of_readings (k + 1, M): ``L n`` for the direction n of each reading.
    """

    of_contacts: Floats
    of_readings: Floats

    @classmethod
    def of(cls, contacts: Contacts, located: LocatedContacts) -> Roots:
        """Factorise the precisions."""
        roots = np.linalg.inv(np.linalg.cholesky(located.precisions))
        directions = located.directions
        rows, entries = np.zeros_like(directions), roots.astype(directions.dtype)
        for i, j in zip(*np.tril_indices(len(rows)), strict=True):
            rows[i] += contacts.spread(entries[:, i, j]) * directions[j]
        return cls(roots, rows)

    def solve(self, gradients: Reals) -> Reals:
        """Return the products of C^-1 with vectors of the contacts, (k + 1, E) each."""
        halved = np.einsum("eij,je->ie", self.of_contacts, gradients)
        return np.asarray(np.einsum("eji,je->ie", self.of_contacts, halved))


def leave_one_out(located: LocatedContacts, roots: Roots) -> Floats:
    """Predict the distance u of each reading from a fit of its contact without it, (M,).

    This is one Newton step from the fit to all readings: with the direction n, the precision C of
    the contact and ``h = n' C^-1 n``, u becomes ``u - h slope / (1 - h curvature)``.
    """
    leverage = np.einsum("im,im->m", roots.of_readings, roots.of_readings)
    left = 1 - np.minimum(leverage * located.curvatures, _MAX_LEVERAGE)
    shift = leverage * located.slopes / left
    return np.asarray(located.inside - np.clip(shift, -_MAX_SHIFT, _MAX_SHIFT))


def fit_profile(
    levels: NDArray[np.intp], inside: Floats, weights: ArrayLike, profile: Profile
) -> Profile:
    """Fit thresholds and softness to readings at known distances (maximum likelihood).

    levels, inside, weights (M,). The parameters are the first threshold, and the logarithms of the
    steps to the others and of the softness.
    """
    n_levels = len(profile.thresholds)
    # Far from all thresholds, levels are certain and distances do not matter.
    far = 2 * profile.radius
    width = 2 * far / _BINS
    bins = np.clip((inside + far) / width, 0, _BINS - 1).astype(np.intp)
    counts = np.bincount(levels * _BINS + bins, weights, (n_levels + 1) * _BINS)
    shares = (counts / counts.sum()).reshape(n_levels + 1, _BINS)
    centres = (np.arange(_BINS) + 0.5) * width - far

    def value_and_gradient(parameters: Floats) -> tuple[float, Floats]:
        steps, softness = np.exp(parameters[1:-1]), np.exp(parameters[-1])
        thresholds = np.cumsum(np.append(parameters[0], steps))
        scaled = (centres - thresholds[:, None]) / softness
        at_least = (1 + np.tanh(scaled / 2)) / 2
        bounds = np.vstack([np.ones(_BINS), at_least, np.zeros(_BINS)])
        total = _OUTLIER_SHARE / (n_levels + 1) - (1 - _OUTLIER_SHARE) * np.diff(bounds, axis=0)
        ratios = np.diff(shares / total, axis=0) * (1 - _OUTLIER_SHARE)
        by_scaled = ratios * at_least * (1 - at_least)
        by_threshold = -by_scaled.sum(axis=1) / softness
        by_step = np.cumsum(by_threshold[::-1])[::-1]
        by_step[1:] *= steps
        by_softness = -(by_scaled * scaled).sum()
        return -float((shares * np.log(total)).sum()), -np.append(by_step, by_softness)

    steps = np.maximum(np.diff(profile.thresholds), 1e-3 * profile.softness)
    start = np.concatenate([profile.thresholds[:1], np.log(steps), [np.log(profile.softness)]])
    found = minimize(
        value_and_gradient,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=[(-np.inf, np.inf), *[_LOG_LENGTHS] * n_levels],
        options={"maxiter": _PROFILE_ITERATIONS, "ftol": _PROFILE_TOLERANCE},
    ).x
    thresholds = np.cumsum(np.append(found[0], np.exp(found[1:-1])))
    return profile._replace(thresholds=thresholds, softness=float(np.exp(found[-1])))


def sensor_steps(
    contacts: Contacts,
    located: LocatedContacts,
    roots: Roots,
    weights: ArrayLike,
    deviations: Floats,
    *,
    prior_sd: float,
) -> Floats:
    """Make a damped Gauss-Newton step of the sensors, with the contacts re-optimised.

    weights (E,): Of the contacts; deviations (N, k): Positions less those of the prior.

    Row m of P is the gradient of u_m by all positions, and row m of Q that by all contacts; h are
    the curvatures, g the slopes, C the contacts' precisions and c their gradients. Second
    derivatives of u are neglected. Eliminating the contacts, with the weight w of the contact of
    each reading, leaves the Schur complement (Triggs et al. 2000, Bundle Adjustment - A Modern
    Synthesis, section 6.1) ::

        gradient   P' w (g - h Q C^-1 c)
        curvature  P' w (h - h Q C^-1 Q' h) P
    """
    n_sensors, k = deviations.shape
    directions, curvatures = located.directions, located.curvatures
    dtype, n_readings = directions.dtype, len(contacts.sensors)
    columns = contacts.sensors[:, None] * k + np.arange(k)
    by_sensors = csr_array(  # P
        (-directions[:k].T.ravel(), columns.ravel(), np.arange(n_readings + 1) * k),
        shape=(n_readings, deviations.size),
    )
    back = by_sensors.T  # without a copy; blocks of both would be copied for each product
    shares = contacts.spread(np.asarray(weights, dtype))

    def by_contacts(gradients: Reals) -> Reals:
        """Return Q C^-1 c. gradients c (k + 1, E) -> (M,)."""
        settled = roots.solve(gradients).astype(dtype, copy=False)
        return np.asarray(np.einsum("im,im->m", directions, contacts.spread(settled)))

    def bent(moves: Reals) -> Reals:
        """Return the product of the damped curvature and moves, each (N k,)."""
        slopes = curvatures * (by_sensors @ moves)
        sums = np.add.reduceat(directions * slopes, contacts.starts, axis=1)
        undamped = back @ (shares * (slopes - curvatures * by_contacts(sums)))
        return np.asarray(undamped + damped * moves)

    slopes = located.slopes - curvatures * by_contacts(located.gradients.T)
    prior = prior_sd**-2
    target = back @ (shares * slopes) - prior * deviations.ravel()
    fixed = np.stack(
        [back @ (shares * curvatures * -axis) for axis in directions[:k]], axis=1
    ).reshape(n_sensors, k, k)
    fixed += prior * np.eye(k)
    rows = np.arange(n_sensors + 1)
    inverse = bsr_array(
        (np.linalg.inv(fixed).astype(dtype), rows[:-1], rows), shape=(deviations.size,) * 2
    )
    damped = prior + _DAMPING * np.einsum("nii->ni", fixed).ravel()
    curvature = LinearOperator(inverse.shape, bent, dtype=dtype)
    found, _ = cg(curvature, target.astype(dtype), rtol=_STEP_TOLERANCE, M=inverse)
    return np.asarray(found.reshape(n_sensors, k), dtype=np.float64)
