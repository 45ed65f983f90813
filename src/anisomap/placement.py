"""From a map in units of nobody to one in metres: its scale, its handedness, its normals.

A map is known up to rotation, translation, scale and mirror image. Whoever knows how far apart
neighbouring sensors are, or that the map is mirrored, says so here; what robots' software reads is
in metres.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from anisomap.errors import InputError
from anisomap.numerics.normals import estimate_normals
from anisomap.sensor_map import SensorMap

METRES = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "\u00b5m": 1e-6, "in": 0.0254}
"""Length of each unit that is understood."""

_LENGTH = re.compile(r"\s*([0-9.eE+-]+)\s*([a-z\u00b5]+)\s*")


@dataclass(frozen=True, eq=False)
class Taxels:
    """Placed sensors of a map as robots' software takes them.

    Attributes
    ----------
    frame : str
        Name of the frame that they are in; its axes are right-handed.
    names : tuple of str
    indices : ndarray of int, shape (n,)
        Which sensors of the map they are.
    positions : ndarray of shape (n, 3)
        Metres.
    normals : ndarray of shape (n, 3)
        Unit vectors out of the skin, estimated from the positions.
    """

    frame: str
    names: tuple[str, ...]
    indices: NDArray[np.intp]
    positions: NDArray[np.float64]
    normals: NDArray[np.float64]

    @property
    def rotations(self) -> Rotation:
        """How each sensor's frame is turned: its z is the normal."""
        helper = np.eye(3)[np.abs(self.normals).argmin(axis=1)]
        x = np.cross(helper, self.normals)
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        y = np.cross(self.normals, x)
        return Rotation.from_matrix(np.stack([x, y, self.normals], axis=-1))

    @property
    def roll_pitch_yaw(self) -> NDArray[np.float64]:
        """The same as turns about the fixed axes x, y and z, in radians, shape (n, 3)."""
        with warnings.catch_warnings():
            # Of a normal along x only the sum of two turns is known; any two will do.
            warnings.filterwarnings("ignore", message="Gimbal lock")
            return np.asarray(self.rotations.as_euler("xyz"))


def parse_length(text: str) -> tuple[float, str]:
    """Read a length such as ``6.5mm``.

    Returns
    -------
    value : float
    unit : str
        A key of `METRES`.

    Raises
    ------
    InputError
        If it is no positive number with a unit.
    """
    match = _LENGTH.fullmatch(text)
    try:
        value, unit = (float(match[1]), match[2]) if match else (0.0, "")
    except ValueError:
        value, unit = 0.0, ""
    if not (np.isfinite(value) and value > 0 and unit in METRES):
        raise InputError(
            f"{text!r} is no length; write a positive number and a unit, such as 6.5mm "
            f"({', '.join(METRES)})"
        )
    return value, unit


def spacing_of(sensor_map: SensorMap) -> float:
    """Measure the median distance from a placed sensor to its nearest neighbour.

    Raises
    ------
    InputError
        If fewer than two sensors of a piece are placed, or most lie on one another.
    """
    nearest: list[float] = []
    for piece in sensor_map.split():
        if piece.n_sensors > 1:
            distances = KDTree(piece.positions).query(piece.positions, k=[2])[0]
            nearest += np.asarray(distances).ravel().tolist()
    spacing = float(np.median(nearest)) if nearest else 0.0
    if not spacing > 0:
        raise InputError("the map has no two sensors apart from each other, so it has no spacing")
    return spacing


def scaled_to_spacing(sensor_map: SensorMap, spacing: float, units: str) -> SensorMap:
    """Give a map its scale, from the distance between neighbouring sensors.

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
        In those units; how it was scaled is in its provenance. Where the map puts neighbours too
        near or too far, all its distances are too long or too short with them.

    Raises
    ------
    InputError
        If the map has no spacing, or `spacing` is no positive number.
    """
    if not (np.isfinite(spacing) and spacing > 0):
        raise InputError(f"spacing is {spacing:g}; it must be a positive number")
    factor = spacing / spacing_of(sensor_map)
    return replace(
        sensor_map,
        positions=factor * sensor_map.positions,
        units=units,
        provenance={**sensor_map.provenance, "spacing": spacing, "scale": factor},
    )


def mirrored(sensor_map: SensorMap) -> SensorMap:
    """Turn a map into its mirror image, in which what was left is right.

    Returns
    -------
    SensorMap
        With the first coordinate negated, and `SensorMap.mirrored` toggled.
    """
    flip = np.ones(sensor_map.dimensions)
    flip[0] = -1.0
    return replace(
        sensor_map,
        positions=flip * sensor_map.positions,
        mirrored=not sensor_map.mirrored,
    )


def normals_of(sensor_map: SensorMap) -> NDArray[np.float64]:
    """Estimate the normals of a map, of each piece by itself.

    Returns
    -------
    ndarray of shape (N, 3)
        NaN for sensors that are not placed. See `anisomap.numerics.normals.estimate_normals`.
    """
    normals = np.full((sensor_map.n_sensors, 3), np.nan)
    for label in range(len(sensor_map.component_sizes)):
        members = sensor_map.component == label
        normals[members] = estimate_normals(in_space(sensor_map.positions[members]))[0]
    return normals


def in_space(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give points three coordinates; those that are missing are 0.

    Raises
    ------
    InputError
        If there are more than three.
    """
    missing = 3 - positions.shape[1]
    if missing < 0:
        raise InputError(f"the map has {positions.shape[1]} dimensions; space has three")
    return np.pad(positions, ((0, 0), (0, missing)))


def taxels(sensor_map: SensorMap, purpose: str) -> Taxels:
    """Give the placed sensors of a map in metres.

    Parameters
    ----------
    sensor_map : SensorMap
        Its unit must be known.
    purpose : str
        What it is for, to begin an error with: ``"URDF"``.

    Returns
    -------
    Taxels

    Raises
    ------
    InputError
        If the map has no scale, is in pieces that share no frame, or no sensor is placed.
    """
    if sensor_map.units not in METRES:
        raise InputError(
            f"{purpose} is in metres, but the map has no scale (its unit is "
            f"{sensor_map.units or 'not known'!r}); say how far apart neighbouring sensors are "
            "(--spacing 6.5mm), or in which unit it is (--units mm)"
        )
    if len(sensor_map.component_sizes) != 1:
        raise InputError(
            f"{purpose} has one frame, but the map has {len(sensor_map.component_sizes)} connected "
            "components with unknown relative positions; write each component to its own file"
        )
    indices = np.flatnonzero(sensor_map.placed)
    positions = in_space(sensor_map.positions[indices]) * METRES[sensor_map.units]
    return Taxels(
        frame=sensor_map.frame,
        names=tuple(sensor_map.names[i] for i in indices),
        indices=indices,
        positions=positions,
        normals=normals_of(sensor_map)[indices],
    )
