"""Numbers in documents come from the tables of `anisomap paper`, by a command and not by hand.

A Markdown document says which columns of which table it shows::

    <!-- numbers: figure-3: run, r-anisomap, isomap -->
    ...
    <!-- end of numbers -->

and what stands between the two lines is written by::

    python -m anisomap.paper.numbers RESULTS TABLES DOCUMENT ...

which first copies the tables that are named from the folder of results to the folder of tables.
"""

from __future__ import annotations

import csv
import re
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from anisomap.errors import FileError
from anisomap.files import atomic_write

_PLACE = re.compile(
    r"(?P<opening><!-- numbers: (?P<table>[\w-]+)(?:: (?P<columns>[^\n]*?))? -->\n)"
    r".*?(?P<closing><!-- end of numbers -->)",
    re.DOTALL,
)


def tables_in(text: str) -> list[str]:
    """List the tables that a document shows."""
    return [place["table"] for place in _PLACE.finditer(text)]


def fill(text: str, tables: Path) -> str:
    """Write the numbers of a document anew.

    Parameters
    ----------
    text : str
        The document.
    tables : Path
        Folder of the tables (CSV).

    Returns
    -------
    str

    Raises
    ------
    FileError
        If a table or one of its columns is not there.
    """
    return _PLACE.sub(
        lambda place: (
            place["opening"]
            + markdown(tables / f"{place['table']}.csv", _split(place["columns"]))
            + place["closing"]
        ),
        text,
    )


def markdown(path: Path, columns: Sequence[str] = ()) -> str:
    """Write columns of a CSV file as a table in Markdown; all of them unless named.

    Raises
    ------
    FileError
        If the file or a column is not there.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            header, *rows = csv.reader(file)
    except (OSError, ValueError) as error:
        raise FileError(f"cannot read the table {path}: {error}") from error
    chosen = list(columns) or header
    for name in chosen:
        if name not in header:
            raise FileError(f"{path} has no column {name!r}, but {', '.join(header)}")
    places = [header.index(name) for name in chosen]
    lines = [chosen, ["---"] * len(chosen), *([_rounded(row[i]) for i in places] for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def collect(results: Path, tables: Path, names: Sequence[str]) -> None:
    """Copy tables out of the folders of experiments.

    Raises
    ------
    FileError
        If a table is not there.
    """
    for name in names:
        found = sorted(results.glob(f"*/{name}.csv"))
        if not found:
            raise FileError(f"there is no table {name} in {results}; run anisomap paper first")
        with atomic_write(tables / f"{name}.csv") as aside:
            shutil.copyfile(found[0], aside)


def main(arguments: Sequence[str]) -> None:
    """Bring documents up to date: RESULTS TABLES DOCUMENT ...

    Raises
    ------
    FileError
        If a file is not there or cannot be written.
    """
    results, tables, *documents = map(Path, arguments)
    tables.mkdir(parents=True, exist_ok=True)
    for path in documents:
        text = path.read_text(encoding="utf-8")
        collect(results, tables, tables_in(text))
        with atomic_write(path) as aside:
            aside.write_text(fill(text, tables), encoding="utf-8")


def _split(columns: str | None) -> list[str]:
    return [name.strip() for name in columns.split(",")] if columns else []


def _rounded(text: str) -> str:
    """Write numbers with three digits after the point, and text as it is."""
    if re.fullmatch(r"-?\d+\.\d+(e-?\d+)?", text):
        return f"{float(text):.3f}"
    return text.replace("|", "\\|")


if __name__ == "__main__":
    main(sys.argv[1:])
