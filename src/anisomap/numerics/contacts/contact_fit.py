"""Rounds of a fit of contacts: locate contacts, fit their profile, move sensors.

Joint refinement of sensor positions, contact locations and the profile that relates them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.contacts.detection import Contacts, Levels, assign_levels, find_contacts
from anisomap.numerics.contacts.likelihood import (
    Profile,
    ReducedSystem,
    evaluate,
    fit_profile,
    leave_one_out,
    level_log_likelihood,
    locate,
)
from anisomap.numerics.neighbours import nearest_distances
from anisomap.numerics.similarity.rest import Rest

Matrix = NDArray[np.float64]

# Chosen by hand on simulated skins, seeds 101 to 105; lengths in sensor spacings.
_WARM_UP_ROUNDS = 4  # of contacts and profile before sensors move
_INITIAL_LOCATION_STEPS, _LOCATION_STEPS = 12, 2
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

    positions (N, k)
    contacts (E, k + 1): Centre and radius of each contact.
    kept: Contacts that are included.
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
    """Alternate between sensors, contacts and profile until the sensors converge. start (N, k)."""
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

    positions (N, k).
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
    starts = [centres]
    if k > 2:
        offset = _SURFACE_OFFSET * extents[:, None] * _normals(contacts, points)
        starts = [centres + offset, centres - offset]
    sides = [
        locate(
            contacts,
            positions,
            np.column_stack([start, np.full(len(extents), radius)]),
            profile,
            steps=_INITIAL_LOCATION_STEPS,
        )
        for start in starts
    ]
    likelier = np.argmax([side.scores for side in sides], axis=0)
    states = np.array([side.states for side in sides])[likelier, np.arange(len(extents))]
    state = ContactState(positions, states, profile, np.ones(len(extents), dtype=bool))
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


# Chosen by hand on simulated skins, seeds 101 to 105; lengths in sensor spacings.
_MIN_CONTACTS = 0.5  # per sensor


@dataclass(frozen=True)
class ContactOptions:
    """Parameters of the contact fit, tuned on simulated skins, seeds 101 to 105.

    Parameters
    ----------
    n_levels : int
        Maximum number of levels above rest into which readings are quantised, 1 to 100.
    max_gain_spread : float
        Standard deviation of the log gains of sensors up to which readings are not normalised.
    max_readings, readings_per_sensor : int
        Approximate number of readings to fit, at least 1: in total or per sensor, whichever gives
        more.
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
    max_readings: int = 30_000
    readings_per_sensor: int = 150
    min_sensors: int = 3
    contact_weight: float = 0.2
    prior_sd: float = 0.5
    n_steps: int = 4
    min_explained: float = 0.45
    min_at_rest: float = 0.2

    def __post_init__(self) -> None:
        for name, least in (
            ("max_readings", 1),
            ("readings_per_sensor", 1),
            ("min_sensors", 2),
            ("n_steps", 1),
            ("max_gain_spread", 0),
        ):
            if not getattr(self, name) >= least:
                raise InputError(f"{name} must be at least {least}, got {getattr(self, name)}")
        if not 1 <= self.n_levels <= 100:
            raise InputError(f"n_levels must be between 1 and 100, got {self.n_levels}")
        if not 0 < self.contact_weight <= 1:
            raise InputError(
                f"contact_weight must be above 0 and at most 1, got {self.contact_weight}"
            )
        if not (np.isfinite(self.prior_sd) and self.prior_sd > 0):
            raise InputError(f"prior_sd must be positive and finite, got {self.prior_sd}")


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
    solution : Solution, optional
        What `resample_contacts` requires; None if the fit was not used.
    """

    positions: Matrix
    n_contacts: int
    explained: float
    at_rest: float
    n_levels: int
    gains: Matrix
    used: bool
    reason: str = ""
    solution: Solution | None = None


@dataclass(frozen=True, eq=False)
class Solution:
    """The contacts of a fit and their states.

    state: In spacings, around the centre of the map that the fit started from.
    centre (k,): That centre.
    unit: Median distance from a sensor to its nearest neighbour on that map.
    """

    contacts: Contacts
    state: ContactState
    centre: Matrix
    unit: float
    options: ContactOptions


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
    4. all sensors make one Gauss-Newton step with the contacts eliminated (`ReducedSystem`) and the
       prior ``p_i ~ N(given, prior_sd^2)``.
    """
    chosen = options or ContactOptions()
    values, given = np.asarray(readings), np.asarray(positions, dtype=np.float64)
    _check(values, given)
    levels = assign_levels(values, chosen.n_levels, chosen.max_gain_spread, rest)
    if levels.at_rest < chosen.min_at_rest:
        reason = (
            f"only {levels.at_rest:.0%} of the readings are at rest; detecting contacts needs "
            f"{chosen.min_at_rest:.0%}"
        )
        return _unused(given, levels, reason)
    centre, unit = given.mean(axis=0), float(np.median(nearest_distances(given)))
    if not unit > 0:
        return _unused(given, levels, "most sensors coincide with another on the map")
    start = (given - centre) / unit
    contacts = _detect(levels, start, chosen)
    n_contacts = 0 if contacts is None else len(contacts.starts)
    if contacts is None or n_contacts < _MIN_CONTACTS * len(start):
        reason = f"{n_contacts} contacts were found, too few for {len(start)} sensors"
        return _unused(given, levels, reason, n_contacts)
    state = _alternated(contacts, initial_state(contacts, start), start, chosen)
    explained = explained_share(contacts, state)
    if not explained >= chosen.min_explained:
        reason = (
            f"the distance from contacts explains {max(explained, 0.0):.0%} of the entropy of the "
            f"readings around them; {chosen.min_explained:.0%} are required"
        )
        return _unused(given, levels, reason, n_contacts, explained)
    refined = state.positions * unit + centre
    refined.setflags(write=False)
    return ContactFit(
        positions=refined,
        n_contacts=n_contacts,
        explained=explained,
        at_rest=levels.at_rest,
        n_levels=levels.max_level,
        gains=levels.gains,
        used=True,
        solution=Solution(contacts, state, centre, unit, chosen),
    )


