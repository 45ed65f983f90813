"""Results of experiments on disk, and the page of results.

Each experiment has a folder with its figures (PNG and SVG), tables (CSV), texts, and a record
(JSON) with captions, a digest of every file and a fingerprint of its inputs. A result is valid
while fingerprint and digests match: the folder is a cache, and its contents are never executed.
"""

from __future__ import annotations

import csv
import io
import json
import math
import shutil
from collections.abc import Iterable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from joblib import hash as digest

from anisomap._version import __version__
from anisomap.drawing.figures import figure_bytes
from anisomap.drawing.report import templates
from anisomap.files.paths import atomic_write, named_errors
from anisomap.paper.experiment import Cell, Experiment, Picture, Result, Settings, Table

PAGE = "index.html"
RECORD = "record.json"
FIGURE_FORMATS = ("png", "svg")
MAX_ROWS = 60
"""Maximum rows of a table on the page; longer tables are only linked."""


def save(folder: Path, name: str, found: Iterable[Result], inputs: str, seconds: float) -> None:
    """Write the result of an experiment; the record is written last."""
    target = folder / name
    record: dict[str, Any] = {"fingerprint": inputs, "seconds": seconds}
    record |= {kind: [] for kind in ("pictures", "documents", "tables")}
    contents: dict[str, bytes] = {}
    for one in found:
        entry: dict[str, Any] = {"name": one.name, "caption": one.caption}
        if isinstance(one, Picture):
            record["pictures"].append(entry)
            for kind in FIGURE_FORMATS:
                contents[f"{one.name}.{kind}"] = figure_bytes(one.figure, kind)
        elif isinstance(one, Table):
            record["tables"].append(entry | {"columns": dict(one.columns), "shown": one.shown})
            contents[f"{one.name}.csv"] = to_csv(one).encode()
        else:
            record["documents"].append(entry)
            contents[one.name] = one.text.encode()
    record["digests"] = {name: digest(content) for name, content in contents.items()}
    contents[RECORD] = (json.dumps(record, indent=1) + "\n").encode()
    with named_errors(target):
        if target.exists():
            shutil.rmtree(target)
        target.mkdir()
        for file, content in contents.items():
            (target / file).write_bytes(content)


def load(folder: Path, name: str, inputs: str) -> dict[str, Any] | None:
    """Read the record of an experiment with its tables; None if it is not valid."""
    try:
        record: dict[str, Any] = json.loads((folder / name / RECORD).read_text(encoding="utf-8"))
        damaged = (
            digest((folder / name / file).read_bytes()) != one
            for file, one in record["digests"].items()
        )
        if record["fingerprint"] != inputs or any(damaged):
            return None
        tables = [_read_table(folder / name, entry) for entry in record["tables"]]
        return record | {"seconds": float(record["seconds"]), "tables": tables}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def to_csv(table: Table) -> str:
    """Format a table as CSV; floats have six significant digits."""
    buffer = io.StringIO()
    lines = csv.writer(buffer, lineterminator="\n")
    lines.writerow(table.columns)
    lines.writerows([f"{v:.6g}" if isinstance(v, float) else v for v in r] for r in table.rows)
    return buffer.getvalue()


def _read_table(folder: Path, entry: dict[str, Any]) -> Table:
    with (folder / f"{entry['name']}.csv").open(encoding="utf-8", newline="") as file:
        header, *lines = csv.reader(file)
    if header != list(entry["columns"]):
        raise ValueError(header)
    rows = tuple(tuple(_from_text(text) for text in line) for line in lines)
    return Table(entry["name"], entry["caption"], entry["columns"], rows, entry["shown"])


def _from_text(text: str) -> Cell:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def write_page(
    path: Path,
    settings: Settings,
    experiments: Iterable[Experiment],
    fingerprints: Mapping[str, str],
) -> None:
    """Write the page of the results beside their folders."""
    environment = templates("anisomap.paper")
    environment.filters |= {"cell": _cell_text, "numeric": _numeric_columns}
    sections = [  # without a result if the experiment was skipped
        {"experiment": one, "result": load(path.parent, one.name, fingerprints.get(one.name, ""))}
        for one in experiments
        if one.title and (one.name in fingerprints or not one.can_run(settings))
    ]
    text = environment.get_template("page.html").render(
        style=files("anisomap.paper").joinpath("templates", "page.css").read_text(encoding="utf-8"),
        sections=sections,
        settings=settings,
        version=__version__,
        max_rows=MAX_ROWS,
    )
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _cell_text(value: Cell) -> str:
    """Format a cell of a table; floats have three significant digits."""
    if isinstance(value, float):
        return "\N{EN DASH}" if math.isnan(value) else f"{value:.3g}"
    return f"{value:,}" if isinstance(value, int) and value >= 10_000 else str(value)


def _numeric_columns(table: Table) -> list[bool]:
    """Return whether each column contains only numbers."""
    return [
        all(not isinstance(row[i], str) for row in table.rows) for i in range(len(table.columns))
    ]
