"""Differences between two maps of one skin: which sensors moved, appeared or were lost."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from anisomap.base.defaults import LEVEL
from anisomap.base.immutable import Immutable
from anisomap.base.wording import counted
from anisomap.errors import InputError
from anisomap.evaluation.scoring import check_distances, median_spacing
from anisomap.numerics.neighbours import nearest_others, padded
from anisomap.numerics.procrustes import Similarity, fit_similarity_robustly
from anisomap.recording import match_names, match_sensors
from anisomap.sensor_map import UNPLACED, SensorMap, is_faulty

MIN_COMPARED = 8
"""Minimum number of sensors of two components that are aligned.

The scale and the tail of chance differences are estimated from the median and a quartile.
"""

# Tuned on maps of halves of the iCub hexagon and palm and of rubbed planes, cylinders and spheres.
_NEIGHBOURS = 12
_MIN_REFERENCES = 3  # the median of fewer neighbours is not robust
_PASSES = 3  # the set of sensors that serve as references settles after two
_UPPER_QUARTILE = float(ndtri(0.75))
# Rayleigh's distribution, of the length of a normal vector in the plane, has this spread of its
# logarithm between the median and the upper quartile. A smaller estimate comes from few sensors.
_MIN_SPREAD: float = 0.5 * np.log(np.log(4) / np.log(2)) / _UPPER_QUARTILE

_LARGEST_LOGARITHM = 700.0  # of a floating-point number


@dataclass(frozen=True, eq=False)
class Difference(Immutable):
    """Comparison of two maps of one skin.

    Attributes
    ----------
    names : tuple of str
        All sensors of the first map, then those that only the second has.
    before, after : ndarray of shape (M, k)
        Positions on the first map, and on the second map aligned with the first; NaN if not
        placed, or not compared.
    distance : ndarray of shape (M,)
        How far each sensor moved relative to its neighbours that did not, in `units`; NaN if not
        compared.
    p_values : ndarray of shape (M,)
        Probability that chance alone moves any of the compared sensors as far (Bonferroni).
    moved : ndarray of bool, shape (M,)
        Sensors that moved farther than chance explains.
    appeared, lost : ndarray of bool, shape (M,)
        Sensors that only the second map places, or only the first; a sensor whose health became
        faulty is lost, and one that recovered has appeared.
    compared : ndarray of bool, shape (M,)
        Sensors that both maps place in components that could be aligned.
    chance : float
        Distance relative to its neighbours beyond which a single sensor counts as moved; the
        smallest over components.
    spacing : float
        Median distance between neighbours on the first map, in `units`.
    scale : float
        Scale factor from the second map to the first.
    reflected : bool
        Whether the second map is a mirror image of the first.
    units : str
        Units of the first map.
    notes : tuple of str
        Sensors that were not compared, and why.
    """

    names: tuple[str, ...]
    before: NDArray[np.float64]
    after: NDArray[np.float64]
    distance: NDArray[np.float64]
    p_values: NDArray[np.float64]
    moved: NDArray[np.bool_]
    appeared: NDArray[np.bool_]
    lost: NDArray[np.bool_]
    compared: NDArray[np.bool_]
    chance: float
    spacing: float
    scale: float
    reflected: bool
    units: str
    notes: tuple[str, ...]

    @property
    def found(self) -> bool:
        """Whether any sensor moved, appeared or was lost."""
        return bool((self.moved | self.appeared | self.lost).any())


def compare_maps(before: SensorMap, after: SensorMap, *, level: float = LEVEL) -> Difference:
    """Find the sensors of which the position, or the presence, differs between two maps.

    Each component is aligned robustly, so that sensors that moved do not bend the others. Since
    maps of one skin differ by a smooth distortion as well, the displacement of a sensor is compared
    with the median displacement of its neighbours. Chance displacements are taken to be
    log-normal, with the median and the upper quartile of all sensors, which allows for tails that
    are heavier than those of normal errors.

    Parameters
    ----------
    before, after : SensorMap
        Two maps of one skin. Sensors are matched by name, or by order if one map has no names.
        Their units, frames and handedness may differ.
    level : float
        Probability that chance alone marks any sensor as moved, in (0, 1).

    Returns
    -------
    Difference

    Raises
    ------
    InputError
        If the maps share no sensors, no two components share `MIN_COMPARED`, all sensors of a map
        have the same position, or the level is out of range.
    """
    if not 0 < level < 1:
        raise InputError(f"the level must be between 0 and 1, got {level:g}")
    before.check_coordinates("on the first map")
    after.check_coordinates("on the second map")
    pair = _match(before, after)
    groups = _aligned_groups(pair)
    if not groups:
        raise InputError(
            f"the maps cannot be aligned: {MIN_COMPARED} sensors must be connected on both maps"
        )
    n_sensors = len(pair.names)
    aligned = np.full_like(pair.after, np.nan)
    distance, p_values = np.full(n_sensors, np.nan), np.full(n_sensors, np.nan)
    n_compared = sum(len(members) for members, _ in groups)
    limits = []
    for members, fit in groups:
        aligned[members] = fit.apply(pair.after[members])
        distance[members], chances, limit = _chances(
            pair.before[members], aligned[members], level / n_compared
        )
        p_values[members] = np.minimum(1.0, n_compared * chances)
        limits.append(limit)
    compared = np.isfinite(distance)
    notes = list(pair.notes)
    left_out = int(np.count_nonzero(pair.placed.all(axis=0) & ~compared))
    if left_out:
        notes.append(
            f"{counted(left_out, 'sensor')} not compared: their components share fewer than "
            f"{MIN_COMPARED}"
        )
    here = pair.placed & pair.working
    return Difference(
        names=pair.names,
        before=pair.before,
        after=aligned,
        distance=distance,
        p_values=p_values,
        moved=p_values < level,
        appeared=here[1] & ~here[0],
        lost=here[0] & ~here[1],
        compared=compared,
        chance=min(limits),
        spacing=median_spacing(pair.before[groups[0][0]]),
        scale=groups[0][1].scale,
        reflected=groups[0][1].reflected,
        units=before.units,
        notes=tuple(notes),
    )


@dataclass(frozen=True)
class _Pair:
    """Two maps with one row per sensor of either; axis 0 of masks and labels is the map."""

    names: tuple[str, ...]
    before: NDArray[np.float64]
    after: NDArray[np.float64]
    component: NDArray[np.intp]
    working: NDArray[np.bool_]
    notes: tuple[str, ...]

    @property
    def placed(self) -> NDArray[np.bool_]:
        return np.asarray(self.component != UNPLACED)


def _match(before: SensorMap, after: SensorMap) -> _Pair:
    """Match sensors by name, or by order if one map has no names."""
    _, notes = match_sensors(before.names, after.names, "the maps")
    if notes:
        after = replace(after, names=before.names)
    names = tuple(dict.fromkeys((*before.names, *after.names)))
    dimensions = max(before.dimensions, after.dimensions)
    positions = np.full((2, len(names), dimensions), np.nan)
    component = np.full((2, len(names)), UNPLACED)
    working = np.zeros((2, len(names)), dtype=bool)
    for i, sensor_map in enumerate((before, after)):
        rows = match_names(sensor_map.names, names)
        positions[i, rows] = padded(sensor_map.positions, dimensions)
        component[i, rows] = sensor_map.component
        working[i, rows] = [not is_faulty(status) for status in sensor_map.health]
    return _Pair(names, positions[0], positions[1], component, working, notes)


def _aligned_groups(pair: _Pair) -> list[tuple[NDArray[np.intp], Similarity]]:
    """Fit each pair of components that share enough sensors, the largest first."""
    both = np.flatnonzero(pair.placed.all(axis=0))
    labels, inverse = np.unique(pair.component[:, both], axis=1, return_inverse=True)
    groups = [both[inverse.ravel() == i] for i in range(labels.shape[1])]
    groups = sorted((g for g in groups if len(g) >= MIN_COMPARED), key=len, reverse=True)
    for group in groups:
        check_distances(pair.before[group], "the first map")
        check_distances(pair.after[group], "the second map")
    return [(g, fit_similarity_robustly(pair.after[g], pair.before[g])) for g in groups]


def _chances(
    before: NDArray[np.float64], after: NDArray[np.float64], level: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Test displacements as they are, and relative to neighbours in the same distortion.

    The former show patches that moved as a whole, the latter single sensors. Returns displacements
    relative to neighbours, p values, and the displacement that has the level as p value.
    """
    displacement = after - before
    near = nearest_others(before, _NEIGHBOURS)[1]
    whole = np.linalg.norm(displacement, axis=1)
    tests = 2.0
    of_whole = _Tail.of(whole).p_values(whole)
    p_values = tests * of_whole
    for _ in range(_PASSES):
        reference = np.where((p_values < level)[:, None], np.nan, displacement)[near]
        known = np.isfinite(reference[:, :, 0]).sum(axis=1) >= _MIN_REFERENCES
        drift = np.zeros_like(displacement)
        drift[known] = np.nanmedian(reference[known], axis=1)
        local = np.linalg.norm(displacement - drift, axis=1)
        tail = _Tail.of(local)
        p_values = np.minimum(1.0, tests * np.minimum(of_whole, tail.p_values(local)))
    return local, p_values, tail.quantile(level / tests)


@dataclass(frozen=True)
class _Tail:
    """Log-normal distribution of lengths of displacements."""

    median: float
    spread: float

    @classmethod
    def of(cls, lengths: NDArray[np.float64]) -> _Tail:
        """Fit the median and the upper quartile, which few sensors that moved do not change."""
        middle, upper = np.maximum(np.quantile(lengths, [0.5, 0.75]), np.finfo(float).tiny)
        return cls(float(middle), max(float(np.log(upper / middle)) / _UPPER_QUARTILE, _MIN_SPREAD))

    def p_values(self, lengths: NDArray[np.float64]) -> NDArray[np.float64]:
        positive = np.maximum(lengths, np.finfo(float).tiny)
        return np.asarray(ndtr(-np.log(positive / self.median) / self.spread))

    def quantile(self, p_value: float) -> float:
        logarithm = np.log(self.median) - self.spread * ndtri(p_value)
        return float(np.exp(min(logarithm, _LARGEST_LOGARITHM)))
