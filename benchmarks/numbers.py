"""Insert tables of results into Markdown documents.

A document marks where columns of a table go::

    <!-- numbers: figure-3: run, r-anisomap, isomap -->
    ...
    <!-- end of numbers -->

``figure-3 [plane-bombardment, patch]`` takes all rows of these first columns only, in this order.
The following command copies the tables that the documents name from the folder of results to the
folder of tables, and replaces the lines between the markers. Tables that the results lack keep
their last version in the folder of tables::

    python -m benchmarks.numbers RESULTS TABLES DOCUMENT ...
"""

from __future__ import annotations

import csv
import re
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from anisomap.errors import FileError
from anisomap.files.paths import atomic_write
from benchmarks.harness import markdown_table

_MARKED = re.compile(
    r"(?P<opening><!-- numbers: (?P<table>[\w-]+)(?: \[(?P<rows>[^]\n]*)\])?"
    r"(?:: (?P<columns>[^\n]*?))? -->\n)"
    r".*?(?P<closing><!-- end of numbers -->)",
    re.DOTALL,
)


def tables_in(text: str) -> list[str]:
    """Return the names of the tables in a document."""
    return [match["table"] for match in _MARKED.finditer(text)]


def fill(text: str, tables: Path) -> str:
    """Replace the tables of a document."""
    return _MARKED.sub(
        lambda match: (
            match["opening"]
            + to_markdown(
                tables / f"{match['table']}.csv", _split(match["columns"]), _split(match["rows"])
            )
            + match["closing"]
        ),
        text,
    )


def to_markdown(path: Path, columns: Sequence[str] = (), keys: Sequence[str] = ()) -> str:
    """Convert columns and rows of a CSV file, all by default, to a Markdown table."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            header, *rows = csv.reader(file)
    except (OSError, ValueError) as error:
        raise FileError(f"cannot read the table {path}: {error}") from error
    chosen = list(columns) or header
    for name in chosen:
        if name not in header:
            raise FileError(f"{path} has no column {name!r}; its columns are {', '.join(header)}")
    named = [row[0] for row in rows]
    for key in keys:
        if key not in named:
            raise FileError(f"{path} has no row {key!r}; its rows are {', '.join(named)}")
    rows = [row for key in keys for row in rows if row[0] == key] if keys else rows
    indices = [header.index(name) for name in chosen]
    cells = ([_rounded(row[i]) for i in indices] for row in rows)
    return "".join(f"{line}\n" for line in markdown_table(chosen, cells))


def collect(results: Path, tables: Path, names: Sequence[str]) -> None:
    """Copy tables from the folder of results, or from its folders of experiments."""
    for name in names:
        found = [*results.glob(f"{name}.csv"), *sorted(results.glob(f"*/{name}.csv"))]
        if found:
            with atomic_write(tables / f"{name}.csv") as temporary:
                shutil.copyfile(found[0], temporary)
        elif not (tables / f"{name}.csv").exists():
            raise FileError(
                f"neither {results} nor {tables} has a table {name}; run anisomap paper first"
            )


def main(arguments: Sequence[str]) -> None:
    """Update documents; the arguments are RESULTS TABLES DOCUMENT ..."""
    results, tables, *documents = map(Path, arguments)
    tables.mkdir(parents=True, exist_ok=True)
    for path in documents:
        text = path.read_text(encoding="utf-8")
        collect(results, tables, tables_in(text))
        with atomic_write(path) as temporary:
            temporary.write_text(fill(text, tables), encoding="utf-8")


def _split(columns: str | None) -> list[str]:
    return [name.strip() for name in columns.split(",")] if columns else []


def _rounded(text: str) -> str:
    """Round floats to three decimals; escape other text."""
    if re.fullmatch(r"-?\d+\.\d+(e-?\d+)?", text):
        return f"{float(text):.3f}"
    return text.replace("|", "\\|")


if __name__ == "__main__":
    main(sys.argv[1:])
