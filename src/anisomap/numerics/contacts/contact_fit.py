"""Fit of contacts: the readings of a contact depend on the distance of sensors from its centre.

Joint refinement of sensor positions, contact locations and the profile that relates them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.contacts.likelihood import (
    Contacts,
    Levels,
    LocatedContacts,
    Profile,
    Roots,
    assign_levels,
    find_contacts,
    fit_profile,
    leave_one_out,
    level_log_likelihood,
    locate,
    sensor_steps,
)
from anisomap.numerics.neighbours import nearest_distances
from anisomap.numerics.precision import Floats, Reals
from anisomap.numerics.ranges import (
    COUNT,
    NOT_NEGATIVE,
    POSITIVE,
    SHARE,
    at_least,
    between,
    check_ranges,
)
from anisomap.numerics.similarity.rest import Rest

# Chosen by hand on simulated skins; lengths in sensor spacings.
_MIN_SINGLE = 128  # sensors from which readings are float32, as their correlations are
_WARM_UP_ROUNDS = 2  # of contacts and profile before sensors move; with 1, planes in 3D diverge
_INITIAL_STEPS, _WARM_UP_STEPS = 6, 3  # of contacts, which follow the sensors later
_SURFACE_OFFSET = 0.7  # of a contact's extent; initial distance of its centre from the skin
_OUTLIER_FACTOR = 4.0  # times the upper quartile range; contacts that score lower are dropped
_MAX_DROPPED = 0.4  # of all contacts
_MIN_SOFTNESS = 0.05  # of the profile
_MIN_RADIUS_SD = 0.02  # of the mean radius
_MAX_STEP = 0.45  # keeps neighbours from changing places in one step
_MIN_CONTACTS = 0.5  # per sensor


@dataclass(frozen=True)
class ContactOptions:
    """Parameters of the contact fit, tuned on simulated skins.

    Parameters
    ----------
    n_levels : int
        Maximum number of levels above rest into which readings are quantised, 1 to 100.
    max_gain_spread : float
        Standard deviation of the log gains of sensors up to which readings are not normalised.
    max_readings, readings_per_sensor : int
        Approximate number of readings above rest to fit, at least 1: in total or per sensor,
        whichever gives more.
    min_sensors : int
        Fewest touched sensors of a contact, at least 2.
    contact_weight : float
        Weight of each contact, in (0, 1], since consecutive frames are not independent.
    prior_sd : float
        Standard deviation of the displacement of a sensor from the given map, in sensor spacings,
        above 0.
    n_steps : int
        Maximum number of steps of the sensors, at least 1.
    min_explained : float
        Share of the entropy of the readings that contacts must explain for the fit to be used.
    min_at_rest : float
        Share of readings at rest below which contacts are not fitted.

    Raises
    ------
    InputError
        If a value is out of range.
    """

    n_levels: int = 6
    max_gain_spread: float = 0.3
    max_readings: int = 10_000
    readings_per_sensor: int = 30
    min_sensors: int = 3
    contact_weight: float = 0.5
    prior_sd: float = 0.5
    n_steps: int = 4
    min_explained: float = 0.4
    min_at_rest: float = 0.2

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)


_RANGES = {
    **dict.fromkeys(("max_readings", "readings_per_sensor", "n_steps"), COUNT),
    "min_sensors": at_least(2, whole=True),
    "max_gain_spread": NOT_NEGATIVE,
    "n_levels": between(1, 100),
    "contact_weight": SHARE,
    "prior_sd": POSITIVE,
}


@dataclass(frozen=True, eq=False)
class ContactFit:
    """A map refined by contacts, or the given map with the reason why it was not refined.

    Attributes
    ----------
    positions : ndarray of shape (N, k)
        In the unit and around the centre of the given positions; equal to them if not `used`.
    n_contacts : int
        Number of contacts found.
    explained : float
        Share of the entropy of the readings that the distance from their contact explains; at most
        1. Each reading is left out of the fit of its own contact. NaN if contacts were not fitted.
    at_rest : float
        Share of all readings at rest.
    n_levels : int
        Levels above rest that were distinguished; 1 for readings that are on or off.
    gains : ndarray of shape (N,)
        Gain of each sensor relative to the median.
    used : bool
        Whether the fit passed the checks of `ContactOptions`.
    reason : str
        Reason for not using the fit; empty if it was used.
    """

    positions: Floats
    n_contacts: int
    explained: float
    at_rest: float
    n_levels: int
    gains: Floats
    used: bool
    reason: str = ""


def fit_contacts(
    readings: ArrayLike,
    positions: ArrayLike,
    options: ContactOptions | None = None,
    *,
    rest: Rest | None = None,
) -> ContactFit:
    """Refine a map by fitting the contacts that caused the readings.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings in any unit.
    positions : array_like of shape (N, k)
        An approximately correct map in any unit, for example from
        `anisomap.numerics.covariogram.covariogram_fit.fit_covariogram`.
    options : ContactOptions, optional
    rest : Rest, optional
        Rest of the sensors, if already estimated.

    Returns
    -------
    ContactFit
        With the given positions if the checks of `ContactOptions` fail.

    Raises
    ------
    InputError
        If shapes disagree, a value is not finite, or there are fewer than 3 sensors.

    Notes
    -----
    Contact e is at y_e with radius R_e. Sensor i reads level l or higher with probability
    ``expit((R_e - |p_i - y_e| - rho_l) / s)``, except for outliers; ``R_e ~ N(R0, tau^2)``. These
    steps alternate:

    1. the likelihood of each contact (y, R) is maximised, in 3D from both sides of the skin
       (`locate`);
    2. the contacts with the lowest likelihoods are dropped, and rho and s are fitted to distances
       for which each reading is left out of the fit of its own contact (`fit_profile`);
    3. R0 and tau are set to the moments of the radii, tau^2 divided by the number of radii that
       the readings determine (MacKay 1992, Neural Computation 4: 415-447);
    4. all sensors make one Gauss-Newton step with the contacts eliminated (`sensor_steps`) and the
       prior ``p_i ~ N(given, prior_sd^2)``.
    """
    chosen = options or ContactOptions()
    values, given = np.asarray(readings), np.asarray(positions, dtype=np.float64)
    _check(values, given)
    levels = assign_levels(
        values,
        chosen.n_levels,
        max_gain_spread=chosen.max_gain_spread,
        max_touches=max(chosen.max_readings, chosen.readings_per_sensor * len(given)),
        rest=rest,
    )
    if levels.at_rest < chosen.min_at_rest:
        reason = (
            f"only {levels.at_rest:.0%} of the readings are at rest; detecting contacts needs "
            f"{chosen.min_at_rest:.0%}"
        )
        return _fitted(given.copy(), levels, reason)
    centre, unit = given.mean(axis=0), float(np.median(nearest_distances(given)))
    if not unit > 0:
        return _fitted(given.copy(), levels, "most sensors coincide with another on the map")
    start = (given - centre) / unit
    contacts = find_contacts(levels, start, min_sensors=chosen.min_sensors)
    n_contacts = 0 if contacts is None else len(contacts.starts)
    if contacts is None or n_contacts < _MIN_CONTACTS * len(start):
        reason = f"{n_contacts} contacts were found, too few for {len(start)} sensors"
        return _fitted(given.copy(), levels, reason, n_contacts)
    moved, explained = _alternate(contacts, start, chosen)
    if not explained >= chosen.min_explained:
        reason = (
            f"the distance from contacts explains {max(explained, 0.0):.0%} of the entropy of the "
            f"readings around them; {chosen.min_explained:.0%} are required"
        )
        return _fitted(given.copy(), levels, reason, n_contacts, explained)
    return _fitted(moved * unit + centre, levels, "", n_contacts, explained)


def _alternate(contacts: Contacts, start: Floats, options: ContactOptions) -> tuple[Floats, float]:
    """Alternate between contacts, profile and sensors.

    Returns the positions, and the share of the entropy of the levels that distances explain. start
    (N, k): in spacings around the centre.
    """
    positions = start
    states, profile = _initial_contacts(contacts, start)
    last = _WARM_UP_ROUNDS + options.n_steps
    for step in range(last + 1):
        steps = _WARM_UP_STEPS if step <= _WARM_UP_ROUNDS else 1
        located = locate(contacts, _rounded(positions), states, profile, steps=steps)
        roots = Roots.of(contacts, located)
        scores = located.scores / contacts.counts
        lowest, median, upper = np.quantile(scores, [_MAX_DROPPED, 0.5, 0.75])
        kept = scores >= min(median - _OUTLIER_FACTOR * (upper - median), lowest)
        included = contacts.spread(kept)
        inside = leave_one_out(located, roots)
        fitted = fit_profile(contacts.levels, inside, included, profile)
        if step == last:
            break
        states = located.states
        if step >= _WARM_UP_ROUNDS:
            weights, moved = options.contact_weight * kept, positions - start
            moves = sensor_steps(
                contacts, located, roots, weights, moved, prior_sd=options.prior_sd
            )
            moves *= min(1.0, _MAX_STEP / max(np.linalg.norm(moves, axis=1).max(), _MAX_STEP))
            positions = positions + moves
            states = _follow(contacts, located, roots, moves)
        undetermined = (roots.of_contacts[kept, -1, -1] / profile.radius_sd) ** 2
        states, profile = _centre_radii(states, fitted, undetermined, kept)
    score, _, _ = level_log_likelihood(contacts.levels, inside, fitted)
    shares = np.bincount(contacts.levels[included]) / included.sum()
    entropy = -float((shares[shares > 0] * np.log(shares[shares > 0])).sum())
    # Contacts determine neither the place nor the size of a map.
    positions = positions - positions.mean(axis=0)
    positions *= np.linalg.norm(start) / np.linalg.norm(positions)
    return positions, 1 + float(score[included].mean()) / entropy


def _rounded(positions: Floats) -> Reals:
    return positions.astype(np.float32 if len(positions) >= _MIN_SINGLE else np.float64)


def _follow(contacts: Contacts, located: LocatedContacts, roots: Roots, moves: Floats) -> Floats:
    """Move the states of contacts along with the sensors, to first order, (E, k + 1)."""
    moved = moves.T.astype(located.directions.dtype)[:, contacts.sensors]
    changes = np.einsum("km,km->m", located.directions[:-1], moved) * located.curvatures
    sums = np.add.reduceat(located.directions * changes, contacts.starts, axis=1)
    return located.states + roots.solve(located.gradients.T + sums).T


def _centre_radii(
    states: Floats, fitted: Profile, undetermined: Floats, kept: NDArray[np.bool_]
) -> tuple[Floats, Profile]:
    """Set the first threshold to 0, and the distribution of radii to their moments.

    undetermined: Posterior over prior variance of the radii of kept contacts: the share of each
        that the readings do not determine.
    """
    shift = fitted.thresholds[0]
    states = states.copy()
    states[:, -1] -= shift
    radii = states[kept, -1]
    radius = float(radii.mean())
    n_determined = max(float((1 - np.minimum(undetermined, 1)).sum()), 1e-3 * len(radii))
    spread = float(np.sqrt(((radii - radius) ** 2).sum() / n_determined))
    return states, Profile(
        fitted.thresholds - shift,
        max(fitted.softness, _MIN_SOFTNESS),
        radius,
        max(spread, _MIN_RADIUS_SD * abs(radius)),
    )


def _initial_contacts(contacts: Contacts, positions: Floats) -> tuple[Floats, Profile]:
    """Start from the centre of the touched sensors, in 3D on the more likely side of the skin."""
    k = positions.shape[1]
    points, pressed = positions[contacts.sensors], contacts.levels > 0
    sums = np.add.reduceat(
        np.column_stack([contacts.levels[:, None] * points, contacts.levels, points]),
        contacts.starts,
    )
    centres = sums[:, :k] / sums[:, k : k + 1]
    offsets = np.linalg.norm(points - centres[contacts.owners], axis=1) * pressed
    extents = np.maximum.reduceat(offsets, contacts.starts)
    # 1.22 is the length of (1, 0.7): centres are offset from the skin by 0.7 of the extent.
    radius = 1.05 * float(np.median(extents)) * (1.22 if k > 2 else 1.0)
    thresholds = np.linspace(0, 0.7 * radius, contacts.max_level)
    profile = Profile(thresholds, 0.1 * radius, radius, 0.2 * radius)
    starts = [centres]
    if k > 2:
        # The normal is the direction of least variance of the sensors around a contact.
        around = points - (sums[:, k + 1 :] / contacts.counts[:, None])[contacts.owners]
        squares = np.add.reduceat(around[:, :, None] * around[:, None], contacts.starts)
        offset = _SURFACE_OFFSET * extents[:, None] * np.linalg.eigh(squares)[1][:, :, 0]
        starts = [centres + offset, centres - offset]
    sides = [
        locate(
            contacts,
            _rounded(positions),
            np.column_stack([one, np.full(len(extents), radius)]),
            profile,
            steps=_INITIAL_STEPS,
        )
        for one in starts
    ]
    likelier = np.argmax([side.scores for side in sides], axis=0)
    return np.array([side.states for side in sides])[likelier, np.arange(len(extents))], profile


def _fitted(
    positions: Floats, levels: Levels, reason: str, n_contacts: int = 0, explained: float = np.nan
) -> ContactFit:
    """Describe a fit, which is used unless there is a reason against it."""
    positions.setflags(write=False)
    return ContactFit(
        positions=positions,
        n_contacts=n_contacts,
        explained=explained,
        at_rest=levels.at_rest,
        n_levels=levels.max_level,
        gains=levels.gains,
        used=not reason,
        reason=reason,
    )


def _check(values: NDArray[np.generic], given: Floats) -> None:
    if values.ndim != 2 or not values.size:
        raise InputError(f"readings must have shape (T, N), got {values.shape}")
    n_sensors = values.shape[1]
    if given.ndim != 2 or len(given) != n_sensors or not given.shape[1]:
        raise InputError(f"positions must have shape ({n_sensors}, k), got {given.shape}")
    if n_sensors < 3:
        raise InputError(f"contacts need at least 3 sensors, got {n_sensors}")
    if not np.isfinite(given).all() or not np.isfinite(values).all():
        raise InputError("readings and positions must be finite")
