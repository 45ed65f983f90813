"""Units, scale, mirror image and normals of maps, and poses of sensors for robot software."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anisomap.base import DEFAULT_METHOD, METRES
from anisomap.errors import InputError
from anisomap.numerics.neighbours import nearest_distances, padded
from anisomap.numerics.ranges import POSITIVE
from anisomap.numerics.surfaces import estimate_normals, frames_along
from anisomap.sensor_map import MAX_COORDINATE, UNSCALED, SensorMap

_MIN_LENGTH = 1e-150  # its square is a normal floating-point number
# Median ratios, by dimensions, of lengths on good maps to true lengths if the median distance to
# the nearest sensor is the true one: python -m benchmarks.placing.scale refits them.
_TOO_LONG = {2: 1.2, 3: 1.06}
_LENGTH = re.compile(r"\s*+([0-9.eE+-]++)\s*+([a-z\u00b5]++)\s*+")


def parse_length(text: str) -> tuple[float, str]:
    """Parse a length such as ``6.5mm``."""
    match = _LENGTH.fullmatch(text)
    try:
        value, unit = (float(match[1]), match[2]) if match else (0.0, "")
    except ValueError:
        value, unit = 0.0, ""
    if not (np.isfinite(value) and value > 0 and unit in METRES):
        raise InputError(f"{text!r} is not a length such as 6.5mm, in {', '.join(METRES)}")
    return value, unit


def median_spacing(sensor_map: SensorMap) -> float:
    """Compute the median distance from a placed sensor to its nearest neighbour.

    Neighbours are searched within each connected component.

    Parameters
    ----------
    sensor_map : SensorMap

    Returns
    -------
    float
        Positive, in the unit of the map.

    Raises
    ------
    InputError
        If no component has two placed sensors, or most placed sensors coincide.
    """
    nearest: list[float] = []
    for component in sensor_map.split():
        if component.n_sensors > 1:
            nearest += nearest_distances(component.positions).tolist()
    spacing = float(np.median(nearest)) if nearest else 0.0
    if not spacing > 0:
        raise InputError("the spacing of the map is undefined: no component has two places")
    return spacing


def spacing_on_skin(sensor_map: SensorMap) -> float:
    """Estimate the median distance to the nearest sensor on the skin, in the unit of the map.

    Errors of positions shorten this distance on a map by the default method, which is corrected.
    """
    corrected = sensor_map.method == DEFAULT_METHOD
    factor = _TOO_LONG.get(sensor_map.dimensions, 1.0) if corrected else 1.0
    return factor * median_spacing(sensor_map)


def rescaled(sensor_map: SensorMap, factor: float, units: str) -> SensorMap:
    """Multiply all lengths of a map by a factor."""
    scaled = _stretched(sensor_map, np.full(sensor_map.dimensions, factor))
    return replace(scaled, errors=factor * sensor_map.errors, units=units)


def _stretched(sensor_map: SensorMap, factors: NDArray[np.float64]) -> SensorMap:
    """Multiply each coordinate of a map by a factor. factors (k,)."""
    covariances = sensor_map.covariances
    if covariances is not None:
        covariances = np.outer(factors, factors) * covariances
    return replace(sensor_map, positions=factors * sensor_map.positions, covariances=covariances)


def in_millimetres(sensor_map: SensorMap) -> SensorMap:
    """Convert a map with a unit of length to millimetres, for display."""
    if sensor_map.units not in METRES:
        return sensor_map
    return rescaled(sensor_map, METRES[sensor_map.units] / METRES["mm"], "mm")


def length_shown(units: str, unscaled: str) -> tuple[str, float]:
    """Return the unit for display, and the conversion factor: mm if the unit of the map is known.

    unscaled: Text for a unit that is arbitrary or unknown.
    """
    if units not in METRES:
        return (unscaled if units in UNSCALED else units), 1.0
    return "mm", METRES[units] / METRES["mm"]


def scaled_to_spacing(sensor_map: SensorMap, spacing: float, units: str) -> SensorMap:
    """Scale a map to a given spacing of neighbouring sensors.

    Parameters
    ----------
    sensor_map : SensorMap
    spacing : float
        Median distance from a sensor to its nearest neighbour on the skin.
    units : str
        Unit of `spacing`.

    Returns
    -------
    SensorMap
        The map in `units`, with the scale factor in its provenance. Errors of positions shorten
        the distance to the nearest sensor on a map. The scale of a map by the default method is
        corrected for this; 80 % of its lengths are within 15 % of the true lengths.

    Raises
    ------
    InputError
        If the map has no spacing (see `median_spacing`) or is in the frame of the robot, or
        `spacing` is not positive or is out of the range of floating-point numbers.
    """
    POSITIVE.check("spacing", spacing)
    if sensor_map.anchored:
        raise InputError("the map is in the frame of the robot, so it must not be scaled")
    factor = spacing / spacing_on_skin(sensor_map)
    largest = float(np.nanmax(np.abs(sensor_map.positions))) * factor
    # Squares in the computation of distances must neither underflow nor overflow.
    if not (spacing > _MIN_LENGTH and factor > 0 and largest < MAX_COORDINATE):
        raise InputError(f"a spacing of {spacing:g} {units} is out of range; check its unit")
    provenance = {**sensor_map.provenance, "spacing": spacing, "scale": factor}
    return replace(rescaled(sensor_map, factor, units), provenance=provenance)


def mirrored(sensor_map: SensorMap) -> SensorMap:
    """Reflect a map.

    Parameters
    ----------
    sensor_map : SensorMap

    Returns
    -------
    SensorMap
        With the first coordinate negated, and `SensorMap.mirrored` toggled.

    Raises
    ------
    InputError
        If the map is in the frame of the robot.
    """
    if sensor_map.anchored:
        raise InputError("the map is in the frame of the robot, so it must not be reflected")
    flip = np.ones(sensor_map.dimensions)
    flip[0] = -1.0
    normals = None if sensor_map.normals is None else sensor_map.normals * [-1.0, 1.0, 1.0]
    flipped = _stretched(sensor_map, flip)
    return replace(flipped, normals=normals, mirrored=not sensor_map.mirrored)


def surface_normals(sensor_map: SensorMap) -> NDArray[np.float64]:
    """Return the surface normal at each sensor.

    Missing normals are estimated, separately for each connected component.

    Parameters
    ----------
    sensor_map : SensorMap
        Of at most three dimensions.

    Returns
    -------
    ndarray of shape (N, 3)
        Unit vectors, NaN for unplaced sensors. See `anisomap.numerics.surfaces.estimate_normals`.

    Raises
    ------
    InputError
        If the map has more than three dimensions.
    """
    normals = np.full((sensor_map.n_sensors, 3), np.nan)
    for label in range(len(sensor_map.component_sizes)):
        members = sensor_map.component == label
        normals[members] = estimate_normals(pad_to_3d(sensor_map.positions[members]))[0]
    if sensor_map.normals is not None:
        known = np.isfinite(sensor_map.normals).all(axis=1) & sensor_map.placed
        normals[known] = sensor_map.normals[known]
    return normals


def pad_to_3d(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Append zero coordinates to points of fewer than three dimensions.

    positions (N, k) -> (N, 3).
    """
    if positions.shape[1] > 3:
        raise InputError(f"the map must have at most 3 dimensions, got {positions.shape[1]}")
    return padded(positions, 3)


