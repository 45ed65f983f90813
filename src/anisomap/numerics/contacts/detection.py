"""Ordinal levels of readings, and the contacts in them.

Levels do not depend on the sensors' response curves. A contact is a patch of pressed sensors around
a peak in one frame, with the sensors at rest around it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array, eye_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from anisomap.numerics.graph.neighbour_graphs import greatest_of_rows
from anisomap.numerics.neighbours import spanning_tree
from anisomap.numerics.similarity.rest import Rest, estimate_rest

Matrix = NDArray[np.float64]
Indices = NDArray[np.intp]

_MIN_DEPTH = 0.02  # of a sensor's range; readings below are at rest
_RANGE_QUANTILE = 0.998  # of all readings; excludes glitches
_MIN_TOUCHES = 5  # readings above rest, for an estimate of the gain
_SAMPLED_FRAMES = 500  # in which readings above rest are counted

# Lengths are in median distances of neighbours on the map.
_N_NEIGHBOURS = 6  # as on a triangular lattice
_MAX_LINK = 2.5  # longer links are kept only in the spanning tree
_REACH = 2.2  # nearer peaks belong to one contact, and nearer sensors at rest bound it
_MIN_RATIO = 1.3  # distance to the second nearest peak over the nearest; ambiguous below
_MAX_TOUCHED = 0.7  # of all sensors; above it a posture or a fault
_MIN_AT_REST = 2  # sensors at rest around a contact, which bound it


@dataclass(frozen=True, eq=False)
class Levels:
    """Readings of some frames as levels, from 0 at rest to `max_level` under the deepest contact.

    values (F, N): Of frames at even intervals.
    max_level: At least 1; each level up to it occurs.
    at_rest: Share of readings within the noise of their sensor's rest.
    gains (N,): Gain of each sensor relative to the median.
    """

    values: NDArray[np.int8]
    max_level: int
    at_rest: float
    gains: Matrix


@dataclass(frozen=True, eq=False)
class Contacts:
    """E contacts and their M readings.

    sensors, levels (M,): Of the readings, ordered by contact; 0 for sensors at rest beside it.
    owners (M,): Contact of each reading.
    starts (E,): First reading of each contact.
    max_level: Highest possible level.
    """

    sensors: Indices
    levels: Indices
    owners: Indices
    starts: Indices
    max_level: int

    @cached_property
    def counts(self) -> Indices:
        """Number of readings of each contact, (E,)."""
        return np.diff(self.starts, append=len(self.sensors))

    def spread(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the value of the contact of each reading, (..., E) -> (..., M)."""
        # Indices, such as `owners`, take several times as long.
        return np.repeat(values, self.counts, axis=-1)


