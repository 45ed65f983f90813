"""Figures of sensors by kind, with arrows from one position to another."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from anisomap.drawing.figures.backend import (
    FAINT,
    INK,
    MARKERS,
    PALETTE,
    Axes,
    panel,
    panel_figure,
)
from anisomap.drawing.figures.panels import set_up_axes, write_label
from anisomap.drawing.view import best_view, box_around, printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from anisomap.evaluation import Difference
    from anisomap.layout import LayoutCheck
    from anisomap.placement import Anchors, Placement
    from anisomap.scene import Mesh

_MAX_LABELS, _MAX_LABEL = 12, 14

_LOOKS = {
    "unchanged": ("#a9b0b7", MARKERS[0]),
    "moved": (PALETTE[0], MARKERS[1]),
    "lost": (PALETTE[3], "X"),
    "appeared": (PALETTE[2], MARKERS[2]),
    "placed": ("#8a929a", MARKERS[0]),
    "anchors": (PALETTE[0], MARKERS[1]),
    "as stated": ("#a9b0b7", MARKERS[0]),
    "not tested": ("#dfe2e5", MARKERS[0]),
    "turned, mirrored": (PALETTE[0], MARKERS[1]),
    "exchanged, moved": (PALETTE[2], MARKERS[2]),
    "swapped, shifted": (PALETTE[1], MARKERS[3]),
    "dead, doubled": (PALETTE[3], "X"),
}
"""Colour and marker of each kind of sensor, by its name in the legend."""

_STATUSES = {
    "as stated": ("ok",),
    "not tested": ("not tested",),
    "turned, mirrored": ("turned", "mirrored"),
    "exchanged, moved": ("exchanged", "moved"),
    "swapped, shifted": ("swapped", "cycle", "shifted"),
    "dead, doubled": ("dead", "doubled"),
}
"""Statuses of `LayoutCheck` that are drawn alike."""


def difference_figure(
    difference: Difference, title: str = "Differences between two maps"
) -> Figure:
    """Draw two maps in one frame, with an arrow for each sensor that moved."""
    return _figure(
        plot_difference,
        difference,
        title=printable(title, 80),
        note="Arrows lead from the first map to the second, which is aligned with the first.",
    )


@panel(lambda difference: min(3, difference.before.shape[1]))
def plot_difference(difference: Difference, *, ax: Axes = None) -> None:
    """Plot the panel of `difference_figure`."""
    moved, lost, appeared = difference.moved, difference.lost, difference.appeared
    kinds = {
        "unchanged": difference.compared & ~moved & ~lost & ~appeared,
        "moved": moved & ~lost,
        "lost": lost,
        "appeared": appeared,
    }
    before = np.where(np.isfinite(difference.before), difference.before, difference.after)
    worst = np.flatnonzero(moved)[np.argsort(-difference.distance[moved], kind="stable")]
    labels = {int(i): difference.names[i] for i in worst[:_MAX_LABELS]}
    arrows = np.where(moved[:, None], difference.after, np.nan)
    _draw_displacements(ax, before, arrows, kinds, labels, units=difference.units)


def placement_figure(
    placement: Placement, anchors: Anchors | None = None, mesh: Mesh | None = None
) -> Figure:
    """Draw a placed map, and where its anchors are."""
    placed = placement.map
    note = "Positions in metres."
    if np.isfinite(placed.errors).any():
        error = float(np.nanmedian(placed.errors))
        note = f"{note} 90 % of the sensors are within their error, {error:.2g} m in the median."
    return _figure(
        plot_placement,
        placement,
        anchors,
        mesh,
        title=printable(f"Placed in {placed.frame}: {placement.methods[0]}", 70),
        note=note,
        height=0.86,
    )


@panel(lambda placement: min(3, placement.map.dimensions))
def plot_placement(
    placement: Placement,
    anchors: Anchors | None = None,
    mesh: Mesh | None = None,
    *,
    ax: Axes = None,
) -> None:
    """Plot the panel of `placement_figure`."""
    placed = placement.map
    names = set(() if anchors is None else anchors.names)
    known = np.array([name in names for name in placed.names], dtype=bool)
    kinds = {"placed": placed.placed & ~known, "anchors": placed.placed & known}
    chosen = np.flatnonzero(placed.placed & known)[:_MAX_LABELS]
    labels = {int(i): placed.names[i] for i in chosen}
    nowhere = np.full_like(placed.positions, np.nan)
    _draw_displacements(ax, placed.positions, nowhere, kinds, labels, units=placed.units)
    if mesh is not None and ax.name == "3d":
        ax.plot_trisurf(
            *mesh.vertices.T,
            triangles=mesh.faces,
            color="#c9cdd2",
            alpha=0.25,
            linewidth=0,
            zorder=0,
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
    return _figure(
        plot_layout,
        check,
        title=printable(title, 80),
        note="Arrows lead from the stated position of a sensor to that indicated by its readings.",
        columns=3,
    )


@panel(lambda check: min(3, check.layout.dimensions))
def plot_layout(check: LayoutCheck, *, ax: Axes = None) -> None:
    """Plot the panel of `layout_figure`.

    Parameters
    ----------
    check : LayoutCheck
    """
    layout, status = check.layout, np.array(check.status)
    kinds = {kind: np.isin(status, every) & layout.placed for kind, every in _STATUSES.items()}
    start, end = layout.positions, check.corrected.positions
    changed = (start != end).any(axis=1) & layout.placed
    first = [int(finding.sensors[0]) for finding in check.findings[:_MAX_LABELS]]
    labels = {i: layout.names[i] for i in first}
    arrows = np.where(changed[:, None], end, np.nan)
    _draw_displacements(ax, start, arrows, kinds, labels, units=layout.units)


def _figure(
    plot: Callable[..., Axes],
    *data: object,
    title: str,
    note: str,
    columns: int = 4,
    height: float = 0.87,
) -> Figure:
    return panel_figure(plot, *data, title=title, note=note, columns=columns, drawn=(0.05, height))


def _draw_displacements(
    axes: Axes,
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    kinds: Mapping[str, NDArray[np.bool_]],
    labels: Mapping[int, str],
    *,
    units: str,
) -> None:
    """Draw sensors by kind, and arrows to other positions. start, end (N, k), kinds (N,)."""
    start, end = start[:, :3], end[:, :3]
    drawn = np.any(list(kinds.values()), axis=0)
    shown = [points[np.isfinite(points).all(axis=1)] for points in (start[drawn], end[drawn])]
    shown = [points for points in shown if len(points)]
    limits = box_around(*shown)
    set_up_axes(axes, limits, best_view(*shown) if start.shape[1] == 3 else (0.0, 0.0), units)
    size = 40.0 * float(np.clip(np.sqrt(60 / drawn.sum()), 0.1, 1))
    for kind, chosen in kinds.items():
        if not chosen.any():
            continue
        colour, marker = _LOOKS[kind]
        places = start[chosen]
        axes.scatter(
            *places.T,
            s=size,
            color=colour,
            marker=marker,
            edgecolors="white",
            linewidths=0.4,
            label=f"{kind} ({chosen.sum()})",
        )
        arrows = end[chosen] - places
        known = np.isfinite(arrows).all(axis=1)
        _draw_arrows(axes, places[known], arrows[known], colour)
    for i, name in labels.items():
        right_half = bool(start[i, 0] > limits[0].mean())
        write_label(axes, start[i], printable(name, _MAX_LABEL), right_half)


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
