"""Sensor readings in closed form. Sensors do not affect the dynamics."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist


def read_balls(
    sensors: ArrayLike, centres: ArrayLike, ball_radius: ArrayLike, detection_radius: float
) -> NDArray[np.float32]:
    """Read balls with short-range proximity sensors.

    sensors (N, 3), centres (T, B, 3), ball_radius (B,).

    McGregor et al. (2011), section "Sensor Modelling": "proportional to the detectable body's
    maximum penetration into the sensor's sphere of detection". Single precision halves the size;
    its seven digits exceed the resolution of real sensors.
    """
    sensors, frames = np.asarray(sensors, dtype=np.float64), np.asarray(centres, dtype=np.float64)
    radius = np.asarray(ball_radius, dtype=np.float64)
    readings = np.empty((len(frames), len(sensors)), dtype=np.float32)
    for row, balls in zip(readings, frames, strict=True):
        row[:] = (detection_radius + radius - cdist(sensors, balls)).max(axis=1)
    return np.maximum(readings, 0, out=readings)


def read_capsules(
    sensors: ArrayLike,
    starts: ArrayLike,
    ends: ArrayLike,
    capsule_radius: float,
    detection_radius: float,
) -> NDArray[np.float32]:
    """Read capsules: all points within a radius of a segment.

    sensors (N, 3), starts, ends (T, B, 3).
    """
    sensors = np.asarray(sensors, dtype=np.float64)
    frames = np.asarray(starts, dtype=np.float64), np.asarray(ends, dtype=np.float64)
    readings = np.empty((len(frames[0]), len(sensors)), dtype=np.float32)
    for row, start, end in zip(readings, *frames, strict=True):
        axis = end - start
        from_start = sensors[:, None] - start
        along = np.einsum("nbd,bd->nb", from_start, axis) / np.einsum("bd,bd->b", axis, axis)
        distance = np.linalg.norm(from_start - np.clip(along, 0, 1)[..., None] * axis, axis=2)
        row[:] = (detection_radius + capsule_radius - distance).max(axis=1)
    return np.maximum(readings, 0, out=readings)


def read_half_spaces(
    sensors: ArrayLike, directions: ArrayLike, offsets: ArrayLike, detection_radius: float
) -> NDArray[np.float32]:
    """Read an infinite flat surface: all points ``x`` with ``x @ direction >= offset``.

    sensors (N, 3), directions (T, 3), offsets (T,).
    """
    heights = np.asarray(directions, dtype=np.float64) @ np.asarray(sensors, dtype=np.float64).T
    gaps = np.asarray(offsets, dtype=np.float64)[:, None] - heights
    return np.asarray(np.maximum(detection_radius - gaps, 0), dtype=np.float32)
