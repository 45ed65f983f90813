"""The page that walks through all results, in the paper's order."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any

from anisomap._version import __version__
from anisomap.errors import MissingExtraError
from anisomap.files import atomic_write
from anisomap.paper import result_cache as results
from anisomap.paper.experiment import Cell, Experiment, Settings, Table

_MOST_ROWS = 60
_ROOM = "anisomap.paper"


@dataclass(frozen=True)
class Section:
    """An experiment as the page shows it; `kept` is None if it was left out."""

    experiment: Experiment
    kept: results.Kept | None


def write_page(
    path: Path,
    folder: Path,
    settings: Settings,
    experiments: Mapping[str, Experiment],
    keys: Mapping[str, str],
) -> None:
    """Write the page about what is finished in a folder.

    Parameters
    ----------
    path : Path
        The HTML file; it refers to pictures and tables by relative links.
    folder : Path
        That of all experiments.
    settings : Settings
    experiments : mapping of str to Experiment
        In the order of the page.
    keys : mapping of str to str
        What each was made from; finished ones of other settings are left out.

    Raises
    ------
    FileError
        If the file cannot be written.
    MissingExtraError
        If jinja2 is not installed.
    """
    template = _environment().get_template("page.html")
    sections = [
        Section(one, results.load(folder, one.name, keys[one.name]) if one.name in keys else None)
        for one in experiments.values()
        if one.title and (one.name in keys or one.files)
    ]
    text = template.render(
        style=files(_ROOM).joinpath("templates", "page.css").read_text(encoding="utf-8"),
        sections=sections,
        settings=settings,
        version=__version__,
        most_rows=_MOST_ROWS,
    )
    with atomic_write(path) as aside:
        aside.write_text(text, encoding="utf-8")


def shown(value: Cell) -> str:
    """Write a cell of a table: numbers with three digits that count."""
    if isinstance(value, float):
        return "\N{EN DASH}" if math.isnan(value) else f"{value:.3g}"
    return f"{value:,}" if isinstance(value, int) and value >= 10_000 else str(value)


def numeric_columns(table: Table) -> list[bool]:
    """Tell which columns hold nothing but numbers."""
    return [
        all(not isinstance(row[i], str) for row in table.rows) for i in range(len(table.columns))
    ]


@cache
def _environment() -> Any:
    try:
        jinja2 = import_module("jinja2")
    except ModuleNotFoundError as error:
        raise MissingExtraError("the page of the paper's results", "report") from error
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(_ROOM),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"shown": shown, "numeric": numeric_columns}
    return environment
