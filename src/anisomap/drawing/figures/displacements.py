"""Figures of sensors with arrows from one position to another.

Figure of the check of a layout: arrows from stated to proposed places.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from anisomap.drawing.figures.backend import (
    FAINT,
    INK,
    MARKERS,
    PALETTE,
    Axes,
    drawing_style,
    new_figure,
    panel_axes,
    write_notes,
    write_title,
)
from anisomap.drawing.figures.panels import set_up_axes, write_label
from anisomap.drawing.view import View, best_view, box_around, printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from anisomap.evaluation import Difference
    from anisomap.layout import LayoutCheck
    from anisomap.placement import Anchors, Placement
    from anisomap.scene import Mesh

_MAX_LABELS, _MAX_LABEL = 12, 14
_WIDTH, _HEIGHT = 8.0, 7.2  # inches


@dataclass(frozen=True, eq=False)
class Group:
    """Sensors of one kind, drawn alike.

    label: For the legend.
    colour, marker: Of matplotlib.
    """

    label: str
    sensors: NDArray[np.intp]
    colour: str
    marker: str


def difference_figure(
    difference: Difference, title: str = "Differences between two maps"
) -> Figure:
    """Draw two maps in one frame, with an arrow for each sensor that moved."""
    return legend_figure(
        lambda axes: plot_difference(difference, ax=axes),
        dimensions=difference.before.shape[1],
        title=printable(title, 80),
        note="Arrows lead from the first map to the second, which is aligned with the first.",
    )


def plot_difference(difference: Difference, *, ax: Axes | None = None) -> Axes:
    """Plot the panel of `difference_figure`."""
    still = difference.compared & ~difference.moved & ~difference.lost & ~difference.appeared
    groups = [
        Group(f"{label} ({np.count_nonzero(mask)})", np.flatnonzero(mask), colour, marker)
        for label, mask, colour, marker in (
            ("unchanged", still, "#a9b0b7", MARKERS[0]),
            ("moved", difference.moved & ~difference.lost, PALETTE[0], MARKERS[1]),
            ("lost", difference.lost, PALETTE[3], "X"),
            ("appeared", difference.appeared, PALETTE[2], MARKERS[2]),
        )
        if mask.any()
    ]
    before = np.where(np.isfinite(difference.before), difference.before, difference.after)
    worst = np.flatnonzero(difference.moved)[
        np.argsort(-difference.distance[difference.moved], kind="stable")[:_MAX_LABELS]
    ]
    labels = {int(i): difference.names[i] for i in worst}
    arrows = np.where(difference.moved[:, None], difference.after, np.nan)
    return plot_displacements(before, arrows, groups, labels, units=difference.units, ax=ax)


def placement_figure(
    placement: Placement, anchors: Anchors | None = None, mesh: Mesh | None = None
) -> Figure:
    """Draw a placed map, and where its anchors are."""
    placed = placement.map
    note = "Positions in metres."
    if np.isfinite(placed.errors).any():
        error = float(np.nanmedian(placed.errors))
        note = f"{note} 90 % of the sensors are within their error, {error:.2g} m in the median."
    return legend_figure(
        lambda axes: plot_placement(placement, anchors, mesh, ax=axes),
        dimensions=placed.dimensions,
        title=printable(f"Placed in {placed.frame}: {placement.methods[0]}", 70),
        note=note,
        height=0.86,
    )


def plot_placement(
    placement: Placement,
    anchors: Anchors | None = None,
    mesh: Mesh | None = None,
    *,
    ax: Axes | None = None,
) -> Axes:
    """Plot the panel of `placement_figure`."""
    placed = placement.map
    names = () if anchors is None else anchors.names
    known = np.array([name in set(names) for name in placed.names], dtype=bool)
    groups = [
        Group(f"{label} ({np.count_nonzero(mask)})", np.flatnonzero(mask), colour, marker)
        for label, mask, colour, marker in (
            ("placed", placed.placed & ~known, "#8a929a", MARKERS[0]),
            ("anchors", placed.placed & known, PALETTE[0], MARKERS[1]),
        )
        if mask.any()
    ]
    chosen = np.flatnonzero(placed.placed & known)[:_MAX_LABELS]
    labels = {int(i): placed.names[i] for i in chosen}
    nowhere = np.full_like(placed.positions, np.nan)
    axes = plot_displacements(placed.positions, nowhere, groups, labels, units=placed.units, ax=ax)
    if mesh is not None and axes.name == "3d":
        axes.plot_trisurf(
            *mesh.vertices.T,
            triangles=mesh.faces,
            color="#c9cdd2",
            alpha=0.25,
            linewidth=0,
            zorder=0,
        )
    return axes


def legend_figure(
    plot: Callable[[Axes], object],
    *,
    dimensions: int,
    title: str,
    note: str,
    n_columns: int = 4,
    height: float = 0.87,
) -> Figure:
    """Draw one panel with its legend above it and a note below it."""
    with drawing_style():
        figure = new_figure(_WIDTH, _HEIGHT)
        figure.set_layout_engine("constrained", rect=(0, 0.05, 1, height))
        plot(figure.add_subplot(projection="3d" if dimensions >= 3 else None))
        figure.legend(
            loc="upper right", ncols=n_columns, frameon=False, bbox_to_anchor=(0.99, 0.96)
        )
        write_title(figure, title)
        write_notes(figure, [note])
        return figure


def plot_displacements(
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    groups: list[Group],
    labels: dict[int, str],
    *,
    units: str = "",
    ax: Axes | None = None,
) -> Axes:
    """Plot positions of sensors by group, and arrows to other positions. start, end (N, k)."""
    start, end = start[:, :3], end[:, :3]
    axes = panel_axes(ax, start.shape[1])
    drawn = np.unique(np.concatenate([group.sensors for group in groups]))
    shown = [points[np.isfinite(points).all(axis=1)] for points in (start[drawn], end[drawn])]
    shown = [points for points in shown if len(points)]
    view: View = best_view(*shown) if start.shape[1] == 3 else (0.0, 0.0)
    limits = box_around(*shown)
    set_up_axes(axes, limits, view, units)
    size = 40.0 * float(np.clip(np.sqrt(60 / len(drawn)), 0.1, 1))
    for group in groups:
        places = start[group.sensors]
        axes.scatter(
            *places.T,
            s=size,
            color=group.colour,
            marker=group.marker,
            edgecolors="white",
            linewidths=0.4,
            label=group.label,
        )
        arrows = end[group.sensors] - places
        known = np.isfinite(arrows).all(axis=1)
        _draw_arrows(axes, places[known], arrows[known], group.colour)
    centre = limits.mean(axis=1)
    for i, name in labels.items():
        right_half = bool(start[i, 0] > centre[0])
        text = printable(name, _MAX_LABEL)
        write_label(axes, start[i], f"{text} " if right_half else f" {text}", right_half)
    return axes


def _draw_arrows(
    axes: Axes, places: NDArray[np.float64], arrows: NDArray[np.float64], colour: str
) -> None:
    if not len(places):
        return
    if axes.name == "3d":
        axes.quiver(*places.T, *arrows.T, color=colour, linewidth=1.0, arrow_length_ratio=0.15)
        return
    axes.quiver(
        *places.T, *arrows.T, color=colour, angles="xy", scale_units="xy", scale=1, width=0.004
    )
    axes.plot(*(places + arrows).T, ".", color=FAINT, markersize=3, markeredgecolor=INK)


_MAX_LABELS_LAYOUT_CHECK = 12

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
        for finding in check.findings[:_MAX_LABELS_LAYOUT_CHECK]
    }
    arrows = np.where(changed[:, None], end, np.nan)
    return plot_displacements(start, arrows, groups, labels, units=check.layout.units, ax=ax)
