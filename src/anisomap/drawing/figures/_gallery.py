"""How several configurations are drawn side by side."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from anisomap.drawing.figures._layout import drawing_style
from anisomap.drawing.figures._panels import FAINT, INK, Axes, Look, draw_body
from anisomap.drawing.figures.gallery import Panel
from anisomap.drawing.view import box_around

# Inches.
_HEAD, _LINE, _BELOW = 0.45, 0.17, 0.35
_CHARACTERS_AN_INCH = 13.5
_SHORT = 0.6  # of the longest axis


def gallery_figure(
    title: str, panels: Sequence[Panel], columns: int, note: str, size: float
) -> Figure:
    """See `anisomap.drawing.figures.gallery.gallery_figure`."""
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    width = size * columns + 0.7
    lines = textwrap.wrap(note, int(width * _CHARACTERS_AN_INCH)) if note else []
    foot = _LINE * len(lines) + 0.15
    height = _HEAD + rows * size + foot + 0.2
    with drawing_style():
        figure = Figure(figsize=(width, height), facecolor="white")
        cells = figure.add_gridspec(
            rows,
            columns,
            left=0.7 / width,
            right=1 - 0.5 / width,
            top=1 - (_HEAD + _BELOW) / height,
            bottom=(foot + _BELOW + 0.2) / height,
            wspace=0.22,
            hspace=0.34,
        )
        for i, panel in enumerate(panels):
            row, column = divmod(i, columns)
            space = {"projection": "3d", "proj_type": "ortho", "computed_zorder": False}
            flat = panel.points.shape[1] == 2
            _draw(figure.add_subplot(cells[row, column], **({} if flat else space)), panel)
        figure.text(
            0.2 / width, 1 - 0.12 / height, title, va="top", fontsize=14, fontweight="bold",
            color=INK, parse_math=False,
        )  # fmt: skip
        figure.text(
            0.2 / width, 0.1 / height, "\n".join(lines), va="bottom", fontsize=8.5, color=FAINT,
            linespacing=1.35, parse_math=False,
        )  # fmt: skip
        return figure


def _draw(axes: Axes, panel: Panel) -> None:
    look = Look(
        colours=panel.colours,
        pairs=panel.pairs,
        ailing=np.zeros(len(panel.points), dtype=bool),
        unscored=panel.unscored,
        labels=dict(panel.labels),
    )
    limits = box_around(panel.points, panel.ghosts[:, : panel.points.shape[1]])
    draw_body(axes, panel.points, look, limits=limits, view=panel.view, units=panel.units)
    _thin_out(axes, np.ptp(limits, axis=1))
    if len(panel.ghosts):
        axes.scatter(*panel.ghosts.T, s=22, facecolors="none", edgecolors=FAINT, linewidths=0.7)
    axes.set_title(panel.title, fontsize=10, color=INK, parse_math=False)


def _thin_out(axes: Axes, extents: NDArray[np.float64]) -> None:
    """Leave short axes as many ticks as they have room for."""
    for name, extent in zip("xyz", extents, strict=False):
        axis = getattr(axes, f"{name}axis")
        axis.set_major_locator(MaxNLocator(3 if extent > _SHORT * extents.max() else 2))
        axis.label.set_size(8)
        axis.set_tick_params(labelsize=7)
