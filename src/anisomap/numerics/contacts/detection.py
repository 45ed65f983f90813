"""Ordinal levels of readings, which are independent of the sensors' response curves.

Detection of contacts: adjacent pressed sensors in a frame, and sensors at rest around them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array, eye_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from anisomap.numerics.graph.neighbour_graphs import greatest_of_rows
from anisomap.numerics.neighbours import spanning_tree
from anisomap.numerics.similarity.rest import Rest, estimate_rest

Floats = NDArray[np.float64]

# Chosen by hand on simulated skins, seeds 101 to 105.
_MIN_DEPTH = 0.02  # of a sensor's range; readings below are at rest
_RANGE_QUANTILE = 0.998  # of all readings; excludes glitches
_GAIN_QUANTILE = 0.9  # of the readings above rest
_MIN_TOUCHES = 5  # readings above rest, for an estimate of the gain


@dataclass(frozen=True, eq=False)
class Levels:
    """Readings as ordinal levels, from 0 at rest to `max_level` under the deepest contact.

    max_level: At least 1; each level up to it occurs.
    at_rest: Share of all readings within the noise of their sensor's rest.
    gains (N,): Gain of each sensor relative to the median.
    """

    values: NDArray[np.int8]
    max_level: int
    at_rest: float
    gains: NDArray[np.float64]


def assign_levels(
    readings: ArrayLike, n_levels: int, max_gain_spread: float, rest: Rest | None = None
) -> Levels:
    """Quantise readings (T, N) above rest into at most `n_levels` levels of about equal counts.

    Sensors whose log gains spread by more than `max_gain_spread` are divided by their gains, the
    0.9 quantiles of their readings above rest, which are themselves noisy. The rest is estimated
    if it is not given.
    """
    values = np.asarray(readings)
    rest = estimate_rest(values) if rest is None else rest
    depths = np.ascontiguousarray(rest.depth(values).T)  # sensor by sensor
    ordered = [np.sort(depth[depth > 0]) for depth in depths]
    typical = np.quantile(depths, _RANGE_QUANTILE, axis=1)
    typical = np.where(typical > 0, typical, [one[-1] if one.size else 0.0 for one in ordered])
    gains = _gains(ordered, typical)
    if np.log(gains).std() > max_gain_spread:
        depths /= gains[:, None]
        ordered = [one / gain for one, gain in zip(ordered, gains, strict=True)]
        typical = typical / gains
    least_depth = _MIN_DEPTH * np.median(typical)
    pressed = np.concatenate([one[one > least_depth] for one in ordered])
    edges = pressed
    if pressed.size:
        edges = np.unique(np.quantile(pressed, np.arange(1, n_levels) / n_levels))
    edges = edges[edges < pressed.max(initial=0.0)]
    by_sensor = np.empty(depths.shape, dtype=np.int8)
    for depth, row in zip(depths, by_sensor, strict=True):
        row[:] = (depth > least_depth) * (1 + np.searchsorted(edges, depth, side="left"))
    extent = values.max(axis=0).astype(np.float64) - values.min(axis=0)
    near = np.maximum(rest.threshold, _MIN_DEPTH * extent)
    at_rest = float((np.abs(values - rest.value) <= near).mean()) if values.size else 0.0
    levels, gains = np.ascontiguousarray(by_sensor.T), gains / np.median(gains)
    for array in (levels, gains):
        array.setflags(write=False)
    return Levels(values=levels, max_level=len(edges) + 1, at_rest=at_rest, gains=gains)


def _gains(ordered: list[Floats], typical: Floats) -> Floats:
    """Return the gain of each sensor; the median of all for a rarely touched sensor."""
    gains = np.full(len(ordered), np.nan)
    for i, depth in enumerate(ordered):
        touched = depth[depth > _MIN_DEPTH * typical[i]]
        if touched.size > _MIN_TOUCHES:
            gains[i] = np.quantile(touched, _GAIN_QUANTILE)
    known = np.isfinite(gains)
    return np.where(known, gains, np.median(gains[known]) if known.any() else 1.0)


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

    sensors: Sensor of each reading, ordered by contact.
    levels: Level of each reading; 0 for sensors at rest beside the contact.
    starts: Index of the first reading of each contact.
    frames: Frame of each contact.
    max_level: Highest possible level.
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

    def select(self, chosen: NDArray[np.bool_]) -> Contacts:
        """Return some contacts, given as a mask of shape (E,)."""
        if chosen.all():
            return self
        kept = chosen[self.contact_index]
        sizes = self.sizes[chosen]
        return replace(
            self,
            sensors=self.sensors[kept],
            levels=self.levels[kept],
            starts=np.cumsum(sizes) - sizes,
            frames=self.frames[chosen],
        )


@dataclass(frozen=True, eq=False)
class _Neighbourhood:
    """Distances on a map, and for each sensor its neighbours and the sensors near it."""

    distances: Matrix
    neighbours: csr_array
    near_peaks: csr_array
    near_borders: csr_array

    @cached_property
    def smoothing(self) -> csr_array:
        weights = self.neighbours + 2 * eye_array(len(self.distances))
        return csr_array(weights / np.asarray(weights.sum(axis=1))[:, None])


@dataclass(frozen=True, eq=False)
class _Touches:
    """K touched sensors, ordered by frame and sensor; those of a patch are joined by neighbours.

    `numbers`, shape (T, N), is the index of the touch of each frame and sensor, or -1.
    """

    rows: Indices
    sensors: Indices
    heights: Matrix
    patches: Indices
    numbers: NDArray[np.int32]

    def pairs(self, lists: csr_array) -> tuple[Indices, Indices]:
        """Return pairs of touches in a frame, the second in the list of the first's sensor."""
        first, sensors = _entries(lists, self.sensors)
        second = self.numbers[self.rows[first], sensors].astype(np.intp)
        return first[second >= 0], second[second >= 0]


