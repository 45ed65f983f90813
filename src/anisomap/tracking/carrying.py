"""New positions in the frame of an old map, with the corrections that the old map has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.errors import InputError
from anisomap.evaluation.difference import MIN_COMPARED
from anisomap.evaluation.neighbourhood import median_spacing
from anisomap.numerics.kriging import Kernel, predict_field
from anisomap.numerics.procrustes import Similarity, fit_similarity, fit_similarity_robustly
from anisomap.sensor_map import UNASSESSED, UNPLACED, SensorMap

# The corrections of an old map, such as those by a mesh, are taken to change over a few spacings.
_REACH, _NOISE = 3.0, 0.1
_NEIGHBOURS = 4  # of which a new sensor takes the largest error
_EXPLAINED = 0.5  # share of the variance of a map that its own evidence must explain


@dataclass(frozen=True, eq=False)
class _Frame:
    """From the map of new evidence to the frame of an old map.

    Parameters
    ----------
    rows : ndarray of int
        Rows of the old map from which the frame is known.
    label : int
        Their component on the old map.
    to_before : Similarity
        From the map of all evidence to that of the old evidence.
    to_old : Similarity
        From the map of the old evidence to the old map.
    base, field : ndarray of shape (n, k)
        Places of `rows` by `to_old`, and the corrections that the old map has there.
    """

    rows: NDArray[np.intp]
    label: int
    to_before: Similarity
    to_old: Similarity
    base: NDArray[np.float64]
    field: NDArray[np.float64]

    def carry(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transform points of the map of all evidence, shape (m, l), without corrections."""
        return self.to_old.apply(_padded(self.to_before.apply(points), self.base.shape[1]))

    def corrections(
        self, points: NDArray[np.float64], spacing: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Predict the corrections at carried points, and their RMS errors."""
        size = float(np.sqrt(np.mean(np.sum(self.field**2, axis=1))))
        found, variance = predict_field(
            self.base, self.field, points, Kernel(_REACH * spacing, _NOISE)
        )
        return found, size * np.sqrt(variance)


def carry_over(
    old: SensorMap,
    before: SensorMap,
    after: SensorMap,
    moved: Sequence[str],
    extra: Sequence[str] = (),
) -> SensorMap:
    """Bring a map of new evidence into the frame of an old map.

    Parameters
    ----------
    old : SensorMap
        The map to update.
    before, after : SensorMap
        Maps of the old evidence and of all evidence, by name, each in a frame of its own.
    moved : sequence of str
        Sensors that do not tell the frame, and do not keep their corrections.
    extra : sequence of str
        Sensors without a position that the result lists as well.

    Returns
    -------
    SensorMap
        Sensors of the old map that the new evidence does not place keep their positions. Sensors
        of components that share too few sensors with the old map are left out.

    Raises
    ------
    InputError
        If the old evidence is not that of the old map.
    """
    new = [n for n in (*after.names, *extra) if n not in set(old.names)]
    names = (*old.names, *dict.fromkeys(new))
    grown = _grown(old, names)
    row = {name: i for i, name in enumerate(names)}
    positions, component = np.array(grown.positions), np.array(grown.component)
    errors = np.array(grown.errors)
    normals = None if grown.normals is None else np.array(grown.normals)
    spacing = median_spacing(old.positions[old.component == 0])
    # Positions that were measured are worth more than any map.
    measured = {n for n, e in zip(old.names, old.errors, strict=True) if old.anchored and e == 0}
    for label in range(len(after.component_sizes)):
        members = np.flatnonzero(after.component == label)
        listed = [after.names[i] for i in members]
        frame = _frame(old, before, after, members, moved)
        if frame is None:
            continue
        carried = frame.carry(after.positions[members])
        found, doubt = frame.corrections(carried, spacing)
        found += carried
        kept = {old.names[i]: place for place, i in enumerate(frame.rows)}
        neighbours = KDTree(frame.base)
        for place, name in enumerate(listed):
            i = row[name]
            if name in kept:
                shift = carried[place] - frame.base[kept[name]]
                if name not in measured:
                    positions[i] = old.positions[i] + shift
                continue
            positions[i], component[i] = found[place], frame.label
            near = np.atleast_1d(
                neighbours.query(carried[place], k=min(_NEIGHBOURS, len(frame.rows)))[1]
            )
            errors[i] = np.hypot(np.max(old.errors[frame.rows[near]]), doubt[place])
            if normals is not None:
                normals[i] = np.nan
    return replace(
        grown,
        positions=positions,
        component=_renumbered(component),
        errors=errors,
        normals=normals,
        stress=after.stress,
        n_iterations=after.n_iterations,
        verdict=after.verdict,
        uneven=old.uneven or after.uneven,
        notes=tuple(dict.fromkeys((*old.notes, *after.notes))),
    )


def _grown(old: SensorMap, names: tuple[str, ...]) -> SensorMap:
    """Append sensors without a position to a map."""
    more = len(names) - old.n_sensors
    return replace(
        old,
        names=names,
        positions=np.pad(old.positions, ((0, more), (0, 0)), constant_values=np.nan),
        component=np.pad(old.component, (0, more), constant_values=UNPLACED),
        health=(*old.health, *(UNASSESSED,) * more),
        errors=np.pad(old.errors, (0, more), constant_values=np.nan),
        covariances=None,  # those of the old recordings alone
        normals=None
        if old.normals is None
        else np.pad(old.normals, ((0, more), (0, 0)), constant_values=np.nan),
    )


def _frame(
    old: SensorMap,
    before: SensorMap,
    after: SensorMap,
    members: NDArray[np.intp],
    moved: Sequence[str],
) -> _Frame | None:
    """Find the frame of a component of the map of all evidence; None if it shares too little."""
    rows = {name: i for i, name in enumerate(old.names)}
    places = {name: i for i, name in enumerate(before.names)}
    groups: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
    for i in members.tolist():
        name = after.names[i]
        if name in rows and name in places and name not in moved:
            key = int(old.component[rows[name]]), int(before.component[places[name]])
            if UNPLACED not in key:
                groups.setdefault(key, []).append((i, rows[name], places[name]))
    if not groups:
        return None
    (label, _), largest = max(groups.items(), key=lambda group: len(group[1]))
    new, there, then = np.array(largest, dtype=np.intp).T
    if len(new) <= after.dimensions:
        return None
    fit = fit_similarity_robustly if len(new) >= MIN_COMPARED else fit_similarity
    to_before = fit(after.positions[new], before.positions[then])
    dimensions = old.dimensions
    source, target = _padded(before.positions[then], dimensions), old.positions[there]
    to_old = fit_similarity(source, target)
    base = to_old.apply(source)
    field = target - base
    if np.sum(field**2) > (1 - _EXPLAINED) * np.sum((target - target.mean(axis=0)) ** 2):
        raise InputError(
            "the statistics are not those of the map: a map that is made of them has another "
            "shape; give the file that was written with the map"
        )
    return _Frame(there, label, to_before, to_old, base, field)


def _padded(points: NDArray[np.float64], dimensions: int) -> NDArray[np.float64]:
    return np.pad(points, ((0, 0), (0, dimensions - points.shape[1])))


def _renumbered(component: NDArray[np.intp]) -> NDArray[np.intp]:
    """Give components new numbers, in order of decreasing size."""
    labels, sizes = np.unique(component[component != UNPLACED], return_counts=True)
    order = {int(label): i for i, label in enumerate(labels[np.argsort(-sizes, kind="stable")])}
    return np.array([order.get(int(label), UNPLACED) for label in component], dtype=np.intp)
