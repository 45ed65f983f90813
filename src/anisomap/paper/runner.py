"""All experiments, in the order of the page, and their runs: in parallel, each at most once.

Each experiment has a folder with its figures (PNG and SVG), tables (CSV), texts, and a record
(JSON) with captions, a digest of every file and a fingerprint of its inputs. A result is valid
while fingerprint and digests match. The page shows all results, in the order of the paper.
"""

from __future__ import annotations

import csv
import hashlib
import importlib.metadata
import io
import json
import math
import os
import shutil
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from graphlib import TopologicalSorter
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Any

from joblib import Parallel, cpu_count, delayed
from threadpoolctl import threadpool_limits

import anisomap
from anisomap._version import __version__
from anisomap.drawing.figures import figure_bytes
from anisomap.drawing.report import templates
from anisomap.errors import AnisomapWarning, FileError, InputError, MissingExtraError
from anisomap.files.paths import atomic_write
from anisomap.paper import accuracy, bodies, claims, patch, sample_data, sensitivity
from anisomap.paper.experiment import (
    REGISTRY,
    Cell,
    Document,
    Experiment,
    Picture,
    Settings,
    Table,
)

_MODULES = (claims, bodies, patch, accuracy, sample_data, sensitivity)
"""Modules that register experiments when they are imported."""

_PAGE_ORDER = (
    "claims",
    "figure-1",
    "figure-2",
    "real-skin",
    "figure-3",
    *(f"figure-{number}" for number in range(4, 8)),
    *(f"figure-s{number}" for number in range(1, 11)),
    "data-s1-s6",
    "data-s7-s11",
    "text-s3",
    "bins",
    "failing-sensor",
    "unlike-responses",
    "rivals",
    sensitivity.CYLINDER,
    *(f"sensitivity-{parameter.name}" for parameter in sensitivity.PARAMETERS),
    "dimensions",
)
"""Experiments with a section on the page; the others, which provide data to them, follow."""

EXPERIMENTS: Mapping[str, Experiment] = MappingProxyType(
    {name: REGISTRY[name] for name in (*_PAGE_ORDER, *REGISTRY)}
)
"""By name, which is also the name of the folder of its results."""


@dataclass(frozen=True)
class Status:
    """State of an experiment after a run.

    seconds: Duration of the experiment when it was computed.
    state: Skipped experiments lack a recording.
    """

    name: str
    seconds: float
    state: str


def reproduce(
    folder: str | os.PathLike[str],
    settings: Settings | None = None,
    *,
    only: Sequence[str] = (),
    workers: int | None = None,
    experiments: Mapping[str, Experiment] = EXPERIMENTS,
    report: Callable[[Status, float], None] | None = None,
) -> list[Status]:
    """Run the experiments of the paper and write the page."""
    settings, target = settings or Settings(), Path(folder)
    chosen = _with_needs(only or list(experiments), experiments)
    _check(settings, workers)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"cannot create the folder {target}: {error.strerror}") from error

    found = {one.name: Status(one.name, 0.0, "skipped") for one in chosen}
    prints: dict[str, str] = {}
    pending: dict[str, Experiment] = {}

    def finish(name: str, seconds: float, state: str) -> None:
        found[name] = Status(name, seconds, state)
        if report is not None:
            finished = sum(status.state != "skipped" for status in found.values())
            report(found[name], finished / total)

    runnable = [one for one in chosen if one.can_run(settings)]
    total = len(runnable)
    for one in runnable:
        prints[one.name] = fingerprint(one, settings, prints)
        result = load(target, one.name, prints[one.name])
        if result is None:
            pending[one.name] = one
        else:
            finish(one.name, result["seconds"], "cached")
    order = TopologicalSorter({one.name: {*one.needs} & {*pending} for one in pending.values()})
    order.prepare()
    while order.is_active():
        level = sorted(order.get_ready(), key=lambda name: -pending[name].cost)
        parallel = Parallel(
            n_jobs=min(workers or cpu_count(), len(level)),
            batch_size=1,
            pre_dispatch="n_jobs",  # after a kill, workers finish only what they are running
            return_as="generator_unordered",
        )
        calls = (delayed(_run)(target, pending[name], settings, prints) for name in level)
        for name, seconds in parallel(calls):
            finish(name, seconds, "computed")
            order.done(name)
    write_page(target / PAGE, settings, experiments, prints)
    return list(found.values())


def _check(settings: Settings, workers: int | None) -> None:
    if not all(map(find_spec, ("mujoco", "matplotlib", "jinja2"))):
        raise MissingExtraError("reproducing the paper", "paper")
    if workers is not None and workers < 1:
        raise InputError(f"workers must be at least 1, got {workers}")
    if settings.recordings is not None and not settings.recordings.is_dir():
        raise FileError(f"the folder of recordings {settings.recordings} does not exist")


def _run(
    folder: Path, experiment: Experiment, settings: Settings, prints: Mapping[str, str]
) -> tuple[str, float]:
    """Compute and save an experiment; return its name and duration."""
    started = time.perf_counter()
    needed = [load(folder, name, prints[name]) for name in experiment.needs]
    tables = {table.name: table for result in needed if result for table in result["tables"]}
    with threadpool_limits(1), warnings.catch_warnings():
        # Notes on single maps would be repeated for hundreds of maps; the tables hold the scores.
        warnings.simplefilter("ignore", AnisomapWarning)
        found = [*experiment.compute(settings, tables)]
        seconds = round(time.perf_counter() - started, 2)
        save(folder, experiment.name, found, prints[experiment.name], seconds)
    return experiment.name, seconds


def _with_needs(names: Sequence[str], experiments: Mapping[str, Experiment]) -> list[Experiment]:
    """Return experiments in an order in which each follows those that it needs."""
    found: dict[str, Experiment] = {}

    def add(name: str) -> None:
        if name not in experiments:
            raise InputError(f"unknown experiment {name!r}; choose from {', '.join(experiments)}")
        for needed in experiments[name].needs:
            add(needed)
        found.setdefault(name, experiments[name])

    for name in names:
        add(name)
    return list(found.values())


PAGE = "index.html"
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
        return {
            "seconds": float(record["seconds"]),
            **{kind: [{**entry} for entry in record[kind]] for kind in ("pictures", "documents")},
            "tables": [_read_table(folder / name, entry) for entry in record["tables"]],
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


def write_page(
    path: Path,
    settings: Settings,
    experiments: Mapping[str, Experiment],
    fingerprints: Mapping[str, str],
) -> None:
    """Write the page of the results beside their folders."""
    environment = templates("anisomap.paper")
    environment.filters |= {"cell": _cell_text, "numeric": _numeric_columns}
    sections = [  # without a result if the experiment was skipped
        {"experiment": one, "result": load(path.parent, one.name, fingerprints.get(one.name, ""))}
        for one in experiments.values()
        if one.title and (one.name in fingerprints or one.files)
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
    """Format a cell of a table; floats with three significant digits."""
    if isinstance(value, float):
        return "\N{EN DASH}" if math.isnan(value) else f"{value:.3g}"
    return f"{value:,}" if isinstance(value, int) and value >= 10_000 else str(value)


def _numeric_columns(table: Table) -> list[bool]:
    """Whether each column holds numbers only."""
    return [
        all(not isinstance(row[i], str) for row in table.rows) for i in range(len(table.columns))
    ]