def find_contacts(
    levels: Levels, positions: ArrayLike, *, min_sensors: int, max_readings: int
) -> Contacts | None:
    """Find patches of touched neighbours, and split those with several peaks. positions (N, k)."""
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
    n_near = min(_N_NEIGHBOURS, n_sensors - 1)
    adjacency = greatest_of_rows(-distances, n_near + 1)  # and the sensor itself
    np.fill_diagonal(adjacency, val=False)
    adjacency &= adjacency.T
    tree = spanning_tree(distances)
    link = float(np.median(distances[adjacency | tree]))
    adjacency = (adjacency & (distances < _MAX_LINK * link)) | tree
    return _Neighbourhood(
        distances,
        csr_array(adjacency.astype(np.float64)),
        csr_array(distances < _MIN_PEAK_DISTANCE * link),
        csr_array(distances < _BORDER_WIDTH * link),
    )


def _detect(
    levels: Levels, nearby: _Neighbourhood, frames: Indices, min_sensors: int
) -> Contacts | None:
    values = levels.values[frames]
    n_sensors = values.shape[1]
    n_touched = np.count_nonzero(values, axis=1)
    usable = (n_touched >= min_sensors) & (n_touched <= _MAX_TOUCHED * n_sensors)
    frames, values = frames[usable], values[usable]
    if not len(frames):
        return None
    touches = _touches(values, nearby)
    pressed, peaks = _split_at_peaks(touches, nearby)

    owners, beside = _entries(nearby.near_borders, touches.sensors[pressed])
    at_rest = values[touches.rows[pressed][owners], beside] == 0
    borders = np.unique(peaks[owners[at_rest]] * n_sensors + beside[at_rest])
    border_peaks, resting = borders // n_sensors, borders % n_sensors

    n_touches = len(touches.sensors)
    complete = (np.bincount(peaks, minlength=n_touches) >= min_sensors) & (
        np.bincount(border_peaks, minlength=n_touches) >= _MIN_AT_REST
    )
    if not complete.any():
        return None
    of_contact = np.concatenate([peaks, border_peaks])
    order = np.argsort(of_contact, kind="stable")
    order = order[complete[of_contact[order]]]
    sensors = np.concatenate([touches.sensors[pressed], resting])[order]
    of_contact = of_contact[order]
    _, starts = np.unique(of_contact, return_index=True)
    rows = touches.rows[of_contact[starts]]
    return Contacts(
        sensors=sensors,
        levels=values[touches.rows[of_contact], sensors].astype(np.intp),
        starts=starts,
        frames=frames[rows],
        max_level=levels.max_level,
    )


def _touches(values: NDArray[np.int8], nearby: _Neighbourhood) -> _Touches:
    """Find touched sensors, and join touched neighbours in a frame to patches."""
    smoothed = np.asarray((nearby.smoothing @ values.T).T)
    # Breaks ties between sensors of equal height, independently of their order.
    smoothed = smoothed + 1e-6 * nearby.distances.mean(axis=1) / nearby.distances.mean()
    rows, sensors = np.nonzero(values)
    numbers = np.full(values.shape, -1, dtype=np.int32)
    numbers[rows, sensors] = np.arange(len(rows))
    touches = _Touches(rows, sensors, smoothed[rows, sensors], np.zeros_like(rows), numbers)
    first, second = touches.pairs(nearby.neighbours)
    links = csr_array((np.ones(len(first)), (first, second)), shape=(len(rows), len(rows)))
    _, patches = connected_components(links, directed=False)
    return replace(touches, patches=patches.astype(np.intp))


def _split_at_peaks(touches: _Touches, nearby: _Neighbourhood) -> tuple[Indices, Indices]:
    """Return the touches that are clearly nearest to one peak of their patch, and these peaks."""
    heights, patches, sensors = touches.heights, touches.patches, touches.sensors
    first, second = touches.pairs(nearby.near_peaks)
    joined = patches[first] == patches[second]
    highest = heights.copy()
    np.maximum.at(highest, first[joined], heights[second[joined]])
    peaks = np.flatnonzero(heights >= highest)
    peaks = peaks[np.argsort(patches[peaks], kind="stable")]
    n_peaks = np.bincount(patches[peaks])
    of_patch = csr_array(
        (np.ones(len(peaks)), peaks, np.append(0, np.cumsum(n_peaks))),
        shape=(len(n_peaks), len(heights)),
    )
    first, peaks = _entries(of_patch, patches)
    distances = nearby.distances[sensors[first], sensors[peaks]]
    order = np.lexsort((distances, first))
    nearest = np.flatnonzero(np.diff(first, prepend=-1))  # `first` is in order and complete
    second_nearest = distances[order[np.minimum(nearest + 1, len(order) - 1)]]
    clear = (n_peaks[patches] == 1) | (
        second_nearest > _MIN_DISTANCE_RATIO * distances[order[nearest]]
    )
    return np.flatnonzero(clear), peaks[order[nearest[clear]]]


def _entries(lists: csr_array, rows: Indices) -> tuple[Indices, Indices]:
    """Return the entries of rows of a sparse matrix: the index into `rows`, and the column."""
    counts = np.diff(lists.indptr)[rows]
    owners = np.repeat(np.arange(len(rows)), counts)
    offsets = np.arange(len(owners)) - np.repeat(np.cumsum(counts) - counts, counts)
    return owners, lists.indices[lists.indptr[rows][owners] + offsets]
