"""Panels of figures: configurations of sensors, alone and side by side; distances of maps."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import pdist

from anisomap.drawing.figures.backend import (
    FAINT,
    INK,
    PALETTE,
    Axes,
    add_axes,
    drawing_style,
    load,
    new_figure,
    set_ticks,
    set_title,
    write_notes,
    write_title,
)
from anisomap.drawing.view import (
    VIEWS,
    Panel,
    Points,
    View,
    axis_title,
    best_view,
    box_around,
    neighbour_pairs,
    outlines,
    place_colours,
    segments,
    view_axes,
)
from anisomap.errors import InputError
from anisomap.evaluation import Score
from anisomap.sensor_map import SensorMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_VECTOR_DOTS = 5_000
"""Above this number of sensors, dots and lines are stored as pixels in SVG and PDF files."""

# Sizes and limits below were chosen by eye.
_N_LAYERS = 6
_MAX_DOTS = 3_000  # pairs drawn as dots; more are drawn as a density
_MAX_SENSORS = 1_500  # sensors of which all pairs of distances are drawn
_DENSITY_CELLS = 90
_STEEP = 50  # degrees of elevation above which the z axis is foreshortened
_FEW_PAIRS = 200
_OUTLINE = "#8a6d3b"
_DOT_AREA = 75.0  # square points, for up to 60 sensors
_CROWDED = 300
_CROSS = {"marker": "x", "color": "black", "linewidths": 1.4}
_SQUARE = {"marker": "s", "facecolors": "none", "edgecolors": INK, "linewidths": 0.8}

# Inches.
_HEAD, _LINE, _BELOW = 0.45, 0.17, 0.35
_CHARACTERS_PER_INCH = 13.5

_FLAT_VIEW: View = (0.0, 0.0)  # ignored in 2D
_OBLIQUE_VIEW: View = (38.0, -68.0)  # of flat bodies, so that bending of the map is visible


def draw_configuration(axes: Axes, shown: Panel, limits: Points | None = None) -> None:
    """Draw a configuration with its neighbours joined, from back to front. limits (k, 2)."""
    points = shown.points
    limits = box_around(points) if limits is None else limits
    set_up_axes(axes, limits, shown.view, shown.units)
    nearness = np.ones(len(points))
    if shown.dimensions == 3:
        depth = points @ view_axes(shown.view)[2]
        nearness = 1 - (depth.max() - depth) / np.ptp(limits, axis=1).max()
    if len(ellipses := outlines(shown, shown.view)):
        axes.plot(*ellipses.T, color=_OUTLINE, linewidth=0.6, alpha=0.7, zorder=0.5)
    _draw_layers(axes, shown, np.clip(nearness, 0, 1))
    write_labels(axes, shown, points)


def draw_distances(axes: Axes, truth: Points, found: Points, units: str) -> str:
    """Draw the distance of every pair of sensors on the map against the true distance.

    Up to 3000 pairs are drawn as dots, more as a density. Of more than 1500 sensors, 1500 are
    drawn, equally spaced in their order.

    truth, found (n, k).
    """
    n_sensors = len(truth)
    kept = np.unique(np.linspace(0, n_sensors - 1, min(n_sensors, _MAX_SENSORS)).astype(int))
    both = pdist(truth[kept]), pdist(found[kept])
    n_pairs = both[0].size
    longest = 1.04 * float(np.max(both))
    label = f"{n_pairs} pairs of sensors"
    axes.plot([0, longest], [0, longest], color=INK, linewidth=1, linestyle="--", zorder=3)
    if n_pairs <= _MAX_DOTS:
        size = 4 if n_pairs > _FEW_PAIRS else 8
        axes.plot(
            *both, ".", markersize=size, alpha=0.5, markeredgewidth=0, color=PALETTE[0],
            rasterized=True,
        )  # fmt: skip
    else:
        colors = load("matplotlib.colors")
        cells, edges, _ = np.histogram2d(*both, bins=_DENSITY_CELLS, range=[[0, longest]] * 2)
        shades = ["#cfe3f1", PALETTE[0], "#001b2e"]
        axes.pcolormesh(
            edges,
            edges,
            np.ma.masked_equal(cells.T, 0),
            norm=colors.LogNorm(vmin=1),
            cmap=colors.LinearSegmentedColormap.from_list("pairs", shades),
            rasterized=True,
        )
        label += ", as a density"
    if len(kept) < n_sensors:
        label = f"{n_pairs} pairs among {len(kept)} of {n_sensors} sensors"
    axes.set(xlim=(0, longest), ylim=(0, longest))
    axes.set_aspect("equal")
    axes.set_xlabel(axis_title("true distance", units), parse_math=False, color=INK)
    axes.set_ylabel(axis_title("distance on the map", units), parse_math=False, color=INK)
    axes.locator_params(nbins=5)
    return label


def set_up_axes(axes: Axes, limits: Points, view: View, units: str) -> None:
    """Set limits, an equal aspect, labels with units and the view of axes of positions.

    limits (k, 2).
    """
    for name, span in zip("xyz", limits, strict=False):
        axes.set(**{f"{name}lim": span})
        title = axis_title(name, units)
        getattr(axes, f"set_{name}label")(title, parse_math=False, color=INK)
    set_ticks(axes, np.ptp(limits, axis=1), 4)
    axes.set_aspect("equal")
    if len(limits) == 2:
        axes.grid(color="#e6e8eb", linewidth=0.6)
        axes.set_axisbelow(True)
        return
    axes.set_proj_type("ortho")
    axes.computed_zorder = False  # `_draw_layers` orders lines among dots
    axes.view_init(*view)
    axes.set_box_aspect(np.ptp(limits, axis=1), zoom=1.07)
    axes.tick_params(pad=-2)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color("#fafbfb")
        axis.labelpad = -3
    if view[0] > _STEEP:  # tick labels of the foreshortened z axis would overlap
        axes.zaxis.set_ticklabels([])


def _draw_layers(axes: Axes, shown: Panel, nearness: Points) -> None:
    """Draw from back to front, because 3D axes do not sort lines among dots."""
    points = shown.points
    first, second = shown.pairs.T
    dot_layer = np.minimum((nearness * _N_LAYERS).astype(int), _N_LAYERS - 1)
    # A line has the depth of its farther end, so that it never crosses a nearer dot.
    line_layer = np.minimum(dot_layer[first], dot_layer[second])
    size = _DOT_AREA * float(np.clip(np.sqrt(60 / len(points)), 0.02, 1))
    crowded, as_pixels = len(points) > _CROWDED, len(points) > MAX_VECTOR_DOTS
    common = {"rasterized": as_pixels} | ({"depthshade": False} if axes.name == "3d" else {})
    for layer in np.unique(dot_layer):
        near = (layer + 1) / _N_LAYERS
        axes.plot(
            *segments(points, shown.pairs[line_layer == layer]).T,
            color="#555b62",
            alpha=(0.12 + 0.5 * near**1.5) * (0.5 if crowded else 1),
            linewidth=(0.5 + 0.6 * near) * (0.6 if crowded else 1),
            rasterized=as_pixels,
            zorder=4 * layer + 1,
        )
        chosen = dot_layer == layer
        axes.scatter(
            *points[chosen].T,
            s=size * (0.4 + 0.6 * near),
            c=shown.colours[chosen],
            alpha=0.45 + 0.55 * near,
            edgecolors=np.where(shown.uncompared[chosen], FAINT, "white").tolist(),
            linewidths=0 if crowded else 0.5,
            zorder=4 * layer + 2,
            **common,
        )
        for marked, scale, style in ((shown.faulty, 1.3, _CROSS), (shown.uncompared, 2.6, _SQUARE)):
            if (marked & chosen).any():
                axes.scatter(
                    *points[marked & chosen].T,
                    s=(size if as_pixels else max(size, 16)) * scale,
                    zorder=4 * layer + 3,
                    **style,
                    **common,
                )


def write_labels(axes: Axes, shown: Panel, points: Points) -> None:
    """Write the names of a panel towards its middle. points (n, k)."""
    rightwards = view_axes(shown.view)[0] if points.shape[1] == 3 else np.array([1.0, 0.0])
    middle = box_around(points).mean(axis=1)
    for i, name in shown.labels.items():
        write_label(axes, points[i], name, bool((points[i] - middle) @ rightwards > 0))


def write_label(axes: Axes, point: Points, name: str, leftwards: bool) -> None:
    """Write a name to the left or right of a point, legible above everything else."""
    axes.text(
        *point,
        f"{name}  " if leftwards else f"  {name}",
        ha="right" if leftwards else "left",
        fontsize=7.5,
        color=INK,
        parse_math=False,
        va="bottom",
        zorder=100,
        path_effects=[load("matplotlib.patheffects").withStroke(linewidth=2, foreground="white")],
    )


def truth_panel(
    title: str,
    truth: ArrayLike,
    *,
    units: str = "",
    on_maps: ArrayLike | None = None,
    excluded: ArrayLike | None = None,
    labels: Mapping[int, str] | None = None,
) -> Panel:
    """Prepare a panel of the true positions. truth (N, k)."""
    places = np.asarray(truth, dtype=np.float64)
    placed = (
        np.ones(len(places), dtype=bool) if on_maps is None else np.asarray(on_maps, dtype=bool)
    )
    left_out = np.zeros(len(places), dtype=bool)
    if excluded is not None:
        left_out |= np.asarray(excluded, dtype=bool)
    drawn = _panel(title, places, places, placed, left_out, units=units, labels=labels or {})
    return replace(drawn, unplaced=places[~placed])


def map_panel(
    title: str,
    sensor_map: SensorMap,
    score: Score,
    truth: ArrayLike,
    *,
    labels: Mapping[int, str] | None = None,
) -> Panel:
    """Prepare a panel of a map aligned with the truth, in the colours of the truth panel.

    truth (N, k).
    """
    places = np.asarray(truth, dtype=np.float64)
    return _panel(
        title,
        score.alignment.apply(sensor_map.positions)[:, : places.shape[1]],
        places,
        sensor_map.placed & (sensor_map.component == 0),
        np.isin(np.arange(sensor_map.n_sensors), score.excluded),
        units=score.units,
        labels=labels or {},
    )


def gallery_figure(
    title: str, panels: Sequence[Panel], columns: int, note: str = "", *, size: float = 3.5
) -> Figure:
    """Draw panels in rows."""
    if not panels:
        raise InputError("there are no panels to draw")
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    width = size * columns + 0.7
    lines = textwrap.wrap(note, int(width * _CHARACTERS_PER_INCH)) if note else []
    foot = _LINE * len(lines) + 0.15
    height = _HEAD + rows * size + foot + 0.2
    with drawing_style():
        figure = new_figure(width, height)
        sides = {"left": 0.7 / width, "right": 1 - 0.5 / width, "wspace": 0.22, "hspace": 0.34}
        top, bottom = 1 - (_HEAD + _BELOW) / height, (foot + _BELOW + 0.2) / height
        cells = figure.add_gridspec(rows, columns, top=top, bottom=bottom, **sides)
        for i, shown in enumerate(panels):
            _draw_panel(add_axes(figure, shown.dimensions, cells[divmod(i, columns)]), shown)
        write_title(figure, title)
        write_notes(figure, lines)
        return figure


def _draw_panel(ax: Axes, shown: Panel) -> None:
    rings = shown.points[:0] if shown.unplaced is None else shown.unplaced
    limits = box_around(shown.points, rings)
    draw_configuration(ax, shown, limits)
    set_ticks(ax, np.ptp(limits, axis=1), 3)
    for name in "xyz"[: len(limits)]:
        axis = getattr(ax, f"{name}axis")
        axis.label.set_size(8)
        axis.set_tick_params(labelsize=7)
    if len(rings):
        ax.scatter(*rings.T, s=22, facecolors="none", edgecolors=FAINT, linewidths=0.7)
    set_title(ax, shown.title)


def _panel(
    title: str,
    points: Points,
    truth: Points,
    placed: NDArray[np.bool_],
    excluded: NDArray[np.bool_],
    *,
    units: str,
    labels: Mapping[int, str],
) -> Panel:
    view = _FLAT_VIEW
    if truth.shape[1] == 3:
        view = VIEWS[0] if best_view(truth) == VIEWS[0] else _OBLIQUE_VIEW
    rows = np.flatnonzero(placed)
    row_of = {int(sensor): i for i, sensor in enumerate(rows)}
    pairs = neighbour_pairs(truth[rows])
    return Panel(
        points=points[rows],
        colours=place_colours(truth, view)[rows],
        pairs=pairs[~excluded[rows][pairs].any(axis=1)],  # whose place on the map is arbitrary
        view=view,
        units=units,
        uncompared=excluded[rows],
        faulty=np.zeros(len(rows), dtype=bool),
        sensors=rows,
        truth=truth[rows],
        labels={row_of[sensor]: name for sensor, name in labels.items() if sensor in row_of},
        title=title,
    )
