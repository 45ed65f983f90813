"""Maps refined by contacts: where each contact was, how readings fall about it, and the sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from anisomap.errors import InputError
from anisomap.numerics.contacts.bundle_adjustment import ReducedSystem
from anisomap.numerics.contacts.detection import Contacts, find_contacts
from anisomap.numerics.contacts.levels import Levels, assign_levels
from anisomap.numerics.contacts.localisation import choose, evaluate, leave_one_out, locate
from anisomap.numerics.contacts.profile import Profile, fit_profile, level_terms

Matrix = NDArray[np.float64]

_FEWEST = 0.5  # contacts a sensor
_WARMING_UP = 4  # rounds of contacts and profile before sensors move
_STEPS_AT_FIRST, _STEPS = 12, 10
_OFF_THE_SURFACE = 0.7  # of a contact's radius
_WORST = 4.0  # contacts whose score lies so many times the upper quartile below the median go
_MOST_DROPPED = 0.4
_SOFTEST = 0.05  # spacings
_SAMEST = 0.02  # of the reach
_FARTHEST_STEP = 0.45  # spacings
_SETTLED = 0.02  # spacings


@dataclass(frozen=True)
class ContactOptions:
    """Parameters of the fit; the defaults were chosen on simulated skins, once for all.

    Parameters
    ----------
    levels : int
        Most levels that readings are sorted into, rest aside; 1 to 100.
    max_gain_spread : float
        Spread of the gains of sensors, as a standard deviation of logarithms, up to which readings
        of different sensors are compared as they are.
    max_readings, readings_per_sensor : int
        About how many readings of contacts to fit, at least 1: in all, or for each sensor,
        whichever is more.
    min_sensors : int
        Fewer touched sensors make no contact; at least 2.
    share : float
        How much each contact counts, in (0, 1]: contacts of frames that follow each other are not
        independent.
    prior_sd : float
        How far a sensor is expected to stray from the given map, in spacings, above 0.
    rounds, steps : int
        How often contacts are looked for, and how often sensors are moved each time.
    min_explained : float
        Share of the entropy of readings that contacts must explain to be believed.
    min_at_rest : float
        Share of readings that must lie at rest for contacts to be believed.
    """

    levels: int = 8
    max_gain_spread: float = 0.3
    max_readings: int = 30_000
    readings_per_sensor: int = 150
    min_sensors: int = 3
    share: float = 0.2
    prior_sd: float = 0.5
    rounds: int = 2
    steps: int = 8
    min_explained: float = 0.45
    min_at_rest: float = 0.2

    def __post_init__(self) -> None:
        for name, least in (
            ("max_readings", 1),
            ("readings_per_sensor", 1),
            ("min_sensors", 2),
            ("rounds", 1),
            ("steps", 1),
            ("max_gain_spread", 0),
        ):
            if not getattr(self, name) >= least:
                raise InputError(f"{name} is {getattr(self, name)}; it must be at least {least}")
        if not 1 <= self.levels <= 100:
            raise InputError(f"levels is {self.levels}; it must be 1 to 100")
        if not 0 < self.share <= 1:
            raise InputError(f"share is {self.share}; it must be above 0 and at most 1")
        if not (np.isfinite(self.prior_sd) and self.prior_sd > 0):
            raise InputError(f"prior_sd is {self.prior_sd}; it must be above 0")


@dataclass(frozen=True, eq=False)
class ContactFit:
    """A map refined by contacts, or left as it was.

    Attributes
    ----------
    positions : ndarray of shape (N, k)
        In the unit and about the centre of the given ones; the very same where not `used`.
    n_contacts : int
        How many were found.
    explained : float
        Share of the entropy of the readings of contacts that distance from the contact explains,
        each reading left out of its own contact's fit; at most 1. NaN where it was not fitted.
    at_rest : float
        Share of all readings that lie at rest.
    gains : ndarray of shape (N,)
        How strongly each sensor reads, over the median.
    used : bool
        Whether the contacts were believed.
    reason : str
        Why not, if not.
    """

    positions: Matrix
    n_contacts: int
    explained: float
    at_rest: float
    gains: Matrix
    used: bool
    reason: str = ""


@dataclass(frozen=True, eq=False)
class _State:
    """What is believed of sensors, contacts, and the profile that connects them."""

    places: Matrix
    contacts: Matrix
    profile: Profile
    kept: NDArray[np.bool_]


def fit_contacts(
    readings: ArrayLike, positions: ArrayLike, options: ContactOptions | None = None
) -> ContactFit:
    """Refine a map by the contacts that made the readings.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings, of any unit.
    positions : array_like of shape (N, k)
        A nearly correct map in any unit, for example from
        `anisomap.numerics.covariogram.fit.fit_covariogram`.
    options : ContactOptions, optional

    Returns
    -------
    ContactFit
        With the given positions where contacts cannot be believed.

    Raises
    ------
    InputError
        If shapes disagree, or something is not finite.

    Notes
    -----
    Contact e is at y_e and reaches R_e far. Sensor i reads level l or higher with probability
    ``expit((R_e - |p_i - y_e| - rho_l) / s)``, but for outliers; ``R_e ~ N(R0, tau^2)``. In turns,

    1. each contact (y, R) is moved to where its readings are most likely, in space from both sides
       of the skin (`locate`);
    2. the worst contacts are dropped, and rho and s are learned from distances that leave each
       reading out of its own contact's fit (`fit_profile`);
    3. R0 and tau are those of the contacts; tau^2 is divided by how many reaches the readings
       determine (MacKay 1992, Neural Computation 4: 415-447);
    4. all sensors make one Gauss-Newton step, the contacts following (`ReducedSystem`), with the
       prior ``p_i ~ N(given, prior_sd^2)``.

    Contacts are looked for again on the refined map. What is given up is said by `ContactOptions`.
    """
    chosen = options or ContactOptions()
    values, given = np.asarray(readings), np.asarray(positions, dtype=np.float64)
    _check(values, given)
    levels = assign_levels(values, chosen.levels, chosen.max_gain_spread)
    if levels.at_rest < chosen.min_at_rest:
        reason = (
            f"only {levels.at_rest:.0%} of the readings are at rest, where "
            f"{chosen.min_at_rest:.0%} must be for contacts to stand out"
        )
        return _unused(given, levels, reason)
    centre, unit = given.mean(axis=0), _spacing(given)
    start = (given - centre) / unit
    places, n_contacts, explained = start, 0, np.nan
    for _ in range(chosen.rounds):
        contacts = _found(levels, places, chosen)
        n_contacts = 0 if contacts is None else len(contacts.starts)
        if contacts is None or n_contacts < _FEWEST * len(places):
            reason = f"{n_contacts} contacts were found, too few for {len(places)} sensors"
            return _unused(given, levels, reason, n_contacts)
        state = _adjusted(contacts, places, start, chosen)
        places, explained = state.places, _explained(contacts, state)
    if not explained >= chosen.min_explained:
        reason = (
            f"the distance from contacts explains {max(explained, 0.0):.0%} of what the sensors "
            f"about them read, where {chosen.min_explained:.0%} make contacts believable"
        )
        return _unused(given, levels, reason, n_contacts, explained)
    refined = places * unit + centre
    refined.setflags(write=False)
    return ContactFit(
        positions=refined,
        n_contacts=n_contacts,
        explained=explained,
        at_rest=levels.at_rest,
        gains=levels.gains,
        used=True,
    )


def _unused(
    given: Matrix, levels: Levels, reason: str, n_contacts: int = 0, explained: float = np.nan
) -> ContactFit:
    kept = given.copy()
    kept.setflags(write=False)
    return ContactFit(kept, n_contacts, explained, levels.at_rest, levels.gains, False, reason)


def _found(levels: Levels, places: Matrix, options: ContactOptions) -> Contacts | None:
    return find_contacts(
        levels,
        places,
        min_sensors=options.min_sensors,
        max_readings=max(options.max_readings, options.readings_per_sensor * len(places)),
    )


def _adjusted(contacts: Contacts, places: Matrix, start: Matrix, options: ContactOptions) -> _State:
    """Move sensors, contacts and profile in turns until the sensors settle."""
    state = _first_guess(contacts, places)
    for _ in range(_WARMING_UP):
        state = _relearned(contacts, state)
    for _ in range(options.steps):
        fitted = evaluate(contacts, state.places, state.contacts, state.profile)
        reduced = ReducedSystem(contacts, fitted, state.kept, len(start))
        moves = reduced.step(state.places - start, share=options.share, prior_sd=options.prior_sd)
        farthest = float(np.linalg.norm(moves, axis=1).max())
        places = state.places + moves * min(1.0, _FARTHEST_STEP / max(farthest, _SETTLED))
        state = _relearned(contacts, _same_size(places, start, state))
        if farthest < _SETTLED:
            break
    return state


def _first_guess(contacts: Contacts, places: Matrix) -> _State:
    """Put contacts amid the sensors that they touch, or off the surface on the better side."""
    k = places.shape[1]
    points, pressed = places[contacts.sensors], contacts.levels > 0
    mass = contacts.total(contacts.levels.astype(np.float64))
    centres = contacts.total(contacts.levels[:, None] * points) / mass[:, None]
    apart = np.linalg.norm(points - centres[contacts.contact_index], axis=1) * pressed
    radii = np.maximum.reduceat(apart, contacts.starts)
    reach = 1.05 * float(np.median(radii)) * (1.22 if k > 2 else 1.0)
    thresholds = np.linspace(0, 0.7 * reach, contacts.max_level)
    profile = Profile(thresholds, 0.1 * reach, reach, 0.2 * reach)
    offset = np.zeros_like(centres)
    if k > 2:
        offset = _OFF_THE_SURFACE * radii[:, None] * _normals(contacts, points)
    above, below = (
        locate(
            contacts,
            places,
            np.column_stack([centres + side * offset, np.full(len(radii), reach)]),
            profile,
            steps=_STEPS_AT_FIRST,
        )
        for side in (1, -1)
    )
    best = choose(contacts, above.scores >= below.scores, above, below)
    return _State(places, best.states, profile, np.ones(len(radii), dtype=bool))


def _normals(contacts: Contacts, points: Matrix) -> Matrix:
    """Give the direction in which the sensors about each contact spread least, shape (E, k)."""
    centres = contacts.total(points) / contacts.sizes[:, None]
    apart = points - centres[contacts.contact_index]
    _, vectors = np.linalg.eigh(contacts.total(apart[:, :, None] * apart[:, None, :]))
    return np.asarray(vectors[:, :, 0])


def _relearned(contacts: Contacts, state: _State) -> _State:
    """Locate all contacts, drop the worst, and learn the profile from what is left."""
    fitted = locate(contacts, state.places, state.contacts, state.profile, steps=_STEPS)
    scores = fitted.scores / contacts.sizes
    lowest, middle, upper = np.quantile(scores, [_MOST_DROPPED, 0.5, 0.75])
    kept = scores >= min(middle - _WORST * (upper - middle), lowest)
    learned = fit_profile(
        contacts.levels,
        leave_one_out(contacts, fitted),
        kept[contacts.contact_index],
        state.profile,
    )
    shift = learned.thresholds[0]
    states = fitted.states.copy()
    states[:, -1] -= shift
    reaches = states[kept, -1]
    reach = float(reaches.mean())
    certain = np.linalg.inv(fitted.precisions[kept])[:, -1, -1] / state.profile.spread**2
    determined = max(float((1 - np.minimum(certain, 1)).sum()), 1e-3 * len(reaches))
    profile = Profile(
        learned.thresholds - shift,
        max(learned.softness, _SOFTEST),
        reach,
        max(float(np.sqrt(((reaches - reach) ** 2).sum() / determined)), _SAMEST * abs(reach)),
    )
    return _State(state.places, states, profile, kept)


def _same_size(places: Matrix, start: Matrix, state: _State) -> _State:
    """Centre a map, and give it the size that it set out with: contacts tell no scale."""
    centre = places.mean(axis=0)
    factor = float(np.sqrt((start**2).sum() / ((places - centre) ** 2).sum()))
    contacts = (state.contacts - np.append(centre, 0.0)) * factor
    return _State((places - centre) * factor, contacts, state.profile.scaled(factor), state.kept)


def _explained(contacts: Contacts, state: _State) -> float:
    """Compare the entropy of levels with what is left of it when the distance is known."""
    fitted = evaluate(contacts, state.places, state.contacts, state.profile)
    scores, _, _ = level_terms(contacts.levels, leave_one_out(contacts, fitted), state.profile)
    counted = state.kept[contacts.contact_index]
    shares = np.bincount(contacts.levels[counted]) / counted.sum()
    entropy = -float((shares[shares > 0] * np.log(shares[shares > 0])).sum())
    return 1 + float(scores[counted].mean()) / entropy


def _spacing(places: Matrix) -> float:
    """Give the median distance from a sensor to its nearest."""
    distances, _ = KDTree(places).query(places, k=2)
    unit = float(np.median(np.asarray(distances)[:, 1]))
    if not unit > 0:
        raise InputError("most sensors share their place with another; contacts refine a map only")
    return unit


def _check(values: NDArray[np.generic], given: Matrix) -> None:
    if values.ndim != 2 or not values.size:
        raise InputError(f"the readings have shape {values.shape}; they must be (T, N)")
    n_sensors = values.shape[1]
    if given.ndim != 2 or len(given) != n_sensors or not given.shape[1]:
        raise InputError(f"the positions have shape {given.shape}; they must be ({n_sensors}, k)")
    if n_sensors < 3:
        raise InputError(f"{n_sensors} sensors are too few for contacts; give 3 or more")
    if not np.isfinite(given).all() or not np.isfinite(values).all():
        raise InputError("the readings and positions must be finite")
