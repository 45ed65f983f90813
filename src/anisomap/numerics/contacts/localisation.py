"""Where each contact is, given where the sensors are; and where it would be without a reading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.contacts.detection import Contacts
from anisomap.numerics.contacts.profile import Profile, level_terms

Matrix = NDArray[np.float64]

_SETTLED = 1e-5  # of a score
_FIRST_DAMPING = 1e-2
_LEAST_DAMPING = 1e-6
_STIFFNESS = 1e-3  # of 1 / softness^2: holds a centre of which readings say nothing
_MOST_LEVERAGE = 0.8
_FARTHEST_SHIFT = 1.5  # spacings
_NEAREST = 1e-6  # spacings


@dataclass(frozen=True, eq=False)
class Fitted:
    """Contacts where their readings are most likely, and how readings change about there.

    Attributes
    ----------
    states : ndarray of shape (E, k + 1)
        Centre y and reach R of each contact.
    scores : ndarray of shape (E,)
        Log probability of a contact's readings and of its reach.
    pulls : ndarray of shape (E, k + 1)
        Derivative of the scores by the states: about 0.
    precisions : ndarray of shape (E, k + 1, k + 1)
        Minus their second derivative, positive definite.
    inside : ndarray of shape (M,)
        How far each sensor lies inside the reach, ``u = R - |p - y|``.
    directions : ndarray of shape (M, k + 1)
        Derivative of u by the state, ``((p - y) / |p - y|, 1)``; minus that of the centre is its
        derivative by p.
    slopes, curvatures : ndarray of shape (M,)
        Of the readings' scores by u; see `level_terms`.
    """

    states: Matrix
    scores: Matrix
    pulls: Matrix
    precisions: Matrix
    inside: Matrix
    directions: Matrix
    slopes: Matrix
    curvatures: Matrix


def evaluate(contacts: Contacts, places: Matrix, states: Matrix, profile: Profile) -> Fitted:
    """Score contacts at given states."""
    k = places.shape[1]
    apart = places[contacts.sensors] - states[contacts.contact_index, :k]
    distances = np.sqrt((apart**2).sum(axis=1) + _NEAREST**2)
    directions = np.column_stack([apart / distances[:, None], np.ones(len(apart))])
    inside = states[contacts.contact_index, k] - distances
    score, slopes, curvatures = level_terms(contacts.levels, inside, profile)
    strays = (states[:, k] - profile.reach) / profile.spread
    pulls = contacts.total(slopes[:, None] * directions)
    pulls[:, k] -= strays / profile.spread
    precisions = contacts.total(
        curvatures[:, None, None] * directions[:, :, None] * directions[:, None, :]
    )
    stiffness = np.append(np.full(k, _STIFFNESS / profile.softness**2), profile.spread**-2)
    precisions += np.diag(stiffness)
    scores = contacts.total(score) - strays**2 / 2
    return Fitted(states, scores, pulls, precisions, inside, directions, slopes, curvatures)


def locate(
    contacts: Contacts, places: Matrix, states: Matrix, profile: Profile, *, steps: int = 12
) -> Fitted:
    """Move contacts to where their readings are most likely (Levenberg-Marquardt, each by itself).

    Parameters
    ----------
    contacts : Contacts
    places : ndarray of shape (N, k)
    states : ndarray of shape (E, k + 1)
        Where to set out from.
    profile : Profile
    steps : int

    Returns
    -------
    Fitted
        No score is below that of the start.
    """
    best = evaluate(contacts, places, states, profile)
    damping = np.full(len(states), _FIRST_DAMPING)
    diagonal = np.arange(states.shape[1])
    for _ in range(steps):
        stiff = best.precisions.copy()
        stiff[:, diagonal, diagonal] *= 1 + damping[:, None]
        moves = np.linalg.solve(stiff, best.pulls[:, :, None])[:, :, 0]
        tried = evaluate(contacts, places, best.states + moves, profile)
        gained = tried.scores - best.scores
        best = choose(contacts, gained > 0, tried, best)
        damping = np.where(gained > 0, np.maximum(damping / 5, _LEAST_DAMPING), damping * 6)
        if np.abs(gained).max() < _SETTLED:
            break
    return best


def choose(contacts: Contacts, which: NDArray[np.bool_], one: Fitted, other: Fitted) -> Fitted:
    """Take some contacts of one fit, and the rest of another."""
    by_reading = which[contacts.contact_index]

    def mixed(mask: NDArray[np.bool_], a: Matrix, b: Matrix) -> Matrix:
        return np.where(mask.reshape(-1, *[1] * (a.ndim - 1)), a, b)

    return Fitted(
        mixed(which, one.states, other.states),
        mixed(which, one.scores, other.scores),
        mixed(which, one.pulls, other.pulls),
        mixed(which, one.precisions, other.precisions),
        mixed(by_reading, one.inside, other.inside),
        mixed(by_reading, one.directions, other.directions),
        mixed(by_reading, one.slopes, other.slopes),
        mixed(by_reading, one.curvatures, other.curvatures),
    )


def leave_one_out(contacts: Contacts, fitted: Fitted) -> Matrix:
    """Tell how far inside each sensor would lie, had its contact been fitted without its reading.

    Parameters
    ----------
    contacts : Contacts
    fitted : Fitted

    Returns
    -------
    ndarray of shape (M,)

    Notes
    -----
    One Newton step away from the fit of all readings: with the direction n, the contact's
    precision C and ``h = n' C^-1 n``, u becomes ``u - h slope / (1 - h curvature)``.
    """
    inverse = np.linalg.inv(fitted.precisions)[contacts.contact_index]
    n = fitted.directions
    lever = np.einsum("mi,mij,mj->m", n, inverse, n)
    shift = lever * fitted.slopes / (1 - np.minimum(lever * fitted.curvatures, _MOST_LEVERAGE))
    return np.asarray(fitted.inside - np.clip(shift, -_FARTHEST_SHIFT, _FARTHEST_SHIFT))
