"""Rewiring within a recording: from some frame on, sensors read the places of others."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.signals import count_contacts, some_sensors
from anisomap.numerics.similarity.rest import ranks_of_depths

_N_BLOCKS = 16  # of a recording; it may change between any two
_MAX_FRAMES = 4096  # of which ranks are correlated
_MIN_CONTACTS = 8  # of a sensor before and after, for correlations that can be compared
_MIN_SENSORS, _MIN_SHARE = 8, 0.5  # that are judged
_MAX_RANK = 0.25  # of its own profile before among those of all: unrelated ones are beyond; by hand
_LEAST_GAIN = 0.3  # of the correlation of profiles, by taking that of another; chosen by hand


def find_rewired(
    readings: NDArray[Any], touched: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], int] | None:
    """Find sensors that read the places of others from a frame on; None if there are none.

    readings, touched (T, N).

    The profile of a sensor is its rank correlation with the others. After a change of wires, its
    profile is that which another sensor of those that changed had before.
    """
    n_frames = len(readings)
    if n_frames < 50 * _N_BLOCKS:
        return None
    chosen = some_sensors(readings.shape[1])
    step = -(-n_frames // _MAX_FRAMES)
    ranks = ranks_of_depths(readings[::step][:, chosen], single=True)
    ranks = ranks - ranks.mean(axis=0)
    blocks = np.array_split(ranks, _N_BLOCKS)
    sums = np.cumsum([block.sum(axis=0, dtype=np.float64) for block in blocks], axis=0)
    products = np.cumsum([(block.T @ block).astype(np.float64) for block in blocks], axis=0)
    counts = np.cumsum([len(block) for block in blocks])
    parts = np.array_split(touched[:, chosen], _N_BLOCKS)
    contacts = np.cumsum([count_contacts(part) for part in parts], axis=0)
    best = np.empty(0, dtype=np.intp)
    frame = 0
    for split in range(_N_BLOCKS - 1):
        least = np.minimum(contacts[split], contacts[-1] - contacts[split])
        judged = np.flatnonzero(least >= _MIN_CONTACTS)
        if judged.size < max(_MIN_SENSORS, _MIN_SHARE * chosen.size):
            continue
        before = _correlation(products[split], sums[split], counts[split], judged)
        after = _correlation(
            products[-1] - products[split], sums[-1] - sums[split],
            counts[-1] - counts[split], judged,
        )  # fmt: skip
        found = chosen[judged[_changed(before, after)]]
        if found.size > best.size:
            best, frame = found, int(counts[split]) * step
    return (best, frame) if best.size else None


def _correlation(
    products: NDArray[np.float64], sums: NDArray[np.float64], count: int, judged: NDArray[np.intp]
) -> NDArray[np.float64]:
    covariance = (products - np.outer(sums, sums) / count)[np.ix_(judged, judged)]
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    return np.asarray(covariance / np.outer(deviation, deviation))


def _changed(before: NDArray[np.float64], after: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the sensors whose profiles after are those of one another before."""
    first, second = _profiles(before), _profiles(after)
    similarity = second @ first.T
    own = np.diag(similarity)
    rank = np.count_nonzero(similarity > own[:, None], axis=1)
    gain = similarity.max(axis=1) - own
    found = np.flatnonzero((rank > _MAX_RANK * len(own)) & (gain > _LEAST_GAIN))
    among = np.isin(similarity.argmax(axis=1)[found], found)
    return found if found.size > 1 and 2 * among.sum() >= found.size else found[:0]


def _profiles(correlation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centre rows and scale them to unit length, without the diagonal."""
    others = ~np.eye(len(correlation), dtype=bool)
    rows = np.where(others, correlation, 0)
    rows = (rows - rows.sum(axis=1, keepdims=True) / (len(rows) - 1)) * others
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12))
