"""Agreement of the contacts of every pair of sensors, for readings that are on or off."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.precision import Floats, Reals, symmetric_from_upper
from anisomap.numerics.similarity.correlation import pearson

MIN_CONTACTS = 50
"""Minimum number of distinct contacts for an agreement; with fewer, its variance exceeds 1 / 50."""

MIN_SINGLE = 0.8
"""Minimum share of the frames with a single contact for an agreement.

It is at least .87 if one body touches the skin (iCub, Nao, rolling, rubbing and pressing), and at
most .54 if several bodies do (bombardment, steps).
"""

_N_NEIGHBOURS = 8  # of the graph in which a contact is connected; 6 gives the same decisions
_SAMPLED_CONTACTS = 600  # regularly sampled; the standard error of their share is below .02
_CONTACTS_AT_ONCE = 4096  # contacts multiplied at a time; bounds the memory


def distinct_contacts(readings: ArrayLike) -> NDArray[np.bool_]:
    """Find the distinct sets of at least two sensors that were active simultaneously.

    readings (T, N).
    """
    return _contacts_and_frames(np.asarray(readings))[0]


def _contacts_and_frames(values: NDArray[np.generic]) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Return distinct contacts, and the first frame of each."""
    # All sensors rest while nothing touches the skin. Contacts may cover most of the skin, so the
    # majority of the sensors decides only without such frames.
    sides = values > values.min(axis=0), values < values.max(axis=0)
    active = max(sides, key=lambda on: (np.count_nonzero(~on.any(axis=1)), -np.count_nonzero(on)))
    frames = np.flatnonzero(np.count_nonzero(active, axis=1) > 1)
    together = active[frames]
    if not len(together):
        return np.asarray(together), frames
    # Hashing whole rows takes a tenth of the time of sorting them.
    packed = np.packbits(together, axis=1)
    rows = packed.view(f"V{packed.shape[1]}").ravel().tolist()
    first = np.sort(list(dict(zip(rows[::-1], range(len(rows) - 1, -1, -1), strict=True)).values()))
    return np.asarray(together[first]), frames[first]


def shows_single_contacts(readings: ArrayLike) -> bool:
    """Return whether readings that are on or off show one contact at a time. readings (T, N)."""
    contacts = distinct_contacts(readings)
    if len(contacts) < MIN_CONTACTS:
        return False
    correlation = pearson(contacts.astype(np.float32))
    np.fill_diagonal(correlation, -np.inf)
    nearest = np.argsort(-correlation, axis=1, kind="stable")[:, :_N_NEIGHBOURS]
    linked = np.zeros(correlation.shape, dtype=bool)
    np.put_along_axis(linked, nearest, values=True, axis=1)
    linked |= linked.T
    sampled = contacts[np.linspace(0, len(contacts) - 1, _SAMPLED_CONTACTS).astype(int)]
    return float(_is_connected(sampled, linked).mean()) >= MIN_SINGLE


def _is_connected(active: NDArray[np.bool_], linked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return whether the active sensors of each contact are connected, shape (C,)."""
    links = linked.astype(np.float32)
    reached = np.zeros_like(active)
    np.put_along_axis(reached, active.argmax(axis=1)[:, None], True, axis=1)
    while True:
        grown = reached | (active & (reached.astype(np.float32) @ links > 0))
        if np.array_equal(grown, reached):
            return np.asarray((reached == active).all(axis=1))
        reached = grown


@dataclass(frozen=True, eq=False)
class Contacts:
    """Distinct contacts of N sensors, and the first frame of each.

    active (C, N), frames (C,)
    """

    active: NDArray[np.bool_]
    frames: NDArray[np.intp]

    @classmethod
    def of(cls, readings: ArrayLike) -> Contacts:
        """Find the distinct contacts of readings, (T, N)."""
        return cls(*_contacts_and_frames(np.asarray(readings)))

    def select(self, sensors: NDArray[np.bool_]) -> Contacts:
        """Return the contacts of some sensors, given as a mask of shape (N,)."""
        return Contacts(self.active[:, sensors], self.frames)

    @cached_property
    def similarity(self) -> Reals:
        """The `contact_agreement` of every pair of sensors, (N, N)."""
        whole = np.array([0, self.frames.max(initial=0) + 1])
        return np.asarray(self.resampled(whole, np.ones((1, 1)))[0])

    def resampled(self, edges: NDArray[np.intp], weights: Floats) -> Floats:
        """Return the agreement over weighted blocks of frames. weights (R, B) -> (R, N, N)."""
        block = np.searchsorted(edges, self.frames, side="right") - 1
        n_sensors = self.active.shape[1]
        together, total = np.zeros((len(weights), n_sensors, n_sensors)), np.zeros(len(weights))
        for i in np.unique(block):
            inside = self.active[block == i]
            for begin in range(0, len(inside), _CONTACTS_AT_ONCE):
                products, weight = _weighted_products(inside[begin : begin + _CONTACTS_AT_ONCE])
                total += weights[:, i] * weight
                together += weights[:, i, None, None] * products
        found = np.empty_like(together)
        for i, sums in enumerate(together):
            found[i] = _agreement(symmetric_from_upper(sums), float(total[i]))
        return found


def contact_agreement(readings: ArrayLike) -> Reals:
    """Compute the chance-corrected agreement of every pair of sensors over distinct contacts.

    readings (T, N), on or off -> Cohen's kappa, (N, N), in [-1, 1]; exactly symmetric, ones on the
    diagonal. 0 for sensors without contacts and for sensors that are part of all contacts.

    Cohen (1960), doi:10.1177/001316446002000104. p_i is the weighted share of contacts in which
    sensor i is active, and p_ij is the share in which both i and j are active::

        kappa_ij = 2 (p_ij - p_i p_j) / (p_i + p_j - 2 p_i p_j)

    The correlation of readings that are on or off depends on the durations of contacts and on
    touches of single sensors, and is dominated by wide contacts. Here, every set of active sensors
    counts once, whatever its duration. A contact of m sensors has weight 1 / m. Frames with a
    single active sensor do not count, since they are no evidence about pairs.
    """
    return Contacts.of(readings).similarity


def _weighted_products(contacts: NDArray[np.bool_]) -> tuple[Floats, float]:
    """Sum the weights of the contacts of both sensors of each pair, and of all. contacts (C, N)."""
    active = contacts.astype(np.float64)
    size = active.sum(axis=1)
    weights = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    active *= np.sqrt(weights)[:, None]
    return active.T @ active, float(weights.sum())


def _agreement(together: Floats, total: float) -> Reals:
    """Compute the agreement of every pair from sums of weights of contacts. together (N, N)."""
    together = together / max(total, np.finfo(np.float64).tiny)
    active = np.diag(together)
    by_chance = np.outer(active, active)
    disagreement = np.add.outer(active, active) - 2 * by_chance
    agreement = 2 * (together - by_chance)
    np.divide(agreement, disagreement, out=agreement, where=disagreement > 0)
    agreement[disagreement <= 0] = 0.0
    np.clip(agreement, -1, 1, out=agreement)
    np.fill_diagonal(agreement, 1.0)
    return agreement