@dataclass(frozen=True, eq=False)
class Taxels:
    """Poses of the placed sensors of a map.

    frame: Name of the right-handed reference frame.
    indices: Indices of the sensors in the map.
    positions (n, 3): In metres.
    normals (n, 3): Outward unit normals, from the map or estimated from the positions.
    """

    frame: str
    names: tuple[str, ...]
    indices: NDArray[np.intp]
    positions: NDArray[np.float64]
    normals: NDArray[np.float64]

    @property
    def rotations(self) -> Rotation:
        """Orientation of each sensor's frame; its z axis is the normal, x and y are arbitrary."""
        return Rotation.from_matrix(frames_along(self.normals))

    @property
    def roll_pitch_yaw(self) -> NDArray[np.float64]:
        """Rotations about the fixed x, y and z axes in radians, shape (n, 3)."""
        with warnings.catch_warnings():
            # If the normal is along x, only the sum of two angles is determined.
            warnings.filterwarnings("ignore", message="Gimbal lock")
            return np.asarray(self.rotations.as_euler("xyz"))


def to_taxels(sensor_map: SensorMap, purpose: str) -> Taxels:
    """Convert the placed sensors of a map to poses in metres."""
    if sensor_map.units not in METRES:
        raise InputError(
            f"{purpose} needs positions in metres, but the unit of the map is "
            f"{sensor_map.units or 'unknown'!r}; scale the map by its sensor spacing first"
        )
    n_components = len(sensor_map.component_sizes)
    if n_components != 1:
        raise InputError(
            f"{purpose} needs one connected component, but the map has {n_components}; write each "
            "map of SensorMap.split() to a file of its own, or leave sensors out with --drop"
        )
    indices = np.flatnonzero(sensor_map.placed)
    positions = pad_to_3d(sensor_map.positions[indices]) * METRES[sensor_map.units]
    return Taxels(
        frame=sensor_map.frame,
        names=tuple(sensor_map.names[i] for i in indices),
        indices=indices,
        positions=positions,
        normals=surface_normals(sensor_map)[indices],
    )
