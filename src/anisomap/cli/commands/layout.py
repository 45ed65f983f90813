"""``anisomap check``: stated sensor positions against the readings of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from cyclopts.validators import Number

from anisomap import io
from anisomap.cli import parameters as options
from anisomap.cli import pipeline, printing
from anisomap.cli.console import MAX_SHOWN, Printer, number, percent, progress
from anisomap.drawing import figures
from anisomap.errors import InputError
from anisomap.files import check_distinct
from anisomap.layout import LayoutCheck, LayoutFinding, check_layout
from anisomap.numerics.layout.chance import N_SHIFTS
from anisomap.placement import Modules
from anisomap.sensor_map import UNSCALED, SensorMap
from anisomap.wording import join_items

INCONSISTENT = 1
"""Exit code if readings of sensors contradict their positions."""


def check(
    layout_file: Annotated[Path, Parameter(help="File of sensor positions, in any map format.")],
    recording_file: options.RecordingFile,
    /,
    *,
    output: Annotated[
        Path | None, Parameter(alias="-o", group=options.outputs_group, show_default=False)
    ] = None,
    picture: Annotated[
        Path | None, Parameter(group=options.outputs_group, show_default=False)
    ] = None,
    modules: Annotated[Path | None, Parameter(group=options.method_group)] = None,
    module_size: Annotated[
        int | None, Parameter(group=options.method_group, validator=Number(gte=3))
    ] = None,
    shifts: Annotated[
        int, Parameter(group=options.method_group, validator=Number(gte=1))
    ] = N_SHIFTS,
    seed: Annotated[int, Parameter(group=options.method_group, validator=Number(gte=0))] = 0,
    missing: options.Missing = "error",
    reading: options.Reading = options.DEFAULT_READING,
    reporting: options.Reporting = options.DEFAULT_REPORTING,
) -> int:
    """Check sensor positions against a recording: whose readings contradict their positions.

    Finds swapped sensors, shifted cables, turned, mirrored and exchanged modules, moved patches,
    and doubled and dead sensors. Sensors without evidence in the recording are not tested. The
    exit code is 0 if nothing is found, and 1 otherwise.

    Parameters
    ----------
    output
        File for the corrected positions, in any map format.
    picture
        File for a figure: .png, .svg or .pdf.
    modules
        Table of the modules: columns sensor, module and optionally pad. By default, modules are
        found as blocks of consecutive sensors whose shapes repeat.
    module_size
        Channels per module, those without a sensor included: 12 for the triangles of the iCub. The
        numbers at the end of sensor names count.
    shifts
        Circular shifts in time that show what chance explains.
    seed
        Seed of the shifts.
    """
    outputs = [path for path in (output, picture) if path]
    inputs = [path for path in (layout_file, recording_file, modules) if path]
    check_distinct(outputs, [*inputs, *reading.inputs])
    if output:
        io.check_writable(output)
    if picture:
        figures.check_writable(picture)
    if modules and module_size:
        raise InputError("give the modules by --modules or by --module-size, not by both")
    layout = io.read_map(layout_file)
    if output:
        options.DEFAULT_PLACING.check([output], layout.units)
    chosen: Modules | int | None = (
        io.read_modules(modules, layout.names) if modules else module_size
    )
    recording = pipeline.complete(pipeline.read(recording_file, reading.checked()), missing)
    with progress("checking the layout"):
        found = check_layout(layout, recording, modules=chosen, n_shifts=shifts, rng=seed)
    files = _write(found, output, picture, f"{layout_file.name} and {recording_file.name}")
    with reporting.printer() as printer:
        _print(printer, found, f"{layout_file.name} against {recording_file.name}")
        if files:
            printing.print_files(printer, files)
    return 0 if found.consistent else INCONSISTENT


def _write(
    found: LayoutCheck, output: Path | None, picture: Path | None, title: str
) -> list[tuple[str, Path]]:
    files = []
    if output:
        io.write(found.corrected, output)
        files.append(("corrected positions", output))
    if picture:
        figures.save_figure(figures.layout_figure(found, title), picture)
        files.append(("picture", picture))
    return files


def _print(printer: Printer, found: LayoutCheck, title: str) -> None:
    layout = found.layout
    accused = int(np.count_nonzero(found.accused))
    printer.facts(
        title,
        {
            "sensors tested": f"{found.n_tested} of {layout.n_sensors}",
            "modules": _modules(found),
            "verdict": "consistent"
            if found.consistent
            else f"not consistent: the readings of {accused} sensors "
            f"({percent(accused / found.n_tested)}) contradict their positions",
        },
    )
    if found.findings:
        unit = "unit of the layout" if layout.units in UNSCALED else layout.units
        printer.table(
            "Findings",
            ("kind", "sensors", f"off by ({unit})", "agreement", "corrected", "chance gains"),
            [_row(found, finding) for finding in found.findings[:MAX_SHOWN]],
        )
        for finding in found.findings[:MAX_SHOWN]:
            printer.line(f"  {finding.kind}: {finding.explanation}")
        if len(found.findings) > MAX_SHOWN:
            printer.line(f"  ... and {len(found.findings) - MAX_SHOWN} more findings")
    for note in found.notes:
        printer.line(f"  note: {note}")
    printer.record(**_values(found))


def _modules(found: LayoutCheck) -> str:
    if not found.n_modules:
        return "none"
    sizes = np.unique(np.bincount(found.module[found.module >= 0]))
    smallest, largest = int(sizes.min()), int(sizes.max())
    size = f"{largest}" if smallest == largest else f"{smallest} to {largest}"
    return f"{found.n_modules} of {size} sensors"


def _row(found: LayoutCheck, finding: LayoutFinding) -> tuple[str, ...]:
    return (
        finding.kind,
        join_items(found.names(finding), 3),
        number(finding.displacement, 3),
        number(finding.agreement_stated, 2),
        number(finding.agreement_proposed, 2),
        number(finding.chance, 2),
    )


def _values(found: LayoutCheck) -> dict[str, object]:
    def place(layout: SensorMap, i: int) -> object:
        return layout.positions[i]

    return {
        "consistent": found.consistent,
        "sensors": found.layout.n_sensors,
        "tested": found.n_tested,
        "modules": found.n_modules,
        "median_spacing": found.spacing,
        "units": found.layout.units,
        "findings": [
            {
                "kind": finding.kind,
                "explanation": finding.explanation,
                "sensors": [
                    {
                        "sensor": found.layout.names[i],
                        "stated": place(found.layout, i),
                        "proposed": place(found.corrected, i),
                    }
                    for i in finding.sensors.tolist()
                ],
                "displacement": finding.displacement,
                "agreement_stated": finding.agreement_stated,
                "agreement_proposed": finding.agreement_proposed,
                "chance": finding.chance,
                "gain": finding.gain,
            }
            for finding in found.findings
        ],
        "status": dict(zip(found.layout.names, found.status, strict=True)),
        "agreement": dict(zip(found.layout.names, found.agreement.tolist(), strict=True)),
        "notes": found.notes,
    }
