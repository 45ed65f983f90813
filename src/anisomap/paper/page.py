"""The HTML page with all results, in the order of the paper."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.resources import files
from pathlib import Path

from anisomap._version import __version__
from anisomap.files import atomic_write
from anisomap.paper import results
from anisomap.paper.experiment import Cell, Experiment, Settings, Table

MAX_ROWS = 60  # of a table on the page; longer tables are only linked

_PACKAGE = "anisomap.paper"


@dataclass(frozen=True)
class Section:
    """Section of the page; `result` is None if the experiment was skipped."""

    experiment: Experiment
    result: results.Result | None


def write_page(
    path: Path,
    settings: Settings,
    experiments: Mapping[str, Experiment],
    fingerprints: Mapping[str, str],
) -> None:
    """Write the page of the results beside their folders.

    Parameters
    ----------
    path : Path
        The HTML file, in the parent folder of all experiments; it links to their files.
    settings : Settings
    experiments : mapping of str to Experiment
        In the order of the page.
    fingerprints : mapping of str to str
        Of the experiments that were run; others are left out unless they lack a recording.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    jinja2 = import_module("jinja2")
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(_PACKAGE),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"cell": cell_text, "numeric": numeric_columns}
    sections = [
        Section(
            one,
            results.load(path.parent, one.name, fingerprints[one.name])
            if one.name in fingerprints
            else None,
        )
        for one in experiments.values()
        if one.title and (one.name in fingerprints or one.files)
    ]
    text = environment.get_template("page.html").render(
        style=files(_PACKAGE).joinpath("templates", "page.css").read_text(encoding="utf-8"),
        sections=sections,
        settings=settings,
        version=__version__,
        max_rows=MAX_ROWS,
    )
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def cell_text(value: Cell) -> str:
    """Format a cell of a table; floats with three significant digits."""
    if isinstance(value, float):
        return "\N{EN DASH}" if math.isnan(value) else f"{value:.3g}"
    return f"{value:,}" if isinstance(value, int) and value >= 10_000 else str(value)


def numeric_columns(table: Table) -> list[bool]:
    """Whether each column holds numbers only."""
    return [
        all(not isinstance(row[i], str) for row in table.rows) for i in range(len(table.columns))
    ]
