"""``anisomap coverage``: the required length and density of a stimulation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from cyclopts.validators import Number

from anisomap.cli import bodies
from anisomap.cli import parameters as options
from anisomap.cli.console import number, percent, progress
from anisomap.drawing import figures
from anisomap.drawing.figures.coverage import coverage_figure
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
    reporting: options.Reporting = options.DEFAULT_REPORTING,
) -> None:
    """Estimate how long a skin must be stimulated: coverage as a function of recording length.

    Parameters
    ----------
    body
        Name, mesh, model or positions, as for `anisomap simulate`.
    scenario
        Scenario: see `anisomap scenarios`.
    frames
        Recording length; may be repeated.
    runs
        Number of seeds to average over.
    seed
        First seed.
    sensors
        Number of sensors, or a file with their positions.
    parameter
        NAME=VALUE, a parameter of the scenario, such as the density of the stimulation; may be
        repeated.
    method
        Reconstruction method: see `anisomap methods`.
    dimensions
        Number of coordinates.
    output
        CSV file for the table.
    picture
        File for a figure of the curves: .png, .svg or .pdf.
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
    with reporting.printer() as printer:
        printer.table(f"Coverage of {skin.name} by {scenario}, mean of {runs} runs", _COLUMNS, rows)
        printer.record(body=skin.name, scenario=scenario, runs=runs, coverage=_values(curve))
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
        figure = coverage_figure(title, curve.n_frames, curve.rate_hz, shares)
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


def _values(curve: CoverageCurve) -> list[dict[str, object]]:
    return [
        {
            "frames": int(n_frames),
            "seconds": float(curve.seconds[i]),
            "sensors_touched": float(curve.touched[i].mean()),
            "neighbours_touched_together": float(curve.pairs[i].mean()) / max(curve.n_pairs, 1),
            "mantel_r": curve.mantel_r[i],
        }
        for i, n_frames in enumerate(curve.n_frames)
    ]
