"""Differences between two maps of one skin: which sensors moved, appeared or were lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from anisomap.base.immutable import Immutable
from anisomap.errors import InputError
from anisomap.evaluation.scoring import check_distances, median_spacing
from anisomap.names import match_names, match_sensors
from anisomap.numerics.neighbours import nearest_others, padded
from anisomap.numerics.procrustes import fit_similarity_robustly
from anisomap.sensor_map import UNPLACED, SensorMap, is_faulty

LEVEL = 0.01
"""Probability that chance alone marks any sensor as moved."""

MIN_COMPARED = 8
"""Minimum number of sensors of two components that are aligned.

The median and a quartile of displacements give the scale and the tail of chance displacements.
"""

# Tuned on maps of halves of the iCub hexagon and palm and of rubbed planes, cylinders and spheres.
_NEIGHBOURS = 12
_MIN_REFERENCES = 3  # the median of fewer neighbours is not robust
_PASSES = 3  # the set of reference sensors is stable after two
_UPPER_QUARTILE = float(ndtri(0.75))
# Logarithmic spread between the median and the upper quartile of Rayleigh's distribution, i.e. of
# the length of a normal vector in the plane. Estimates from few sensors may be smaller.
_MIN_SPREAD: float = 0.5 * np.log(np.log(4) / np.log(2)) / _UPPER_QUARTILE
_ROUNDING = 2e-4  # of coordinates in files, relative to the spacing


@dataclass(frozen=True, eq=False)
class Difference(Immutable):
    """Comparison of two maps of one skin.

    Attributes
    ----------
    names : tuple of str
        All sensors of the first map, then the sensors that only the second map contains.
    distance : ndarray of shape (M,)
        Displacement of each sensor relative to its unmoved neighbours, in `units`; NaN if not
        compared.
    moved : ndarray of bool, shape (M,)
        Sensors that moved farther than chance explains.
    appeared, lost : ndarray of bool, shape (M,)
        Sensors that are placed on the second map only, or on the first map only; faulty sensors
        count as not placed.
    smallest : float
        The smallest detectable move of a single sensor, in `units`; infinite if chance explains
        every move.
    spacing : float
        Median distance between neighbours on the first map, in `units`.
    units : str
        Units of the first map.
    notes : tuple of str
        Sensors that were not compared, and the reasons.
    """

    names: tuple[str, ...]
    distance: NDArray[np.float64]
    moved: NDArray[np.bool_]
    appeared: NDArray[np.bool_]
    lost: NDArray[np.bool_]
    smallest: float
    spacing: float
    units: str
    notes: tuple[str, ...]

    @property
    def found(self) -> bool:
        """Whether any sensor moved, appeared or was lost."""
        return bool((self.moved | self.appeared | self.lost).any())


def compare_maps(before: SensorMap, after: SensorMap) -> Difference:
    """Find the sensors whose position or presence differs between two maps.

    Each component is aligned robustly: sensors that moved do not affect the alignment. Since
    maps of one skin differ by a smooth distortion as well, the displacement of a sensor is compared
    with the median displacement of its neighbours. Chance displacements are taken to be
    log-normal, with the median and the upper quartile of all sensors, which allows for tails that
    are heavier than those of normal errors. A sensor moved if chance alone displaces any of the
    compared sensors as far with a probability below `LEVEL` (Bonferroni).

    Parameters
    ----------
    before, after : SensorMap
        Two maps of one skin. Sensors are matched by name, taxels of an iCub by number if no name is
        shared, and sensors by order if one map has no names. Units, frames and handedness may
        differ.

    Returns
    -------
    Difference

    Raises
    ------
    InputError
        If the maps share no sensors, no two components share `MIN_COMPARED`, or all sensors of a
        map have the same position.
    """
    by_order = match_sensors(before.names, after.names, "the maps")[1]
    own = before.names if by_order else after.names
    names = tuple(dict.fromkeys((*before.names, *own)))
    dimensions = max(before.dimensions, after.dimensions)
    positions = np.full((2, len(names), dimensions), np.nan)
    component = np.full((2, len(names)), UNPLACED)
    here = np.zeros((2, len(names)), dtype=bool)
    for i, (sensor_map, called) in enumerate(((before, before.names), (after, own))):
        rows = match_names(called, names)
        positions[i, rows] = padded(sensor_map.positions, dimensions)
        component[i, rows] = sensor_map.component
        here[i, rows] = sensor_map.placed & [not is_faulty(one) for one in sensor_map.health]
    placed = (component != UNPLACED).all(axis=0)
    groups = _shared_components(component, placed)
    if not groups:
        raise InputError(f"the maps have no {MIN_COMPARED} common sensors in one component")
    level = LEVEL / sum(map(len, groups))
    distance, moved = np.full(len(names), np.nan), np.zeros(len(names), dtype=bool)
    limits = []
    for members in groups:
        first, second = positions[:, members]
        check_distances(first, "the first map")
        check_distances(second, "the second map")
        fit = fit_similarity_robustly(second, first)
        distance[members], moved[members], limit = _moves(first, fit.apply(second), level)
        limits.append(limit)
    notes = list(by_order)
    if left_out := int(np.count_nonzero(placed & np.isnan(distance))):
        notes.append(
            "sensors not compared, because their components share fewer than "
            f"{MIN_COMPARED} sensors: {left_out}"
        )
    return Difference(
        names=names,
        distance=distance,
        moved=moved,
        appeared=here[1] & ~here[0],
        lost=here[0] & ~here[1],
        smallest=min(limits),
        spacing=median_spacing(positions[0, groups[0]]),
        units=before.units,
        notes=tuple(notes),
    )


def _shared_components(
    component: NDArray[np.intp], placed: NDArray[np.bool_]
) -> list[NDArray[np.intp]]:
    """List the sensors of each pair of components that share enough sensors, the largest first."""
    both = np.flatnonzero(placed)
    labels, inverse = np.unique(component[:, both], axis=1, return_inverse=True)
    groups = [both[inverse.ravel() == i] for i in range(labels.shape[1])]
    return sorted((g for g in groups if len(g) >= MIN_COMPARED), key=len, reverse=True)


def _moves(
    before: NDArray[np.float64], after: NDArray[np.float64], level: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_], float]:
    """Test displacements, and displacements relative to neighbours with the same distortion.

    The first test detects patches that moved as a whole, the second single sensors. Returns
    relative displacements, whether sensors moved, and the smallest detectable move.
    """
    displacement = after - before
    near = nearest_others(before, _NEIGHBOURS)[1]
    rounding = max(_ROUNDING * median_spacing(before), np.finfo(float).tiny)
    whole = np.linalg.norm(displacement, axis=1)
    as_patch = moved = whole > _limit(whole, level / 2, rounding)
    for _ in range(_PASSES):
        reference = np.where(moved[:, None], np.nan, displacement)[near]
        known = np.isfinite(reference[:, :, 0]).sum(axis=1) >= _MIN_REFERENCES
        drift = np.zeros_like(displacement)
        drift[known] = np.nanmedian(reference[known], axis=1)
        local = np.linalg.norm(displacement - drift, axis=1)
        limit = _limit(local, level / 2, rounding)
        moved = as_patch | (local > limit)
    return local, moved, limit


def _limit(lengths: NDArray[np.float64], p_value: float, rounding: float) -> float:
    """Return the length that log-normal chance exceeds with a probability. lengths (N,).

    A few moved sensors hardly change the median and the upper quartile.
    """
    middle, upper = np.maximum(np.quantile(lengths, [0.5, 0.75]), rounding)
    spread = max(float(np.log(upper / middle)) / _UPPER_QUARTILE, _MIN_SPREAD)
    with np.errstate(over="ignore"):
        return float(middle * np.exp(-spread * ndtri(p_value)))