def assign_levels(
    readings: ArrayLike,
    n_levels: int,
    *,
    max_gain_spread: float,
    max_touches: float = np.inf,
    rest: Rest | None = None,
) -> Levels:
    """Quantise readings (T, N) above rest into at most `n_levels` levels of about equal counts.

    Of so many frames that about `max_touches` readings are above rest. Sensors whose log gains
    spread by more than `max_gain_spread` are divided by their gains, the 0.9 quantiles of their
    readings above rest, which are themselves noisy. The rest is estimated if it is not given.
    """
    values = np.asarray(readings)
    rest = estimate_rest(values) if rest is None else rest
    n_frames, n_sensors = values.shape
    sample = rest.depth(values[:: max(1, n_frames // _SAMPLED_FRAMES)])
    touches = n_frames * n_sensors * np.mean(sample > _MIN_DEPTH * np.median(sample.max(axis=0)))
    values = values[:: max(1, round(touches / max_touches))]
    near = np.maximum(rest.threshold, _MIN_DEPTH * np.ptp(values, axis=0))
    at_rest = float((np.abs(values - rest.value) <= near).mean())
    depths = rest.depth(values)
    ordered = np.sort(depths, axis=0)
    extents = ordered[int(_RANGE_QUANTILE * (len(ordered) - 1))]
    extents = np.where(extents > 0, extents, ordered[-1])
    counts = (depths > _MIN_DEPTH * extents).sum(axis=0)
    gains = ordered[len(ordered) - 1 - counts // 10, np.arange(n_sensors)]
    touched = counts > _MIN_TOUCHES
    typical = np.median(gains[touched]) if touched.any() else 1.0
    gains = np.where(touched, gains / typical, 1.0)
    if np.log(gains).std() > max_gain_spread:
        depths /= gains
        extents = extents / gains
    pressed = depths > _MIN_DEPTH * np.median(extents)
    heights = depths[pressed]
    edges = heights
    if heights.size:
        edges = np.unique(np.quantile(heights, np.arange(1, n_levels) / n_levels))
        edges = edges[edges < heights.max()]
    levels = np.zeros(depths.shape, dtype=np.int8)
    levels[pressed] = 1 + np.searchsorted(edges, heights, side="left")
    return Levels(levels, len(edges) + 1, at_rest, gains)


def find_contacts(levels: Levels, positions: ArrayLike, *, min_sensors: int) -> Contacts | None:
    """Find patches of touched neighbours, and split those with several peaks. positions (N, k).

    A touched sensor belongs to the peak of its patch that is nearest, unless others are about as
    near.
    """
    n_sensors = levels.values.shape[1]
    n_touched = np.count_nonzero(levels.values, axis=1)
    usable = (n_touched >= min_sensors) & (n_touched <= _MAX_TOUCHED * n_sensors)
    values = levels.values[usable]
    rows, sensors = np.nonzero(values)
    n_touches = len(rows)
    if not n_touches:
        return None
    distances, neighbours, link = _neighbourhood(np.asarray(positions, dtype=np.float64))
    # Breaks ties between sensors of equal height, independently of their order.
    uneven = 1e-6 * distances.mean(axis=1) / distances.mean()
    smoothing = neighbours + 2 * eye_array(n_sensors)
    smoothed = (smoothing @ values.T).T / np.asarray(smoothing.sum(axis=1)).ravel() + uneven
    heights = smoothed[rows, sensors]

    # Pairs of touches of one frame, the second within reach of the first.
    numbers = np.full(values.shape, -1, dtype=np.intp)
    numbers[rows, sensors] = np.arange(n_touches)
    touch, beside = _entries(csr_array(distances < _REACH * link), sensors)
    other = numbers[rows[touch], beside]
    both = other >= 0
    first, second = touch[both], other[both]
    adjacent = neighbours.toarray()[sensors[first], sensors[second]] > 0
    links = csr_array(
        (np.ones(np.count_nonzero(adjacent)), (first[adjacent], second[adjacent])),
        shape=(n_touches, n_touches),
    )
    patches = connected_components(links, directed=False)[1].astype(np.intp)
    joined = patches[first] == patches[second]
    highest = heights.copy()
    np.maximum.at(highest, first[joined], heights[second[joined]])

    peaks = np.flatnonzero(heights >= highest)
    peaks = peaks[np.argsort(patches[peaks], kind="stable")]
    n_peaks = np.bincount(patches[peaks])
    ends = np.append(0, np.cumsum(n_peaks))
    of_patch = csr_array((np.ones(len(peaks)), peaks, ends), shape=(len(n_peaks), n_touches))
    first, peaks = _entries(of_patch, patches)
    to_peaks = distances[sensors[first], sensors[peaks]]
    order = np.lexsort((to_peaks, first))
    nearest = np.flatnonzero(np.diff(first, prepend=-1))  # `first` is in order and complete
    second_nearest = to_peaks[order[np.minimum(nearest + 1, len(order) - 1)]]
    clear = (n_peaks[patches] == 1) | (second_nearest > _MIN_RATIO * to_peaks[order[nearest]])
    peaks = peaks[order[nearest]]

    resting = ~both & clear[touch]
    borders = np.unique(peaks[touch[resting]] * n_sensors + beside[resting])
    border_peaks, border_sensors = borders // n_sensors, borders % n_sensors
    complete = (np.bincount(peaks[clear], minlength=n_touches) >= min_sensors) & (
        np.bincount(border_peaks, minlength=n_touches) >= _MIN_AT_REST
    )
    if not complete.any():
        return None
    of_contact = np.concatenate([peaks[clear], border_peaks])
    order = np.argsort(of_contact, kind="stable")
    order = order[complete[of_contact[order]]]
    found, starts, owners = np.unique(of_contact[order], return_index=True, return_inverse=True)
    readers = np.concatenate([sensors[clear], border_sensors])[order]
    return Contacts(
        sensors=readers,
        levels=values[rows[found][owners], readers].astype(np.intp),
        owners=owners,
        starts=starts,
        max_level=levels.max_level,
    )


def _neighbourhood(positions: Matrix) -> tuple[Matrix, csr_array, float]:
    """Return distances, an adjacency of neighbours and their median distance."""
    distances = cdist(positions, positions)
    n_near = min(_N_NEIGHBOURS, len(distances) - 1)
    adjacency = greatest_of_rows(-distances, n_near + 1)  # and the sensor itself
    np.fill_diagonal(adjacency, val=False)
    adjacency &= adjacency.T
    tree = spanning_tree(distances)
    link = float(np.median(distances[adjacency | tree]))
    adjacency = (adjacency & (distances < _MAX_LINK * link)) | tree
    return distances, csr_array(adjacency.astype(np.float64)), link


def _entries(lists: csr_array, rows: Indices) -> tuple[Indices, Indices]:
    """Return the entries of rows of a sparse matrix: the index into `rows`, and the column."""
    counts = np.diff(lists.indptr)[rows]
    owners = np.repeat(np.arange(len(rows)), counts)
    offsets = np.arange(len(owners)) - np.repeat(np.cumsum(counts) - counts, counts)
    return owners, lists.indices[lists.indptr[rows][owners] + offsets]
