"""What the benchmarks share: their options, quiet work on one thread, progress, and tables."""

from __future__ import annotations

import argparse
import csv
import multiprocessing
import os
import platform
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import astuple, fields
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_info, threadpool_limits

from anisomap.errors import AnisomapWarning

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Of figures: Okabe & Ito (2008), distinct for all kinds of colour vision."""

Source = TypeVar("Source")
Row = TypeVar("Row")


def options(
    text: str | None,
    output: str,
    *,
    seeds: int | None = None,
    first_seed: int | None = None,
    recordings: bool = True,
    workers: bool = False,
) -> argparse.ArgumentParser:
    """Create the parser of a benchmark, with the options that several have; None leaves one out."""
    parser = argparse.ArgumentParser(description=text)
    parser.add_argument("-o", "--output", type=Path, default=Path(output))
    if seeds is not None:
        parser.add_argument("--seeds", type=int, default=seeds, help="0 maps real skins only")
    if first_seed is not None:
        parser.add_argument("--first-seed", type=int, default=first_seed)
    if recordings:
        parser.add_argument(
            "--recordings", type=Path, nargs="+", default=(),
            help="folders of NPZ files with positions",
        )  # fmt: skip
    if workers:
        parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    return parser


def files_in(folders: Iterable[Path]) -> list[Path]:
    """Return the recordings in folders."""
    return [path for folder in folders for path in sorted(folder.glob("*.npz"))]


@contextmanager
def quietly() -> Iterator[None]:
    """Work on one thread, without the warnings of maps."""
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)
        yield


def in_parallel(
    measure: Callable[[Source], list[Row]],
    sources: Sequence[Source],
    workers: int,
    *,
    ordered: bool = True,
) -> Iterator[list[Row]]:
    """Measure sources in processes; yield the rows of each, and print how many are done.

    ordered: As the sources; otherwise as they are done, for runs that can be continued.
    """
    started = time.monotonic()
    with ProcessPoolExecutor(workers, initializer=_end_with_parent) as pool:
        jobs = [pool.submit(_quietly, measure, source) for source in sources]
        for done, job in enumerate(jobs if ordered else as_completed(jobs), start=1):
            yield job.result()
            left = (time.monotonic() - started) / done * (len(jobs) - done)
            print(f"\r{done} of {len(jobs)}, {left / 60:.0f} min left ", end="", flush=True)
    print()


def _end_with_parent() -> None:
    """End this worker when the process that started it ends, even if that one is killed."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _quietly(measure: Callable[[Source], list[Row]], source: Source) -> list[Row]:
    with quietly():
        return measure(source)


def columns(kind: Any) -> list[str]:
    """Return the names of the fields of a dataclass: the columns of a table of them."""
    return [field.name for field in fields(kind)]


def write_csv(
    path: Path, names: Sequence[str], rows: Iterable[Sequence[object]], digits: int | None = None
) -> None:
    """Write a table; the file is replaced when it is complete. digits: Of floats; None for all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".part")
    with partial.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(names)
        for row in rows:
            table.writerow(
                [f"{v:.{digits}g}" if digits and isinstance(v, float) else v for v in row]
            )
    partial.replace(path)


def write_rows(path: Path, rows: Sequence[Any], digits: int | None = None) -> None:
    """Write rows, which are dataclasses of one kind, as CSV; nothing if there are none."""
    if rows:
        write_csv(path, columns(rows[0]), map(astuple, rows), digits)


def frame(rows: Sequence[Any]) -> Any:
    """Return rows, which are dataclasses of one kind, as a data frame of pandas."""
    return pd.DataFrame([astuple(row) for row in rows], columns=columns(rows[0]))


def measured(
    measure: Callable[[Source], list[Row]], sources: Sequence[Source], workers: int
) -> list[Row]:
    """Measure sources in processes; return the rows of all."""
    return [row for rows in in_parallel(measure, sources, workers) for row in rows]


def stream(path: Path, rows: Iterable[Row]) -> list[Row]:
    """Print rows, which are dataclasses of one kind, as they are made; write them as CSV."""
    made: list[Any] = []
    with quietly():
        row: Any
        for row in rows:
            print(*astuple(row), sep=", ", flush=True)
            made.append(row)
            write_rows(path, made, digits=4)
    return made


def publish(folder: Path, name: str, rows: Sequence[Any], text: str) -> None:
    """Write rows as CSV and their table as Markdown, and print the table."""
    write_rows(folder / f"{name}.csv", rows, digits=4)
    (folder / f"{name}-table.md").write_text(text, encoding="utf-8")
    print(text)


def read_rows(path: Path, kind: Callable[..., Row]) -> list[Row]:
    """Read rows that `write_rows` wrote; none if there is no file."""
    if not path.exists():
        return []
    found = pd.read_csv(path, dtype=get_type_hints(kind))
    return [kind(**row) for row in found.to_dict("records")]


def markdown_table(
    names: Sequence[str], rows: Iterable[Iterable[object]], texts: Sequence[str] | None = None
) -> Iterator[str]:
    """Yield the lines of a table in Markdown; columns that are not `texts` are aligned right."""
    rule = ["---" if texts is None else ":---" if name in texts else "---:" for name in names]
    for cells in chain([names, rule], rows):
        yield f"| {' | '.join(map(str, cells))} |"


def keyed_table(
    rows: Iterable[Mapping[str, object]], texts: Sequence[str] | None = None
) -> Iterator[str]:
    """Yield the lines of a table in Markdown, see `markdown_table`, of rows by column."""
    remaining = iter(rows)
    first = next(remaining, None)
    if first is not None:
        cells = (row.values() for row in chain([first], remaining))
        yield from markdown_table([*first], cells, texts)


def machine(of_what: str) -> str:
    """Describe the machine, the versions of libraries and the inputs in one sentence."""
    libraries = ("numpy", "scipy", "scikit-learn", "numba")
    versions = ", ".join(f"{name} {version(name)}" for name in libraries)
    blas = {
        f"{found['internal_api']} {found['version']} for {found['architecture']}"
        for found in threadpool_info()
        if found["user_api"] == "blas" and "architecture" in found
    }
    python = platform.python_version()
    return (
        f"Measured on {os.cpu_count()} cores ({_processor()}) with Python {python}, "
        f"{versions}{''.join(', ' + one for one in sorted(blas))}; {of_what}."
    )


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or platform.machine())


def growth_exponent(sizes: Sequence[float], times: Sequence[float]) -> float:
    """Fit the exponent of a power law of times."""
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])
