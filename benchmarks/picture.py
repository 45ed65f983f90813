"""Figure of CPU time against the number of sensors, on logarithmic axes."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.comparison import Row
from benchmarks.tables import grouped

# Colours of Okabe & Ito, distinct for all types of colour vision; markers differ as well.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
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
    looks = itertools.cycle(zip(_COLOURS, _MARKS, strict=True))
    for ((stage, dataset, reference), group), (colour, mark) in zip(
        grouped(rows).items(), looks, strict=False
    ):
        sizes = [row.n_sensors for row in group]
        label = f"{stage}: {dataset}" + (f"  (dashed: {reference})" if reference else "")
        axes.plot(sizes, [row.cpu for row in group], "-", color=colour, marker=mark, label=label)
        if reference:
            axes.plot(sizes, [row.reference_cpu for row in group], "--", color=colour)
            for row in group:
                fill = "white" if row.estimated else colour
                axes.plot(
                    row.n_sensors, row.reference_cpu, mark, color=colour, markerfacecolor=fill
                )
    sizes = sorted({row.n_sensors for row in rows})
    axes.set(xscale="log", yscale="log", xlabel="sensors", ylabel="CPU time (s)")
    axes.set_xticks(sizes, [f"{size:,}" for size in sizes])
    axes.tick_params(axis="x", which="minor", bottom=False, labelbottom=False)
    axes.grid(visible=True, alpha=0.3)
    axes.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.1), frameon=False)
