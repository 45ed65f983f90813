"""``anisomap check``: stated sensor positions against the readings of a recording."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import Parameter
from cyclopts.validators import Number

import anisomap
from anisomap import drawing, io
from anisomap.base.defaults import N_SHIFTS
from anisomap.base.wording import join_items, number, percent
from anisomap.cli import parameters as options
from anisomap.cli.console import MAX_SHOWN, Columns, Printer, attributes, progress
from anisomap.errors import AnisomapError, AnisomapWarning, InputError

if TYPE_CHECKING:
    from anisomap.layout import LayoutCheck, LayoutFinding

INCONSISTENT = 1
"""Exit code if readings contradict positions, those of single sensors or of all."""

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
    module_table: Annotated[Path | None, Parameter(group=options.method_group)] = None,
    module_size: Annotated[
        int | None, Parameter(group=options.method_group, validator=Number(gte=3))
    ] = None,
    time_shifts: Annotated[options.Count, options.expert] = N_SHIFTS,
    seed: options.Seed = 0,
    missing: options.Missing = "error",
    reading: options.ReadingOptions = options.DEFAULT_READING,
    printer: options.Printing = options.PRINTER,
) -> int:
    """Check sensor positions against a recording: whose readings contradict their positions.

    Finds swapped sensors, shifted cables, turned, mirrored and exchanged modules, moved patches,
    and doubled and dead sensors. Sensors without evidence in the recording are not tested. The
    exit code is 0 if nothing is found, 1 if readings contradict positions, those of single sensors
    or of the layout as a whole, and 2 if the recording says too little.

    Parameters
    ----------
    output
        File for the corrected positions, in any map format.
    module_table
        Table of the modules: columns sensor, module and optionally pad. By default, modules are
        found as blocks of consecutive sensors whose shapes repeat.
    module_size
        Channels per module, those without a sensor included: 12 for the triangles of the iCub. The
        numbers at the end of sensor names count.
    time_shifts
        Number of random circular shifts in time that show what chance explains.
    """
    from anisomap import route
    from anisomap.cli.outputs import Outputs

    if module_table and module_size:
        raise InputError("give the modules by --module-table or by --module-size, not by both")
    outputs = Outputs(
        maps=[output] if output else [],
        picture=picture,
        inputs=[layout_file, recording_file, module_table, *reading.inputs],
    )
    how = reading.checked()
    try:
        layout = io.read_map(layout_file)
        scaled = f"scale it first: anisomap convert {layout_file} scaled.csv --spacing 6.5mm"
        options.DEFAULT_PLACING.check(outputs.maps, layout.units, hint=scaled)
        chosen = io.read_modules(module_table, layout.names) if module_table else module_size
        (recording,) = route.read_runs([recording_file], how, missing, progress=progress)
        with progress("checking the layout"):
            found = anisomap.check_layout(
                layout, recording, modules=chosen, n_shifts=time_shifts, rng=seed
            )
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
    )
    _print(printer, found, f"{layout_file.name} against {recording_file.name}")
    printer.files(files)
    return _EXIT_CODES.get(found.verdict, INCONSISTENT)


def _are_swapped(layout_file: Path, recording_file: Path, how: io.ReadOptions) -> bool:
    """Return whether the first file is a recording of sensors that the second one places."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AnisomapWarning)
            recorded = io.read(layout_file, options=how).names
            return not set(recorded).isdisjoint(io.read_map(recording_file).names)
    except AnisomapError:
        return False


def _print(printer: Printer, found: LayoutCheck, title: str) -> None:
    from anisomap.placement.frames import length_shown

    layout = found.layout
    accused = int(np.count_nonzero(found.accused))
    printer.facts(
        title,
        {
            "sensors tested": f"{found.n_tested} of {layout.n_sensors}",
            "modules": _modules(found),
            "as a whole": f"{percent(max(0.0, found.explained))} of the possible agreement "
            f"(p = {found.p:.2g} against shuffled layouts)",
            "verdict": found.verdict
            if not found.findings
            else f"{found.verdict}: the readings of {accused} sensors "
            f"({percent(accused / found.n_tested)}) contradict their positions",
        },
    )
    records = [_record(found, finding) for finding in found.findings]
    if records:
        unit, factor = length_shown(layout.units, "unit of the layout")
        columns: Columns = {
            "kind": ("kind", str),
            "sensors": ("sensors", lambda each: join_items([one["sensor"] for one in each], 3)),
            f"off by ({unit})": ("displacement", lambda length: number(factor * length, 3)),
            "agreement": ("agreement_stated", lambda share: number(share, 2)),
            "corrected": ("agreement_proposed", lambda share: number(share, 2)),
            "chance gains": ("chance", lambda gain: number(gain, 2)),
        }
        printer.rows("Findings", columns, records[:MAX_SHOWN])
        for one in records[:MAX_SHOWN]:
            printer.say(f"  {one['kind']}: {one['explanation']}")
        if len(records) > MAX_SHOWN:
            printer.line(f"  ... and {len(records) - MAX_SHOWN} more findings")
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
    measured = "kind explanation displacement agreement_stated agreement_proposed chance gain"
    return attributes(finding, measured) | {"sensors": sensors}


def _modules(found: LayoutCheck) -> str:
    if not found.n_modules:
        return "none"
    sizes = np.unique(np.bincount(found.module[found.module >= 0]))
    smallest, largest = int(sizes.min()), int(sizes.max())
    size = f"{largest}" if smallest == largest else f"{smallest} to {largest}"
    return f"{found.n_modules} of {size} sensors"
