"""What sensors read, in closed form: they add nothing to the dynamics."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist


def read_balls(
    sensors: ArrayLike, centres: ArrayLike, ball_radius: ArrayLike, detection_radius: float
) -> NDArray[np.float32]:
    """Read balls with short-range proximity sensors.

    Parameters
    ----------
    sensors : array_like of shape (N, 3)
        Where the sensors are.
    centres : array_like of shape (T, B, 3)
        Where the centres of B balls are in each of T frames.
    ball_radius : float or array_like of shape (B,)
        Of all balls, or of each.
    detection_radius : float
        Radius of the sphere about a sensor in which it detects.

    Returns
    -------
    ndarray of shape (T, N)
        How deep the deepest ball reaches into each sensor's sphere of detection,
        ``max(0, detection_radius + ball_radius - distance)``, in the unit of the lengths.

    Notes
    -----
    McGregor et al. (2011), section "Sensor Modelling": "proportional to the detectable body's
    maximum penetration into the sensor's sphere of detection". Single precision keeps seven
    digits, more than any sensor has, at half the size.
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

    Parameters
    ----------
    sensors : array_like of shape (N, 3)
    starts, ends : array_like of shape (T, B, 3)
        Of the segments of B capsules in each of T frames.
    capsule_radius, detection_radius : float

    Returns
    -------
    ndarray of shape (T, N)
        As `read_balls` gives, with the distance from the segment.
    """
    sensors = np.asarray(sensors, dtype=np.float64)
    frames = np.asarray(starts, dtype=np.float64), np.asarray(ends, dtype=np.float64)
    readings = np.empty((len(frames[0]), len(sensors)), dtype=np.float32)
    for row, start, end in zip(readings, *frames, strict=True):
        axis = end - start
        from_start = sensors[:, None] - start
        along = np.einsum("nbd,bd->nb", from_start, axis) / np.einsum("bd,bd->b", axis, axis)
        away = np.linalg.norm(from_start - np.clip(along, 0, 1)[..., None] * axis, axis=2)
        row[:] = (detection_radius + capsule_radius - away).max(axis=1)
    return np.maximum(readings, 0, out=readings)


def read_half_spaces(
    sensors: ArrayLike, directions: ArrayLike, offsets: ArrayLike, detection_radius: float
) -> NDArray[np.float32]:
    """Read a flat surface without end: all points ``x`` with ``x @ direction >= offset``.

    Parameters
    ----------
    sensors : array_like of shape (N, 3)
    directions : array_like of shape (T, 3)
        Unit vectors into what is behind the surface, one a frame.
    offsets : array_like of shape (T,)
    detection_radius : float

    Returns
    -------
    ndarray of shape (T, N)
        How deep it reaches into each sensor's sphere of detection.
    """
    heights = np.asarray(directions, dtype=np.float64) @ np.asarray(sensors, dtype=np.float64).T
    gaps = np.asarray(offsets, dtype=np.float64)[:, None] - heights
    return np.asarray(np.maximum(detection_radius - gaps, 0), dtype=np.float32)
