"""``anisomap coverage``: how long a skin must be stimulated, and how densely."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from cyclopts.validators import Number

from anisomap.cli import bodies
from anisomap.cli.console import number, percent, progress, show_table
from anisomap.drawing import figures
from anisomap.drawing.figures import curves
from anisomap.files import atomic_write, check_distinct, check_target
from anisomap.methods import DEFAULT_METHOD
from anisomap.simulation import CoverageCurve, coverage_curve
from anisomap.simulation.coverage import LENGTHS

_COLUMNS = ("frames", "seconds", "sensors touched", "neighbours touched together", "Mantel r")


def coverage(
    body: str = "sphere",
    /,
    *,
    scenario: Annotated[str, Parameter(alias="-s")] = "rubbing",
    frames: Annotated[list[int] | None, Parameter(negative=(), validator=Number(gte=1))] = None,
    runs: Annotated[int, Parameter(validator=Number(gte=1))] = 3,
    seed: Annotated[int, Parameter(validator=Number(gte=0))] = 1,
    sensors: str | None = None,
    parameter: Annotated[list[str] | None, Parameter(alias="-p", negative=())] = None,
    method: Annotated[str, Parameter(alias="-m")] = DEFAULT_METHOD,
    dimensions: Annotated[int, Parameter(alias="-d", validator=Number(gte=1))] = 3,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    picture: Path | None = None,
) -> None:
    """Tell how long a skin must be stimulated: what recordings cover as they grow.

    Parameters
    ----------
    body
        As for `anisomap simulate`: a name, a mesh, a model, or positions of sensors like yours.
    scenario
        What happens to it: see `anisomap scenarios`.
    frames
        Length to look at, may be repeated.
    runs
        Seeds to average over.
    seed
        The first of them.
    sensors
        How many sensors, or a file with their positions.
    parameter
        NAME=VALUE, a parameter of the scenario, such as how dense the stimulation is; may be
        repeated.
    method
        How maps are made: see `anisomap methods`.
    dimensions
        Of the space to map into.
    output
        CSV file for the table.
    picture
        Draw the curves: .png, .svg or .pdf.
    """
    check_distinct([path for path in (output, picture) if path], [])
    if output:
        check_target(output)
    if picture:
        figures.check_writable(picture)
    skin = bodies.find(body, sensors)
    with progress(f"simulating {runs} runs of {scenario} of {skin.name}"):
        curve = coverage_curve(
            skin,
            scenario,
            frames or LENGTHS,
            range(seed, seed + runs),
            method=method,
            dimensions=dimensions,
            **bodies.parse_parameters(parameter or []),
        )
    rows = _rows(curve)
    show_table(f"Coverage of {skin.name} by {scenario}, mean of {runs} runs", _COLUMNS, rows)
    if output:
        with atomic_write(output) as aside:
            lines = [",".join(cells) for cells in (_COLUMNS, *rows)]
            aside.write_text("\n".join(lines) + "\n", encoding="utf-8")
    if picture:
        shares = {
            "sensors touched": curve.touched,
            "neighbours touched together": curve.pairs / max(curve.n_pairs, 1),
            f"Mantel r of {method}": curve.mantel_r,
        }
        title = f"{skin.name}, {scenario}"
        figure = curves.coverage_figure(title, curve.n_frames, curve.rate_hz, shares)
        figures.save_figure(figure, picture)


def _rows(curve: CoverageCurve) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for i, n_frames in enumerate(curve.n_frames):
        maps = curve.mantel_r[i][np.isfinite(curve.mantel_r[i])]
        rows.append(
            (
                str(n_frames),
                number(float(curve.seconds[i])),
                percent(float(curve.touched[i].mean())),
                percent(float(curve.pairs[i].mean()) / max(curve.n_pairs, 1)),
                number(float(maps.mean()), 3) if maps.size else "-",
            )
        )
    return rows
