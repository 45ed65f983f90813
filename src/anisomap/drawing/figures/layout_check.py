"""Figure of the check of a layout: arrows from stated to proposed places."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from anisomap.drawing.figures.backend import (
    MARKERS,
    PALETTE,
    Axes,
)
from anisomap.drawing.figures.displacements import Group, legend_figure, plot_displacements
from anisomap.drawing.view import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from anisomap.layout import LayoutCheck

_MAX_LABELS = 12

# Kinds that are drawn alike: label, colour, marker, statuses of `LayoutCheck`.
_GROUPS = (
    ("as stated", "#a9b0b7", MARKERS[0], ("ok",)),
    ("not tested", "#dfe2e5", MARKERS[0], ("not tested",)),
    ("turned, mirrored", PALETTE[0], MARKERS[1], ("turned", "mirrored")),
    ("exchanged, moved", PALETTE[2], MARKERS[2], ("exchanged", "moved")),
    ("swapped, shifted", PALETTE[1], MARKERS[3], ("swapped", "cycle", "shifted")),
    ("dead, doubled", PALETTE[3], "X", ("dead", "doubled")),
)


def layout_figure(check: LayoutCheck, title: str = "Check of a layout") -> Figure:
    """Draw a layout, with arrows from the stated places to those that the readings propose.

    Parameters
    ----------
    check : LayoutCheck
        See `anisomap.check_layout`.
    title : str

    Returns
    -------
    matplotlib.figure.Figure
        Save it with `save_figure`.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    return legend_figure(
        lambda axes: plot_layout(check, ax=axes),
        dimensions=check.layout.dimensions,
        title=printable(title, 80),
        note="Arrows lead from the stated position of a sensor to that indicated by its readings.",
        n_columns=3,
    )


def plot_layout(check: LayoutCheck, *, ax: Axes | None = None) -> Axes:
    """Plot the panel of `layout_figure`.

    Parameters
    ----------
    check : LayoutCheck
    ax : matplotlib Axes, optional
        Axes to draw into, with ``projection="3d"`` for a layout in 3D. A new figure is created by
        default.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    InputError
        If `ax` has another number of dimensions.
    MissingExtraError
        If matplotlib is not installed.
    """
    status = np.array(check.status)
    placed = check.layout.placed
    groups = []
    for label, colour, marker, kinds in _GROUPS:
        chosen = np.flatnonzero(np.isin(status, kinds) & placed)
        if chosen.size:
            groups.append(Group(f"{label} ({chosen.size})", chosen, colour, marker))
    start, end = check.layout.positions, check.corrected.positions
    changed = (start != end).any(axis=1) & placed
    labels = {
        int(finding.sensors[0]): check.layout.names[finding.sensors[0]]
        for finding in check.findings[:_MAX_LABELS]
    }
    arrows = np.where(changed[:, None], end, np.nan)
    return plot_displacements(start, arrows, groups, labels, units=check.layout.units, ax=ax)
