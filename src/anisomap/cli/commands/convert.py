"""``anisomap convert``: a map in another format, or in metres."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisomap import io
from anisomap.cli import parameters as options
from anisomap.cli.console import show_facts
from anisomap.files import check_distinct
from anisomap.placement import METRES, median_spacing


def convert(
    map_file: Annotated[Path, Parameter(help="File of a map.")],
    output: Annotated[Path, Parameter(help="File to write; its suffix chooses the format.")],
    /,
    *,
    placing: options.Placing = options.AS_IT_IS,
) -> None:
    """Write a map in another format: for a robot's software, a viewer, a spreadsheet.

    `anisomap formats` lists what can be written.
    """
    check_distinct([output], [map_file])
    io.check_writable(output)
    sensor_map = io.read_map(map_file)
    placing.check([output], sensor_map.units)
    placed = placing.applied(sensor_map)
    io.write(placed, output)
    facts = {"sensors placed": f"{int(placed.placed.sum())} of {placed.n_sensors}"}
    if placed.units in METRES:
        facts["neighbours"] = f"{median_spacing(placed):.4g} {placed.units} apart (median)"
    facts["known up to"] = placed.known_up_to
    show_facts(f"Written to {output}", facts)
