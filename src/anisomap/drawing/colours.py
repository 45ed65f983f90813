"""Colours that encode positions, as seen from a direction of view."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

View: TypeAlias = tuple[float, float]
"""Direction of view: elevation above the x-y plane and azimuth, in degrees."""

VIEWS: tuple[View, ...] = ((18.0, -60.0), (18.0, 30.0), (65.0, -90.0))
"""Available views: the default, one from its right, and one from above with x to the right."""

_MIN_SPREAD = 0.4  # of the longest axis: shorter axes use part of their range of colours
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


def place_colours(points: ArrayLike, view: View = VIEWS[0]) -> NDArray[np.float64]:
    """Encode positions as colours.

    Seen from `view`, up is light, right is yellow and left is blue: these two contrasts survive
    every common colour vision deficiency. The third axis, from red (near) to green (far), is
    redundant with depth. In 2D it repeats the vertical axis.

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
    # The largest contrasts in OKLab that stay within sRGB: clipping would merge colours.
    lab = np.column_stack([0.58 + 0.20 * up, 0.10 * nearer, 0.11 * right])
    linear = np.clip((lab @ _LAB_TO_CONES.T) ** 3 @ _CONES_TO_RGB.T, 0, 1)
    curved = 1.055 * linear ** (1 / 2.4) - 0.055
    return np.asarray(np.where(linear <= 0.0031308, 12.92 * linear, curved))


def view_axes(view: View) -> NDArray[np.float64]:
    """Return the unit vectors to the right, up, and towards the viewer, shape (3, 3)."""
    elevation, azimuth = np.radians(view)
    right = [-np.sin(azimuth), np.cos(azimuth), 0.0]
    towards = [
        np.cos(elevation) * np.cos(azimuth),
        np.cos(elevation) * np.sin(azimuth),
        np.sin(elevation),
    ]
    return np.array([right, np.cross(towards, right), towards])


def _spread(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scale each axis to [-1, 1], short axes to less, so that noise does not become a colour."""
    lowest, highest = points.min(axis=0), points.max(axis=0)
    half = (highest - lowest) / 2
    half = np.maximum(half, _MIN_SPREAD * half.max())
    middle = (lowest + highest) / 2
    return np.asarray((points - middle) / np.where(half > 0, half, 1))
