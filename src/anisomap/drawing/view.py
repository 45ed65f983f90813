"""What the picture and the report draw alike: colour by place, neighbours, a side to look from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from anisomap.evaluation import Score
from anisomap.sensor_map import SensorMap

View: TypeAlias = tuple[float, float]
"""Elevation and azimuth of the eye above the x-y plane, in degrees."""

VIEWS: tuple[View, ...] = ((18.0, -60.0), (18.0, 30.0), (65.0, -90.0))
"""Sides to look from: the usual one, one to its right, and from above with x to the right."""

MOST_JOINED = 10_000
"""Of so many sensors, lines between neighbours would be one grey mass."""

_USUAL_VIEW_BONUS = 1.25
_CANDIDATES = 8
_LONGEST = 2.5
_FLATTEST = 0.4
_GREY = 0.72
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


@dataclass(frozen=True, eq=False)
class Body:
    """A piece of a map as it is drawn: in the plane or in space, on the truth where one is known.

    Attributes
    ----------
    number : int
        Which piece, from 1; the largest comes first.
    sensors : ndarray of int, shape (n,)
        Which sensors of the map it holds; those that were compared with the truth come first.
    points : ndarray of shape (n, k)
        Where they are, k = 2 or 3: laid onto the truth, or else centred, in a frame of their own.
    truth : ndarray of shape (m, k)
        True places of the first m sensors; empty if none is known.
    colours : ndarray of shape (n, 3)
        sRGB in [0, 1], by true place if known, else by place; grey for sensors not compared.
    pairs : ndarray of int, shape (E, 2)
        Neighbours, by true place if known, else by place; none of more than 10,000 sensors.
    view : tuple of float
        A good side to look from: elevation and azimuth in degrees.
    units : str
        Unit of `points` and `truth`.
    """

    number: int
    sensors: NDArray[np.intp]
    points: NDArray[np.float64]
    truth: NDArray[np.float64]
    colours: NDArray[np.float64]
    pairs: NDArray[np.intp]
    view: View
    units: str

    @property
    def compared(self) -> NDArray[np.bool_]:
        """Which sensors have a true place, shape (n,); all count as such if none is known."""
        known = len(self.truth) or len(self.points)
        return np.arange(len(self.points)) < known


def bodies(sensor_map: SensorMap, score: Score | None = None) -> list[Body]:
    """Lay out the pieces of a map for drawing.

    Parameters
    ----------
    sensor_map : SensorMap
        The map. Of more than three dimensions the first three are kept, one gets a second.
    score : Score, optional
        The comparison of this map with the truth; it holds for the largest piece.

    Returns
    -------
    list of Body
        The largest first. A piece of one sensor has no shape and is left out.
    """
    found = []
    for label in range(len(sensor_map.component_sizes)):
        sensors = np.flatnonzero(sensor_map.component == label)
        if label == 0 and score is not None:
            found.append(_on_the_truth(sensor_map, sensors, score))
        elif len(sensors) > 1:
            found.append(_by_itself(sensor_map, sensors, label + 1))
    return found


def place_colours(points: ArrayLike, view: View = VIEWS[0]) -> NDArray[np.float64]:
    """Give every sensor a colour that says where it is.

    Seen from `view`, up is light and right is yellow (left is blue): the two contrasts that every
    common kind of colour blindness leaves. The third axis, red near and green far, only adds to
    what depth already shows. In the plane, where there is no depth, it repeats up and down.

    Parameters
    ----------
    points : array_like of shape (N, 2) or (N, 3)
        Finite positions.
    view : tuple of float
        Elevation and azimuth in degrees.

    Returns
    -------
    ndarray of shape (N, 3)
        sRGB, each channel in [0, 1].
    """
    points = np.asarray(points, dtype=np.float64)
    if points.shape[1] == 2:
        right, up = _spread(points).T
        nearer = -up
    else:
        right, up, nearer = _spread(points @ view_axes(view).T).T
    # As far apart as they can be without leaving what screens show: clipping makes colours alike.
    lab = np.column_stack([0.58 + 0.20 * up, 0.10 * nearer, 0.11 * right])
    linear = np.clip((lab @ _LAB_TO_CONES.T) ** 3 @ _CONES_TO_RGB.T, 0, 1)
    curved = 1.055 * linear ** (1 / 2.4) - 0.055
    return np.asarray(np.where(linear <= 0.0031308, 12.92 * linear, curved))


def neighbour_pairs(points: ArrayLike) -> NDArray[np.intp]:
    """Tell which sensors lie side by side.

    Two sensors are neighbours if the ball between them holds no third (Gabriel & Sokal 1969,
    Systematic Zoology 18: 259-278), each is among the 8 nearest of the other or the other way
    round, and they are not much farther apart than either is from its nearest one. That leaves no
    diagonals in a square lattice, all six sides in a triangular one, and no bridges across gaps.

    Parameters
    ----------
    points : array_like of shape (N, k)
        Finite positions.

    Returns
    -------
    ndarray of int, shape (E, 2)
        Pairs i < j in ascending order.
    """
    points = np.asarray(points, dtype=np.float64)
    count = min(_CANDIDATES + 1, len(points))
    if count < 2:
        return np.empty((0, 2), dtype=np.intp)
    tree = KDTree(points)
    distances, found = map(np.asarray, tree.query(points, k=count))
    reach = _LONGEST * distances[:, 1]
    pairs = np.column_stack([np.repeat(np.arange(len(points)), count), found.ravel()])
    pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)
    first, second = points[pairs[:, 0]], points[pairs[:, 1]]
    lengths = np.linalg.norm(first - second, axis=1)
    near = lengths <= np.maximum(reach[pairs[:, 0]], reach[pairs[:, 1]])
    if count > 2:
        third = np.asarray(tree.query((first + second) / 2, k=3)[0])[:, 2]
        near &= third > lengths / 2 * (1 + 1e-6)
    return np.asarray(pairs[near], dtype=np.intp)


def best_view(*configurations: NDArray[np.float64]) -> View:
    """Choose the side from which bodies in space cover most of their pictures.

    Parameters
    ----------
    *configurations : ndarray of shape (n, 3)
        Finite positions. None of them should be seen edge-on.

    Returns
    -------
    tuple of float
        One of `VIEWS`: the first, unless another shows distinctly more.
    """
    areas = [_area(view, configurations) for view in VIEWS]
    areas[0] *= _USUAL_VIEW_BONUS
    return VIEWS[int(np.argmax(areas))]


def box_around(*configurations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give limits, shape (k, 2), that hold all configurations; thin boxes are thickened."""
    points = np.vstack(configurations)
    lowest, highest = points.min(axis=0), points.max(axis=0)
    half = (highest - lowest) / 2
    half = np.maximum(1.08 * half, (0.25 * half.max() if half.max() > 0 else 1.0))
    middle = (lowest + highest) / 2
    return np.column_stack([middle - half, middle + half])


