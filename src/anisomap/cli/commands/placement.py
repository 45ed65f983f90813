"""``anisomap place``: a map in metres, in the frame of the robot."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cyclopts import Group, Parameter

import anisomap
from anisomap import drawing, io, placement
from anisomap.base import METRES
from anisomap.base.wording import number
from anisomap.cli import parameters as options
from anisomap.cli.console import MAX_SHOWN, Columns, Printer
from anisomap.errors import InputError
from anisomap.map_verdict import UNKNOWN

_MM = 1e3  # per metre


@Parameter(name="*", group=Group("Anchors", sort_key=2))
@dataclass(frozen=True)
class AnchorOptions:
    """Sensors with a known position.

    Parameters
    ----------
    anchor
        Sensor and position in metres: s17=0.012,0.040,0.003. May be repeated.
    anchors
        File of the positions of some sensors, in any map format.
    units
        Unit of the --anchors file, if it contains none.
    """

    anchor: list[str] = field(default_factory=list)
    anchors: Path | None = None
    units: str = ""

    def read(self) -> placement.Anchors | None:
        """Read the anchors; None if there are none."""
        given = [placement.parse_anchor(text) for text in self.anchor]
        if len({len(position) for _, position in given}) > 1:
            raise InputError("all anchors must have two coordinates, or all three")
        if self.anchors is not None:
            found = placement.anchors_from_map(io.read_map(self.anchors), self.units)
            given += zip(found.names, map(tuple, found.positions.tolist()), strict=True)
        return placement.anchors_at(given) if given else None


def _modules(
    rigid: options.ModuleOptions, sensor_map: anisomap.SensorMap
) -> placement.Modules | None:
    if not rigid.given:
        return None
    if rigid.module_layout is None or not rigid.divided:
        raise InputError("modules need --module-layout and either --module-table or --module-size")
    size = rigid.module_size or 0
    divided = rigid.listed(sensor_map.names) or placement.modules_by_size(sensor_map.names, size)
    return rigid.with_layout(divided)


def place_map(
    map_file: options.MapFile,
    /,
    *,
    output: options.Output = None,
    picture: Annotated[options.Picture, options.expert] = None,
    frame: str = "",
    known: AnchorOptions = AnchorOptions(),
    rigid: options.ModuleOptions = options.DEFAULT_MODULES,
    mesh: Path | None = None,
    mesh_units: Annotated[str, options.expert] = "m",
    spacing: str = "",
    handedness: Annotated[Literal["same", "mirrored"] | None, options.expert] = None,
    suggest: Annotated[options.Amount, options.expert] = 0,
    printer: options.Printing = options.PRINTER,
) -> None:
    """Place a map in the frame of the robot, with an error for each sensor.

    Anchors are sensors with known positions; three or more determine the pose. Rigid modules of
    known shape determine the scale and make the map more accurate. Anchors, modules and a mesh can
    be combined.

    Parameters
    ----------
    output
        Map file; its suffix gives the format [NAME.placed.csv]. May be repeated. The default file
        is in the current folder.
    frame
        Name of the frame of the anchors.
    mesh
        Mesh of the robot part, in the frame of the anchors. Sensors are placed on its surface, and
        get its normals. The format is .stl, .obj, .ply, .off or .glb.
    mesh_units
        Unit of the mesh.
    spacing
        Median distance to the nearest sensor, such as 6.5mm.
    handedness
        Handedness of the map, if known: same as the skin, or mirrored. Default: determined from
        anchors and modules.
    suggest
        Number of anchors to suggest for each component. The command prints the best sensors to
        measure, and places nothing.

    Examples
    --------
    anisomap place skin.map.csv --anchors measured.csv -o skin.urdf
    anisomap place skin.map.csv --module-layout pads.csv --module-size 12
    anisomap place skin.map.csv --suggest 4
    """
    from anisomap.cli.outputs import Outputs

    if suggest:
        names = placement.suggest_anchors(io.read_map(map_file), suggest)
        printer.line(f"measure the positions of {','.join(names)}")
        printer.record(suggested=names)
        return
    outputs = Outputs(
        maps=output or [options.beside(map_file, ".placed.csv")],
        picture=picture,
        inputs=[map_file, *rigid.files, known.anchors, mesh],
    )
    sensor_map, anchors = io.read_map(map_file), known.read()
    surface = None if mesh is None else _read_mesh(mesh, mesh_units)
    found = placement.place(
        sensor_map,
        anchors,
        modules=_modules(rigid, sensor_map),
        mesh=surface,
        spacing=placement.parse_length(spacing) if spacing else None,
        handedness=handedness or "",
    )
    if frame:
        found = replace(found, map=replace(found.map, frame=frame))
    files = outputs.write(
        found.map, lambda: drawing.figures.plot_placement(found, anchors, surface).figure
    )
    _print(printer, found, map_file.name)
    if spacing:
        options.doubt_spacing(spacing)
    printer.files(files)


def _read_mesh(path: Path, units: str) -> Any:
    """Return a `Mesh` in metres."""
    from anisomap.files.meshes import read_mesh
    from anisomap.numerics.surfaces import Mesh

    if units not in METRES:
        raise InputError(f"--mesh-units must be one of {', '.join(METRES)}, got {units!r}")
    vertices, faces = read_mesh(path)
    return Mesh(vertices * METRES[units], faces)


def _print(printer: Printer, found: placement.Placement, name: str) -> None:
    from anisomap.placement.placing import headline

    placed, spacing = found.map, np.nan
    errors = placed.errors[np.isfinite(placed.errors)] * _MM
    with suppress(InputError):  # a single sensor, or coincident sensors
        spacing = placement.spacing_on_skin(placed) * _MM * METRES[placed.units]
    facts = {
        "sensors placed": f"{int(placed.placed.sum())} of {placed.n_sensors}",
        "median spacing": f"{number(spacing)} mm",
        **{
            f"component {label}" if len(found.methods) > 1 else "placed by": method
            for label, method in enumerate(found.methods)
        },
        "handedness": "as on the skin" if placed.handed else "unknown",
    }
    if errors.size:
        facts["error of a sensor"] = (
            f"below {number(float(np.median(errors)), 3)} mm with a probability of 90% "
            f"(median of all sensors; at most {number(float(errors.max()), 3)} mm)"
        )
    if placed.verdict.level != UNKNOWN:
        facts["verdict on the map"] = f"{headline(placed)}, RMS over all sensors"
    facts["pose"] = placed.pose
    printer.facts(f"Placement of {name}", facts)
    errors_of = zip(
        found.anchors, found.residuals.tolist(), found.left_out_errors.tolist(), strict=True
    )
    anchors = [dict(zip(("sensor", "residual", "left_out"), one, strict=True)) for one in errors_of]
    columns: Columns = {
        "sensor": ("sensor", str),
        "residual (mm)": ("residual", _in_mm),
        "left out (mm)": ("left_out", _in_mm),
    }
    printer.rows("Anchors", columns, anchors, max_rows=MAX_SHOWN)
    printer.names({"left out": found.left_out})
    printer.notes(placed.notes)
    printer.record(
        placed,
        "handed anchored units notes",
        sensors=placed.n_sensors,
        placed=int(placed.placed.sum()),
        placed_by=found.methods,
        median_spacing=spacing / _MM,
        errors=dict(zip(placed.names, placed.errors.tolist(), strict=True)),
        anchors=anchors,
        left_out=found.left_out,
    )


def _in_mm(length: float) -> str:
    return number(_MM * length, 3)
