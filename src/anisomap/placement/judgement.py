"""How far a map can be used, in words: errors are lengths where the scale of the map is known.

Three errors of one map are told, each as what it is: that of the map, an RMS over its sensors; that
of regions; and that of a single sensor, a distance that it does not exceed with 90 %, whatever the
error of the map is within its interval.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.placement.frames import METRES, length_shown, median_spacing
from anisomap.sensor_map import SensorMap, radius
from anisomap.usability import ACCURACY

COVERAGE = 0.9
"""Probability with which a sensor is within its error."""


def headline(sensor_map: SensorMap) -> str:
    """Return the verdict on a map, and how far its positions are off, in one line."""
    return sensor_map.verdict.headline(*spacing_shown(sensor_map))


def judgement(sensor_map: SensorMap) -> tuple[str, ...]:
    """Say how far a map can be used, what that means, its accuracy, and the reasons."""
    spacing, unit = spacing_shown(sensor_map)
    told = list(sensor_map.verdict.told(spacing, unit))
    within = errors_of_sensors(sensor_map)
    within = within[np.isfinite(within) & (sensor_map.component == 0)]
    if within.size and unit == "mm":
        factor = length_shown(sensor_map.units, "")[1]
        told.insert(
            2,
            "These are RMS errors over all sensors; a single sensor is within "
            f"{float(np.median(within)) * factor:.2g} mm of its place with a probability of 90%.",
        )
    return tuple(told)


def errors_in_mm(sensor_map: SensorMap) -> dict[str, float]:
    """Return the errors of a verdict in mm, by name with ``_mm``; {} if the scale is unknown."""
    spacing, unit = spacing_shown(sensor_map)
    names = [name for name in ACCURACY if not name.startswith("neighbours")]
    known = names if unit == "mm" else []
    return {f"{name}_mm": spacing * getattr(sensor_map.verdict, name) for name in known}


def spacing_shown(sensor_map: SensorMap) -> tuple[float, str]:
    """Return the median spacing of a map in mm, and mm; 1 and spacings if its scale is unknown."""
    if sensor_map.units in METRES:
        unit, factor = length_shown(sensor_map.units, "")
        try:
            return factor * median_spacing(sensor_map), unit
        except InputError:  # a single sensor, or all at one position
            pass
    return 1.0, "spacings"


def errors_of_sensors(sensor_map: SensorMap) -> NDArray[np.float64]:
    """Return the distance within which each sensor is with `COVERAGE`, shape (N,), in its units.

    From `SensorMap.errors` of a placed map, else from its covariances; NaN if unknown.
    """
    if sensor_map.covariances is None:
        return sensor_map.errors
    k = sensor_map.dimensions
    variance = np.trace(sensor_map.covariances, axis1=1, axis2=2) / k
    found = radius(k, COVERAGE) * np.sqrt(variance)
    return np.where(np.isfinite(sensor_map.errors), sensor_map.errors, found)
