"""Contacts in readings: which sensors one thing presses at one time, and which it just misses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array, eye_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial.distance import cdist

from anisomap.numerics.contacts.levels import Levels

Matrix = NDArray[np.float64]
Indices = NDArray[np.intp]

_NEIGHBOURS = 6
_LONGEST_LINK = 2.5  # median links; a longer one joins parts of a skin only where nothing else does
_BESIDE = 2.2  # median links; so near are the resting sensors that bound a contact
_APART = 2.2  # median links; peaks that are nearer are one
_CLEAR = 1.3  # a sensor between two peaks belongs to neither unless so many times nearer to one
_MOST_TOUCHED = 0.7  # of all sensors; more is no contact but a posture, or a fault
_FEWEST_AT_REST = 2
_SAMPLE = 200  # frames that tell how many contacts to expect


@dataclass(frozen=True, eq=False)
class Contacts:
    """E contacts, and the M readings that tell of them.

    Attributes
    ----------
    sensors : ndarray of int, shape (M,)
        Which sensor each reading is of, contact after contact.
    levels : ndarray of int, shape (M,)
        The readings: 0 where a sensor beside the contact rests.
    starts : ndarray of int, shape (E,)
        Where each contact's readings begin.
    frames : ndarray of int, shape (E,)
        When each contact was.
    max_level : int
        The highest level there can be.
    """

    sensors: Indices
    levels: Indices
    starts: Indices
    frames: Indices
    max_level: int

    @property
    def sizes(self) -> Indices:
        """How many readings each contact has, shape (E,)."""
        return np.diff(self.starts, append=len(self.sensors))

    @cached_property
    def contact_index(self) -> Indices:
        """Which contact each reading belongs to, shape (M,)."""
        return np.repeat(np.arange(len(self.starts)), self.sizes)

    def total(self, values: Matrix) -> Matrix:
        """Sum something over the readings of each contact: (M, ...) to (E, ...)."""
        return np.asarray(np.add.reduceat(values, self.starts, axis=0))


@dataclass(frozen=True, eq=False)
class _Surroundings:
    """What is near what on a map."""

    distances: Matrix
    link: float
    joined: csr_array

    @cached_property
    def smoothing(self) -> csr_array:
        kept = self.joined + 2 * eye_array(len(self.distances))
        return csr_array(kept / np.asarray(kept.sum(axis=1))[:, None])


def find_contacts(
    levels: Levels, places: ArrayLike, *, min_sensors: int, max_readings: int
) -> Contacts | None:
    """Find contacts: touched neighbours, cut apart where there are several peaks among them.

    Parameters
    ----------
    levels : Levels
    places : array_like of shape (N, k)
        A map; only what is near what matters.
    min_sensors : int
        Fewer touched sensors do not tell where a contact is.
    max_readings : int
        About how many readings of contacts to look for. Frames are left out evenly if there are
        more: those that follow each other tell nearly the same.

    Returns
    -------
    Contacts or None
        None if there are none.
    """
    around = _survey(np.asarray(places, dtype=np.float64))
    n_frames = len(levels.values)
    sample = np.arange(0, n_frames, max(1, n_frames // _SAMPLE))
    few = _gather(levels, around, sample, min_sensors)
    if few is None:
        return None
    expected = len(few.sensors) * n_frames / len(sample)
    stride = max(1, round(expected / max_readings))
    return _gather(levels, around, np.arange(0, n_frames, stride), min_sensors)


def _survey(places: Matrix) -> _Surroundings:
    distances = cdist(places, places)
    n_sensors = len(distances)
    near = np.argsort(distances, axis=1)[:, 1 : min(_NEIGHBOURS, n_sensors - 1) + 1]
    joined = np.zeros(distances.shape, dtype=bool)
    np.put_along_axis(joined, near, values=True, axis=1)
    joined &= joined.T
    # Edges must be positive: scipy reads a dense 0 as no edge.
    tree = minimum_spanning_tree(np.maximum(distances, np.finfo(float).tiny)).toarray() > 0
    tree |= tree.T
    link = float(np.median(distances[joined | tree]))
    joined = (joined & (distances < _LONGEST_LINK * link)) | tree
    return _Surroundings(distances, link, csr_array(joined.astype(np.float64)))


def _gather(
    levels: Levels, around: _Surroundings, frames: Indices, min_sensors: int
) -> Contacts | None:
    smoothed = np.asarray((around.smoothing @ levels.values[frames].T).T)
    # Sensors of equal height are no two peaks: the outer one counts, in any order of sensors.
    smoothed = smoothed + 1e-6 * around.distances.mean(axis=1) / around.distances.mean()
    found = [
        (frame, pressed, resting)
        for frame, heights in zip(frames, smoothed, strict=True)
        for pressed, resting in _contacts_of(levels.values[frame] > 0, heights, around, min_sensors)
    ]
    if not found:
        return None
    sizes = np.array([len(pressed) + len(resting) for _, pressed, resting in found])
    return Contacts(
        sensors=np.concatenate([np.concatenate(of_contact[1:]) for of_contact in found]),
        levels=np.concatenate(
            [
                np.append(levels.values[frame, pressed], np.zeros(len(resting), dtype=np.intp))
                for frame, pressed, resting in found
            ]
        ).astype(np.intp),
        starts=np.cumsum(sizes) - sizes,
        frames=np.array([frame for frame, _, _ in found]),
        max_level=levels.max_level,
    )


def _contacts_of(
    touched: NDArray[np.bool_], heights: Matrix, around: _Surroundings, min_sensors: int
) -> Iterator[tuple[Indices, Indices]]:
    """Give the pressed sensors of each contact of a frame, and those at rest beside them."""
    active = np.flatnonzero(touched)
    if not min_sensors <= len(active) <= _MOST_TOUCHED * len(touched):
        return
    n_patches, patch_of = connected_components(around.joined[active][:, active], directed=False)
    for patch in range(n_patches):
        inside = active[patch_of == patch]
        if len(inside) < min_sensors:
            continue
        for pressed in _cut_apart(inside, heights[inside], around):
            beside = (around.distances[pressed] < _BESIDE * around.link).any(axis=0)
            resting = np.flatnonzero(beside & ~touched)
            if len(pressed) >= min_sensors and len(resting) >= _FEWEST_AT_REST:
                yield pressed, resting


def _cut_apart(inside: Indices, heights: Matrix, around: _Surroundings) -> list[Indices]:
    distances = around.distances[np.ix_(inside, inside)]
    near = distances < _APART * around.link
    peaks = np.flatnonzero(heights >= np.where(near, heights, -np.inf).max(axis=1))
    if len(peaks) == 1:
        return [inside]
    to_peaks = distances[:, peaks]
    nearest, second = np.sort(to_peaks, axis=1)[:, :2].T
    owner, clear = to_peaks.argmin(axis=1), second > _CLEAR * nearest
    return [inside[(owner == peak) & clear] for peak in range(len(peaks))]
