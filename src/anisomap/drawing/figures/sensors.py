"""Figures of sensors by kind: moved, placed, checked and touched."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from anisomap.drawing.figures.backend import (
    FAINT,
    INK,
    MARKERS,
    PALETTE,
    Axes,
    Caption,
    panel,
    set_title,
)
from anisomap.drawing.figures.maps import (
    largest_component,
    set_up_axes,
    write_label,
    write_labels,
)
from anisomap.drawing.view import (
    Points,
    best_view,
    box_around,
    segments,
    shown_name,
    span_dimensions,
    with_axes,
)
from anisomap.evaluation import Score
from anisomap.health import TouchCoverage
from anisomap.health.sensors import MIN_CONTACTS
from anisomap.health.touch_coverage import ENOUGH_CONTACTS
from anisomap.placement.frames import METRES, in_millimetres, length_shown
from anisomap.sensor_map import SensorMap

if TYPE_CHECKING:
    from anisomap.base.scene import Mesh
    from anisomap.evaluation import Difference
    from anisomap.layout import LayoutCheck
    from anisomap.placement import Anchors, Placement

_MAX_LABELS = 12
_DOT_AREA = 40.0  # chosen by eye
_CLASSES = (
    "none",
    f"fewer than {MIN_CONTACTS}",
    f"{MIN_CONTACTS} to {ENOUGH_CONTACTS - 1}",
    f"{ENOUGH_CONTACTS} or more",
)
_SHADES = ("#ffffff", "#cde2f2", "#5aa5d6", "#00426b")  # from light to dark, also in greyscale
_LACKING, _LINES = "#c0392b", "#c4c9ce"

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


@panel(lambda difference, *_: span_dimensions(np.vstack([difference.before, difference.after])))
def plot_difference(
    difference: Difference, *, title: str = "Differences between two maps", ax: Axes = None
) -> Caption:
    """Plot two maps in one frame, with an arrow for each sensor that moved.

    Parameters
    ----------
    difference : Difference
        From `anisomap.evaluation.compare_maps`.
    title : str
    """
    moved, lost, appeared = difference.moved, difference.lost, difference.appeared
    kinds = {
        "unchanged": difference.compared & ~moved & ~lost & ~appeared,
        "moved": moved & ~lost,
        "lost": lost,
        "appeared": appeared,
    }
    units, factor = length_shown(difference.units, difference.units)
    before = np.where(np.isfinite(difference.before), difference.before, difference.after)
    worst = np.flatnonzero(moved)[np.argsort(-difference.distance[moved], kind="stable")]
    labels = {int(i): difference.names[i] for i in worst[:_MAX_LABELS]}
    arrows = np.where(moved[:, None], difference.after, np.nan)
    _draw_displacements(ax, factor * before, factor * arrows, kinds, labels, units=units)
    note = "Arrows lead from the first map to the second, which is aligned with the first."
    return Caption(title, note, legend=4)


@panel(lambda placement, *_: span_dimensions(placement.map.positions))
def plot_placement(
    placement: Placement,
    anchors: Anchors | None = None,
    mesh: Mesh | None = None,
    *,
    ax: Axes = None,
) -> Caption:
    """Plot a placed map, and where its anchors are.

    Parameters
    ----------
    placement : Placement
        From `anisomap.placement.place`.
    anchors : Anchors, optional
    mesh : Mesh, optional
        Drawn in 3D only.
    """
    placed = in_millimetres(placement.map)
    names = set(() if anchors is None else anchors.names)
    known = np.array([name in names for name in placed.names], dtype=bool)
    kinds = {"placed": placed.placed & ~known, "anchors": placed.placed & known}
    chosen = np.flatnonzero(placed.placed & known)[:_MAX_LABELS]
    labels = {int(i): placed.names[i] for i in chosen}
    nowhere = np.full_like(placed.positions, np.nan)
    _draw_displacements(ax, placed.positions, nowhere, kinds, labels, units=placed.units)
    if mesh is not None and ax.name == "3d":
        look = {"color": "#c9cdd2", "alpha": 0.25, "linewidth": 0, "zorder": 0}
        ax.plot_trisurf(*mesh.vertices.T / METRES[placed.units], triangles=mesh.faces, **look)
    note = ""
    if np.isfinite(placed.errors).any():
        error = f"{float(np.nanmedian(placed.errors)):.2g} {placed.units}"
        note = f"90 % of the sensors are within their error, {error} in the median."
    return Caption(f"Placed in {placed.frame}: {placement.methods[0]}", note, legend=4)


@panel(lambda check, *_: span_dimensions(check.layout.positions))
def plot_layout(
    check: LayoutCheck, *, title: str = "Check of a layout", ax: Axes = None
) -> Caption:
    """Plot a layout, with arrows from the stated places to those that the readings propose.

    Parameters
    ----------
    check : LayoutCheck
        From `anisomap.check_layout`.
    title : str
    """
    layout, corrected = in_millimetres(check.layout), in_millimetres(check.corrected)
    status = np.array(check.status)
    kinds = {kind: np.isin(status, every) & layout.placed for kind, every in _STATUSES.items()}
    start, end = layout.positions, corrected.positions
    changed = (start != end).any(axis=1) & layout.placed
    ends = [i for finding in check.findings for i in finding.sensors[[0, -1]].tolist()]
    labels = {i: layout.names[i] for i in ends[:_MAX_LABELS]}
    arrows = np.where(changed[:, None], end, np.nan)
    _draw_displacements(ax, start, arrows, kinds, labels, units=layout.units)
    note = "Arrows lead from the stated position of a sensor to the one that its readings indicate."
    return Caption(title, note, legend=3)


def _draw_displacements(
    axes: Axes,
    start: Points,
    end: Points,
    kinds: Mapping[str, NDArray[np.bool_]],
    labels: Mapping[int, str],
    *,
    units: str,
) -> None:
    """Draw sensors by kind, and arrows to other positions. start, end (N, k), kinds (N,)."""
    k = 3 if axes.name == "3d" else 2
    start, end = with_axes(start, k), with_axes(end, k)
    drawn = np.any(list(kinds.values()), axis=0)
    shown = [points[np.isfinite(points).all(axis=1)] for points in (start[drawn], end[drawn])]
    shown = [points for points in shown if len(points)]
    limits = box_around(*shown)
    set_up_axes(axes, limits, best_view(*shown) if k == 3 else (0.0, 0.0), units)
    size = _DOT_AREA * float(np.clip(np.sqrt(60 / drawn.sum()), 0.1, 1))
    for kind, chosen in kinds.items():
        if not chosen.any():
            continue
        colour, marker = _LOOKS[kind]
        places = start[chosen]
        axes.scatter(
            *places.T, s=size, color=colour, marker=marker, edgecolors="white", linewidths=0.4,
            label=f"{kind} ({chosen.sum()})",
        )  # fmt: skip
        arrows = end[chosen] - places
        known = np.isfinite(arrows).all(axis=1)
        _draw_arrows(axes, places[known], arrows[known], colour)
    for i, name in labels.items():
        right_half = bool(start[i, 0] > limits[0].mean())
        write_label(axes, start[i], shown_name(name), right_half)


def _draw_arrows(axes: Axes, places: Points, arrows: Points, colour: str) -> None:
    if not len(places):
        return
    flat = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.004}
    look = {"linewidth": 1.0, "arrow_length_ratio": 0.15} if axes.name == "3d" else flat
    axes.quiver(*places.T, *arrows.T, color=colour, **look)
    if axes.name != "3d":
        axes.plot(*(places + arrows).T, ".", color=FAINT, markersize=3, markeredgecolor=INK)


@panel(lambda sensor_map, *_: 3 if sensor_map.dimensions > 2 else 2)
def plot_touches(
    sensor_map: SensorMap,
    coverage: TouchCoverage,
    score: Score | None = None,
    *,
    ax: Axes = None,
) -> Caption:
    """Plot contacts by place on the map, neighbours never touched together, and where to touch.

    Sensors are darker the more contacts they had. Red lines join neighbours that were never
    touched together; numbers mark the places to touch next, the most urgent first.

    Parameters
    ----------
    sensor_map : SensorMap
        Its largest component is drawn, in its first two or three coordinates.
    coverage : TouchCoverage
        From `anisomap.health.touch_coverage`, of the same map.
    score : Score, optional
        Score of this map: the map is aligned with the truth.
    """
    shown = largest_component(sensor_map, score)
    points = shown.points[:, : 3 if sensor_map.dimensions > 2 else 2]
    row = {int(sensor): i for i, sensor in enumerate(shown.sensors)}
    set_up_axes(ax, box_around(points), shown.view, shown.units)
    ax.plot(*segments(points, shown.pairs).T, color=_LINES, linewidth=0.6, zorder=1)
    apart = [[row[i], row[j]] for i, j in coverage.never_together.tolist() if {i, j} <= row.keys()]
    if apart:
        ax.plot(*segments(points, np.array(apart)).T, color=_LACKING, linewidth=1.2, zorder=2)
    classes = np.digitize(coverage.contacts[shown.sensors], (1, MIN_CONTACTS, ENOUGH_CONTACTS))
    for i, label in enumerate(_CLASSES):
        some = points[classes == i]
        if len(some):
            ax.scatter(
                *some.T, color=_SHADES[i], edgecolors=INK, linewidths=0.6, s=_DOT_AREA,
                marker=MARKERS[i], label=label, zorder=3,
            )  # fmt: skip
    write_labels(ax, shown, points)
    for rank, place in enumerate(coverage.places, start=1):
        if place.component == 0:
            where = points[[row[i] for i in place.sensors]].mean(axis=0)
            ax.text(
                *where, str(rank), fontsize=12, fontweight="bold", color=_LACKING, ha="center",
                va="center", zorder=101,
            )  # fmt: skip
    ax.legend(
        frameon=False, fontsize=8, title="contacts", loc="upper left", bbox_to_anchor=(1.02, 1)
    )
    set_title(ax, "Contacts, and where to touch next (1: first)")
    return Caption(size=(8.0, 5.6))