def view_axes(view: View) -> NDArray[np.float64]:
    """Give the unit vectors of a view: to the right, up, and towards the eye, shape (3, 3)."""
    elevation, azimuth = np.radians(view)
    right = [-np.sin(azimuth), np.cos(azimuth), 0.0]
    towards = [
        np.cos(elevation) * np.cos(azimuth),
        np.cos(elevation) * np.sin(azimuth),
        np.sin(elevation),
    ]
    return np.array([right, np.cross(towards, right), towards])


def axis_title(axis: str, units: str) -> str:
    """Name an axis with its unit: ``x (mm)``."""
    if not units:
        return f"{axis} (unit unknown)"
    return f"{axis} ({'arbitrary units' if units == 'arbitrary' else shown(units, 24)})"


def warn_of_pieces(sensor_map: SensorMap) -> list[str]:
    """Say that separate pieces share no frame, if the map has some and does not say so itself."""
    count = len(sensor_map.component_sizes)
    if count < 2 or any("component" in note for note in sensor_map.notes):
        return []
    return [
        f"the map has {count} separate components that share no frame of reference: their "
        "positions relative to one another are unknown"
    ]


def shown(text: str, longest: int | None = None) -> str:
    """Make any text fit to be shown: printable, on one line, and no longer than asked."""
    clean = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)
    if longest is None or len(clean) <= longest:
        return clean
    return clean[: longest - 1] + "\N{HORIZONTAL ELLIPSIS}"


def _on_the_truth(sensor_map: SensorMap, sensors: NDArray[np.intp], score: Score) -> Body:
    sensors = np.concatenate([score.sensors, np.setdiff1d(sensors, score.sensors)])
    alignment = score.alignment
    places = _with_axes(sensor_map.positions[sensors], len(alignment.translation))
    points = alignment.scale * places @ alignment.rotation.T + alignment.translation
    dimensions = min(max(points.shape[1], 2), 3)
    points, truth = _with_axes(points, dimensions), _with_axes(score.truth, dimensions)
    view = best_view(truth, points) if dimensions == 3 else VIEWS[0]
    grey = np.full((len(sensors) - len(truth), 3), _GREY)
    return Body(
        number=1,
        sensors=sensors,
        points=points,
        truth=truth,
        colours=np.vstack([place_colours(truth, view), grey]),
        pairs=_joined(truth),
        view=view,
        units=score.units,
    )


def _by_itself(sensor_map: SensorMap, sensors: NDArray[np.intp], number: int) -> Body:
    points = sensor_map.positions[sensors]
    points = _with_axes(points - points.mean(axis=0), min(max(points.shape[1], 2), 3))
    return Body(
        number=number,
        sensors=sensors,
        points=points,
        truth=np.empty((0, points.shape[1])),
        colours=place_colours(points),
        pairs=_joined(points),
        view=best_view(points) if points.shape[1] == 3 else VIEWS[0],
        units=sensor_map.units,
    )


def _joined(points: NDArray[np.float64]) -> NDArray[np.intp]:
    return neighbour_pairs(points if len(points) <= MOST_JOINED else points[:0])


def _with_axes(points: NDArray[np.float64], dimensions: int) -> NDArray[np.float64]:
    """Bring points to so many coordinates: zeros are added, or the last left out."""
    missing = max(0, dimensions - points.shape[1])
    return np.asarray(np.pad(points, ((0, 0), (0, missing)))[:, :dimensions])


def _area(view: View, configurations: Sequence[NDArray[np.float64]]) -> float:
    """Area that an ellipse of each body's proportions covers, multiplied up."""
    flat = [(points - points.mean(axis=0)) @ view_axes(view)[:2].T for points in configurations]
    return float(np.prod([np.linalg.svd(seen, compute_uv=False) for seen in flat]))


def _spread(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Stretch each axis over [-1, 1], thin ones less, so that noise is not made a colour."""
    lowest, highest = points.min(axis=0), points.max(axis=0)
    half = (highest - lowest) / 2
    half = np.maximum(half, _FLATTEST * half.max())
    middle = (lowest + highest) / 2
    return np.asarray((points - middle) / np.where(half > 0, half, 1))
