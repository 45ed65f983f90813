"""Times as tables in Markdown and CSV, with their growth, and as a figure."""

from __future__ import annotations

import itertools
import math
import platform
from collections.abc import Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from threadpoolctl import threadpool_info

from benchmarks.harness import COLOURS, keyed_table
from benchmarks.speed.measuring import Row, n_cores

_TEXT_COLUMNS = ("N", "stage", "input", "reference", "same result")


def markdown(rows: Sequence[Row], n_frames: int) -> str:
    """Return the machine, the times and their growth as Markdown."""
    lines = [machine(f"{n_frames:,} frames"), "", *keyed_table(map(_cells, rows), _TEXT_COLUMNS)]
    if growth := [*keyed_table(_growth(rows), _TEXT_COLUMNS)]:
        lines += ["", "Growth of CPU times: exponent of N", "", *growth]
    return "\n".join(lines) + "\n"


def machine(of_what: str) -> str:
    """Describe the machine, the versions of libraries and the inputs in one sentence."""
    libraries = ("numpy", "scipy", "scikit-learn", "numba")
    versions = ", ".join(f"{name} {version(name)}" for name in libraries)
    blas = {
        f"{found['internal_api']} {found['version']} for {found['architecture']}"
        for found in threadpool_info()
        if found["user_api"] == "blas" and "architecture" in found
    }
    return (
        f"Measured on {n_cores()} cores ({_processor()}) with Python {platform.python_version()}, "
        f"{versions}{''.join(', ' + one for one in sorted(blas))}; {of_what}."
    )


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or platform.machine())


def _cells(row: Row) -> dict[str, str]:
    ratio = significant(row.ratio)
    goal = "" if row.goal is None else f"{row.goal:,.0f}"
    return {
        "N": f"{row.n_sensors:,}",
        "stage": row.stage,
        "input": row.dataset,
        "CPU, 1 thread (s)": seconds(row.cpu),
        "clock, all cores (s)": seconds(row.clock_all_cores),
        "memory (MB)": _megabytes(row.memory),
        "reference": f"{row.reference} ({row.details})" if row.details else row.reference,
        "its CPU (s)": ("≈ " if row.estimated else "") + seconds(row.reference_cpu),
        "its memory (MB)": _megabytes(row.reference_memory),
        "ratio": f"**{ratio}**" if row.missed else ratio,
        "goal": f"{goal} (missed)" if row.missed else goal,
        "same result": "yes" if row.same else "**NO**",
    }


def seconds(value: float) -> str:
    """Format seconds with three significant digits."""
    return significant(value) if value >= 0.001 or math.isnan(value) else f"{value:.1g}"


def significant(value: float) -> str:
    """Format a number with three significant digits, NaN as an empty text."""
    if math.isnan(value):
        return ""
    places = max(0, 2 - math.floor(math.log10(value))) if value > 0 else 0
    return f"{value:,.{places}f}"


def _megabytes(value: float) -> str:
    return "" if math.isnan(value) else f"{value:,.0f}"


def _growth(rows: Sequence[Row]) -> Iterator[dict[str, str]]:
    """Yield the growth of times between the two largest sizes, for both implementations."""
    for (stage, dataset, reference), group in grouped(rows).items():
        known = [row for row in group if row.cpu > 0]
        if len(known) < 2:
            continue
        before, last = known[-2:]
        sizes = [before.n_sensors, last.n_sensors]
        theirs = growth_exponent(sizes, [before.reference_cpu, last.reference_cpu])
        yield {
            "stage": stage,
            "input": dataset,
            "from N": f"{before.n_sensors:,}",
            "to N": f"{last.n_sensors:,}",
            "anisomap": f"{growth_exponent(sizes, [before.cpu, last.cpu]):.1f}",
            "reference": reference,
            "its exponent": f"{theirs:.1f}",
        }


def grouped(rows: Iterable[Row]) -> dict[tuple[str, str, str], list[Row]]:
    """Group rows of all sizes by stage, input and reference."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.stage, row.dataset, row.reference), []).append(row)
    return groups


def growth_exponent(sizes: Sequence[float], times: Sequence[float]) -> float:
    """Fit the exponent of a power law of times."""
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])


_MARKS = ("o", "s", "^", "D", "v", "P", "X")


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw one panel per family of stages: references dashed, hollow markers if estimated."""
    drawn = [row for row in rows if row.drawn]
    families = list(dict.fromkeys(row.family for row in drawn))
    figure = Figure(figsize=(14, 7 * -(-len(families) // 2)), layout="constrained")
    panels = figure.subplots(-(-len(families) // 2), min(2, len(families)), squeeze=False).flat
    for family, axes in zip(families, panels, strict=False):
        _draw_family(axes, [row for row in drawn if row.family == family])
        axes.set_title(family)
    for unused in panels:
        unused.set_axis_off()
    figure.suptitle(
        "CPU time on one thread: anisomap solid, references dashed, hollow where estimated"
    )
    figure.savefig(path, dpi=110, metadata={"Software": None})


def _draw_family(axes: Axes, rows: Sequence[Row]) -> None:
    looks = itertools.cycle(zip(COLOURS, _MARKS, strict=True))
    for ((stage, dataset, reference), group), (colour, mark) in zip(
        grouped(rows).items(), looks, strict=False
    ):
        sizes = [row.n_sensors for row in group]
        label = f"{stage}: {dataset}  (dashed: {reference})"
        axes.plot(sizes, [row.cpu for row in group], "-", color=colour, marker=mark, label=label)
        axes.plot(sizes, [row.reference_cpu for row in group], "--", color=colour)
        for row in group:
            fill = "white" if row.estimated else colour
            axes.plot(row.n_sensors, row.reference_cpu, mark, color=colour, markerfacecolor=fill)
    sizes = sorted({row.n_sensors for row in rows})
    axes.set(xscale="log", yscale="log", xlabel="sensors", ylabel="CPU time (s)")
    axes.set_xticks(sizes, [f"{size:,}" for size in sizes])
    axes.tick_params(axis="x", which="minor", bottom=False, labelbottom=False)
    axes.grid(visible=True, alpha=0.3)
    axes.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.1), frameon=False)
