"""Results of experiments on disk.

Each experiment has a folder with its figures (PNG and SVG), tables (CSV), texts, and a record
(JSON) with captions, a digest of every file and a fingerprint of its inputs. A result is valid
while fingerprint and digests match.

`joblib.Memory` is not used: it stores pickles, which are unsafe to load from a folder that was
received from others; it would not notice changes in functions that an experiment calls; and the
files written here are the output in any case. The page shows all results, in the order of the
paper.
"""

from __future__ import annotations

import csv
import hashlib
import importlib.metadata
import io
import json
import math
import shutil
from collections.abc import Iterable, Mapping
from functools import cache
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any

import anisomap
from anisomap._version import __version__
from anisomap.drawing.figures import figure_bytes
from anisomap.errors import FileError
from anisomap.files import atomic_write
from anisomap.paper.experiment import Cell, Document, Experiment, Picture, Settings, Table

RECORD = "record.json"
FIGURE_FORMATS = ("png", "svg")

_LIBRARIES = ("numpy", "scipy", "mujoco", "matplotlib")


def fingerprint(experiment: Experiment, settings: Settings, needed: Mapping[str, str]) -> str:
    """Digest everything that the result of an experiment depends on."""
    inputs = {
        "name": experiment.name,
        "settings": {"seed": settings.seed, "quick": settings.quick},
        "recordings": [_digest(path.read_bytes()) for path in experiment.paths(settings)],
        "needs": {name: needed[name] for name in experiment.needs},
        "code": _digest_of_package(),
        "libraries": {name: importlib.metadata.version(name) for name in _LIBRARIES},
    }
    return _digest(json.dumps(inputs, sort_keys=True).encode())


def save(
    folder: Path,
    name: str,
    found: Iterable[Picture | Table | Document],
    inputs: str,
    seconds: float,
) -> None:
    """Write the result of an experiment, and its record last."""
    target = folder / name
    record: dict[str, Any] = {"fingerprint": inputs, "seconds": seconds}
    record |= {kind: [] for kind in ("pictures", "documents", "tables")}
    try:
        if target.exists():
            shutil.rmtree(target)
        target.mkdir()
        for one in found:
            entry: dict[str, Any] = {"name": one.name, "caption": one.caption}
            if isinstance(one, Picture):
                record["pictures"].append(entry)
                for kind in FIGURE_FORMATS:
                    (target / f"{one.name}.{kind}").write_bytes(figure_bytes(one.figure, kind))
            elif isinstance(one, Table):
                entry |= {"columns": dict(one.columns), "shown": one.shown}
                record["tables"].append(entry)
                (target / f"{one.name}.csv").write_text(to_csv(one), encoding="utf-8")
            else:
                record["documents"].append(entry)
                (target / one.name).write_text(one.text, encoding="utf-8")
        record["digests"] = {
            path.name: _digest(path.read_bytes()) for path in sorted(target.iterdir())
        }
        text = json.dumps(record, indent=1) + "\n"
        (target / RECORD).write_text(text, encoding="utf-8")
    except OSError as error:
        raise FileError(f"cannot write {target}: {error.strerror or error}") from error


def load(folder: Path, name: str, inputs: str) -> dict[str, Any] | None:
    """Read the record of an experiment, with its tables, if it is valid."""
    try:
        record: dict[str, Any] = json.loads((folder / name / RECORD).read_text(encoding="utf-8"))
        damaged = (
            _digest((folder / name / file).read_bytes()) != digest
            for file, digest in record["digests"].items()
        )
        if record["fingerprint"] != inputs or any(damaged):
            return None
        tables = [_read_table(folder / name, entry) for entry in record["tables"]]
        return {
            "seconds": float(record["seconds"]),
            "pictures": [{**entry} for entry in record["pictures"]],
            "documents": [{**entry} for entry in record["documents"]],
            "tables": tables,
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def to_csv(table: Table) -> str:
    """Write a table as CSV; floats with six significant digits."""
    lines = [list(table.columns), *([_to_text(value) for value in row] for row in table.rows)]
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(lines)
    return buffer.getvalue()


def _read_table(folder: Path, entry: dict[str, Any]) -> Table:
    with (folder / f"{entry['name']}.csv").open(encoding="utf-8", newline="") as file:
        header, *lines = csv.reader(file)
    if header != list(entry["columns"]):
        raise ValueError(header)
    rows = tuple(tuple(_from_text(text) for text in line) for line in lines)
    return Table(entry["name"], entry["caption"], entry["columns"], rows, entry["shown"])


def _to_text(value: Cell) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _from_text(text: str) -> Cell:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


@cache
def _digest_of_package() -> str:
    """Digest the source code and texts; the command line does not affect results."""
    root = Path(str(files(anisomap)))
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*")):
        if path.suffix in (".py", ".txt") and path.relative_to(root).parts[0] != "cli":
            digest.update(path.read_bytes())
    return digest.hexdigest()


MAX_ROWS = 60  # of a table on the page; longer tables are only linked

_PACKAGE = "anisomap.paper"


def write_page(
    path: Path,
    settings: Settings,
    experiments: Mapping[str, Experiment],
    fingerprints: Mapping[str, str],
) -> None:
    """Write the page of the results beside their folders."""
    jinja2 = import_module("jinja2")
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(_PACKAGE),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"cell": cell_text, "numeric": numeric_columns}
    sections = [  # without a result if the experiment was skipped
        {"experiment": one, "result": load(path.parent, one.name, fingerprints.get(one.name, ""))}
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
