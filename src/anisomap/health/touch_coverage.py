"""Contacts of the skin by place on the map, and the places to touch next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from anisomap.base.immutable import Immutable
from anisomap.base.wording import join_items
from anisomap.errors import InputError
from anisomap.names import match_names
from anisomap.numerics.neighbours import nearest_others
from anisomap.numerics.signals import count_contacts, count_joint_contacts
from anisomap.recording import Recording, join_runs
from anisomap.sensor_map import UNPLACED, SensorMap

ENOUGH_CONTACTS = 12
"""Contacts of a sensor, or of two neighbours together, that suffice: more improve a map little.

Tuned on six simulated recordings (rubbing and bombardment, seeds 11 to 16, 125 to 2000 frames): the
median error of sensors falls from 0.9 spacings at 2 joint contacts with neighbours to 0.33 at 12 to
20, and to 0.31 at 20 to 40.
"""

N_PLACES = 5
"""Default number of places to touch next: as many as a person can remember."""

NEIGHBOUR_RADIUS = 1.5
"""Maximum distance of neighbours, relative to the distance of either one to its nearest sensor.

Neighbours thus include diagonals of a square lattice (1.41), but no second neighbours in a row (2).
"""

_MAX_NEIGHBOURS = 8  # of a sensor on a square lattice, diagonals included
_PLACE_RADIUS = 2.0  # spacings: one stroke of a finger; includes 18 sensors of a triangular lattice
_MAX_IN_PLACE = 18
_MIN_NEED = 0.5  # sensors; for less, a stroke is not worthwhile


@dataclass(frozen=True, eq=False)
class Place(Immutable):
    """A place on the map to touch.

    Attributes
    ----------
    sensors : tuple of int
        Sensors that lack contacts, in decreasing order of need.
    centre : ndarray of shape (k,)
        Centre of these sensors, in units of the map.
    radius : float
        Greatest distance of these sensors from the centre, in units of the map.
    need : float
        Missing evidence, in sensors: 1 is one sensor without any evidence.
    component : int
        Component of the map on which the place is.
    """

    sensors: tuple[int, ...]
    centre: NDArray[np.float64]
    radius: float
    need: float
    component: int

    def in_words(self, names: Sequence[str]) -> str:
        """Return the place as text, such as ``"around s17, s18 and s44"``."""
        return f"around {join_items([names[i] for i in self.sensors[:3]])}"


@dataclass(frozen=True, eq=False)
class TouchCoverage(Immutable):
    """Contacts of the N sensors of a map.

    Attributes
    ----------
    contacts : ndarray of int, shape (N,)
        Separate contacts of each sensor: runs of frames clearly beyond rest, as in `assess`.
    pairs : ndarray of int, shape (P, 2)
        Pairs of neighbours on the map; see `neighbouring_sensors`.
    together : ndarray of int, shape (P,)
        Separate simultaneous contacts of both sensors of a pair.
    need : ndarray of shape (N,)
        See `needed_evidence`.
    places : tuple of Place
        Places to touch next, the most urgent first; empty if no contacts are lacking.
    """

    contacts: NDArray[np.intp]
    pairs: NDArray[np.intp]
    together: NDArray[np.intp]
    need: NDArray[np.float64]
    places: tuple[Place, ...]

    @property
    def untouched(self) -> NDArray[np.intp]:
        """Sensors that were never touched; their positions are unknown."""
        return np.flatnonzero(self.contacts == 0)

    @property
    def never_together(self) -> NDArray[np.intp]:
        """Pairs of neighbours that were never touched at the same time, shape (p, 2)."""
        return np.asarray(self.pairs[self.together == 0])


def touch_coverage(
    sensor_map: SensorMap, recording: Recording | ArrayLike | Sequence[Recording]
) -> TouchCoverage:
    """Count the contacts of sensors and of neighbours on a map, and find where they are lacking.

    Parameters
    ----------
    sensor_map : SensorMap
    recording : Recording, array_like of shape (T, N), or sequence of Recording
        Recordings of the sensors of the map, matched by name. Missing readings count as no contact.

    Returns
    -------
    TouchCoverage

    Raises
    ------
    InputError
        If the recordings do not have the sensors of the map.
    """
    joined = join_runs(recording)
    if set(joined.names) != set(sensor_map.names):
        raise InputError(f"recording and map must have the same sensors, {joined.names[0]!r} ...")
    pairs = neighbouring_sensors(sensor_map.positions, sensor_map.component)
    contacts = np.zeros(sensor_map.n_sensors, dtype=np.intp)
    together = np.zeros(len(pairs), dtype=np.intp)
    for part in joined.parts:
        touched = part.complete("interpolate").signals.touched & np.isfinite(part.readings)
        rows = match_names(part.names, sensor_map.names)
        contacts[rows] += count_contacts(touched)
        column = match_names(sensor_map.names, part.names)
        inside = (column[pairs] >= 0).all(axis=1)
        together[inside] += count_joint_contacts(touched, column[pairs[inside]])
    need = needed_evidence(contacts, pairs, together, sensor_map.component)
    places = next_places(sensor_map.positions, need, component=sensor_map.component)
    return TouchCoverage(contacts, pairs, together, need, places)


def neighbouring_sensors(
    positions: ArrayLike, component: ArrayLike | None = None
) -> NDArray[np.intp]:
    """List the pairs of sensors that are neighbours on a map. positions (N, k)."""
    points = np.asarray(positions, dtype=np.float64)
    found = [np.empty((0, 2), dtype=np.intp)]
    for members in _components(points, component):
        distances, near = nearest_others(points[members], _MAX_NEIGHBOURS)
        if not near.size:
            continue
        nearest = distances[:, 0]
        reach = NEIGHBOUR_RADIUS * np.maximum(nearest[:, None], nearest[near])
        first, which = np.nonzero(distances <= reach)
        both = np.sort(np.column_stack([first, near[first, which]]), axis=1)
        found.append(members[np.unique(both, axis=0)])
    return np.concatenate(found)


def needed_evidence(
    contacts: ArrayLike, pairs: ArrayLike, together: ArrayLike, component: ArrayLike | None = None
) -> NDArray[np.float64]:
    """Compute the missing share of the evidence for each sensor's position. Returns (N,)."""
    number = np.asarray(contacts, dtype=np.float64)
    own = np.maximum(0, 1 - number / ENOUGH_CONTACTS)
    both = np.asarray(pairs, dtype=np.intp).reshape(-1, 2)
    lack = np.maximum(0, 1 - np.asarray(together, dtype=np.float64) / ENOUGH_CONTACTS)
    ends, n_sensors = both.ravel(), len(number)
    total = np.bincount(ends, np.repeat(lack, 2), n_sensors)
    need = np.maximum(own, total / np.maximum(np.bincount(ends, minlength=n_sensors), 1))
    if component is not None:
        need[np.asarray(component) != 0] = 1
    return np.asarray(need)


