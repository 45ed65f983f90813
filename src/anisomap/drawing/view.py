"""Common parts of figures and reports: components prepared for drawing, views, and file names."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from anisomap.base.wording import printable, shortened
from anisomap.errors import FileError
from anisomap.evaluation import Score
from anisomap.numerics.neighbours import padded
from anisomap.sensor_map import SensorMap, ellipses, is_faulty

Points: TypeAlias = NDArray[np.float64]
View: TypeAlias = tuple[float, float]
"""Direction of view: elevation above the x-y plane and azimuth, in degrees."""

VIEWS: tuple[View, ...] = ((18.0, -60.0), (18.0, 30.0), (65.0, -90.0))
"""Available views: the default, a view from its right, and a view from above, x to the right."""

_MIN_SPREAD = 0.4  # of the longest axis; shorter axes use a part of the range of colours
# Ottosson (2020), "A perceptual color space for image processing": OKLab to linear sRGB.
_LAB_TO_CONES = np.array(
    [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.2914855480],
    ]
)
_CONES_TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


def place_colours(points: ArrayLike, view: View = VIEWS[0]) -> Points:
    """Encode positions as colours. points (N, 2 or 3) -> (N, 3).

    Seen from `view`, up is light, right is yellow and left is blue: these two contrasts are visible
    with every common colour vision deficiency. Red is near and green is far; in 2D, low and high.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.shape[1] == 2:
        right, up = _spread(points).T
        nearer = -up
    else:
        right, up, nearer = _spread(points @ view_axes(view).T).T
    # The largest contrasts in OKLab that stay within sRGB: clipping would merge colours.
    lab = np.column_stack([0.58 + 0.20 * up, 0.10 * nearer, 0.11 * right])
    linear = np.clip((lab @ _LAB_TO_CONES.T) ** 3 @ _CONES_TO_RGB.T, 0, 1)
    curved = 1.055 * linear ** (1 / 2.4) - 0.055
    return np.asarray(np.where(linear <= 0.0031308, 12.92 * linear, curved))


def view_axes(view: View) -> Points:
    """Return the unit vectors to the right, up, and towards the viewer, shape (3, 3)."""
    elevation, azimuth = np.radians(view)
    right = [-np.sin(azimuth), np.cos(azimuth), 0.0]
    towards = [
        np.cos(elevation) * np.cos(azimuth),
        np.cos(elevation) * np.sin(azimuth),
        np.sin(elevation),
    ]
    return np.array([right, np.cross(towards, right), towards])


def _spread(points: Points) -> Points:
    """Scale each axis to [-1, 1], and short axes to less, so that noise is not coloured."""
    lowest, highest = points.min(axis=0), points.max(axis=0)
    half = (highest - lowest) / 2
    half = np.maximum(half, _MIN_SPREAD * half.max())
    middle = (lowest + highest) / 2
    return np.asarray((points - middle) / np.where(half > 0, half, 1))


MAX_JOINED = 10_000
"""Maximum number of sensors whose neighbours are joined: more lines would form a grey area."""

_DEFAULT_VIEW_BONUS = 1.25  # minimum gain of another view over the default view
_N_NEIGHBOURS = 8
_MAX_LENGTH = 2.5  # of a line, in distances to the nearest sensor
_ALIKE = 1.25  # ratio of the 90 % to the 10 % quantile of half axes that is hardly visible
_PLANAR = 1e-6  # largest height of a planar configuration, in units of its width
_N_LABELS, _LABEL_ALL = 8, 24
_MAX_LABEL, MAX_UNITS = 14, 24  # characters
_GREY = 0.72


@dataclass(frozen=True, eq=False)
class Panel:
    """A component of a map, or true positions, prepared for drawing in 2D or 3D.

    points (n, k), covariances (n, k, k): Aligned with the truth if it is known, else centred.
    colours (n, 3): sRGB in [0, 1] by true position if known, else by position; grey for sensors
        that were not compared.
    pairs: Neighbours by true position if known, else by position; empty above `MAX_JOINED` sensors.
    uncompared, faulty (n,): Sensors that the score excludes, and faulty sensors, to be marked.
    sensors: Indices in the map; sensors that were compared with the truth are first.
    truth (m, k), errors (m,): True positions of the first m sensors, and their errors; empty if the
        truth is unknown.
    number: Number of the component, from 1 for the largest.
    labels: Names written beside points.
    unplaced (m, k): True positions of sensors that maps do not place, drawn as rings.
    limits (k, 2): Limits of the axes; by default around all marks.
    """

    points: Points
    colours: Points
    pairs: NDArray[np.intp]
    view: View
    units: str
    uncompared: NDArray[np.bool_]
    faulty: NDArray[np.bool_]
    sensors: NDArray[np.intp]
    truth: Points
    errors: Points = field(default_factory=lambda: np.empty(0))
    number: int = 1
    covariances: Points | None = None
    labels: Mapping[int, str] = field(default_factory=dict)
    unplaced: Points | None = None
    limits: Points | None = None
    title: str = ""

    @property
    def dimensions(self) -> int:
        """Number of coordinates drawn, 2 or 3."""
        return int(self.points.shape[1])

    def only(self, rows: NDArray[np.intp]) -> Panel:
        """Keep some sensors, without lines, ellipses and labels."""
        return replace(
            self,
            points=self.points[rows],
            colours=self.colours[rows],
            pairs=self.pairs[:0],
            uncompared=self.uncompared[rows],
            faulty=self.faulty[rows],
            sensors=self.sensors[rows],
            truth=self.truth[rows[rows < len(self.truth)]],
            errors=self.errors[rows[rows < len(self.errors)]],
            covariances=None,
            labels={},
        )

    def true(self) -> Panel:
        """Return the panel of the true positions."""
        labels = {i: name for i, name in self.labels.items() if i < len(self.truth)}
        compared = self.only(np.arange(len(self.truth)))
        return replace(compared, points=self.truth, pairs=self.pairs, labels=labels)


