"""Placing of a map: from arbitrary units to metres in the frame of the robot; texts about errors.

Three errors of a map are reported: the RMS error over all sensors, the error of regions, and the
error of a single sensor. The last is exceeded with a probability of 10 %, given the interval of the
error of the map.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anisomap.base import DEFAULT_METHOD, METRES
from anisomap.base.wording import join_items
from anisomap.errors import InputError
from anisomap.map_verdict import ACCURACY
from anisomap.names import match_names
from anisomap.numerics.neighbours import padded
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.surfaces import Mesh, Points
from anisomap.placement.anchors import COVERAGE, AnchorFit, Anchors, fit_anchors
from anisomap.placement.frames import (
    length_shown,
    mirrored,
    rescaled,
    scaled_to_spacing,
    spacing_on_skin,
)
from anisomap.placement.handedness import DECISIVE, Known, Tied
from anisomap.placement.modules import MIN_PADS, NO_MODULE, Modules, fit_modules
from anisomap.placement.surface import (
    Surface,
    bend_to_surface,
    check_near_surface,
    fit_to_surface,
    surface_evidence,
)
from anisomap.sensor_map import UNPLACED, SensorMap, radius

# Standard deviations of the logarithm of a scale. Scales by modules were 1 to 5 % off on real and
# simulated hexagons; the deviation of scales by spacing is a cautious guess.
_MODULE_SCALE, _SPACING_SCALE = 0.04, 0.2


@dataclass(frozen=True, eq=False)
class Placement:
    """A map in metres.

    Attributes
    ----------
    map : SensorMap
        The placed map; with anchors, in the frame of the robot and with `SensorMap.errors`.
    anchors : tuple of str
        Sensors that served as anchors.
    residuals : ndarray of shape (n,)
        Distances of the anchors from their places on the map, in metres.
    left_out_errors : ndarray of shape (n,)
        Errors of each anchor predicted from the others of its component; NaN with fewer than 5.
    methods : tuple of str
        Method by which each component was placed, the largest first.
    left_out : tuple of str
        Sensors that could not be placed.
    """

    map: SensorMap
    anchors: tuple[str, ...] = ()
    residuals: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    left_out_errors: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    methods: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()


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
        Known positions of at least 3 sensors that are not in a line, or of 4 that are not in a
        plane if nothing else determines the handedness of a map in 3D. Each component needs its
        own anchors.
    modules : Modules, optional
        Rigid modules with a template: see `fit_modules`.
    mesh : Mesh, optional
        Surface of the skin in metres, in the frame of the anchors. Sensors are placed on the mesh,
        with normals of the mesh, and its shape may determine the handedness.
    spacing : (float, str), optional
        Median distance between neighbouring sensors and its unit.
    handedness : {"", "same", "mirrored"}
        Handedness of the map compared with the skin, if known.

    Returns
    -------
    Placement
        Without anchors, the map keeps its components and has an arbitrary pose.

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
        raise InputError(f"maps are placed in 2 or 3 dimensions, got {sensor_map.dimensions}")
    if mesh is not None and anchors is None:
        raise InputError("to place a map on a mesh, give at least 3 anchors")
    stated = None if not handedness else handedness == "mirrored"
    if anchors is None and modules is None and spacing is None and sensor_map.units not in METRES:
        raise InputError("the map has no scale: give --anchors, --module-layout or --spacing")
    parts = []
    for label in range(len(sensor_map.component_sizes)):
        members = sensor_map.component == label
        positions = np.where(members[:, None], sensor_map.positions, np.nan)
        component = np.where(members, 0, UNPLACED)
        part = replace(sensor_map, positions=positions, component=component)
        parts.append(_scaled(part, modules, spacing))
    if anchors is None:
        return _unanchored(sensor_map, parts, stated)
    surface = None if mesh is None else Surface(mesh)
    return _anchored(sensor_map, parts, anchors, _Shape(modules, surface, stated))


class _Shape(NamedTuple):
    """Known shape of the skin, and the handedness specified by the user."""

    modules: Modules | None
    surface: Surface | None
    mirrored: bool | None


class _Part(NamedTuple):
    """A component of the map: all sensors, placed or not, and prior knowledge.

    rigid: Whether the component was fitted by modules.
    """

    map: SensorMap
    scale_sigma: float = np.inf
    evidence: float = 0.0
    how: str = "not placed: no module has 3 of its sensors"
    rigid: bool = False

    def fresh(self, whole: SensorMap, label: int) -> NDArray[np.bool_]:
        """Mask the sensors of the component, without sensors that another component places."""
        return np.asarray(self.map.placed & (whole.placed <= (whole.component == label)))


def _scaled(part: SensorMap, modules: Modules | None, spacing: tuple[float, str] | None) -> _Part:
    """Scale a component by modules if there are any, else by spacing."""
    if modules is not None:
        on_module = modules.index[part.placed & (modules.index != NO_MODULE)]
        if np.bincount(on_module, minlength=1).max() >= MIN_PADS:
            fit = fit_modules(part, modules)
            how, evidence = "scaled by its modules", abs(fit.evidence)
            provenance = {k: v for k, v in part.provenance.items() if k not in {"spacing", "scale"}}
            found = replace(_in_metres(fit.map), provenance=provenance)
            return _Part(found, _MODULE_SCALE, evidence, how, rigid=True)
    if spacing is not None and np.count_nonzero(part.placed) > 1:
        scaled = _in_metres(scaled_to_spacing(part, *spacing))
        return _Part(scaled, _SPACING_SCALE, how="scaled by its spacing")
    if part.units in METRES:
        how = f"in {part.units}, converted to m"
        return _Part(_in_metres(part), _SPACING_SCALE, how=how)
    return _Part(part)


def _in_metres(sensor_map: SensorMap) -> SensorMap:
    return rescaled(sensor_map, METRES[sensor_map.units], "m")


def _unanchored(sensor_map: SensorMap, parts: list[_Part], stated: bool | None) -> Placement:
    """Combine components in metres; each keeps its own frame."""
    positions = np.full_like(sensor_map.positions, np.nan)
    covariances = np.full((*positions.shape, positions.shape[1]), np.nan)
    component = np.full(sensor_map.n_sensors, UNPLACED)
    handed, mirror = True, sensor_map.mirrored
    for label, part in enumerate(parts):
        if part.map.units != "m":
            continue
        known, hand = part.map, part.evidence >= DECISIVE
        if not hand and stated is not None:
            known, hand = (mirrored(known) if stated else known), True
        handed = handed and hand
        mirror = known.mirrored if label == 0 else mirror
        fresh = part.fresh(sensor_map, label)
        positions[fresh], component[fresh] = known.positions[fresh], label
        if known.covariances is not None:
            covariances[fresh] = known.covariances[fresh]
    labels = np.unique(component[component != UNPLACED])
    result = replace(
        sensor_map,
        positions=positions,
        component=np.where(component == UNPLACED, UNPLACED, np.searchsorted(labels, component)),
        covariances=None if sensor_map.covariances is None else covariances,
        units="m",
        handed=handed,
        mirrored=mirror,
        provenance=parts[0].map.provenance,
    )
    methods = tuple(part.how for part in parts)
    return _with_missing(Placement(result, methods=methods), sensor_map)


def _place_part(
    part: _Part,
    members: NDArray[np.intp],
    anchored: NDArray[np.intp],
    anchors: Anchors,
    shape: _Shape,
) -> tuple[AnchorFit, Points, Points, str]:
    """Place the sensors `members` of a component by the anchors of its sensors `anchored`.

    Returns the fit, positions and normals (n, 3), and the method.
    """
    k = anchors.positions.shape[1]
    index = np.searchsorted(members, anchored)
    tied = Tied(padded(part.map.positions[members], k), index, anchors.positions)
    evidence, surface = part.evidence, shape.surface
    if surface is not None and len(index) >= k:
        evidence += surface_evidence(tied, surface)
    known = Known.of(part.map, shape.mirrored, part.scale_sigma, evidence)
    fit = fit_anchors(tied, known)
    positions, normals = fit.positions, np.full((len(members), 3), np.nan)
    how = "similarity and smooth field" if fit.warped else "similarity"
    if surface is not None:
        if not fit.warped:
            positions = fit_to_surface(tied, surface, reflection=fit.reflected)
        check_near_surface(positions, fit.errors, surface)
        positions, normals = surface.nearest(bend_to_surface(positions, tied, surface))
        how += " on the mesh"
    if part.rigid and shape.modules is not None:
        how += " of rigid modules"
        positions = _rigid(positions, shape.modules.select(members))
    return fit, positions, normals, f"{how}, {len(index)} anchors"


def _anchored(
    sensor_map: SensorMap, parts: list[_Part], anchors: Anchors, shape: _Shape
) -> Placement:
    """Place each component by its anchors, in a common frame."""
    where = _rows(sensor_map, anchors, shape)
    n_sensors, k = sensor_map.n_sensors, max(anchors.positions.shape[1], sensor_map.dimensions)
    positions, normals = np.full((n_sensors, k), np.nan), np.full((n_sensors, 3), np.nan)
    errors = np.full(n_sensors, np.nan)
    residuals, left_out = np.full((2, len(where)), np.nan)
    methods, failures = [], []
    handed, mirror = True, []
    for label, part in enumerate(parts):
        here = part.fresh(sensor_map, label)
        mine, members = np.flatnonzero(here[where]), np.flatnonzero(here)
        try:
            fit, positions[members], normals[members], how = _place_part(
                part, members, where[mine], anchors.select(mine), shape
            )
        except InputError as error:
            failures.append(error)
            methods.append(f"not placed: {error}")
            continue
        mirror.append(part.map.mirrored != fit.reflected)
        handed = handed and fit.handed
        methods.append(how)
        errors[members] = fit.errors
        residuals[mine], left_out[mine] = fit.residuals, fit.left_out
    if not mirror:
        raise failures[0]
    if shape.modules is None:
        # Measured positions replace positions on the map, except that modules stay rigid.
        measured = np.isfinite(residuals)
        positions[where[measured]] = anchors.positions[measured]
        errors[where[measured]] = 0.0
    result = replace(
        sensor_map,
        positions=positions,
        component=np.where(np.isfinite(positions).all(axis=1), 0, UNPLACED),
        errors=errors,
        covariances=None,  # included in the errors
        normals=None if shape.surface is None else normals,
        units="m",
        handed=handed,
        anchored=True,
        mirrored=mirror[0],
        provenance={**sensor_map.provenance, "anchors": len(where), "placed_by": methods[0]},
    )
    found = Placement(result, anchors.names, residuals, left_out, tuple(methods))
    return _with_missing(found, sensor_map)


def _with_missing(found: Placement, before: SensorMap) -> Placement:
    """Add the names of sensors that were left out, and a note."""
    after = found.map
    missing = tuple(before.names[i] for i in np.flatnonzero(before.placed & ~after.placed))
    if not missing:
        return found
    note = (
        "sensors left out, because their component has too few anchors: "
        f"{len(missing)} ({join_items(missing)})"
    )
    return replace(found, map=replace(after, notes=(*before.notes, note)), left_out=missing)


def _rows(sensor_map: SensorMap, anchors: Anchors, shape: _Shape) -> NDArray[np.intp]:
    """Check the coordinates of the anchors, and return their rows in the map."""
    k = anchors.positions.shape[1]
    if k < sensor_map.dimensions:
        raise InputError("anchors of a map in 3D must have three coordinates")
    if shape.surface is not None and k < 3:
        raise InputError("anchors on a mesh must have three coordinates")
    rows = match_names(anchors.names, sensor_map.names)
    if (rows < 0).any():
        names = sensor_map.names
        unknown = join_items([anchors.names[i] for i in np.flatnonzero(rows < 0)], 5)
        raise InputError(
            f"anchors must be sensors of the map, whose names are {names[0]} ... {names[-1]}; "
            f"unknown sensors: {unknown}"
        )
    return rows


def _rigid(positions: Points, modules: Modules) -> Points:
    """Restore the shape of the modules of a warped map."""
    k = positions.shape[1]
    offsets = padded(modules.offsets[:, :k] * METRES[modules.units], k)
    found = positions.copy()
    for module in np.unique(modules.index[modules.index != NO_MODULE]):
        members = np.flatnonzero(modules.index == module)
        if len(members) >= MIN_PADS:
            own, target = offsets[members], positions[members]
            found[members] = fit_similarity(own, target, scaling=False, reflection=False).apply(own)
    return found


def headline(sensor_map: SensorMap) -> str:
    """Return the verdict on a map and the error of its positions in one line."""
    return sensor_map.verdict.headline(*spacing_shown(sensor_map))


def judgement(sensor_map: SensorMap) -> tuple[str, ...]:
    """Return sentences about the use of a map, its accuracy, and the reasons."""
    spacing, unit = spacing_shown(sensor_map)
    told = list(sensor_map.verdict.told(spacing, unit))
    within = errors_of_sensors(sensor_map)
    within = within[np.isfinite(within) & (sensor_map.component == 0)]
    if within.size and unit == "mm":
        factor = length_shown(sensor_map.units, "")[1]
        told.insert(
            2,
            "These are RMS errors over all sensors; a single sensor has an error below "
            f"{float(np.median(within)) * factor:.2g} mm with a probability of 90%.",
        )
    if unit == "mm" and "spacing" in sensor_map.provenance and not sensor_map.anchored:
        accurate = "lengths on a good map are then usually within 15% of the true lengths"
        wrong = "errors of positions shorten it on the map, so lengths are too long"
        told.append(
            f"Millimetres assume a median distance of {spacing:.3g} mm to the nearest sensor; "
            f"{accurate if sensor_map.method == DEFAULT_METHOD else wrong}."
        )
    return tuple(told)


def errors_in_mm(sensor_map: SensorMap) -> dict[str, float]:
    """Return the errors of a verdict in mm; names end in ``_mm``; {} if the scale is unknown."""
    spacing, unit = spacing_shown(sensor_map)
    names = [name for name in ACCURACY if not name.startswith("neighbours")]
    known = names if unit == "mm" else []
    return {f"{name}_mm": spacing * getattr(sensor_map.verdict, name) for name in known}


def spacing_shown(sensor_map: SensorMap) -> tuple[float, str]:
    """Return the median spacing of a map in mm, and "mm"; 1 and "spacings" without a scale."""
    if sensor_map.units in METRES:
        unit, factor = length_shown(sensor_map.units, "")
        try:
            return factor * spacing_on_skin(sensor_map), unit
        except InputError:  # a single sensor, or coincident sensors
            pass
    return 1.0, "spacings"


def errors_of_sensors(sensor_map: SensorMap) -> NDArray[np.float64]:
    """Return the error of each sensor at probability `COVERAGE`, shape (N,), in units of the map.

    From `SensorMap.errors` of a placed map, else from its covariances; NaN if unknown.
    """
    if sensor_map.covariances is None:
        return sensor_map.errors
    k = sensor_map.dimensions
    variance = np.trace(sensor_map.covariances, axis1=1, axis2=2) / k
    found = radius(k, COVERAGE) * np.sqrt(variance)
    return np.where(np.isfinite(sensor_map.errors), sensor_map.errors, found)