def resample_contacts(
    fit: ContactFit, starts: NDArray[np.floating], weights: NDArray[np.floating]
) -> Matrix:
    """Compute the maps that a fit would give of frames with other weights, to first order.

    starts (R, N, k), weights (R, T) -> (R, N, k).

    One Gauss-Newton step of the sensors from the fit, with the profile kept.
    """
    solved = _solution(fit)
    state = solved.state
    located = evaluate(solved.contacts, state.positions, state.contacts, state.profile)
    maps = []
    for start, of_frames in zip(starts, weights, strict=True):
        of_contacts = state.kept * of_frames[solved.contacts.frames]
        reduced = ReducedSystem(solved.contacts, located, of_contacts, len(start))
        steps = reduced.step(
            state.positions - (start - solved.centre) / solved.unit,
            contact_weight=solved.options.contact_weight,
            prior_sd=solved.options.prior_sd,
        )
        maps.append((state.positions + steps) * solved.unit + solved.centre)
    return np.array(maps)


def _solution(fit: ContactFit) -> Solution:
    if fit.solution is None:
        raise InputError("only a fit of contacts that was used can be resampled")
    return fit.solution


def _alternated(
    contacts: Contacts, state: ContactState, start: Matrix, options: ContactOptions
) -> ContactState:
    return alternate(
        contacts,
        state,
        start,
        contact_weight=options.contact_weight,
        prior_sd=options.prior_sd,
        n_steps=options.n_steps,
    )


def _unused(
    given: Matrix, levels: Levels, reason: str, n_contacts: int = 0, explained: float = np.nan
) -> ContactFit:
    kept = given.copy()
    kept.setflags(write=False)
    return ContactFit(
        positions=kept,
        n_contacts=n_contacts,
        explained=explained,
        at_rest=levels.at_rest,
        n_levels=levels.max_level,
        gains=levels.gains,
        used=False,
        reason=reason,
    )


def _detect(levels: Levels, positions: Matrix, options: ContactOptions) -> Contacts | None:
    return find_contacts(
        levels,
        positions,
        min_sensors=options.min_sensors,
        max_readings=max(options.max_readings, options.readings_per_sensor * len(positions)),
    )


def _check(values: NDArray[np.generic], given: Matrix) -> None:
    if values.ndim != 2 or not values.size:
        raise InputError(f"readings must have shape (T, N), got {values.shape}")
    n_sensors = values.shape[1]
    if given.ndim != 2 or len(given) != n_sensors or not given.shape[1]:
        raise InputError(f"positions must have shape ({n_sensors}, k), got {given.shape}")
    if n_sensors < 3:
        raise InputError(f"contacts need at least 3 sensors, got {n_sensors}")
    if not np.isfinite(given).all() or not np.isfinite(values).all():
        raise InputError("readings and positions must be finite")
