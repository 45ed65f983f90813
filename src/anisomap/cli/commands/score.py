"""``anisomap score``: a map against reference positions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisomap import io
from anisomap.cli import parameters as options
from anisomap.cli import pipeline
from anisomap.evaluation import PERMUTATIONS


def score_map(
    map_file: Annotated[Path, Parameter(help="File of a map.")],
    reference_file: Annotated[
        Path,
        Parameter(
            help="File of reference positions: true positions (x, y[, z] and names), a recording "
            "with positions, or another map."
        ),
    ],
    /,
    *,
    units: str | None = None,
    exclude: options.Exclude = None,
    permutations: options.Permutations = PERMUTATIONS,
    seed: options.Seed = 0,
    reporting: options.Reporting = options.DEFAULT_REPORTING,
) -> None:
    """Score a map against reference positions of its sensors.

    Sensors are matched by name, or by order if no name is shared.

    Parameters
    ----------
    units
        Unit of the reference positions, if the file does not state it.
    """
    sensor_map, reference = io.read_map(map_file), io.read_map(reference_file)
    if units is None:
        units = "" if reference.units == "arbitrary" else reference.units
    left_out = options.sensors(exclude, sensor_map.names)
    with reporting.printer() as printer:
        result = pipeline.score_with_progress(
            sensor_map, replace(reference, units=units), permutations, seed, exclude=left_out
        )
        kind = f"the map {reference_file.name}" if reference.method else reference_file.name
        pipeline.print_score(printer, result, f"Score of {map_file.name} against {kind}")
