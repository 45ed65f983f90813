"""``anisomap update``: a new recording added to a map."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from anisomap import io
from anisomap.cli import parameters as options
from anisomap.cli import pipeline, printing
from anisomap.cli.console import MAX_SHOWN, Printer, number, progress
from anisomap.drawing import figures
from anisomap.errors import InputError
from anisomap.files import check_distinct
from anisomap.runs import join_runs
from anisomap.sensor_map import UNSCALED
from anisomap.tracking import Update, update_map
from anisomap.tracking.updating import LEVEL
from anisomap.wording import join_items


def update(
    map_file: Annotated[Path, Parameter(help="File of the map.")],
    recordings: Annotated[list[Path], Parameter(help="Files of new recordings of the skin.")],
    /,
    *,
    output: Annotated[
        list[Path] | None, Parameter(alias="-o", group=options.outputs_group, negative=())
    ] = None,
    picture: Annotated[Path | None, Parameter(group=options.outputs_group)] = None,
    statistics: Path | None = None,
    drop: options.Drop = None,
    missing: options.Missing = "error",
    level: float = LEVEL,
    reading: options.Reading = options.DEFAULT_READING,
    reporting: options.Reporting = options.DEFAULT_REPORTING,
) -> None:
    """Add the evidence of a new recording to a map, and say what changed.

    New sensors are placed in the frame of the map. Sensors that moved, according to the recording,
    are named, and their positions follow from the new recording. The map must have been made with
    `anisomap map --keep-statistics`; it may have been placed on the robot since.

    Parameters
    ----------
    output
        File for the map; its suffix chooses the format. May be repeated. Default: NAME.updated.csv
        in the current folder. The new statistics are written beside the first.
    picture
        File for a figure: .png, .svg or .pdf.
    statistics
        Statistics of the map. Default: NAME.statistics.npz beside the map.
    level
        Probability that chance alone marks any sensor as moved.
    """
    outputs = output or [Path(f"{map_file.name.split('.')[0]}.updated.csv")]
    old_statistics = statistics or io.statistics_beside(map_file)
    new_statistics = io.statistics_beside(outputs[0])
    check_distinct(
        [*outputs, new_statistics, *([picture] if picture else [])],
        [map_file, old_statistics, *recordings, *reading.inputs],
    )
    for path in outputs:
        io.check_writable(path)
    if picture:
        figures.check_writable(picture)
    how = reading.checked()
    sensor_map = io.read_map(map_file)
    if not old_statistics.exists():
        raise InputError(
            f"there is no file {old_statistics} with the statistics of the map; make the map with "
            "anisomap map --keep-statistics, or name the file with --statistics"
        )
    _check_scale(outputs, sensor_map.units)
    evidence = io.read_statistics(old_statistics)
    runs = pipeline.read_runs(recordings, how, missing)
    joined = join_runs(runs)
    dropped = options.sensors(drop, joined.names, joined.metadata)
    with progress("updating the map"):
        found = update_map(sensor_map, evidence, runs, drop=dropped, level=level)
    provenance = {**found.map.provenance, "updated_by": joined.source}
    updated = replace(found.map, provenance=provenance)
    files = [("statistics", new_statistics)]
    io.write_statistics(found.evidence, new_statistics)
    for path in outputs:
        io.write(updated, path)
        files.append(("map", path))
    if picture:
        title = f"{map_file.name} and its update"
        figures.save_figure(figures.difference_figure(found.difference, title), picture)
        files.append(("picture", picture))
    with reporting.printer() as printer:
        _print(printer, found, map_file.name)
        printing.print_files(printer, files)


def _check_scale(outputs: list[Path], units: str) -> None:
    for path in outputs:
        if io.needs_scale(path) and units in UNSCALED:
            raise InputError(
                f"cannot write {path}: its format is in metres, but the map has no scale; place "
                "the map first with anisomap place"
            )


def _print(printer: Printer, found: Update, name: str) -> None:
    changes, total = found.difference, found.evidence
    known = changes.distance[changes.compared & ~changes.moved]
    units = "units of the map" if changes.units in UNSCALED else changes.units
    facts = {
        "recordings": f"{len(total.recordings)}, {total.n_frames} frames",
        "sensors placed": f"{int(found.map.placed.sum())} of {found.map.n_sensors}",
        "added": str(len(found.added)),
        "moved": str(len(found.moved)),
        "not recorded": str(len(found.silent)),
        "agreement": f"r = {number(found.agreement, 3)} of the old and the new similarity",
    }
    if known.size:
        facts["other shifts"] = (
            f"{number(float(np.median(known)), 3)} {units} (median), "
            f"{number(float(known.max()), 3)} at most; the spacing is {number(changes.spacing, 3)}"
        )
    printer.facts(f"Update of {name}", facts)
    tested = found.moves
    like = {} if tested is None else dict(zip(tested.names, tested.like, strict=True))
    moved = [changes.names.index(sensor) for sensor in found.moved]
    if moved:
        printer.table(
            "Sensors that moved",
            ("sensor", "like", f"distance ({units})", "spacings", "p"),
            [
                (
                    changes.names[i],
                    like[changes.names[i]],
                    number(changes.distance[i]),
                    number(changes.distance[i] / changes.spacing, 3),
                    number(changes.p_values[i], 2),
                )
                for i in moved
            ],
            max_rows=MAX_SHOWN,
        )
    lists = {"added": found.added, "not recorded": found.silent, "not placed": found.unplaced}
    for kind, names in lists.items():
        if names:
            printer.line(f"{kind}: {join_items(names, MAX_SHOWN)}")
    for note in found.notes:
        printer.line(f"  note: {note}")
    printer.record(
        recordings=len(total.recordings),
        frames=total.n_frames,
        sensors=found.map.n_sensors,
        placed=int(found.map.placed.sum()),
        units=changes.units,
        spacing=changes.spacing,
        agreement=found.agreement,
        added=found.added,
        moved=[
            {
                "sensor": changes.names[i],
                "like": like[changes.names[i]],
                "distance": float(changes.distance[i]),
                "p": float(changes.p_values[i]),
            }
            for i in moved
        ],
        not_recorded=found.silent,
        not_placed=found.unplaced,
        shifts=dict(zip(changes.names, changes.distance.tolist(), strict=True)),
        errors=dict(zip(found.map.names, found.map.errors.tolist(), strict=True)),
        notes=found.notes,
    )