def drawn_components(sensor_map: SensorMap, score: Score | None = None) -> list[Panel]:
    """Prepare the largest component of a map, and others with several sensors, for drawing."""
    return [
        _prepared(sensor_map, label, None if label else score)
        for label, size in enumerate(sensor_map.component_sizes)
        if size > 1 or not label
    ]


def drawn_dimensions(sensor_map: SensorMap, score: Score | None = None) -> int:
    """Return the number of coordinates, 2 or 3, in which a map is drawn."""
    known = 2 if score is None else span_dimensions(score.truth)
    return max(known, min(max(sensor_map.dimensions, 2), 3))


def neighbour_pairs(points: ArrayLike) -> NDArray[np.intp]:
    """Find pairs of neighbouring sensors. points (N, k) -> (P, 2).

    The ball whose diameter joins two neighbours contains no third sensor (Gabriel & Sokal 1969,
    Systematic Zoology 18: 259-278), one is among the 8 nearest of the other, and their distance is
    at most 2.5 times the distance of each to its nearest sensor. The result has no diagonals in a
    square lattice, all six neighbours in a triangular lattice, and no lines across gaps.
    """
    points = np.asarray(points, dtype=np.float64)
    count = min(_N_NEIGHBOURS + 1, len(points))
    if count < 2:
        return np.empty((0, 2), dtype=np.intp)
    tree = KDTree(points)
    distances, found = map(np.asarray, tree.query(points, k=count))
    reach = _MAX_LENGTH * distances[:, 1]
    pairs = np.column_stack([np.repeat(np.arange(len(points)), count), found.ravel()])
    pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)
    first, second = points[pairs[:, 0]], points[pairs[:, 1]]
    lengths = np.linalg.norm(first - second, axis=1)
    near = lengths <= np.maximum(reach[pairs[:, 0]], reach[pairs[:, 1]])
    if count > 2:
        third = np.asarray(tree.query((first + second) / 2, k=3)[0])[:, 2]
        near &= third > lengths / 2 * (1 + 1e-6)
    return np.asarray(pairs[near], dtype=np.intp)


def best_view(*configurations: Points) -> View:
    """Choose the view that shows the largest projected area of configurations (n, 3)."""
    # The score is the product over configurations of areas of ellipses fitted to projections.
    centred = [points - points.mean(axis=0) for points in configurations]
    areas = []
    for view in VIEWS:
        seen = [points @ view_axes(view)[:2].T for points in centred]
        areas.append(float(np.prod([np.linalg.svd(flat, compute_uv=False) for flat in seen])))
    areas[0] *= _DEFAULT_VIEW_BONUS
    return VIEWS[int(np.argmax(areas))]


def box_around(*configurations: Points) -> Points:
    """Return limits, shape (k, 2), that contain all configurations; thin boxes are thickened."""
    points = np.vstack(configurations)
    lowest, highest = points.min(axis=0), points.max(axis=0)
    half = (highest - lowest) / 2
    half = np.maximum(1.08 * half, (0.25 * half.max() if half.max() > 0 else 1.0))
    middle = (lowest + highest) / 2
    return np.column_stack([middle - half, middle + half])


def shown_name(name: str) -> str:
    """Return a name short enough for a label of a sensor."""
    return shortened(printable(name), _MAX_LABEL)


def unit_of(units: str) -> str:
    """Name the unit of positions, short and printable."""
    known = "arbitrary units" if units == "arbitrary" else shortened(printable(units), MAX_UNITS)
    return known or "unit unknown"


def axis_title(axis: str, units: str) -> str:
    """Name an axis with its unit: ``x (mm)``."""
    return f"{axis} ({unit_of(units)})"


def ellipses_differ(covariances: ArrayLike) -> bool:
    """Return whether ellipses differ visibly in size; equal ellipses are not drawn.

    covariances (N, k, k).
    """
    longest = ellipses(covariances)[0].max(axis=1)
    low, high = np.nanquantile(longest, (0.1, 0.9)) if np.isfinite(longest).any() else (0, 0)
    return bool(high > _ALIKE * low)


