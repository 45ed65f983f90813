"""``anisomap score``: a map against reference positions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisomap import io
from anisomap.cli import parameters as options
from anisomap.cli import pipeline, printing
from anisomap.errors import InputError
from anisomap.evaluation import PERMUTATIONS


def score_map(
    map_file: Annotated[Path, Parameter(help="File of a map.")],
    reference_file: Annotated[
        Path | None,
        Parameter(
            help="File of reference positions: true positions (x, y[, z] and names), a recording "
            "with positions, or another map."
        ),
    ] = None,
    /,
    *,
    truth: Annotated[Path | None, Parameter(group=options.score_group)] = None,
    units: str | None = None,
    exclude: options.Exclude = None,
    permutations: options.Permutations = PERMUTATIONS,
    seed: options.Seed = 0,
    picture: Annotated[Path | None, Parameter(group=options.outputs_group)] = None,
    report: Annotated[Path | None, Parameter(group=options.outputs_group)] = None,
    reporting: options.Reporting = options.DEFAULT_REPORTING,
) -> None:
    """Score a map against reference positions of its sensors, and name the worst sensors.

    Sensors are matched by name, or by order if no name is shared.

    Parameters
    ----------
    truth
        The same as the second argument.
    units
        Unit of the reference positions, if the file does not state it.
    picture
        File for a figure: .png, .svg or .pdf.
    report
        File for a report: one HTML file that works offline.
    """
    given = [path for path in (reference_file, truth) if path is not None]
    if len(given) != 1:
        raise InputError(
            "give one file of reference positions: anisomap score MAP REFERENCE, or --truth FILE"
        )
    chosen = given[0]
    outputs = pipeline.Outputs(picture=picture, report=report, inputs=(map_file, chosen))
    outputs.check()
    sensor_map, reference = io.read_map(map_file), pipeline.read_reference(chosen, units)
    left_out = options.sensors(exclude, sensor_map.names)
    with reporting.printer() as printer:
        result = pipeline.score_with_progress(
            sensor_map, reference, permutations, seed, exclude=left_out
        )
        files = pipeline.write_outputs(outputs, sensor_map, result)
        kind = f"the map {chosen.name}" if reference.method else chosen.name
        printing.print_score(
            printer, result, sensor_map, f"Score of {map_file.name} against {kind}"
        )
        if files:
            printing.print_files(printer, files)
