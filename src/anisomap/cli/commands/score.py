"""``anisomap score``: a map against the truth."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from anisomap import io
from anisomap.cli import parameters as options
from anisomap.cli import pipeline
from anisomap.cli.console import console, progress
from anisomap.evaluation import PERMUTATIONS, score


def score_map(
    map_file: Annotated[Path, Parameter(help="File of a map.")],
    truth_file: Annotated[
        Path,
        Parameter(
            help="File of true positions: x, y[, z] and names, or a map or recording with them."
        ),
    ],
    /,
    *,
    units: str | None = None,
    exclude: options.Exclude = None,
    permutations: options.Permutations = PERMUTATIONS,
    seed: options.Seed = 0,
    as_json: Annotated[bool, Parameter(name="--json", negative=())] = False,
) -> None:
    """Compare a map with the true positions of its sensors.

    Sensors are matched by name; if no name is shared, by order.

    Parameters
    ----------
    units
        Unit of the true positions, where the file does not say.
    as_json
        Print the figures as JSON, for a script.
    """
    sensor_map, truth = io.read_map(map_file), io.read_map(truth_file)
    if units is None:
        units = "" if truth.units == "arbitrary" else truth.units
    with progress(f"relabelling the sensors {permutations} times") as tell:
        result = score(
            sensor_map,
            replace(truth, units=units),
            exclude=options.sensors(exclude, sensor_map.names),
            permutations=permutations,
            rng=np.random.default_rng(seed),
            progress=tell,
        )
    if not as_json:
        pipeline.show_score(result)
        return
    figures = {
        "mantel_r": result.mantel.r,
        "null_quantiles": {str(level): r for level, r in result.mantel.quantiles().items()},
        "p_value": result.mantel.p_value if permutations else None,
        "permutations": permutations,
        "rms": result.rms,
        "units": result.units,
        "rms_in_spacings": result.rms_in_spacings,
        "median_spacing": result.spacing,
        "reflected": result.alignment.reflected,
        "neighbours_kept": result.neighbours_kept,
        "sensors_compared": result.mantel.n_sensors,
        "notes": list(result.notes),
    }
    console.out(json.dumps(figures, indent=2))
