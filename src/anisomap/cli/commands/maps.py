"""``anisomap convert``, ``diff``, ``score`` and ``check``: maps rewritten, compared, checked."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import Parameter

import anisomap
from anisomap import drawing, io, placement
from anisomap.base import METRES, PERMUTATIONS
from anisomap.base.wording import join_items, number, percent
from anisomap.cli import parameters as options
from anisomap.cli.console import MAX_SHOWN, Columns, Printer, attributes, progress
from anisomap.errors import AnisomapError, AnisomapWarning, InputError

if TYPE_CHECKING:
    from anisomap.layout import LayoutCheck, LayoutFinding


def convert(
    map_file: options.MapFile,
    output: Annotated[Path, Parameter(help="File to write; its suffix gives the format.")],
    /,
    *,
    placing: options.PlacingOptions = options.DEFAULT_PLACING,
    drop: options.Drop = None,
    printer: options.Printing = options.PRINTER,
) -> None:
    """Write a map in another format: for robot software, viewers or tables.

    `anisomap list formats` lists the formats.

    Examples
    --------
    anisomap convert skin.map.csv skin.ply
    anisomap convert skin.map.csv skin.urdf --spacing 6.5mm --frame torso
    anisomap convert skin.map.csv skin.icub.txt --drop s3,c0-c35 --mirror
    """
    from anisomap.cli.outputs import Outputs
    from anisomap.names import sensor_mask
    from anisomap.route import split_names

    outputs = Outputs(maps=[output], inputs=[map_file], placing=placing)
    sensor_map = io.read_map(map_file)
    left_out = sensor_mask(sensor_map.names, split_names(drop, sensor_map.names))
    if left_out.all():
        raise InputError("--drop leaves out all sensors; keep at least one")
    sensor_map = sensor_map.select(~left_out)
    placing.check([output], sensor_map.units)
    placed = placing.applied(sensor_map)
    n_placed, spacing = int(placed.placed.sum()), None
    if placed.units in METRES:
        with suppress(InputError):  # a single sensor has no spacing
            spacing = placement.spacing_on_skin(placed)
    written = outputs.write(placed)
    facts = {"sensors placed": f"{n_placed} of {placed.n_sensors}"}
    if spacing is not None:
        unit, factor = placement.length_shown(placed.units, "")
        facts["median spacing"] = f"{number(factor * spacing)} {unit}"
    printer.facts(f"Map of {map_file.name}", facts | {"pose": placed.pose})
    printer.files(written)
    printer.record(
        placed,
        "units known_up_to",
        sensors=placed.n_sensors,
        placed=n_placed,
        median_spacing=spacing,
    )


DIFFERENT = 1
"""Exit code if the maps differ."""


def diff(
    before_file: Annotated[Path, Parameter(help="File of the first map."), options.existing],
    after_file: Annotated[Path, Parameter(help="File of the second map."), options.existing],
    /,
    *,
    printer: options.Printing = options.PRINTER,
) -> int:
    """Compare two maps: sensors that moved, appeared or disappeared.

    The maps may come from two days or two methods, or from before and after a repair. The second
    map is aligned with the first; sensors that moved do not affect the alignment. The exit code is
    0 if no difference is found, and 1 otherwise.

    Examples
    --------
    anisomap diff monday.map.csv tuesday.map.csv
    anisomap diff before.ply after.map.csv
    anisomap diff before.csv after.csv --json
    """
    found = anisomap.evaluation.compare_maps(io.read_map(before_file), io.read_map(after_file))
    units, factor = placement.length_shown(found.units, "units of the first map")
    masks = {"moved": found.moved, "appeared": found.appeared, "lost": found.lost}
    names = {kind: [found.names[i] for i in np.flatnonzero(m)] for kind, m in masks.items()}
    n_compared = int(np.count_nonzero(np.isfinite(found.distance)))
    printer.facts(
        f"{after_file.name} compared with {before_file.name}",
        {
            "sensors compared": str(n_compared),
            **{kind: str(len(listed)) for kind, listed in names.items()},
            "smallest move": f"moves below {number(factor * found.smallest)} {units} cannot be "
            "told from chance",
        },
    )
    moved = np.flatnonzero(found.moved)
    spacing = found.spacing or np.nan  # 0 if most sensors have the place of another
    records = [
        {
            "sensor": found.names[i],
            "distance": found.distance[i],
            "spacings": found.distance[i] / spacing,
        }
        for i in moved[np.argsort(-found.distance[moved], kind="stable")]
    ]
    columns: Columns = {
        "sensor": ("sensor", str),
        f"distance ({units})": ("distance", lambda distance: number(factor * distance)),
        "spacings": ("spacings", lambda spacings: number(spacings, 3)),
    }
    printer.rows("Sensors that moved", columns, records, max_rows=MAX_SHOWN)
    printer.names({kind: names[kind] for kind in ("appeared", "lost")})
    printer.notes(found.notes)
    printer.record(
        found,
        "units notes",
        different=found.found,
        smallest_move=found.smallest,
        sensors_compared=n_compared,
        moved=records,
        appeared=names["appeared"],
        lost=names["lost"],
        median_spacing=found.spacing,
    )
    return DIFFERENT if found.found else 0


def score_map(
    map_file: options.MapFile,
    reference_file: Annotated[
        Path,
        Parameter(
            help="File of reference positions: a table of true positions (name, x, y[, z]), a "
            "recording with positions, or another map."
        ),
        options.existing,
    ],
    /,
    *,
    units: options.Units = None,
    exclude: options.Exclude = None,
    report: options.Report = None,
    picture: options.Picture = None,
    permutations: options.Permutations = PERMUTATIONS,
    printer: options.Printing = options.PRINTER,
) -> None:
    """Score a map against known positions, and list the worst sensors.

    Sensors are matched by name, or by order if one file has no names. If layouts of an iCub share
    no name, taxels are matched by number.

    Examples
    --------
    anisomap score skin.map.csv truth.csv
    anisomap score skin.map.csv truth.csv --units mm --report score.html
    anisomap score skin.map.csv layout.csv --exclude s3,c0-c35
    """
    from anisomap.cli.outputs import Outputs, Truth, read_reference
    from anisomap.route import split_names

    outputs = Outputs(picture=picture, report=report, inputs=(map_file, reference_file))
    sensor_map, reference = io.read_map(map_file), read_reference(reference_file, units)
    left_out = split_names(exclude, sensor_map.names)
    kind = "the map " if reference.method else ""
    title = f"Score of {map_file.name} against {kind}{reference_file.name}"
    scored = Truth(permutations, reference=reference, exclude=left_out)
    printer.files(outputs.write_all(sensor_map, scored.score(printer, sensor_map, title)))


INCONSISTENT = 1
"""Exit code if sensors are flagged, or the whole layout is rejected."""

_EXIT_CODES = {"consistent": 0, "unknown": 2}


def check(
    layout_file: Annotated[
        Path, Parameter(help="File of sensor positions, in any map format."), options.existing
    ],
    recording_file: options.RecordingFile,
    /,
    *,
    output: Annotated[Path | None, Parameter(alias="-o", group=options.outputs_group)] = None,
    picture: options.Picture = None,
    units: options.Units = None,
    rigid: options.ModuleOptions = options.DEFAULT_MODULES,
    missing: options.Missing = "error",
    reading: options.ReadingOptions = options.DEFAULT_READING,
    printer: options.Printing = options.PRINTER,
) -> int:
    """Check sensor positions against a recording, and correct them.

    The check finds turned, mirrored, exchanged and moved modules, shifted and reversed orders of
    sensors, and swapped, moved, doubled and dead sensors. Sensors without evidence in the recording
    are not tested. By default, modules are blocks of consecutive sensors that have the same shape.
    With --module-layout, the given shape is fitted to each module, even if it is bent in the
    layout. The exit code is 0 if the layout is consistent, 1 if sensors are flagged or the whole
    layout is rejected, and 2 if the recording contains too little evidence.

    Parameters
    ----------
    output
        File for the corrected positions, in any map format.

    Examples
    --------
    anisomap check layout.csv skin.npz
    anisomap check layout.csv skin.npz -o corrected.csv --picture check.png
    anisomap check layout.csv skin.npz --module-size 12 --module-layout pads.csv
    """
    from anisomap import route
    from anisomap.cli.outputs import Outputs, read_layout
    from anisomap.layout import find_modules

    if not rigid.divided and rigid.module_layout is not None:
        raise InputError("--module-layout needs --module-size or --module-table")
    outputs = Outputs(
        maps=[output] if output else [],
        picture=picture,
        inputs=[layout_file, recording_file, *rigid.files, *reading.inputs],
    )
    how = reading.checked()
    try:
        layout = read_layout(layout_file, units)
        scaled = f"scale it first: anisomap convert {layout_file} scaled.csv --spacing 6.5mm"
        options.DEFAULT_PLACING.check(outputs.maps, layout.units, hint=scaled)
        chosen: placement.Modules | int | None = rigid.listed(layout.names) or rigid.module_size
        if rigid.module_layout is not None:
            chosen = rigid.with_layout(find_modules(layout, chosen))
        with progress(f"reading {recording_file.name}") as report_progress:
            runs = route.read_runs([recording_file], how, progress=report_progress)
        recording = route.complete(runs, missing)
        with progress("checking the layout"):
            found = anisomap.check_layout(layout, recording, modules=chosen)
    except InputError as error:
        if _are_swapped(layout_file, recording_file, how):
            hint = f"swap the arguments: anisomap check {recording_file} {layout_file}"
            raise InputError(f"{layout_file} is a recording, so {hint}") from error
        raise
    title = f"{layout_file.name} and {recording_file.name}"
    files = outputs.write(
        found.corrected,
        lambda: drawing.figures.plot_layout(found, title=title).figure,
        "corrected positions",
        source=(layout_file, found.layout),
    )
    edits = None
    with suppress(InputError):  # the format cannot represent the positions
        edits = io.corrections(layout_file, found.layout, found.corrected)
    _print_check(printer, found, f"{layout_file.name} against {recording_file.name}", edits or [])
    printer.files(files)
    return _EXIT_CODES.get(found.verdict, INCONSISTENT)


def _are_swapped(layout_file: Path, recording_file: Path, how: io.ReadOptions) -> bool:
    """Return whether the first file is a recording, and the second contains its positions."""
    try:
        with warnings.catch_warnings(action="ignore", category=AnisomapWarning):
            recorded = io.read(layout_file, options=how).names
            return not set(recorded).isdisjoint(io.read_map(recording_file).names)
    except AnisomapError:
        return False


def _print_check(
    printer: Printer, found: LayoutCheck, title: str, edits: Sequence[io.LineEdit]
) -> None:
    layout = found.layout
    flagged = int(np.count_nonzero(found.flagged))
    printer.facts(
        title,
        {
            "sensors tested": "none, since the layout is rejected"
            if found.verdict == "rejected"
            else f"{found.n_tested} of {layout.n_sensors}",
            "modules": _modules(found),
            "as a whole": f"{percent(max(0.0, found.explained))} of the possible agreement "
            f"(p = {found.p:.2g} against shuffled layouts)",
            "verdict": found.verdict
            if not found.findings
            else f"{found.verdict}; sensors flagged: {flagged} "
            f"({percent(flagged / found.n_tested)})",
        },
    )
    records = [_record(found, finding) for finding in found.findings]
    if records:
        unit, factor = placement.length_shown(layout.units, "unit of the layout")
        columns: Columns = {
            "kind": ("kind", str),
            "sensors": ("sensors", lambda each: join_items([one["sensor"] for one in each], 3)),
            f"off by ({unit})": ("displacement", lambda length: number(factor * length, 3)),
            "agreement": ("agreement_stated", lambda share: number(share, 2)),
            "corrected": ("agreement_proposed", lambda share: number(share, 2)),
        }
        printer.rows("Findings", columns, records[:MAX_SHOWN])
        for one in records[:MAX_SHOWN]:
            sure = f" ({one['certainty']}, z {one['z']:.1f})" if one["certainty"] else ""
            printer.say(f"  {one['kind']}{sure}: {one['explanation']}")
        if len(records) > MAX_SHOWN:
            printer.line(f"  ... and {len(records) - MAX_SHOWN} more")
    if edits:
        printer.say(f"Lines of the file that change: {len(edits)}")
        for edit in edits[:MAX_SHOWN]:
            printer.line(f"  {edit.text}; line {edit.line}:")
            printer.line(f"    {' '.join(edit.after.split())}")
    printer.notes(found.notes)
    printer.record(
        found,
        "explained notes",
        outcome=found.verdict,
        p_value=found.p,
        sensors=layout.n_sensors,
        tested=found.n_tested,
        modules=found.n_modules,
        median_spacing=found.spacing,
        units=layout.units,
        findings=records,
        edits=[attributes(edit, "line before after text") for edit in edits],
        status=dict(zip(layout.names, found.status, strict=True)),
        agreement=dict(zip(layout.names, found.agreement.tolist(), strict=True)),
    )


def _record(found: LayoutCheck, finding: LayoutFinding) -> dict[str, Any]:
    sensors = [
        {
            "sensor": found.layout.names[i],
            "stated": found.layout.positions[i],
            "proposed": found.corrected.positions[i],
        }
        for i in finding.sensors.tolist()
    ]
    measured = "kind explanation displacement agreement_stated agreement_proposed gain z certainty"
    fields = "module angle mirror old_orientation new_orientation"
    modules = [attributes(one, fields) for one in finding.modules]
    return attributes(finding, measured) | {"modules": modules, "sensors": sensors}


def _modules(found: LayoutCheck) -> str:
    if not found.n_modules:
        return "none"
    sizes = np.unique(np.bincount(found.module[found.module >= 0]))
    smallest, largest = int(sizes.min()), int(sizes.max())
    size = f"{largest}" if smallest == largest else f"{smallest} to {largest}"
    return f"{found.n_modules}, with {size} sensors each"
