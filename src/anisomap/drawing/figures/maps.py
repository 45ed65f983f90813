"""Figures of maps: beside the truth, from several sides, and in galleries of panels."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import pdist

from anisomap.base.wording import join_items, printable, shortened
from anisomap.drawing.figures.backend import (
    FAINT,
    INK,
    PALETTE,
    Axes,
    add_axes,
    add_legend,
    load,
    new_figure,
    panel,
    set_ticks,
    set_title,
)
from anisomap.drawing.view import (
    MAX_JOINED,
    MAX_UNITS,
    VIEWS,
    Panel,
    Points,
    View,
    axis_title,
    best_view,
    box_around,
    drawn_components,
    drawn_dimensions,
    layout_notes,
    neighbour_pairs,
    outlines,
    panel_limits,
    place_colours,
    segments,
    shown_name,
    view_axes,
)
from anisomap.errors import InputError
from anisomap.evaluation import Score
from anisomap.evaluation import score as score_map
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

MAX_VECTOR_DOTS = 5_000
"""Above this number of sensors, dots and lines are stored as pixels in SVG and PDF files."""

# Sizes and limits below were chosen by eye. Inches:
_WIDTH, _NARROW, _HEAD, _ROW, _SMALL_ROW, _FOOT = 14.0, 8.0, 0.5, 5.4, 4.2, 0.2
_GALLERY_HEAD, _BELOW, _LINE = 0.45, 0.35, 0.17
_CHARACTERS_PER_INCH, _MAX_LINES = 13.5, 10
_COLUMNS, _MAX_SMALL_PANELS = 3, 9
_COMPARISON = (1.2, 1.2, 0.02, 0.95)  # the third is a gap for the z axis and its title
_N_LAYERS = 6
_MAX_DOTS = 3_000  # pairs drawn as dots; more are drawn as a density
_MAX_SENSORS = 1_500  # sensors of which all pairs of distances are drawn
_DENSITY_CELLS, _FEW_PAIRS = 90, 200
_STEEP = 50  # degrees of elevation above which the z axis is foreshortened
_OUTLINE = "#8a6d3b"
_DOT_AREA = 75.0  # square points, for up to 60 sensors
_CROWDED = 300
_CROSS = {"marker": "x", "color": "black", "linewidths": 1.4}
_SQUARE = {"marker": "s", "facecolors": "none", "edgecolors": INK, "linewidths": 0.8}
_OBLIQUE_VIEW: View = (38.0, -68.0)  # of flat bodies, so that bending of the map is visible


def map_figure(sensor_map: SensorMap, score: Score | None = None) -> Figure:
    """Draw a map.

    With a score: the true positions, the map aligned with them (same view, same limits), and the
    distances on the map against the true ones. True neighbours are joined in both configurations,
    so that folds and tears are visible, and a sensor has the same colour in both. Without a score:
    the map from three sides, or in 2D, with its own neighbours joined. Every further connected
    component has its own panel; components of a single sensor are only counted.

    Parameters
    ----------
    sensor_map : SensorMap
        Of more than three dimensions, the first three are drawn.
    score : Score, optional
        Score of this map against the truth.

    Returns
    -------
    matplotlib.figure.Figure
        Not bound to a window; save it with `save_figure`.

    Raises
    ------
    InputError
        If no sensor has a position.
    MissingExtraError
        If matplotlib is not installed.
    """
    drawn = _components(sensor_map, score)
    first = drawn[:1] if score is not None or len(drawn) == 1 else []
    others = drawn[len(first) :]
    small = others[:_MAX_SMALL_PANELS]
    flat = bool(first) and score is None and first[0].dimensions == 2
    width = _NARROW if flat else _WIDTH
    notes = _notes(sensor_map, score, len(others) - len(small), width)
    main_row = _ROW if first else 0.0
    height = _HEAD + main_row - (-len(small) // _COLUMNS) * _SMALL_ROW
    height += _FOOT + _LINE * len(notes)
    with new_figure(width, height, _title(sensor_map, score), notes) as figure:
        if first and score is not None:
            cells = _cells(figure, 0, _ROW, _COMPARISON)
            _draw_comparison(figure, first[0], score, cells)
        elif first:
            names = ("From the front", "From the right", "From above")
            sides = [("", VIEWS[0])] if flat else list(zip(names, VIEWS, strict=True))
            cells = _cells(figure, 0, _ROW, (1.0,) * len(sides))
            for (title, view), cell in zip(sides, cells, strict=True):
                _draw(figure, cell, replace(first[0], view=view), title)
        for i, component in enumerate(small):
            row, column = divmod(i, _COLUMNS)
            cells = _cells(figure, main_row + row * _SMALL_ROW, _SMALL_ROW, (1.0,) * _COLUMNS)
            count = len(component.points)
            title = f"Component {component.number}: {count} sensors, own coordinate frame"
            _draw(figure, cells[column], component, title)
        _add_legend(figure, first + small)
        return figure


def plot(
    sensor_map: SensorMap,
    truth: SensorMap | Recording | ArrayLike | None = None,
    *,
    ax: Axes | None = None,
) -> Axes:
    """Plot the largest component of a map, over its true positions if these are given.

    Parameters
    ----------
    sensor_map : SensorMap
        Of more than three dimensions, the first three are drawn.
    truth : SensorMap, Recording or array_like of shape (N, 2) or (N, 3), optional
        True positions, as for `anisomap.score`: rings, joined with the sensors of the map, which is
        aligned with them. Lines join true neighbours.
    ax : matplotlib Axes, optional
        See `anisomap.drawing.figures.plot_map`.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    InputError
        See `anisomap.drawing.figures.plot_map` and `anisomap.score`.
    MissingExtraError
        If matplotlib is not installed.
    """
    result = None if truth is None else score_map(sensor_map, truth, permutations=0)
    return plot_map(sensor_map, result, ax=ax)


@panel(drawn_dimensions)
def plot_map(sensor_map: SensorMap, score: Score | None = None, *, ax: Axes = None) -> None:
    """Plot the largest component of a map in one panel.

    Parameters
    ----------
    sensor_map : SensorMap
        Of more than three dimensions, the first three are drawn.
    score : Score, optional
        Score of this map: the map is aligned with the truth, whose positions are rings, and true
        neighbours are joined.
    """
    shown = largest_component(sensor_map, score)
    draw_configuration(ax, shown)
    if n_compared := len(truth := shown.truth):
        gaps = np.full_like(truth, np.nan)
        apart = np.stack([shown.points[:n_compared], truth, gaps], axis=1)
        ax.plot(*apart.reshape(-1, shown.dimensions).T, color=INK, linewidth=0.8, zorder=2.5)
        look = {"markersize": 7, "markerfacecolor": "none", "markeredgecolor": INK}
        ax.plot(*truth.T, "o", **look, zorder=2.5)


@panel()
def plot_distances(score: Score, *, ax: Axes = None) -> None:
    """Plot the distances between sensors on the map against the true distances.

    Parameters
    ----------
    score : Score
        Score of a map.
    """
    draw_distances(ax, score)


def _components(sensor_map: SensorMap, score: Score | None) -> list[Panel]:
    if not sensor_map.placed.any():
        raise InputError("no sensor of the map has a position; there is nothing to draw")
    return drawn_components(sensor_map, score)


def largest_component(sensor_map: SensorMap, score: Score | None) -> Panel:
    """Prepare the largest component of a map."""
    if not (drawn := _components(sensor_map, score)):
        raise InputError("every component of the map has a single sensor; there is nothing to draw")
    return drawn[0]


def _cells(figure: Figure, top: float, height: float, ratios: Sequence[float]) -> list[SubplotSpec]:
    """Create a row of cells for panels, `top` inches below the head."""
    total = figure.get_figheight()
    upper = total - _HEAD - top - 0.55
    grid = figure.add_gridspec(
        1,
        len(ratios),
        left=0.045,
        right=0.985,
        top=upper / total,
        bottom=(upper - height + 1.15) / total,
        wspace=0.2,
        width_ratios=ratios,
    )
    return [grid[0, i] for i in range(len(ratios))]


def _draw(
    figure: Figure, cell: SubplotSpec, shown: Panel, title: str, limits: Points | None = None
) -> None:
    axes = add_axes(figure, shown.dimensions, cell)
    draw_configuration(axes, shown, limits)
    set_title(axes, title)


def _draw_comparison(
    figure: Figure, shown: Panel, score: Score, cells: Sequence[SubplotSpec]
) -> None:
    how = "rotated, scaled and reflected" if score.alignment.reflected else "rotated and scaled"
    error = f"{score.rms:.3g} {shortened(printable(score.units), MAX_UNITS)}".strip()
    spacings = f" = {score.rms_in_spacings:.2g} sensor spacings" if score.spacing > 0 else ""
    limits = panel_limits(shown)
    _draw(figure, cells[0], shown.true(), "True positions", limits)
    _draw(figure, cells[1], shown, f"Map, {how} to fit\nRMS error {error}{spacings}", limits)
    axes = figure.add_subplot(cells[-1])
    label = draw_distances(axes, score)
    set_title(axes, f"Distances: {_agreement(score)}\n{label}")


def _title(sensor_map: SensorMap, score: Score | None) -> str:
    placed = f"{int(sensor_map.placed.sum())} {sensor_map.kind}s"
    parts = [shortened(printable(sensor_map.method), 60) or "map", placed]
    if score is not None:
        parts.append(_agreement(score))
    elif np.isfinite(sensor_map.stress):
        parts.append(f"Stress-1 {sensor_map.stress:.3f}")
    return ", ".join(parts)


def _agreement(score: Score) -> str:
    quantiles = score.mantel.quantiles()
    null = f" (null, 95 %: {quantiles[0.95]:.2f})" if quantiles else ""
    return f"Mantel r {score.mantel.r:.3f}{null}"


def _notes(sensor_map: SensorMap, score: Score | None, hidden: int, width: float) -> list[str]:
    joined = np.count_nonzero(sensor_map.component == 0) <= MAX_JOINED
    kind = "nearest neighbours on the map" if score is None else "true neighbours"
    lines = f"Lines join {kind}. " if joined else ""
    pose = f"The map is {sensor_map.pose}"
    colours = f"{lines}Each {sensor_map.kind} has the same colour in"
    notes = [f"{pose}. {colours} every view."]
    if score is not None:
        notes = [f"{colours} both panels. {pose}, and was fitted to the truth."]
    if sensor_map.covariances is not None and joined:
        notes.append(
            "Ellipses hold 95 % of the true positions, on average over maps of known skins."
        )
    unplaced = [shown_name(sensor_map.names[i]) for i in np.flatnonzero(~sensor_map.placed)]
    if unplaced:
        notes.append(f"Without a position: {join_items(unplaced, 12)}.")
    single = np.count_nonzero(np.bincount(sensor_map.component[sensor_map.placed]) == 1)
    if single and len(sensor_map.component_sizes) > 1:
        notes.append(f"Components of a single sensor, not drawn: {single}.")
    if hidden > 0:
        notes.append(f"Smaller components, not drawn: {hidden}.")
    if sensor_map.dimensions > 3:
        notes.append(f"The first three of {sensor_map.dimensions} dimensions are drawn.")
    caveats = [*sensor_map.notes, *layout_notes(sensor_map, score)]
    notes += [f"Note: {shortened(printable(note), 400)}" for note in caveats]
    wrapped = [
        line for note in notes for line in textwrap.wrap(note, int(width * _CHARACTERS_PER_INCH))
    ]
    if len(wrapped) > _MAX_LINES:
        wrapped = [*wrapped[: _MAX_LINES - 1], "More notes are in the map file and in the report."]
    return wrapped


def _add_legend(figure: Figure, drawn: Sequence[Panel]) -> None:
    marks: list[dict[str, str]] = []
    if any(component.faulty.any() for component in drawn):
        marks.append({"marker": "x", "color": "black", "label": "faulty"})
    if any(component.uncompared.any() for component in drawn):
        marks.append({"marker": "s", "mfc": "#b8b8b8", "mec": INK, "label": "not compared"})
    add_legend(figure, marks, "upper right", (0.985, 1 - 0.12 / figure.get_figheight()))


def draw_configuration(axes: Axes, shown: Panel, limits: Points | None = None) -> None:
    """Draw a configuration with its neighbours joined, from back to front. limits (k, 2)."""
    points = shown.points
    limits = panel_limits(shown) if limits is None else limits
    set_up_axes(axes, limits, shown.view, shown.units)
    nearness = np.ones(len(points))
    if shown.dimensions == 3:
        depth = points @ view_axes(shown.view)[2]
        nearness = 1 - (depth.max() - depth) / np.ptp(limits, axis=1).max()
    if len(ellipses := outlines(shown, shown.view)):
        axes.plot(*ellipses.T, color=_OUTLINE, linewidth=0.6, alpha=0.7, zorder=0.5)
    _draw_layers(axes, shown, np.clip(nearness, 0, 1))
    write_labels(axes, shown, points)


def draw_distances(axes: Axes, score: Score) -> str:
    """Draw the distances of pairs of sensors on the map against the true ones; say what is drawn.

    Many pairs are drawn as a density; of many sensors, some, equally spaced in their order.
    """
    n_sensors = len(score.truth)
    kept = np.unique(np.linspace(0, n_sensors - 1, min(n_sensors, _MAX_SENSORS)).astype(int))
    both = pdist(score.truth[kept]), pdist(score.alignment.aligned[kept])
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
    axes.set_xlabel(axis_title("true distance", score.units), parse_math=False, color=INK)
    axes.set_ylabel(axis_title("distance on the map", score.units), parse_math=False, color=INK)
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
    excluded: ArrayLike = False,
    labels: Mapping[int, str] | None = None,
) -> Panel:
    """Prepare a panel of the true positions. truth (N, k)."""
    places = np.asarray(truth, dtype=np.float64)
    placed = np.full(len(places), True) if on_maps is None else np.asarray(on_maps, dtype=bool)
    view = VIEWS[0]  # ignored in 2D
    if places.shape[1] == 3:
        view = VIEWS[0] if best_view(places) == VIEWS[0] else _OBLIQUE_VIEW
    rows = np.flatnonzero(placed)
    row_of = {int(sensor): i for i, sensor in enumerate(rows)}
    left_out = np.broadcast_to(np.asarray(excluded, dtype=bool), placed.shape)[rows]
    pairs = neighbour_pairs(places[rows])
    return Panel(
        points=places[rows],
        colours=place_colours(places, view)[rows],
        pairs=pairs[~left_out[pairs].any(axis=1)],  # whose place on the map is arbitrary
        view=view,
        units=units,
        uncompared=left_out,
        faulty=np.zeros(len(rows), dtype=bool),
        sensors=rows,
        truth=places[rows],
        labels={row_of[i]: name for i, name in (labels or {}).items() if i in row_of},
        unplaced=places[~placed],
        title=title,
    )


def map_panel(
    title: str,
    sensor_map: SensorMap,
    score: Score,
    truth: Points,
    *,
    labels: Mapping[int, str] | None = None,
) -> Panel:
    """Prepare a panel of a map aligned with the truth, in the colours of the truth panel.

    truth (N, k).
    """
    drawn = truth_panel(
        title,
        truth,
        units=score.units,
        on_maps=sensor_map.placed & (sensor_map.component == 0),
        excluded=np.isin(np.arange(sensor_map.n_sensors), score.excluded),
        labels=labels,
    )
    aligned = score.alignment.apply(sensor_map.positions)[drawn.sensors, : truth.shape[1]]
    return replace(drawn, points=aligned, unplaced=None)


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
    height = _GALLERY_HEAD + rows * size + foot + 0.2
    with new_figure(width, height, title, lines) as figure:
        sides = {"left": 0.7 / width, "right": 1 - 0.5 / width, "wspace": 0.22, "hspace": 0.34}
        top, bottom = 1 - (_GALLERY_HEAD + _BELOW) / height, (foot + _BELOW + 0.2) / height
        cells = figure.add_gridspec(rows, columns, top=top, bottom=bottom, **sides)
        for i, shown in enumerate(panels):
            _draw_panel(add_axes(figure, shown.dimensions, cells[divmod(i, columns)]), shown)
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
