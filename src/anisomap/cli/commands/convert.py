"""``anisomap convert``: a map in another format, or in metres."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisomap import io
from anisomap.cli import parameters as options
from anisomap.errors import InputError
from anisomap.files import check_distinct
from anisomap.placement import METRES, median_spacing


def convert(
    map_file: Annotated[Path, Parameter(help="File of a map.")],
    output: Annotated[Path, Parameter(help="File to write; its suffix chooses the format.")],
    /,
    *,
    placing: options.Placing = options.DEFAULT_PLACING,
    reporting: options.Reporting = options.DEFAULT_REPORTING,
) -> None:
    """Write a map in another format: for robot software, a viewer or a spreadsheet.

    `anisomap formats` lists the formats.
    """
    check_distinct([output], [map_file])
    io.check_writable(output)
    sensor_map = io.read_map(map_file)
    placing.check([output], sensor_map.units)
    placed = placing.applied(sensor_map)
    with reporting.printer() as printer:
        n_placed = int(placed.placed.sum())
        facts = {"sensors placed": f"{n_placed} of {placed.n_sensors}"}
        spacing = None
        if placed.units in METRES:
            with suppress(InputError):  # a single sensor has no spacing
                spacing = median_spacing(placed)
        written = placing.write(placed, output, [map_file])
        if spacing is not None:
            facts["median spacing"] = f"{spacing:.4g} {placed.units}"
        facts["known up to"] = placed.known_up_to
        printer.facts(f"Written to {', '.join(map(str, written))}", facts)
        printer.record(
            files=written,
            sensors=placed.n_sensors,
            placed=n_placed,
            median_spacing=spacing,
            units=placed.units,
            known_up_to=placed.known_up_to,
        )
