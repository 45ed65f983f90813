"""Mirror image and surface normals of a map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.numerics.normals import estimate_normals
from anisomap.sensor_map import SensorMap


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
    normals = sensor_map.normals
    return replace(
        sensor_map,
        positions=flip * sensor_map.positions,
        covariances=None
        if sensor_map.covariances is None
        else np.outer(flip, flip) * sensor_map.covariances,
        normals=None if normals is None else normals * [-1.0, 1.0, 1.0],
        mirrored=not sensor_map.mirrored,
    )


def surface_normals(sensor_map: SensorMap) -> NDArray[np.float64]:
    """Return the surface normal at each sensor.

    Normals that the map lacks are estimated, separately for each connected component.

    Parameters
    ----------
    sensor_map : SensorMap
        Of at most three dimensions.

    Returns
    -------
    ndarray of shape (N, 3)
        Unit vectors, NaN for unplaced sensors. See `anisomap.numerics.normals.estimate_normals`.

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

    Parameters
    ----------
    positions : ndarray of shape (N, k)

    Returns
    -------
    ndarray of shape (N, 3)

    Raises
    ------
    InputError
        If k is greater than 3.
    """
    missing = 3 - positions.shape[1]
    if missing < 0:
        raise InputError(f"the map must have at most 3 dimensions, got {positions.shape[1]}")
    return np.pad(positions, ((0, 0), (0, missing)))
