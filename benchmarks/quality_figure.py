"""Figure of the errors of methods against the length of simulated recordings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from anisomap.comparison import RIVALS
from benchmarks.quality_tables import FRAMES, SCENARIOS, Result

# Okabe & Ito (2008), distinct for all kinds of colour vision.
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#000000")


def draw(results: Sequence[Result], path: Path) -> None:
    """Draw the error of every method against the length of the recording.

    Lines are medians over the seeds, dashed for stock methods; bands reach from the best to the
    worst seed of the other methods.
    """
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    panels = figure.subplots(2, 3, sharex=True)
    scored = [r for r in results if not math.isnan(r.mantel_r)]
    looks = dict(zip(dict.fromkeys(r.method for r in scored), cycle(_COLOURS), strict=False))
    for (body, scenario), axes in zip(SCENARIOS, panels.flat, strict=True):
        name = f"{body}, {scenario}"
        for method, colour in looks.items():
            chosen = [r for r in scored if (r.recording, r.method) == (name, method)]
            draw_method(axes, chosen, method, colour)
        axes.set_title(name, fontsize=10)
        axes.set_xticks(FRAMES, [f"{n:,}" for n in FRAMES])
        axes.minorticks_off()
        axes.grid(visible=True, alpha=0.3)
    for axes in panels[-1]:
        axes.set_xlabel("frames")
    for axes in panels[:, 0]:
        axes.set_ylabel("1 - Mantel r")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.savefig(path, dpi=150)


def draw_method(axes: Axes, results: Sequence[Result], method: str, colour: str) -> None:
    """Draw the errors of one method in one scenario."""
    lengths = sorted({r.n_frames for r in results})
    if not lengths:
        return
    errors = np.array(
        [
            np.quantile([1 - r.mantel_r for r in results if r.n_frames == n], (0, 0.5, 1))
            for n in lengths
        ]
    )
    style = "s--" if method in RIVALS else "o-"
    axes.loglog(lengths, errors[:, 1], style, color=colour, label=method, linewidth=1.5, ms=4)
    if method not in RIVALS:
        axes.fill_between(lengths, errors[:, 0], errors[:, 2], color=colour, alpha=0.15)
