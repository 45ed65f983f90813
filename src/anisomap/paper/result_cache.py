"""What a finished experiment leaves in its folder, and how it is known to be finished.

A folder holds pictures (PNG and SVG), tables (CSV), texts, and ``done.json``: the key of what the
experiment was made from, a digest of every file, captions, and what the columns mean.
"""

from __future__ import annotations

import csv
import hashlib
import importlib.metadata
import inspect
import io
import json
import os
import shutil
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import anisomap
from anisomap.drawing.figures import figure_bytes
from anisomap.errors import FileError
from anisomap.paper.experiment import Cell, Experiment, Outcome, Settings, Table

RECORD = "done.json"
KINDS = ("png", "svg")

# Rooms whose code no result depends on; of this one, only what an experiment calls counts.
_NO_MATTER = ("cli", "io", "paper")
_PICTURES = ("drawing",)
_HERE = __name__.rpartition(".")[0]
_LIBRARIES = ("numpy", "scipy", "mujoco", "matplotlib")


@dataclass(frozen=True)
class Kept:
    """A finished experiment, as its folder tells.

    Attributes
    ----------
    name : str
    key : str
        Digest of what it was made from.
    seconds : float
        How long it took.
    pictures, documents : tuple of dict
        ``name`` and ``caption`` of each.
    tables : tuple of Table
    digests : dict of str to str
        Of every file.
    """

    name: str
    key: str
    seconds: float
    pictures: tuple[dict[str, str], ...]
    documents: tuple[dict[str, str], ...]
    tables: tuple[Table, ...]
    digests: dict[str, str]


def key_of(experiment: Experiment, settings: Settings, needed: Mapping[str, str]) -> str:
    """Digest all that the result of an experiment depends on.

    Parameters
    ----------
    experiment : Experiment
    settings : Settings
    needed : mapping of str to str
        Keys of the experiments whose tables it takes.

    Returns
    -------
    str
        Hexadecimal. It changes with the settings, the recordings, the experiments before it, this
        package's code and the libraries' versions.
    """
    inputs = {
        "name": experiment.name,
        "settings": {"seed": settings.seed, "quick": settings.quick},
        "recordings": [_digest(path.read_bytes()) for path in experiment.paths(settings)],
        "needs": {name: needed[name] for name in experiment.needs},
        "code": [
            _digest_of_package(pictures=bool(experiment.title)),
            _digest_of_experiment(experiment.make),
        ],
        "libraries": {name: importlib.metadata.version(name) for name in _LIBRARIES},
    }
    return _digest(json.dumps(inputs, sort_keys=True).encode())


def save(folder: Path, experiment: Experiment, outcome: Outcome, key: str, started: float) -> None:
    """Write what an experiment made: aside first, then in the place of what was there.

    Parameters
    ----------
    folder : Path
        That of all experiments.
    experiment : Experiment
    outcome : Outcome
    key : str
        From `key_of`.
    started : float
        By `time.perf_counter`.

    Raises
    ------
    FileError
        If something cannot be written.
    """
    target = folder / experiment.name
    try:
        aside = folder / f".{experiment.name}-{os.getpid()}"
        aside.mkdir()
        try:
            _write(aside, experiment.name, outcome, key, started)
            if target.exists():
                shutil.rmtree(target)
            aside.replace(target)
        finally:
            shutil.rmtree(aside, ignore_errors=True)
    except OSError as error:
        raise FileError(f"cannot write {target}: {error.strerror or error}") from error


def sweep(folder: Path, names: Iterable[str]) -> None:
    """Remove what runs that were killed had not finished writing."""
    for name in names:
        for aside in folder.glob(f".{name}-[0-9]*"):
            shutil.rmtree(aside, ignore_errors=True)


def load(folder: Path, name: str, key: str | None = None) -> Kept | None:
    """Read what an experiment left, if all of it is there and whole.

    Parameters
    ----------
    folder : Path
        That of all experiments.
    name : str
    key : str, optional
        What it must have been made from.

    Returns
    -------
    Kept or None
        None if a file is missing or not as it was written, or the key is another one.
    """
    try:
        record = json.loads((folder / name / RECORD).read_text(encoding="utf-8"))
        if key is not None and record["key"] != key:
            return None
        for file, digest in record["digests"].items():
            if _digest((folder / name / file).read_bytes()) != digest:
                return None
        return Kept(
            name=name,
            key=record["key"],
            seconds=record["seconds"],
            pictures=tuple(record["pictures"]),
            documents=tuple(record["documents"]),
            tables=tuple(_read_table(folder / name, entry) for entry in record["tables"]),
            digests=record["digests"],
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None  # damaged in whatever way: it is made again


def table_text(table: Table) -> str:
    """Give a table as CSV: numbers with six digits that count."""
    lines = [list(table.columns), *([_written(value) for value in row] for row in table.rows)]
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(lines)
    return buffer.getvalue()


def _write(folder: Path, name: str, outcome: Outcome, key: str, started: float) -> None:
    for picture in outcome.pictures:
        for kind in KINDS:
            content = figure_bytes(picture.figure, kind)
            (folder / f"{picture.name}.{kind}").write_bytes(content)
    for table in outcome.tables:
        (folder / f"{table.name}.csv").write_text(table_text(table), encoding="utf-8")
    for document in outcome.documents:
        (folder / document.name).write_text(document.text, encoding="utf-8")
    record = {
        "name": name,
        "key": key,
        "seconds": round(time.perf_counter() - started, 2),
        "pictures": [{"name": p.name, "caption": p.caption} for p in outcome.pictures],
        "documents": [{"name": d.name, "caption": d.caption} for d in outcome.documents],
        "tables": [
            {"name": t.name, "caption": t.caption, "columns": dict(t.columns), "shown": t.shown}
            for t in outcome.tables
        ],
        "digests": {p.name: _digest(p.read_bytes()) for p in sorted(folder.iterdir())},
    }
    text = json.dumps(record, indent=1) + "\n"
    (folder / RECORD).write_text(text, encoding="utf-8")


def _read_table(folder: Path, entry: dict[str, Any]) -> Table:
    with (folder / f"{entry['name']}.csv").open(encoding="utf-8", newline="") as file:
        header, *lines = csv.reader(file)
    if header != list(entry["columns"]):
        raise ValueError(header)
    rows = tuple(tuple(_read(text) for text in line) for line in lines)
    return Table(entry["name"], entry["caption"], entry["columns"], rows, entry["shown"])


def _written(value: Cell) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _read(text: str) -> Cell:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


@cache
def _digest_of_package(*, pictures: bool) -> str:
    """Digest the code; that of pictures only for experiments that are shown."""
    aside = _NO_MATTER if pictures else (*_NO_MATTER, *_PICTURES)
    root = Path(str(files(anisomap)))
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        if path.relative_to(root).parts[0] not in aside:
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _digest_of_experiment(make: Callable[..., Outcome]) -> str:
    """Digest the module that an experiment is in, and those of this package that it calls."""
    found: dict[str, str] = {}
    waiting = [inspect.getmodule(getattr(make, "func", make))]
    while waiting:
        module = waiting.pop()
        if module is None or module.__name__ in found:
            continue
        found[module.__name__] = inspect.getsource(module)
        used = (
            inspect.getmodule(value) for value in list(vars(module).values()) if callable(value)
        )
        named = (value for value in vars(module).values() if inspect.ismodule(value))
        waiting += [one for one in (*used, *named) if one and one.__name__.startswith(_HERE + ".")]
    return _digest(json.dumps(found, sort_keys=True).encode())
