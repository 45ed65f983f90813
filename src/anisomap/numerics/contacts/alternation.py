"""Rounds of a fit of contacts: locate contacts, fit their profile, move sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.contacts.bundle_adjustment import ReducedSystem
from anisomap.numerics.contacts.detection import Contacts
from anisomap.numerics.contacts.localisation import evaluate, leave_one_out, locate
from anisomap.numerics.contacts.profile import Profile, fit_profile, level_log_likelihood

Matrix = NDArray[np.float64]

# Chosen by hand on simulated skins, seeds 101 to 105; lengths in sensor spacings.
_WARM_UP_ROUNDS = 4  # of contacts and profile before sensors move
_INITIAL_LOCATION_STEPS, _LOCATION_STEPS = 12, 4
_SURFACE_OFFSET = 0.7  # of a contact's extent; initial distance of its centre from the skin
_OUTLIER_FACTOR = 4.0  # times the upper quartile range; contacts that score lower are dropped
_MAX_DROPPED = 0.4  # of all contacts
_MIN_SOFTNESS = 0.05  # of the profile
_MIN_RADIUS_SD = 0.02  # of the mean radius
_MAX_STEP = 0.45  # keeps neighbours from changing places in one step
_TOLERANCE = 0.02  # largest displacement of a sensor at convergence


@dataclass(frozen=True, eq=False)
class ContactState:
    """Estimates during a fit of contacts, in sensor spacings.

    Attributes
    ----------
    positions : ndarray of shape (N, k)
    contacts : ndarray of shape (E, k + 1)
        Centre and radius of each contact.
    profile : Profile
    kept : ndarray of bool, shape (E,)
        Contacts that are included.
    """

    positions: Matrix
    contacts: Matrix
    profile: Profile
    kept: NDArray[np.bool_]


def alternate(
    contacts: Contacts,
    state: ContactState,
    start: Matrix,
    *,
    contact_weight: float,
    prior_sd: float,
    n_steps: int,
) -> ContactState:
    """Alternate between sensors, contacts and profile until the sensors converge.

    Parameters
    ----------
    contacts : Contacts
    state : ContactState
        From `initial_state`, or of a fit to other contacts.
    start : ndarray of shape (N, k)
        The map from which the prior measures displacements; its centre is 0.
    contact_weight, prior_sd, n_steps
        See `anisomap.numerics.contacts.ContactOptions`.

    Returns
    -------
    ContactState
    """
    for _ in range(n_steps):
        located = evaluate(contacts, state.positions, state.contacts, state.profile)
        reduced = ReducedSystem(contacts, located, state.kept, len(start))
        steps = reduced.step(
            state.positions - start, contact_weight=contact_weight, prior_sd=prior_sd
        )
        largest = float(np.linalg.norm(steps, axis=1).max())
        positions = state.positions + steps * min(1.0, _MAX_STEP / max(largest, _TOLERANCE))
        state = relocated(contacts, _rescaled(positions, start, state))
        if largest < _TOLERANCE:
            break
    return state


def initial_state(contacts: Contacts, positions: Matrix) -> ContactState:
    """Start from the centre of the touched sensors, in 3D on the more likely side of the skin.

    Parameters
    ----------
    contacts : Contacts
    positions : ndarray of shape (N, k)

    Returns
    -------
    ContactState
        After some rounds of contacts and profile, in which the sensors do not move.
    """
    k = positions.shape[1]
    points, pressed = positions[contacts.sensors], contacts.levels > 0
    mass = contacts.total(contacts.levels.astype(np.float64))
    centres = contacts.total(contacts.levels[:, None] * points) / mass[:, None]
    offsets = np.linalg.norm(points - centres[contacts.contact_index], axis=1) * pressed
    extents = np.maximum.reduceat(offsets, contacts.starts)
    # 1.22 is the length of (1, 0.7): centres are offset from the skin by 0.7 of the extent.
    radius = 1.05 * float(np.median(extents)) * (1.22 if k > 2 else 1.0)
    thresholds = np.linspace(0, 0.7 * radius, contacts.max_level)
    profile = Profile(thresholds, 0.1 * radius, radius, 0.2 * radius)
    offset = np.zeros_like(centres)
    if k > 2:
        offset = _SURFACE_OFFSET * extents[:, None] * _normals(contacts, points)
    above, below = (
        locate(
            contacts,
            positions,
            np.column_stack([centres + side * offset, np.full(len(extents), radius)]),
            profile,
            steps=_INITIAL_LOCATION_STEPS,
        )
        for side in (1, -1)
    )
    better = np.where((above.scores >= below.scores)[:, None], above.states, below.states)
    state = ContactState(positions, better, profile, np.ones(len(extents), dtype=bool))
    for _ in range(_WARM_UP_ROUNDS):
        state = relocated(contacts, state)
    return state


def _normals(contacts: Contacts, points: Matrix) -> Matrix:
    """Return the direction of least variance of the sensors around each contact, shape (E, k)."""
    centres = contacts.total(points) / contacts.sizes[:, None]
    offsets = points - centres[contacts.contact_index]
    _, vectors = np.linalg.eigh(contacts.total(offsets[:, :, None] * offsets[:, None, :]))
    return np.asarray(vectors[:, :, 0])


def relocated(contacts: Contacts, state: ContactState) -> ContactState:
    """Locate all contacts, drop the least likely, and fit the profile to the rest."""
    located = locate(
        contacts, state.positions, state.contacts, state.profile, steps=_LOCATION_STEPS
    )
    scores = located.scores / contacts.sizes
    lowest, middle, upper = np.quantile(scores, [_MAX_DROPPED, 0.5, 0.75])
    kept = scores >= min(middle - _OUTLIER_FACTOR * (upper - middle), lowest)
    profile_fit = fit_profile(
        contacts.levels,
        leave_one_out(contacts, located),
        kept[contacts.contact_index],
        state.profile,
    )
    shift = profile_fit.thresholds[0]
    states = located.states.copy()
    states[:, -1] -= shift
    radii = states[kept, -1]
    radius = float(radii.mean())
    # Posterior over prior variance: the share of each radius that the readings do not determine.
    undetermined = np.linalg.inv(located.precisions[kept])[:, -1, -1] / state.profile.radius_sd**2
    n_determined = max(float((1 - np.minimum(undetermined, 1)).sum()), 1e-3 * len(radii))
    radius_sd = float(np.sqrt(((radii - radius) ** 2).sum() / n_determined))
    profile = Profile(
        profile_fit.thresholds - shift,
        max(profile_fit.softness, _MIN_SOFTNESS),
        radius,
        max(radius_sd, _MIN_RADIUS_SD * abs(radius)),
    )
    return ContactState(state.positions, states, profile, kept)


def _rescaled(positions: Matrix, start: Matrix, state: ContactState) -> ContactState:
    """Centre a map and restore its initial size, which contacts do not determine."""
    centre = positions.mean(axis=0)
    factor = float(np.sqrt((start**2).sum() / ((positions - centre) ** 2).sum()))
    contacts = (state.contacts - np.append(centre, 0.0)) * factor
    return ContactState(
        (positions - centre) * factor, contacts, state.profile.scaled(factor), state.kept
    )


def explained_share(contacts: Contacts, state: ContactState) -> float:
    """Return the share of the entropy of the levels that distances explain."""
    located = evaluate(contacts, state.positions, state.contacts, state.profile)
    scores, _, _ = level_log_likelihood(
        contacts.levels, leave_one_out(contacts, located), state.profile
    )
    included = state.kept[contacts.contact_index]
    shares = np.bincount(contacts.levels[included]) / included.sum()
    entropy = -float((shares[shares > 0] * np.log(shares[shares > 0])).sum())
    return 1 + float(scores[included].mean()) / entropy
