"""Detection of contacts: adjacent pressed sensors in a frame, and sensors at rest around them."""

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

# Chosen by hand on simulated skins, seeds 101 to 105; lengths in median links between neighbours.
_N_NEIGHBOURS = 6  # as on a triangular lattice
_MAX_LINK = 2.5  # longer links are kept only in the spanning tree
_BORDER_WIDTH = 2.2  # within which resting sensors bound a contact
_MIN_PEAK_DISTANCE = 2.2  # nearer peaks belong to one contact
_MIN_DISTANCE_RATIO = 1.3  # to the second nearest peak over the nearest; ambiguous below
_MAX_TOUCHED = 0.7  # of all sensors; above it a posture or a fault
_MIN_AT_REST = 2  # resting sensors around a contact, which bound it
_SAMPLE_FRAMES = 200  # from which the number of contacts is predicted


@dataclass(frozen=True, eq=False)
class Contacts:
    """E contacts and their M readings.

    Attributes
    ----------
    sensors : ndarray of int, shape (M,)
        Sensor of each reading, ordered by contact.
    levels : ndarray of int, shape (M,)
        Level of each reading; 0 for sensors at rest beside the contact.
    starts : ndarray of int, shape (E,)
        Index of the first reading of each contact.
    frames : ndarray of int, shape (E,)
        Frame of each contact.
    max_level : int
        Highest possible level.
    """

    sensors: Indices
    levels: Indices
    starts: Indices
    frames: Indices
    max_level: int

    @property
    def sizes(self) -> Indices:
        """Number of readings of each contact, shape (E,)."""
        return np.diff(self.starts, append=len(self.sensors))

    @cached_property
    def contact_index(self) -> Indices:
        """Contact of each reading, shape (M,)."""
        return np.repeat(np.arange(len(self.starts)), self.sizes)

    def total(self, values: Matrix) -> Matrix:
        """Sum values over the readings of each contact: (M, ...) to (E, ...)."""
        return np.asarray(np.add.reduceat(values, self.starts, axis=0))


@dataclass(frozen=True, eq=False)
class _Neighbourhood:
    """Distances on a map, the median link length, and the links between neighbours."""

    distances: Matrix
    link: float
    adjacency: csr_array

    @cached_property
    def smoothing(self) -> csr_array:
        weights = self.adjacency + 2 * eye_array(len(self.distances))
        return csr_array(weights / np.asarray(weights.sum(axis=1))[:, None])


def find_contacts(
    levels: Levels, positions: ArrayLike, *, min_sensors: int, max_readings: int
) -> Contacts | None:
    """Find patches of touched neighbours, and split those with several peaks.

    Parameters
    ----------
    levels : Levels
    positions : array_like of shape (N, k)
        A map; only its neighbourhoods matter.
    min_sensors : int
        Fewest touched sensors of a contact.
    max_readings : int
        Approximate number of readings to return. If there are more, frames are skipped evenly,
        since consecutive frames are redundant.

    Returns
    -------
    Contacts or None
        None if there are none.
    """
    nearby = _neighbourhood(np.asarray(positions, dtype=np.float64))
    n_frames = len(levels.values)
    sample = np.arange(0, n_frames, max(1, n_frames // _SAMPLE_FRAMES))
    sampled = _detect(levels, nearby, sample, min_sensors)
    if sampled is None:
        return None
    expected = len(sampled.sensors) * n_frames / len(sample)
    stride = max(1, round(expected / max_readings))
    return _detect(levels, nearby, np.arange(0, n_frames, stride), min_sensors)


def _neighbourhood(positions: Matrix) -> _Neighbourhood:
    distances = cdist(positions, positions)
    n_sensors = len(distances)
    near = np.argsort(distances, axis=1)[:, 1 : min(_N_NEIGHBOURS, n_sensors - 1) + 1]
    adjacency = np.zeros(distances.shape, dtype=bool)
    np.put_along_axis(adjacency, near, values=True, axis=1)
    adjacency &= adjacency.T
    # scipy.sparse.csgraph reads a dense 0 as no edge.
    tree = minimum_spanning_tree(np.maximum(distances, np.finfo(float).tiny)).toarray() > 0
    tree |= tree.T
    link = float(np.median(distances[adjacency | tree]))
    adjacency = (adjacency & (distances < _MAX_LINK * link)) | tree
    return _Neighbourhood(distances, link, csr_array(adjacency.astype(np.float64)))


def _detect(
    levels: Levels, nearby: _Neighbourhood, frames: Indices, min_sensors: int
) -> Contacts | None:
    smoothed = np.asarray((nearby.smoothing @ levels.values[frames].T).T)
    # Breaks ties between sensors of equal height, independently of their order.
    smoothed = smoothed + 1e-6 * nearby.distances.mean(axis=1) / nearby.distances.mean()
    found = [
        (frame, pressed, resting)
        for frame, heights in zip(frames, smoothed, strict=True)
        for pressed, resting in _contacts_of(levels.values[frame] > 0, heights, nearby, min_sensors)
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
    touched: NDArray[np.bool_], heights: Matrix, nearby: _Neighbourhood, min_sensors: int
) -> Iterator[tuple[Indices, Indices]]:
    """Yield the pressed sensors of each contact of a frame, and those at rest beside them."""
    active = np.flatnonzero(touched)
    if not min_sensors <= len(active) <= _MAX_TOUCHED * len(touched):
        return
    n_patches, patch_of = connected_components(nearby.adjacency[active][:, active], directed=False)
    for patch in range(n_patches):
        inside = active[patch_of == patch]
        if len(inside) < min_sensors:
            continue
        for pressed in _split_at_peaks(inside, heights[inside], nearby):
            beside = (nearby.distances[pressed] < _BORDER_WIDTH * nearby.link).any(axis=0)
            resting = np.flatnonzero(beside & ~touched)
            if len(pressed) >= min_sensors and len(resting) >= _MIN_AT_REST:
                yield pressed, resting


def _split_at_peaks(inside: Indices, heights: Matrix, nearby: _Neighbourhood) -> list[Indices]:
    distances = nearby.distances[np.ix_(inside, inside)]
    near = distances < _MIN_PEAK_DISTANCE * nearby.link
    peaks = np.flatnonzero(heights >= np.where(near, heights, -np.inf).max(axis=1))
    if len(peaks) == 1:
        return [inside]
    to_peaks = distances[:, peaks]
    nearest, second = np.sort(to_peaks, axis=1)[:, :2].T
    owner, clear = to_peaks.argmin(axis=1), second > _MIN_DISTANCE_RATIO * nearest
    return [inside[(owner == peak) & clear] for peak in range(len(peaks))]
