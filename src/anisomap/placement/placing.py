"""Placing a map: from arbitrary units to metres in the frame of the robot."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.numerics.procrustes import fit_similarity
from anisomap.placement.anchors import DECISIVE, Anchors, Known, fit_anchors
from anisomap.placement.modules import NO_MODULE, Modules
from anisomap.placement.orientation import mirrored, pad_to_3d
from anisomap.placement.rigid_fit import ModuleFit, fit_modules
from anisomap.placement.scale import METRES, median_spacing, scaled_to_spacing
from anisomap.sensor_map import UNPLACED, SensorMap
from anisomap.wording import join_items

# Standard deviations of the logarithm of a scale; on the iCub hexagon, modules were 2 % off, and
# the median spacing of simulated maps 10 %.
_MODULE_SCALE, _SPACING_SCALE = 0.03, 0.1
_MIN_PADS = 3


@dataclass(frozen=True, eq=False)
class Placement:
    """A map in metres.

    Attributes
    ----------
    map : SensorMap
        With `SensorMap.errors` and in the frame of the robot if there were anchors.
    anchors : tuple of str
        Sensors that served as anchors.
    residuals : ndarray of shape (n,)
        Distances of the anchors from their places on the map, in metres.
    left_out_errors : ndarray of shape (n,)
        The same, each with a fit to the other anchors of its component; NaN with fewer than 5.
    methods : tuple of str
        How each component was placed, the largest first.
    left_out : tuple of str
        Sensors that could not be placed.
    """

    map: SensorMap
    anchors: tuple[str, ...]
    residuals: NDArray[np.float64]
    left_out_errors: NDArray[np.float64]
    methods: tuple[str, ...]
    left_out: tuple[str, ...]


def place(
    sensor_map: SensorMap,
    anchors: Anchors | None = None,
    *,
    modules: Modules | None = None,
    spacing: tuple[float, str] | None = None,
    handedness: str = "",
) -> Placement:
    """Give a map a scale, a handedness and a pose, with an error for each sensor.

    Parameters
    ----------
    sensor_map : SensorMap
    anchors : Anchors, optional
        Known positions: 3 and more, not in a line; 4, not in a plane, if nothing else tells the
        handedness of a map in 3D. Each component needs its own.
    modules : Modules, optional
        Rigid modules with a template: see `fit_modules`.
    spacing : (float, str), optional
        Median distance between neighbouring sensors and its unit.
    handedness : {"", "same", "mirrored"}
        Whether the map has the handedness of the skin, if the user knows.

    Returns
    -------
    Placement
        Without anchors the map keeps its components and has an arbitrary pose.

    Raises
    ------
    InputError
        If nothing gives a scale, an anchor is no sensor of the map, no component can be placed, or
        the handedness is not determined.
    """
    if handedness not in ("", "same", "mirrored"):
        raise InputError(f"handedness must be same or mirrored, got {handedness!r}")
    if sensor_map.anchored:
        raise InputError("the map is in the frame of the robot already; place the original map")
    if sensor_map.dimensions not in (2, 3):
        raise InputError(
            f"a map must have 2 or 3 dimensions to be placed, got {sensor_map.dimensions}"
        )
    stated = None if not handedness else handedness == "mirrored"
    if anchors is None and modules is None and spacing is None and sensor_map.units not in METRES:
        raise InputError(
            "nothing places the map; give anchors, modules, or the spacing of the sensors"
        )
    parts = [_scaled(part, modules, spacing) for part in _components(sensor_map)]
    if anchors is None:
        return _unanchored(sensor_map, parts, stated)
    return _anchored(sensor_map, parts, anchors, modules, stated)


@dataclass(frozen=True, eq=False)
class _Part:
    """A component of the map: all sensors, placed or not, and what is known of it."""

    map: SensorMap
    scale_sigma: float
    evidence: float
    fit: ModuleFit | None

    def known(self, stated: bool | None) -> Known:
        return Known(median_spacing(self.map), self.scale_sigma, self.evidence, stated)


def _components(sensor_map: SensorMap) -> list[SensorMap]:
    """Return each component with all sensors, those of other components without a position."""
    parts = []
    for label in range(len(sensor_map.component_sizes)):
        members = sensor_map.component == label
        positions = np.where(members[:, None], sensor_map.positions, np.nan)
        parts.append(
            replace(sensor_map, positions=positions, component=np.where(members, 0, UNPLACED))
        )
    return parts


def _scaled(part: SensorMap, modules: Modules | None, spacing: tuple[float, str] | None) -> _Part:
    """Scale a component by its modules, else by its spacing."""
    elsewhere = part.placed
    if modules is not None and _has_module(part, modules):
        fit = fit_modules(part, modules)
        return _Part(_in_metres(fit.map), _MODULE_SCALE, abs(fit.evidence), fit)
    if spacing is not None and np.count_nonzero(elsewhere) > 1:
        return _Part(_in_metres(scaled_to_spacing(part, *spacing)), _SPACING_SCALE, 0.0, None)
    if part.units in METRES:
        return _Part(_in_metres(part), _SPACING_SCALE, 0.0, None)
    return _Part(part, np.inf, 0.0, None)


def _has_module(part: SensorMap, modules: Modules) -> bool:
    on_module = modules.index[part.placed & (modules.index != NO_MODULE)]
    return bool(on_module.size) and int(np.bincount(on_module).max()) >= _MIN_PADS


def _in_metres(sensor_map: SensorMap) -> SensorMap:
    factor = METRES[sensor_map.units]
    return replace(
        sensor_map,
        positions=factor * sensor_map.positions,
        errors=factor * sensor_map.errors,
        units="m",
    )


def _unanchored(sensor_map: SensorMap, parts: list[_Part], stated: bool | None) -> Placement:
    """Combine components in metres, each in a frame of its own."""
    positions = np.full_like(sensor_map.positions, np.nan)
    component = np.full(sensor_map.n_sensors, UNPLACED)
    methods, handed = [], True
    for label, part in enumerate(parts):
        if part.map.units != "m":
            methods.append("not placed: no module has 3 of its sensors")
            continue
        known = part.map
        hand = part.evidence >= DECISIVE
        if not hand and stated is not None:
            known, hand = (mirrored(known) if stated else known), True
        handed = handed and hand
        fresh = known.placed & (sensor_map.placed <= (sensor_map.component == label))
        positions[fresh], component[fresh] = known.positions[fresh], label
        methods.append("scaled by its modules" if part.fit else "scaled by its spacing")
    labels = np.unique(component[component != UNPLACED])
    renumbered = np.where(component == UNPLACED, UNPLACED, np.searchsorted(labels, component))
    missing = _missing(sensor_map, renumbered)
    result = replace(
        sensor_map,
        positions=positions,
        component=renumbered,
        units="m",
        handed=handed,
        notes=(*sensor_map.notes, *_left_out_note(missing)),
    )
    empty = np.empty(0)
    return Placement(result, (), empty, empty, tuple(methods), missing)


def _anchored(
    sensor_map: SensorMap,
    parts: list[_Part],
    anchors: Anchors,
    modules: Modules | None,
    stated: bool | None,
) -> Placement:
    """Place each component by its anchors, all in one frame."""
    rows = {name: i for i, name in enumerate(sensor_map.names)}
    unknown = [name for name in anchors.names if name not in rows]
    if unknown:
        raise InputError(f"anchor {join_items(unknown)} is no sensor of the map")
    where = np.array([rows[name] for name in anchors.names], dtype=np.intp)
    k = max(anchors.positions.shape[1], sensor_map.dimensions)
    if anchors.positions.shape[1] < sensor_map.dimensions:
        raise InputError("anchors of a map in 3D must have three coordinates")
    positions = np.full((sensor_map.n_sensors, k), np.nan)
    errors = np.full(sensor_map.n_sensors, np.nan)
    residuals, left_out = (np.full(len(where), np.nan) for _ in range(2))
    methods, failures = [], []
    mirror, handed = False, True
    for label, part in enumerate(parts):
        here = part.map.placed & (sensor_map.placed <= (sensor_map.component == label))
        mine = np.flatnonzero(here[where])
        members = np.flatnonzero(here)
        try:
            index = np.searchsorted(members, where[mine])
            points = part.map.positions[members]
            fit = fit_anchors(
                points if k == points.shape[1] else pad_to_3d(points),
                index,
                anchors.positions[mine],
                part.known(stated),
            )
        except InputError as error:
            failures.append(error)
            methods.append(f"not placed: {error}")
            continue
        mirror, handed = mirror or fit.reflected, handed and fit.handed
        positions[members] = fit.positions
        errors[members] = fit.errors
        residuals[mine], left_out[mine] = fit.residuals, fit.left_out
        how = "similarity and smooth field" if fit.warped else "similarity"
        known = " of rigid modules" if part.fit else ""
        methods.append(f"{how}{known}, {len(mine)} anchors")
        if part.fit is not None and modules is not None and fit.warped:
            _make_rigid(positions, members, modules)
    if failures and not np.isfinite(positions).any():
        raise failures[0]
    if modules is None:
        # What was measured is worth more than the map; modules stay rigid instead.
        measured = where[np.isfinite(residuals)]
        positions[measured] = anchors.positions[np.isfinite(residuals)]
        errors[measured] = 0.0
    component = np.where(np.isfinite(positions).all(axis=1), 0, UNPLACED)
    missing = _missing(sensor_map, component)
    result = replace(
        sensor_map,
        positions=positions,
        component=component,
        errors=errors,
        units="m",
        handed=handed,
        anchored=True,
        mirrored=sensor_map.mirrored != mirror,
        notes=(*sensor_map.notes, *_left_out_note(missing)),
        provenance={**sensor_map.provenance, "anchors": len(where), "placed_by": methods[0]},
    )
    return Placement(result, anchors.names, residuals, left_out, tuple(methods), missing)


def _make_rigid(
    positions: NDArray[np.float64], members: NDArray[np.intp], modules: Modules
) -> None:
    """Give the modules of a warped map their shape again, in place."""
    k = positions.shape[1]
    template = modules.offsets[:, :k] * METRES[modules.units]
    offsets = np.pad(template, ((0, 0), (0, k - template.shape[1])))
    for module in np.unique(modules.index[members]):
        on_module = members[modules.index[members] == module]
        if module != NO_MODULE and len(on_module) >= _MIN_PADS:
            rigid = fit_similarity(
                offsets[on_module], positions[on_module], scaling=False, reflection=False
            )
            positions[on_module] = rigid.apply(offsets[on_module])


def _missing(sensor_map: SensorMap, component: NDArray[np.intp]) -> tuple[str, ...]:
    lost = sensor_map.placed & (component == UNPLACED)
    return tuple(sensor_map.names[i] for i in np.flatnonzero(lost))


def _left_out_note(missing: tuple[str, ...]) -> tuple[str, ...]:
    if not missing:
        return ()
    return (
        f"{len(missing)} sensors were left out when the map was placed, since their component "
        f"could not be: {join_items(missing)}",
    )
