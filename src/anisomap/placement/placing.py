"""Placing a map: from arbitrary units to metres in the frame of the robot."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.numerics.procrustes import fit_similarity
from anisomap.placement.anchors import AnchorFit, Anchors, fit_anchors
from anisomap.placement.frames import (
    METRES,
    check_placeable,
    mirrored,
    pad_to_3d,
    rescaled,
    scaled_to_spacing,
    surface_normals,
)
from anisomap.placement.handedness import DECISIVE, Known, Normals
from anisomap.placement.modules import NO_MODULE, Modules, fit_modules
from anisomap.placement.surface import (
    Surface,
    bend_to_surface,
    check_near_surface,
    fit_to_surface,
    surface_evidence,
)
from anisomap.recording import match_names
from anisomap.scene import Mesh
from anisomap.sensor_map import UNPLACED, SensorMap
from anisomap.wording import join_items

# Standard deviations of the logarithm of a scale. Modules were 1 to 5 % off on the iCub hexagon and
# on simulated hexagons, seeds 201 to 203; that of the spacing is a guess on the safe side.
_MODULE_SCALE, _SPACING_SCALE = 0.04, 0.2
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
    mesh: Mesh | None = None,
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
    mesh : Mesh, optional
        Surface of the skin in metres, in the frame of the anchors: sensors are placed on it, with
        its normals, and its shape may tell the handedness.
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
    check_placeable(sensor_map, handedness)
    if mesh is not None and anchors is None:
        raise InputError("to place a map on a mesh, give at least 3 anchors")
    stated = None if not handedness else handedness == "mirrored"
    if anchors is None and modules is None and spacing is None and sensor_map.units not in METRES:
        raise InputError(
            "the map has no scale: give anchors, modules, or the spacing of the sensors "
            "(--anchors, --module-layout or --spacing)"
        )
    parts = [_scaled(part, modules, spacing) for part in _components(sensor_map)]
    if anchors is None:
        return _unanchored(sensor_map, parts, stated)
    surface = None if mesh is None else Surface(mesh)
    return _anchored(sensor_map, parts, anchors, _Shape(modules, surface, stated))


@dataclass(frozen=True, eq=False)
class _Shape:
    """What is known of the shape of the skin, and its stated handedness."""

    modules: Modules | None
    surface: Surface | None
    mirrored: bool | None


@dataclass(frozen=True, eq=False)
class _Part:
    """A component of the map: all sensors, placed or not, and what is known of it.

    rigid: Whether it was fitted by its modules.
    """

    map: SensorMap
    scale_sigma: float = np.inf
    evidence: float = 0.0
    how: str = ""
    rigid: bool = False


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
    if modules is not None and _has_module(part, modules):
        fit = fit_modules(part, modules)
        scaled, evidence = _in_metres(fit.map), abs(fit.evidence)
        return _Part(scaled, _MODULE_SCALE, evidence, "scaled by its modules", rigid=True)
    if spacing is not None and np.count_nonzero(part.placed) > 1:
        scaled = _in_metres(scaled_to_spacing(part, *spacing))
        return _Part(scaled, _SPACING_SCALE, how="scaled by its spacing")
    if part.units in METRES:
        how = f"in {part.units}, converted to m"
        return _Part(_in_metres(part), _SPACING_SCALE, how=how)
    return _Part(part)


def _has_module(part: SensorMap, modules: Modules) -> bool:
    on_module = modules.index[part.placed & (modules.index != NO_MODULE)]
    return bool(on_module.size) and int(np.bincount(on_module).max()) >= _MIN_PADS


def _in_metres(sensor_map: SensorMap) -> SensorMap:
    return rescaled(sensor_map, METRES[sensor_map.units], "m")


def _unanchored(sensor_map: SensorMap, parts: list[_Part], stated: bool | None) -> Placement:
    """Combine components in metres, each in a frame of its own."""
    positions = np.full_like(sensor_map.positions, np.nan)
    covariances = np.full((*positions.shape, positions.shape[1]), np.nan)
    component = np.full(sensor_map.n_sensors, UNPLACED)
    methods, handed, mirror = [], True, sensor_map.mirrored
    for label, part in enumerate(parts):
        if part.map.units != "m":
            methods.append("not placed: no module has 3 of its sensors")
            continue
        known = part.map
        hand = part.evidence >= DECISIVE
        if not hand and stated is not None:
            known, hand = (mirrored(known) if stated else known), True
        handed = handed and hand
        mirror = known.mirrored if label == 0 else mirror
        fresh = known.placed & (sensor_map.placed <= (sensor_map.component == label))
        positions[fresh], component[fresh] = known.positions[fresh], label
        if known.covariances is not None:
            covariances[fresh] = known.covariances[fresh]
        methods.append(part.how)
    labels = np.unique(component[component != UNPLACED])
    renumbered = np.where(component == UNPLACED, UNPLACED, np.searchsorted(labels, component))
    missing = _missing(sensor_map, renumbered)
    result = replace(
        sensor_map,
        positions=positions,
        component=renumbered,
        covariances=None if sensor_map.covariances is None else covariances,
        units="m",
        handed=handed,
        mirrored=mirror,
        notes=(*sensor_map.notes, *_left_out_note(missing)),
    )
    empty = np.empty(0)
    return Placement(result, (), empty, empty, tuple(methods), missing)


@dataclass(frozen=True, eq=False)
class _PlacedPart:
    """A component in the frame of the robot."""

    fit: AnchorFit
    positions: NDArray[np.float64]
    normals: NDArray[np.float64]
    method: str


def _place_part(
    part: _Part,
    members: NDArray[np.intp],
    anchored: NDArray[np.intp],
    anchors: Anchors,
    shape: _Shape,
) -> _PlacedPart:
    """Place the sensors `members` of a component by the anchors of its sensors `anchored`."""
    targets = anchors.positions
    k = targets.shape[1]
    points = part.map.positions[members]
    points = points if k == points.shape[1] else pad_to_3d(points)
    index, evidence = np.searchsorted(members, anchored), part.evidence
    if shape.surface is not None and len(index) >= k:
        evidence += surface_evidence(points, index, targets, shape.surface)
    known = Known.of(part.map, shape.mirrored, part.scale_sigma, evidence)
    measured = None
    if anchors.normals is not None:
        measured = Normals(surface_normals(part.map)[members], anchors.normals)
    fit = fit_anchors(points, index, targets, known, measured)
    positions, normals = fit.positions, np.full((len(members), 3), np.nan)
    how = "similarity and smooth field" if fit.warped else "similarity"
    if shape.surface is not None:
        if not fit.warped:
            positions = fit_to_surface(
                points, index, targets, shape.surface, reflection=fit.reflected
            )
        check_near_surface(positions, fit.errors, shape.surface)
        bent = bend_to_surface(positions, index, targets, shape.surface)
        positions, normals = shape.surface.nearest(bent)
        how += " on the mesh"
    if part.rigid and shape.modules is not None:
        how += " of rigid modules"
        positions = _rigid(positions, shape.modules.select(members))
    return _PlacedPart(fit, positions, normals, f"{how}, {len(index)} anchors")


def _anchored(
    sensor_map: SensorMap, parts: list[_Part], anchors: Anchors, shape: _Shape
) -> Placement:
    """Place each component by its anchors, all in one frame."""
    where = _rows(sensor_map, anchors, shape)
    k = max(anchors.positions.shape[1], sensor_map.dimensions)
    n_sensors = sensor_map.n_sensors
    positions, normals = np.full((n_sensors, k), np.nan), np.full((n_sensors, 3), np.nan)
    errors = np.full(n_sensors, np.nan)
    residuals, left_out = (np.full(len(where), np.nan) for _ in range(2))
    methods, placed, failures = [], [], []
    mirror: bool | None = None
    for label, part in enumerate(parts):
        here = part.map.placed & (sensor_map.placed <= (sensor_map.component == label))
        mine, members = np.flatnonzero(here[where]), np.flatnonzero(here)
        try:
            found = _place_part(part, members, where[mine], anchors.select(mine), shape)
        except InputError as error:
            failures.append(error)
            methods.append(f"not placed: {error}")
            continue
        placed.append(found.fit)
        if mirror is None:
            mirror = part.map.mirrored != found.fit.reflected
        methods.append(found.method)
        positions[members], normals[members] = found.positions, found.normals
        errors[members] = found.fit.errors
        residuals[mine], left_out[mine] = found.fit.residuals, found.fit.left_out
    if not placed:
        raise failures[0]
    if shape.modules is None:
        # What was measured is worth more than the map; modules stay rigid instead.
        measured = np.isfinite(residuals)
        positions[where[measured]] = anchors.positions[measured]
        errors[where[measured]] = 0.0
    component = np.where(np.isfinite(positions).all(axis=1), 0, UNPLACED)
    missing = _missing(sensor_map, component)
    result = replace(
        sensor_map,
        positions=positions,
        component=component,
        errors=errors,
        covariances=None,  # errors contain them
        normals=None if shape.surface is None else normals,
        units="m",
        handed=all(fit.handed for fit in placed),
        anchored=True,
        mirrored=bool(mirror),
        notes=(*sensor_map.notes, *_left_out_note(missing)),
        provenance={**sensor_map.provenance, "anchors": len(where), "placed_by": methods[0]},
    )
    return Placement(result, anchors.names, residuals, left_out, tuple(methods), missing)


def _rows(sensor_map: SensorMap, anchors: Anchors, shape: _Shape) -> NDArray[np.intp]:
    """Return the rows of the anchors, and check their coordinates."""
    k = anchors.positions.shape[1]
    if k < sensor_map.dimensions:
        raise InputError("anchors of a map in 3D must have three coordinates")
    if shape.surface is not None and k < 3:
        raise InputError("anchors on a mesh must have three coordinates")
    rows = match_names(anchors.names, sensor_map.names)
    if (rows < 0).any():
        unknown = [anchors.names[i] for i in np.flatnonzero(rows < 0)]
        raise InputError(f"anchor {join_items(unknown)} is no sensor of the map")
    return rows


def _rigid(positions: NDArray[np.float64], modules: Modules) -> NDArray[np.float64]:
    """Give the modules of a warped map their shape again."""
    k = positions.shape[1]
    template = modules.offsets[:, :k] * METRES[modules.units]
    offsets = np.pad(template, ((0, 0), (0, k - template.shape[1])))
    found = positions.copy()
    for module in np.unique(modules.index[modules.index != NO_MODULE]):
        members = np.flatnonzero(modules.index == module)
        if len(members) >= _MIN_PADS:
            rigid = fit_similarity(
                offsets[members], positions[members], scaling=False, reflection=False
            )
            found[members] = rigid.apply(offsets[members])
    return found


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
