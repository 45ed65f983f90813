"""Figure of the coverage of a skin over the length of a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from anisomap.drawing.figures.backend import (
    MARKERS,
    PALETTE,
    Axes,
    drawing_style,
    new_figure,
    panel_axes,
    write_title,
)
from anisomap.drawing.figures.charts import plot_runs

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def coverage_figure(
    title: str,
    n_frames: NDArray[np.intp],
    rate_hz: float,
    shares: dict[str, NDArray[np.float64]],
) -> Figure:
    """Draw shares over the length of a recording: every seed, and the mean over seeds.

    Parameters
    ----------
    title : str
    n_frames : ndarray of int, shape (L,)
        Lengths.
    rate_hz : float
        Frames per second.
    shares : dict of str to ndarray of shape (L, S)
        Values from 0 to 1 for S seeds, by label; NaN where there is none.

    Returns
    -------
    matplotlib.figure.Figure
        Save it with `anisomap.drawing.figures.save_figure`.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    with drawing_style():
        figure = new_figure(7.2, 4.6)
        figure.set_layout_engine("constrained", rect=(0, 0, 1, 0.91))
        plot_coverage(n_frames, rate_hz, shares, ax=figure.add_subplot())
        write_title(figure, title)
        return figure


def plot_coverage(
    n_frames: NDArray[np.intp],
    rate_hz: float,
    shares: dict[str, NDArray[np.float64]],
    *,
    ax: Axes | None = None,
) -> Axes:
    """Plot the panel of `coverage_figure`.

    Parameters
    ----------
    n_frames, rate_hz, shares
        As for `coverage_figure`.
    ax : matplotlib Axes, optional
        Axes to draw into. A new figure is created by default.

    Returns
    -------
    matplotlib Axes
        `ax`, or the new axes; their figure is ``axes.figure``.
    """
    axes = panel_axes(ax)
    for (name, values), colour, marker in zip(shares.items(), PALETTE, MARKERS, strict=False):
        plot_runs(axes, n_frames, values, colour=colour, marker=marker, label=name)
    axes.set_xscale("log")
    axes.set_xticks(n_frames, [f"{n}\n{n / rate_hz:.3g} s" for n in n_frames])
    axes.minorticks_off()
    axes.set_ylim(-0.03, 1.03)
    axes.grid()
    axes.set_xlabel("length of the recording (frames, seconds)")
    axes.set_ylabel("share; Mantel r")
    axes.legend(loc="lower right", frameon=False)
    return axes
