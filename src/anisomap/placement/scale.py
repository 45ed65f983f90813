"""Lengths with units, and the scale of a map from the spacing of its sensors."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from anisomap.errors import InputError
from anisomap.sensor_map import SensorMap

METRES = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "\u00b5m": 1e-6, "in": 0.0254}
"""Length of each supported unit in metres."""

_MIN_LENGTH, _MAX_LENGTH = 1e-150, 1e150  # their squares are normal floating-point numbers
_LENGTH = re.compile(r"\s*+([0-9.eE+-]++)\s*+([a-z\u00b5]++)\s*+")


def parse_length(text: str) -> tuple[float, str]:
    """Parse a length such as ``6.5mm``.

    Parameters
    ----------
    text : str
        A positive number and a unit.

    Returns
    -------
    value : float
    unit : str
        A key of `METRES`.

    Raises
    ------
    InputError
        If `text` is not a positive number followed by a unit.
    """
    match = _LENGTH.fullmatch(text)
    try:
        value, unit = (float(match[1]), match[2]) if match else (0.0, "")
    except ValueError:
        value, unit = 0.0, ""
    if not (np.isfinite(value) and value > 0 and unit in METRES):
        raise InputError(
            f"{text!r} is not a length; write a positive number and a unit, such as 6.5mm "
            f"(units: {', '.join(METRES)})"
        )
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
            distances = KDTree(component.positions).query(component.positions, k=[2])[0]
            nearest += np.asarray(distances).ravel().tolist()
    spacing = float(np.median(nearest)) if nearest else 0.0
    if not spacing > 0:
        raise InputError(
            "the spacing of the map is undefined: it needs two placed sensors at different "
            "positions in one connected component"
        )
    return spacing


def scaled_to_spacing(sensor_map: SensorMap, spacing: float, units: str) -> SensorMap:
    """Scale a map so that neighbouring sensors have a given spacing.

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
        The map in `units`, with the scale factor in its provenance. An error of the map in the
        nearest-neighbour distances becomes an error of the scale.

    Raises
    ------
    InputError
        If the map has no spacing (see `median_spacing`) or is in the frame of the robot, or
        `spacing` is not positive or is out of the range of floating-point numbers.
    """
    if not (np.isfinite(spacing) and spacing > 0):
        raise InputError(f"spacing must be a positive number, got {spacing:g}")
    if sensor_map.anchored:
        raise InputError("the map is in the frame of the robot, so it must not be scaled")
    factor = spacing / median_spacing(sensor_map)
    largest = float(np.nanmax(np.abs(sensor_map.positions))) * factor
    # Distances are computed from squares, which must neither underflow nor overflow.
    if not (spacing > _MIN_LENGTH and factor > 0 and largest < _MAX_LENGTH):
        raise InputError(
            f"a spacing of {spacing:g} {units} takes the positions out of the range of "
            "floating-point numbers; check its unit"
        )
    return replace(
        sensor_map,
        positions=factor * sensor_map.positions,
        errors=factor * sensor_map.errors,
        covariances=None if sensor_map.covariances is None else factor**2 * sensor_map.covariances,
        units=units,
        provenance={**sensor_map.provenance, "spacing": spacing, "scale": factor},
    )
