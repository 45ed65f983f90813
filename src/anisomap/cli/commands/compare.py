"""``anisomap compare``: several methods on recordings with known positions."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from cyclopts.validators import Number
from numpy.typing import NDArray

from anisomap.cli import parameters as options
from anisomap.cli import pipeline
from anisomap.cli.console import progress
from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation import score
from anisomap.files import atomic_write, check_distinct, check_target
from anisomap.methods import DEFAULT_METHOD, PAPER_METHODS, find_method
from anisomap.reconstruction import reconstruct
from anisomap.recording import Recording


def compare(
    recordings: Annotated[list[Path], Parameter(help="Files of recordings with positions.")],
    /,
    *,
    method: Annotated[
        list[str] | None, Parameter(alias="-m", group=options.method_group, negative=())
    ] = None,
    dimensions: Annotated[
        list[int] | None,
        Parameter(alias="-d", group=options.method_group, negative=(), validator=Number(gte=1)),
    ] = None,
    missing: options.Missing = "error",
    reading: options.Reading = options.DEFAULT_READING,
    output: Annotated[Path | None, Parameter(alias="-o", group=options.outputs_group)] = None,
    reporting: options.Reporting = options.DEFAULT_REPORTING,
) -> None:
    """Score several methods on recordings with known positions: a table of Mantel r.

    Parameters
    ----------
    method
        Method to compare; may be repeated. Default: the default method and the paper's four.
    dimensions
        Number of coordinates; may be repeated. Default: 2 and 3.
    output
        File for the table in Markdown.
    """
    methods = tuple(method or (DEFAULT_METHOD, *PAPER_METHODS))
    for name in methods:
        find_method(name)
    if output:
        check_target(output)
        check_distinct([output], recordings)
    rows, values = [], []
    for path in recordings:
        recording = pipeline.complete(pipeline.read(path, reading.checked()), missing)
        truth = recording.positions
        if truth is None:
            raise InputError(
                f"{path} contains no true positions; compare requires recordings with positions"
            )
        for k in dimensions or (2, 3):
            with progress(f"{path.name} in {k} dimensions"):
                scores = {name: _mantel_r(recording, truth, name, k) for name in methods}
            name, size = path.name.split(".")[0], f"{recording.n_sensors} x {recording.n_frames}"
            rows.append((name, size, f"{k}D", *(f"{r:.3f}" for r in scores.values())))
            values.append({"recording": name, "dimensions": k, "mantel_r": scores})
    columns = ("recording", "sensors x frames", "map", *methods)
    with reporting.printer() as printer:
        printer.table(
            "Mantel r",
            ("recording", "sensors x frames", "map", "method", "Mantel r"),
            [
                (*row[:3], method, r)
                for row in rows
                for method, r in zip(methods, row[3:], strict=True)
            ],
        )
        printer.record(scores=values)
    if output:
        with atomic_write(output) as aside:
            aside.write_text(_markdown(columns, rows), encoding="utf-8")


def _mantel_r(
    recording: Recording, truth: NDArray[np.float64], method: str, dimensions: int
) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)  # the notes would repeat for every method
        sensor_map = reconstruct(recording, method, dimensions)
    return score(sensor_map, truth, permutations=0).mantel.r


def _markdown(columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [columns, tuple("---" for _ in columns), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
