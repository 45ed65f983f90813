"""How charts that compare methods are drawn."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullLocator

from anisomap.drawing.figures._layout import drawing_style
from anisomap.drawing.figures._panels import FAINT, INK, Axes
from anisomap.drawing.figures.charts import (
    METHOD_LOOKS,
    CurvePanel,
    MethodLook,
    NullBox,
    ScoreGroup,
)

_GRID = "#d5d9dd"
_WIDTH = 12.0
_GAP = 1.0  # methods' widths between groups
_SPREAD = 0.22


def scores_figure(title: str, rows: Sequence[Sequence[ScoreGroup]]) -> Figure:
    """See `anisomap.drawing.figures.charts.scores_figure`."""
    with drawing_style():
        figure = Figure(figsize=(_WIDTH, 0.9 + 3.6 * len(rows)), facecolor="white")
        figure.set_layout_engine("constrained", rect=(0, 0, 1, 1 - 0.75 / figure.get_figheight()))
        for i, groups in enumerate(rows):
            _draw_groups(figure.add_subplot(len(rows), 1, i + 1), groups)
        _head(figure, title, _methods(group.scores for groups in rows for group in groups))
        return figure


def curves_figure(
    title: str,
    panels: Sequence[CurvePanel],
    *,
    x_label: str,
    y_label: str,
    logarithmic: bool,
    columns: int,
) -> Figure:
    """See `anisomap.drawing.figures.charts.curves_figure`."""
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    with drawing_style():
        width = max(4.2 * columns, 8.5)
        figure = Figure(figsize=(width, 0.9 + 3.0 * rows), facecolor="white")
        figure.set_layout_engine("constrained", rect=(0, 0, 1, 1 - 0.75 / figure.get_figheight()))
        first: Axes = None
        for i, panel in enumerate(panels):
            axes = figure.add_subplot(rows, columns, i + 1, sharey=first)
            first = first or axes
            _draw_curves(axes, panel, logarithmic)
            axes.set_xlabel(x_label)
            if i % columns == 0:
                axes.set_ylabel(y_label)
        _head(figure, title, _methods(panel.curves for panel in panels))
        return figure


def _draw_groups(axes: Axes, groups: Sequence[ScoreGroup]) -> None:
    start, middles = 0.0, []
    for group in groups:
        for i, (method, scores) in enumerate(group.scores.items()):
            look, x = METHOD_LOOKS[method], start + i
            if method in group.nulls:
                _draw_null(axes, x, group.nulls[method], look)
            shift = np.linspace(-_SPREAD, _SPREAD, len(scores)) if len(scores) > 1 else [0.0]
            axes.plot(
                x + np.asarray(shift), scores, look.marker, color=look.colour, markersize=5,
                alpha=0.75, markeredgewidth=0,
            )  # fmt: skip
            if len(scores) > 1:
                axes.plot([x - 0.36, x + 0.36], [np.mean(scores)] * 2, color=INK, linewidth=1.2)
        middles.append(start + (len(group.scores) - 1) / 2)
        start += len(group.scores) + _GAP
    axes.set_xticks(middles, [group.label for group in groups], fontsize=9.5, color=INK)
    axes.tick_params(axis="x", length=0)
    axes.set(xlim=(-0.9, start - _GAP - 0.1), ylim=(-0.24, 1.04), ylabel="Mantel r")
    axes.grid(axis="y")
    axes.set_axisbelow(True)
    axes.axhline(0, color=FAINT, linewidth=0.8)


def _draw_null(axes: Axes, x: float, box: NullBox, look: MethodLook) -> None:
    line = {"color": look.colour, "linewidth": 1.0}
    axes.bxp(
        [
            {
                "med": box.median,
                "q1": box.quartile_1,
                "q3": box.quartile_3,
                "whislo": box.whisker_low,
                "whishi": box.whisker_high,
                "fliers": list(box.outliers),
            }
        ],
        positions=[x],
        widths=0.55,
        boxprops=line,
        whiskerprops=line,
        capprops=line,
        medianprops={"color": INK, "linewidth": 1.0},
        flierprops={"marker": "+", "markeredgecolor": look.colour, "markersize": 4},
        manage_ticks=False,
    )


def _draw_curves(axes: Axes, panel: CurvePanel, logarithmic: bool) -> None:
    if panel.default is not None and panel.x.min() <= panel.default <= panel.x.max():
        axes.axvline(panel.default, color=FAINT, linewidth=0.9, linestyle=":")
    for method, values in panel.curves.items():
        look = METHOD_LOOKS[method]
        axes.plot(panel.x, values, ".", color=look.colour, alpha=0.35, markersize=4)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # no run may have a map here
            mean = np.nanmean(values, axis=1)
        axes.plot(panel.x, mean, color=look.colour, marker=look.marker, markersize=4.5)
    if logarithmic:
        axes.set_xscale("log")
    axes.set_xticks(panel.x, [f"{value:g}" for value in panel.x])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_title(panel.title, fontsize=10, color=INK, parse_math=False)
    axes.grid()
    axes.set_axisbelow(True)


def _methods(mappings: Iterable[Iterable[str]]) -> list[str]:
    used = {method for mapping in mappings for method in mapping}
    return [method for method in METHOD_LOOKS if method in used]


def _head(figure: Figure, title: str, methods: Sequence[str]) -> None:
    height = figure.get_figheight()
    figure.text(
        0.012, 1 - 0.1 / height, title, va="top", fontsize=14, fontweight="bold", color=INK,
        parse_math=False,
    )  # fmt: skip
    looks = [METHOD_LOOKS[method] for method in methods]
    handles = [
        Line2D([], [], ls="none", marker=look.marker, color=look.colour, label=look.label)
        for look in looks
    ]
    figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(0.005, 1 - 0.38 / height),
        ncols=len(handles), frameon=False, fontsize=9.5,
    )  # fmt: skip
