"""Sensor poses in metres, as robot software represents them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anisomap.errors import InputError
from anisomap.placement.orientation import pad_to_3d, surface_normals
from anisomap.placement.scale import METRES
from anisomap.sensor_map import SensorMap


@dataclass(frozen=True, eq=False)
class Taxels:
    """Poses of the placed sensors of a map.

    Attributes
    ----------
    frame : str
        Name of the right-handed reference frame.
    names : tuple of str
    indices : ndarray of int, shape (n,)
        Indices of the sensors in the map.
    positions : ndarray of shape (n, 3)
        In metres.
    normals : ndarray of shape (n, 3)
        Outward unit normals: those of the map, or estimated from the positions.
    errors : ndarray of shape (n,)
        Distance within which a sensor is with a probability of 90 %, in metres; NaN if unknown.
    """

    frame: str
    names: tuple[str, ...]
    indices: NDArray[np.intp]
    positions: NDArray[np.float64]
    normals: NDArray[np.float64]
    errors: NDArray[np.float64]

    @property
    def rotations(self) -> Rotation:
        """Orientation of each sensor's frame; its z axis is the normal, x and y are arbitrary."""
        helper = np.eye(3)[np.abs(self.normals).argmin(axis=1)]
        x = np.cross(helper, self.normals)
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        y = np.cross(self.normals, x)
        return Rotation.from_matrix(np.stack([x, y, self.normals], axis=-1))

    @property
    def roll_pitch_yaw(self) -> NDArray[np.float64]:
        """Rotations about the fixed x, y and z axes in radians, shape (n, 3)."""
        with warnings.catch_warnings():
            # If the normal is along x, only the sum of two angles is determined; any pair is valid.
            warnings.filterwarnings("ignore", message="Gimbal lock")
            return np.asarray(self.rotations.as_euler("xyz"))


def to_taxels(sensor_map: SensorMap, purpose: str) -> Taxels:
    """Convert the placed sensors of a map to poses in metres.

    Parameters
    ----------
    sensor_map : SensorMap
        With a unit of length, one connected component, and at most three dimensions.
    purpose : str
        Start of error messages, such as ``"URDF"``.

    Returns
    -------
    Taxels

    Raises
    ------
    InputError
        If the map has no scale, several components, no placed sensor, or more than three
        dimensions.
    """
    if sensor_map.units not in METRES:
        raise InputError(
            f"{purpose} needs positions in metres, but the unit of the map is "
            f"{sensor_map.units or 'unknown'!r}; scale the map by its sensor spacing first"
        )
    n_components = len(sensor_map.component_sizes)
    if n_components != 1:
        raise InputError(
            f"{purpose} needs one connected component, but the map has {n_components}, and their "
            "relative poses are unknown; write each to a file of its own "
            "(anisomap.io.write_components)"
        )
    indices = np.flatnonzero(sensor_map.placed)
    positions = pad_to_3d(sensor_map.positions[indices]) * METRES[sensor_map.units]
    return Taxels(
        frame=sensor_map.frame,
        names=tuple(sensor_map.names[i] for i in indices),
        indices=indices,
        positions=positions,
        normals=surface_normals(sensor_map)[indices],
        errors=sensor_map.errors[indices] * METRES[sensor_map.units],
    )
