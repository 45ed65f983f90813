"""Rewiring within a recording: from some frame on, sensors read the places of others."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from anisomap.health.recording_faults.found import Found
from anisomap.numerics.signals import count_contacts, some_sensors
from anisomap.numerics.similarity.rest import ranks_of_depths
from anisomap.recording import Recording

_N_BLOCKS = 16  # of a recording; it may change between any two
_MAX_FRAMES = 2048  # of which ranks are correlated
_MIN_CONTACTS = 8  # of a sensor before and after, for correlations that can be compared
_MIN_SENSORS, _MIN_SHARE = 8, 0.5  # that are judged
_MAX_RANK = 0.25  # of its own profile before among those of all: unrelated ones are beyond; by hand
_LEAST_GAIN = 0.3  # of the correlation of profiles, by taking that of another; chosen by hand
_BY_CHANCE = 0.2  # probability that some profile resembles another so by chance; by hand


def find_rewired(recording: Recording) -> Iterator[Found]:
    """Find sensors that read the places of others from a frame on.

    The profile of a sensor is its rank correlation with the others. After a change of wires, its
    profile is that which another sensor of those that changed had before.
    """
    n_frames = recording.n_frames
    if n_frames < 50 * _N_BLOCKS:
        return
    chosen = some_sensors(recording.n_sensors)
    step = -(-n_frames // _MAX_FRAMES)
    ranks = ranks_of_depths(recording.readings[::step][:, chosen], single=True)
    # A column of ones turns products into sums and counts as well.
    values = np.column_stack([ranks - ranks.mean(axis=0), np.ones(len(ranks), ranks.dtype)])
    blocks = np.array_split(values, _N_BLOCKS)
    moments = np.cumsum([block.T @ block for block in blocks], axis=0, dtype=np.float64)
    parts = np.array_split(recording.signals.touched, _N_BLOCKS)
    contacts = np.cumsum([count_contacts(part[:, chosen]) for part in parts], axis=0)
    best = np.empty(0, dtype=np.intp)
    frame = 0
    for split in range(_N_BLOCKS - 1):
        least = np.minimum(contacts[split], contacts[-1] - contacts[split])
        judged = np.flatnonzero(least >= _MIN_CONTACTS)
        if judged.size < max(_MIN_SENSORS, _MIN_SHARE * chosen.size):
            continue
        before, after = moments[split], moments[-1] - moments[split]
        found = chosen[judged[_changed(_correlation(before, judged), _correlation(after, judged))]]
        if found.size > best.size:
            best, frame = found, int(before[-1, -1]) * step
    if best.size:
        yield Found(
            best,
            best.size / recording.n_sensors,
            f"{best.size} sensors read other places from about frame {frame} of {n_frames} on",
        )


def _correlation(moments: NDArray[np.float64], judged: NDArray[np.intp]) -> NDArray[np.float64]:
    sums, count = moments[-1, judged], moments[-1, -1]
    covariance = moments[np.ix_(judged, judged)] - np.outer(sums, sums) / count
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    return np.asarray(covariance / np.outer(deviation, deviation))


def _changed(before: NDArray[np.float64], after: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the sensors whose profiles after are those of one another before."""
    first, second = _profiles(before), _profiles(after)
    similarity = second @ first.T
    own, most = np.diag(similarity), similarity.max(axis=1)
    rank = np.count_nonzero(similarity > own[:, None], axis=1)
    # Of unrelated profiles, the correlation has the variance 1 / n.
    by_chance = np.sqrt(2 * np.log(max(1, len(own) / _BY_CHANCE)) / len(own))
    found = (rank > _MAX_RANK * len(own)) & (most > np.maximum(by_chance, own + _LEAST_GAIN))
    among = found[similarity.argmax(axis=1)] & found
    enough = found.sum() > 1 and 2 * among.sum() >= found.sum()
    return np.flatnonzero(found) if enough else np.empty(0, dtype=np.intp)


def _profiles(correlation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centre rows and scale them to unit length, without the diagonal."""
    others = ~np.eye(len(correlation), dtype=bool)
    rows = np.where(others, correlation, 0)
    rows = (rows - rows.sum(axis=1, keepdims=True) / (len(rows) - 1)) * others
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12))