def next_places(
    positions: ArrayLike,
    need: ArrayLike,
    *,
    component: ArrayLike | None = None,
    n_places: int = N_PLACES,
) -> tuple[Place, ...]:
    """Find the places on a map that lack the most contacts.

    Parameters
    ----------
    positions : array_like of shape (N, k)
        NaN for sensors without a position.
    need : array_like of shape (N,)
        From `needed_evidence`.
    component : array_like of int, shape (N,), optional
        Component of each sensor, -1 without a position; one component by default.
    n_places : int
        Maximum number of places.

    Returns
    -------
    tuple of Place
        The most urgent first. No two places share a sensor. Empty if no place lacks the evidence of
        half a sensor.

    Notes
    -----
    Each place surrounds the sensor with the most `need` within two spacings. Sensors of a place
    count as touched when the next place is chosen.
    """
    points = np.asarray(positions, dtype=np.float64)
    lacking = np.array(need, dtype=np.float64)
    areas = _areas(points, component)
    places: list[Place] = []
    while len(places) < n_places:
        totals = areas @ lacking
        first = int(totals.argmax())
        if totals[first] < _MIN_NEED:
            break
        around = areas[[first]].indices
        needy = around[lacking[around] > 0]
        needy = needy[np.argsort(-lacking[needy], kind="stable")]
        lacking[around] = 0
        centre = points[needy].mean(axis=0)
        places.append(
            Place(
                sensors=tuple(needy.tolist()),
                centre=centre,
                radius=float(np.linalg.norm(points[needy] - centre, axis=1).max()),
                need=float(totals[first]),
                component=0 if component is None else int(np.asarray(component)[needy[0]]),
            )
        )
    return tuple(places)


def _components(points: NDArray[np.float64], component: ArrayLike | None) -> list[NDArray[np.intp]]:
    """Return the placed sensors of each component."""
    placed = np.isfinite(points).all(axis=1)
    labels = np.where(placed, 0, UNPLACED) if component is None else np.asarray(component)
    labels = np.where(placed, labels, UNPLACED)
    return [np.flatnonzero(labels == label) for label in np.unique(labels[labels != UNPLACED])]


def _areas(points: NDArray[np.float64], component: ArrayLike | None) -> csr_array:
    """Mark placed sensors within two spacings of each sensor, including itself, shape (N, N)."""
    pairs = []
    for members in _components(points, component):
        distances, near = nearest_others(points[members], _MAX_IN_PLACE)
        spacing = np.median(distances[:, 0]) if near.size else 0.0
        first, which = np.nonzero(distances <= _PLACE_RADIUS * spacing)
        pairs += [(members, members), (members[first], members[near[first, which]])]
    rows, others = np.hstack(pairs) if pairs else np.empty((2, 0), dtype=np.intp)
    area = csr_array((np.ones(rows.size), (rows, others)), shape=(len(points), len(points)))
    area.sum_duplicates()
    return area
