"""Agreement of the contacts of every pair of sensors, for readings that are on or off."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.graph.neighbour_graphs import neighbour_graph
from anisomap.numerics.precision import Floats, Reals, mirror
from anisomap.numerics.similarity.correlation import pearson

MIN_CONTACTS = 50
"""Minimum number of distinct contacts for an agreement; fewer leave a variance above 1 / 50."""

MIN_SINGLE = 0.8
"""Minimum share of the frames with a single contact for an agreement.

At least .87 where one body touches the skin (iCub, Nao, rolling, rubbing and pressing); at most .54
where several do (bombardment, steps).
"""

_N_NEIGHBOURS = 8  # of the graph on which a contact is connected; 6 gives the same decisions
_SAMPLED_CONTACTS = 600  # regularly sampled; the standard error of their share is below .02
_CONTACTS_AT_ONCE = 4096  # contacts multiplied at a time; bounds the memory


def is_on_off(readings: ArrayLike) -> bool:
    """Return whether every sensor takes at most two values, for shape (T, N)."""
    values = np.asarray(readings)
    lowest, highest = values.min(axis=0), values.max(axis=0)
    return all(
        bool(((part == lowest) | (part == highest)).all())
        for part in np.array_split(values, max(1, len(values) // _CONTACTS_AT_ONCE))
    )


def distinct_contacts(readings: ArrayLike) -> NDArray[np.bool_]:
    """Find the different sets of at least two sensors that were active together.

    readings (T, N).
    """
    return _contacts_and_frames(np.asarray(readings))[0]


def _contacts_and_frames(
    values: NDArray[np.generic],
) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Return distinct contacts, and the first frame of each."""
    active = values > values.min(axis=0)
    if 2 * np.count_nonzero(active) > active.size:
        active = values < values.max(axis=0)
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
    """Return whether readings are on or off and show one contact at a time. readings (T, N)."""
    if not is_on_off(readings):
        return False
    contacts = distinct_contacts(readings)
    if len(contacts) < MIN_CONTACTS:
        return False
    linked = neighbour_graph(pearson(contacts.astype(np.float32)), _N_NEIGHBOURS)
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


def contact_agreement(readings: ArrayLike) -> Reals:
    """Compute the chance-corrected agreement of every pair of sensors over distinct contacts.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings, on or off.

    Returns
    -------
    ndarray of shape (N, N)
        Cohen's kappa, in [-1, 1]; exactly symmetric, ones on the diagonal. 0 for sensors without
        contacts and for sensors that are part of all contacts.

    Notes
    -----
    Cohen (1960), doi:10.1177/001316446002000104. With p_i the weighted share of contacts in which
    sensor i is active, and p_ij that in which i and j are::

        kappa_ij = 2 (p_ij - p_i p_j) / (p_i + p_j - 2 p_i p_j)

    The correlation of readings that are on or off depends on how long contacts last and on touches
    of single sensors, and wide contacts dominate it. Here every set of active sensors counts once,
    however long it lasts; a contact of m sensors has weight 1 / m; and frames with a single active
    sensor, which are evidence of no pair, do not count.
    """
    return _agreement(*weighted_contacts(readings))


def weighted_contacts(readings: ArrayLike) -> tuple[Floats, float]:
    """Sum the weights of the distinct contacts in which both sensors of each pair are active.

    readings (T, N) -> together (N, N), total.
    """
    contacts = distinct_contacts(readings)
    n_sensors = contacts.shape[1]
    together = np.zeros((n_sensors, n_sensors))
    total = 0.0
    for begin in range(0, len(contacts), _CONTACTS_AT_ONCE):
        products, weight = _weighted_products(contacts[begin : begin + _CONTACTS_AT_ONCE])
        together += products
        total += weight
    mirror(together)
    return together, total


def _weighted_products(contacts: NDArray[np.bool_]) -> tuple[Floats, float]:
    """Sum the weights of contacts with both sensors of each pair, and of all. contacts (C, N)."""
    scaled = contacts.astype(np.float64)
    weights = 1 / scaled.sum(axis=1)
    scaled *= np.sqrt(weights)[:, None]
    return scaled.T @ scaled, float(weights.sum())


def _agreement(together: Floats, total: float) -> Reals:
    """Compute the agreement from the sums of `weighted_contacts`."""
    active = np.broadcast_to(np.diag(together)[:, None], together.shape)
    return agreement_of_sums(together, active, np.broadcast_to(total, together.shape))


def agreement_of_sums(together: Floats, active: Floats, total: Floats) -> Reals:
    """Compute the agreement of every pair from sums over contacts; see `contact_agreement`.

    together (N, N), active (N, N), total (N, N) -> (N, N).
    """
    weight = np.maximum(total, np.finfo(np.float64).tiny)
    first, second = active / weight, active.T / weight
    by_chance = first * second
    disagreement = first + second - 2 * by_chance
    agreement = 2 * (together / weight - by_chance)
    np.divide(agreement, disagreement, out=agreement, where=disagreement > 0)
    agreement[disagreement <= 0] = 0.0
    np.clip(agreement, -1, 1, out=agreement)
    np.fill_diagonal(agreement, 1.0)
    return agreement


def resampled_contact_agreement(
    readings: ArrayLike, edges: NDArray[np.intp], weights: Floats
) -> Floats:
    """Compute `contact_agreement` of weighted blocks of frames.

    readings (T, N), weights (R, B) -> (R, N, N).
    """
    contacts, frames = _contacts_and_frames(np.asarray(readings))
    block = np.searchsorted(edges, frames, side="right") - 1
    n_sensors = contacts.shape[1]
    together, total = np.zeros((len(weights), n_sensors, n_sensors)), np.zeros(len(weights))
    for i in np.unique(block):
        products, weight = _weighted_products(contacts[block == i])
        total += weights[:, i] * weight
        together += weights[:, i, None, None] * products
    found = np.empty_like(together)
    for i, sums in enumerate(together):
        mirror(sums)
        found[i] = _agreement(sums, float(total[i]))
    return found
