"""``anisomap compare``: several methods on recordings whose positions are known."""

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
from anisomap.cli.console import console, progress, show_table
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
    reading: options.Reading = options.AS_IT_COMES,
    output: Annotated[Path | None, Parameter(alias="-o", group=options.outputs_group)] = None,
) -> None:
    """Score several methods on recordings with known positions: a table of Mantel r.

    Parameters
    ----------
    method
        Method to compare; may be repeated. Default: the default method and the paper's four.
    dimensions
        Dimensions to map into, may be repeated; 2 and 3 unless given.
    output
        Write the table as Markdown, too.
    """
    methods = tuple(method or (DEFAULT_METHOD, *PAPER_METHODS))
    for name in methods:
        find_method(name)
    if output:
        check_target(output)
        check_distinct([output], recordings)
    rows = []
    for path in recordings:
        recording = pipeline.read(path, reading.checked()).complete(missing)
        truth = recording.positions
        if truth is None:
            raise InputError(f"{path} holds no true positions, so no map of it can be scored")
        for k in dimensions or (2, 3):
            with progress(f"{path.name} in {k} dimensions"):
                scores = [f"{_mantel_r(recording, truth, name, k):.3f}" for name in methods]
            size = f"{recording.n_sensors} x {recording.n_frames}"
            rows.append((path.name.split(".")[0], size, f"{k}D", *scores))
    columns = ("recording", "sensors x frames", "map", *methods)
    show_table("Mantel r", columns, rows)
    if output:
        with atomic_write(output) as aside:
            aside.write_text(_markdown(columns, rows), encoding="utf-8")
        console.print(f"written to {output}", markup=False)


def _mantel_r(
    recording: Recording, truth: NDArray[np.float64], method: str, dimensions: int
) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)  # one doubt would be told many times
        sensor_map = reconstruct(recording, method, dimensions)
    return score(sensor_map, truth, permutations=0).mantel.r


def _markdown(columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [columns, tuple("---" for _ in columns), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
