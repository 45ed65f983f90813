"""What came out of the races: a table in Markdown and one in CSV, and how times grow."""

from __future__ import annotations

import csv
import math
import platform
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import astuple, fields
from importlib.metadata import version
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_info

from benchmarks.measuring import cores
from benchmarks.race import Row

_HEADER = (
    "N",
    "stage",
    "input",
    "CPU, 1 thread (s)",
    "clock, all cores (s)",
    "memory (MB)",
    "against",
    "its CPU (s)",
    "its memory (MB)",
    "ratio",
    "goal",
    "same result",
)
_WORDS = ("N", "stage", "input", "against", "same result")


def markdown(rows: Sequence[Row], n_frames: int) -> str:
    """Write all that there is to tell: where, how fast, and how times grow."""
    lines = [machine(n_frames), "", *_table(_HEADER, map(_cells, rows))]
    if growth := list(_growth(rows)):
        lines += ["", "How CPU times grow: as N to the power of", ""]
        lines += _table(("stage", "input", "from N", "to N", "ours", "against", "theirs"), growth)
    return "\n".join(lines) + "\n"


def machine(n_frames: int) -> str:
    """Say on what it was measured, in a sentence."""
    libraries = ("numpy", "scipy", "scikit-learn", "numba")
    versions = ", ".join(f"{name} {version(name)}" for name in libraries)
    blas = {
        f"{found['internal_api']} {found['version']} for {found['architecture']}"
        for found in threadpool_info()
        if found["user_api"] == "blas" and "architecture" in found
    }
    return (
        f"Measured on {cores()} cores ({_processor()}) with Python {platform.python_version()}, "
        f"{versions}{''.join(', ' + one for one in sorted(blas))}; {n_frames:,} frames."
    )


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or platform.machine())


def _cells(row: Row) -> tuple[str, ...]:
    ratio = figures(row.ratio)
    goal = "" if row.goal is None else f"{row.goal:,.0f}"
    return (
        f"{row.n_sensors:,}",
        row.stage,
        row.given,
        seconds(row.cpu),
        seconds(row.clock_of_all_cores),
        _megabytes(row.memory),
        f"{row.against} ({row.how})" if row.how else row.against,
        ("≈ " if row.estimated else "") + seconds(row.its_cpu) if row.against else "",
        _megabytes(row.its_memory),
        f"**{ratio}**" if row.missed else ratio,
        f"{goal} (missed)" if row.missed else goal,
        row.same if isinstance(row.same, str) else ("yes" if row.same else "**NO**"),
    )


def seconds(value: float) -> str:
    """Write seconds with three figures."""
    return figures(value) if value >= 0.001 or math.isnan(value) else f"{value:.1g}"


def figures(value: float) -> str:
    """Write a number with three figures, and nothing for NaN."""
    if math.isnan(value):
        return ""
    places = max(0, 2 - math.floor(math.log10(value))) if value > 0 else 0
    return f"{value:,.{places}f}"


def _megabytes(value: float) -> str:
    return "" if math.isnan(value) else f"{value:,.0f}"


def _table(header: Sequence[str], lines: Iterable[Sequence[str]]) -> Iterator[str]:
    """Write a table in Markdown, words to the left and numbers to the right."""
    yield _line(header)
    yield _line([":---" if name in _WORDS else "---:" for name in header])
    yield from map(_line, lines)


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _growth(rows: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    """Tell how times grow between the two largest sizes, ours and theirs."""
    for (stage, given, against), group in grouped(rows).items():
        known = [row for row in group if row.cpu > 0]
        if len(known) < 2:
            continue
        before, last = known[-2:]
        sizes = [before.n_sensors, last.n_sensors]
        theirs = growth_exponent(sizes, [before.its_cpu, last.its_cpu]) if against else math.nan
        yield (
            stage,
            given,
            f"{before.n_sensors:,}",
            f"{last.n_sensors:,}",
            f"{growth_exponent(sizes, [before.cpu, last.cpu]):.1f}",
            against,
            "" if math.isnan(theirs) else f"{theirs:.1f}",
        )


def grouped(rows: Iterable[Row]) -> dict[tuple[str, str, str], list[Row]]:
    """Put rows of all sizes together, by stage, input and rival."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.stage, row.given, row.against), []).append(row)
    return groups


def growth_exponent(sizes: Sequence[float], times: Sequence[float]) -> float:
    """Give the exponent of the power of N that fits times best."""
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])


def write_csv(rows: Iterable[Row], path: Path) -> None:
    """Write every number unrounded."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow([*(field.name for field in fields(Row)), "ratio"])
        table.writerows((*astuple(row), row.ratio) for row in rows)
