"""Pictures of the diagnostics of multidimensional scaling."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from anisomap.drawing.figures.backend import (
    FAINT,
    INK,
    PALETTE,
    Axes,
    panel_axes,
    set_title,
)
from anisomap.drawing.view import printable
from anisomap.evaluation import Shepard, ShiftTest

# Chosen by eye.
_MAX_DOTS = 3_000
_N_LABELS = 6


def plot_stress_per_point(
    shares: Sequence[float], names: Sequence[str] = (), *, ax: Axes | None = None
) -> Axes:
    """Plot the share of each sensor in the stress, the greatest first, and name the greatest.

    Parameters
    ----------
    shares : sequence of float
        From `anisomap.evaluation.stress_per_point`.
    names : sequence of str
        Names of the sensors; their indices by default.
    ax : matplotlib Axes, optional
        Axes to draw into. A new figure is created by default.

    Returns
    -------
    matplotlib Axes
    """
    axes = panel_axes(ax)
    values = 100 * np.asarray(shares, dtype=np.float64)
    order = np.argsort(-values, kind="stable")
    labels = names or [str(i) for i in range(len(values))]
    axes.plot(np.arange(1, len(order) + 1), values[order], ".", color=PALETTE[0], markersize=5)
    for rank, i in enumerate(order[:_N_LABELS].tolist(), start=1):
        axes.annotate(
            f" {printable(labels[i])}", (rank, values[i]), fontsize=7, color=INK, parse_math=False
        )
    axes.axhline(100 / len(values), color=FAINT, linewidth=0.8, linestyle=":")
    axes.set(xlabel="rank of the sensor", ylabel="share of the stress, %")
    axes.set_ylim(bottom=0)
    set_title(axes, "Stress per point (dotted: equal shares)")
    return axes


def plot_shepard(found: Shepard, *, units: str = "", ax: Axes | None = None) -> Axes:
    """Plot a Shepard diagram: distances against dissimilarities, and the monotone fit.

    Parameters
    ----------
    found : Shepard
        From `anisomap.evaluation.shepard`. Of more than 3000 pairs, evenly chosen ones are drawn.
    units : str
        Unit of the positions.
    ax : matplotlib Axes, optional
        Axes to draw into. A new figure is created by default.

    Returns
    -------
    matplotlib Axes
    """
    axes = panel_axes(ax)
    some = slice(None, None, -(-len(found.distances) // _MAX_DOTS))
    axes.plot(
        found.dissimilarities[some], found.distances[some], ".", color=PALETTE[0], alpha=0.4,
        markersize=3, markeredgewidth=0,
    )  # fmt: skip
    axes.step(
        found.dissimilarities, found.disparities, where="post", color=PALETTE[1], linewidth=1.4
    )
    axes.set(
        xlabel="dissimilarity",
        ylabel=f"distance on the map ({units})" if units else "distance on the map",
        xlim=(0, None),
        ylim=(0, None),
    )
    fit = f"monotone fit: R squared {found.nonmetric_fit:.3f}, linear {found.linear_fit:.3f}"
    set_title(axes, f"Shepard diagram ({fit})")
    return axes


def plot_shift_test(found: ShiftTest, *, label: str = "statistic", ax: Axes | None = None) -> Axes:
    """Plot the null distribution of a test by shifts, and the observed value.

    Parameters
    ----------
    found : ShiftTest
        From `anisomap.evaluation.shift_test`.
    label : str
        Name of the statistic, with its unit.
    ax : matplotlib Axes, optional
        Axes to draw into. A new figure is created by default.

    Returns
    -------
    matplotlib Axes
    """
    axes = panel_axes(ax)
    axes.hist(found.null, bins="auto", color=PALETTE[0], alpha=0.6, label="sensors shifted in time")
    axes.axvline(found.observed, color=PALETTE[1], linewidth=1.6, label="recording")
    axes.set(xlabel=label, ylabel="number of shifted recordings")
    axes.legend(frameon=False, fontsize=8)
    set_title(axes, f"Test by circular shifts: p = {found.p_value:.3g}")
    return axes