def layout_notes(sensor_map: SensorMap, score: Score | None = None) -> list[str]:
    """Explain properties of a drawing that could mislead."""
    notes = []
    count = len(sensor_map.component_sizes)
    if count > 1 and not any("component" in note for note in sensor_map.notes):
        notes.append(
            f"the map has {count} separate components that share no frame of reference: their "
            "positions relative to one another are unknown"
        )
    if score is not None and span_dimensions(score.truth) > sensor_map.dimensions:
        notes.append(
            f"the map has fewer dimensions than the truth ({sensor_map.dimensions} and "
            f"{span_dimensions(score.truth)}): it lies in the plane or line that fits the true "
            "positions best"
        )
    return notes


def _prepared(sensor_map: SensorMap, label: int, score: Score | None) -> Panel:
    """Align a component with the truth, or centre it."""
    dimensions = drawn_dimensions(sensor_map, score)
    sensors = np.flatnonzero(sensor_map.component == label)
    if score is None:
        points = sensor_map.positions[sensors]
        points = points - points.mean(axis=0)
        truth, errors, units = np.empty((0, dimensions)), np.empty(0), sensor_map.units
        turn = np.eye(sensor_map.dimensions)
    else:
        sensors = np.concatenate([score.sensors, np.setdiff1d(sensors, score.sensors)])
        alignment = score.alignment
        points = alignment.apply(sensor_map.positions[sensors])
        truth, errors = with_axes(score.truth, dimensions), alignment.errors
        units = score.units
        turn = alignment.scale * alignment.rotation[:, : sensor_map.dimensions]
    points = with_axes(points, dimensions)
    covariances = sensor_map.covariances
    if covariances is not None and not ellipses_differ(covariances):
        covariances = None
    if covariances is not None:
        drawn = np.eye(dimensions, len(turn)) @ turn
        covariances = drawn @ covariances[sensors] @ drawn.T
    known = points if score is None else truth
    view = VIEWS[0]
    if dimensions == 3:
        view = best_view(points) if score is None else best_view(truth, points)
    labels = _sensors_to_label(known, view)
    grey = np.full((len(points) - len(known), 3), _GREY)
    colours = place_colours(points) if score is None else place_colours(truth, view)
    return Panel(
        points=points,
        colours=np.vstack([colours, grey]),
        pairs=neighbour_pairs(known if len(known) <= MAX_JOINED else known[:0]),
        view=view,
        units=units,
        uncompared=np.arange(len(points)) >= len(known),
        faulty=np.array([is_faulty(sensor_map.health[i]) for i in sensors], dtype=bool),
        sensors=sensors,
        truth=truth,
        errors=errors,
        number=label + 1,
        covariances=covariances,
        labels={i: shown_name(sensor_map.names[sensors[i]]) for i in labels},
    )


def _sensors_to_label(points: Points, view: View) -> list[int]:
    """Choose distant sensors, in 3D from the nearer half, by farthest-point sampling."""
    candidates = np.arange(len(points))
    if len(points) <= _LABEL_ALL:
        return candidates.tolist()
    if points.shape[1] == 3:
        nearness = points @ view_axes(view)[2]
        candidates = np.flatnonzero(nearness >= np.median(nearness))
    chosen = [int(candidates[np.argmin(points[candidates].sum(axis=1))])]
    distances = np.full(len(candidates), np.inf)
    while len(chosen) < _N_LABELS:
        step = np.linalg.norm(points[candidates] - points[chosen[-1]], axis=1)
        distances = np.minimum(distances, step)
        chosen.append(int(candidates[np.argmax(distances)]))
    return chosen


def segments(points: Points, pairs: NDArray[np.intp]) -> Points:
    """Join pairs of points by lines, separated by NaN. points (n, k) -> (3 E, k)."""
    lines = points[pairs]
    gaps = np.full((len(lines), 1, points.shape[1]), np.nan)
    return np.concatenate([lines, gaps], axis=1).reshape(-1, points.shape[1])


def span_dimensions(points: Points) -> int:
    """Return the number of coordinates needed to draw points, 2 or 3; 2 if z is constant.

    points (n, k): NaN if unknown.
    """
    if points.shape[1] < 3:
        return 2
    spans = np.nanmax(points, axis=0) - np.nanmin(points, axis=0)
    return 2 if spans[2] <= _PLANAR * spans.max() else 3


def with_axes(points: Points, dimensions: int) -> Points:
    """Append zeros or drop last coordinates to obtain a given number of coordinates."""
    return padded(points[:, :dimensions], dimensions)


def checked_kind(path: str | os.PathLike[str], kinds: tuple[str, ...], what: str) -> str:
    """Return the suffix of a file name without the dot; raise unless it is one of `kinds`."""
    kind = Path(path).suffix.lower().removeprefix(".")
    if kind not in kinds:
        *others, last = (f".{one}" for one in kinds)
        ends = " or ".join(filter(None, (", ".join(others), last)))
        raise FileError(f"cannot save {what} as {path}; the name must end in {ends}")
    return kind
