"""Figures of maps: alone, beside the truth, in galleries of panels, and with displacements."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.base import METRES
from anisomap.base.wording import join_items, printable, shortened
from anisomap.drawing.figures.backend import (
    FAINT,
    INK,
    MARKERS,
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
from anisomap.drawing.figures.charts import draw_distances
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
    place_colours,
    segments,
    shown_name,
    span_dimensions,
    view_axes,
    with_axes,
)
from anisomap.errors import InputError
from anisomap.evaluation import Score
from anisomap.evaluation import score as score_map
from anisomap.placement.frames import in_millimetres
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from anisomap.layout import LayoutCheck
    from anisomap.numerics.surfaces import Mesh
    from anisomap.placement import Anchors, Placement

MAX_VECTOR_DOTS = 5_000
"""Maximum number of sensors whose dots and lines are not rasterised in SVG and PDF files."""

# Sizes and limits below were chosen by eye. Inches:
_SIDE, _HEAD, _LINE, _LEFT, _RIGHT = 4.6, 0.8, 0.17, 0.75, 0.85
_CHARACTERS_PER_INCH, _MAX_LINES = 13.5, 10
_MAX_COMPONENTS = 9
_N_LAYERS = 6
_STEEP = 50  # degrees of elevation above which the z axis is foreshortened
_DOT_AREA = 60.0  # square points, for up to 60 sensors
_CROWDED = 300
_MAX_LABELS = 12
_CROSS = {"marker": "x", "color": "black", "linewidths": 1.4}
_SQUARE = {"marker": "s", "facecolors": "none", "edgecolors": INK, "linewidths": 0.8}
_OBLIQUE_VIEW: View = (38.0, -68.0)  # of flat bodies, so that bending of the map is visible


def map_figure(sensor_map: SensorMap, score: Score | None = None) -> Figure:
    """Draw a map.

    With a score, the figure shows the true positions, the map aligned with them (same view, same
    limits), and the distances on the map against the true ones. True neighbours are joined in both
    configurations, so that folds and tears are visible, and a sensor has the same colour in both.
    Without a score, it shows the map (in 3D from three sides) with nearest neighbours joined.
    Every further component has its own panel; components of a single sensor are only counted.

    Parameters
    ----------
    sensor_map : SensorMap
        If there are more than three dimensions, the first three are drawn.
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
    main: list[Panel | Score] = []
    if score is not None:
        how = "rotated, scaled and reflected" if score.alignment.reflected else "rotated and scaled"
        error = f"{score.rms:.3g} {shortened(printable(score.units), MAX_UNITS)}".strip()
        spacings = f" = {score.rms_in_spacings:.2g} sensor spacings" if score.spacing > 0 else ""
        title = f"Map, {how} to fit\nRMS error {error}{spacings}"
        shown = replace(drawn[0], limits=box_around(drawn[0].points, drawn[0].truth), title=title)
        main = [replace(shown.true(), title="True positions"), shown, score]
    elif len(drawn) == 1 and drawn[0].dimensions == 3:
        names = ("From the front", "From the right", "From above")
        main = [replace(drawn[0], view=v, title=t) for v, t in zip(VIEWS, names, strict=True)]
    elif len(drawn) == 1:
        main = [drawn[0]]
    others = drawn[bool(main) :]
    small = [
        replace(
            component,
            title=f"Component {component.number}: {len(component.points)} {sensor_map.kind}s, "
            "own coordinate frame",
        )
        for component in others[:_MAX_COMPONENTS]
    ]
    title, notes = _title(sensor_map, score), _notes(sensor_map, score, len(others) - len(small))
    size = _SIDE if len(main) + len(small) > 1 else 1.6 * _SIDE
    return gallery_figure(title, [*main, *small], 3, "\n".join(notes), size=size, legend=True)


def plot(
    sensor_map: SensorMap,
    truth: SensorMap | Recording | ArrayLike | Score | None = None,
    *,
    ax: Axes | None = None,
) -> Axes:
    """Plot the largest component of a map, over its true positions if these are given.

    Parameters
    ----------
    sensor_map : SensorMap
        If there are more than three dimensions, the first three are drawn.
    truth : SensorMap, Recording, Score or array_like of shape (N, 2) or (N, 3), optional
        True positions, as for `anisomap.score`, or the score of this map. They are drawn as rings,
        and the map is aligned with them. Lines join true neighbours.
    ax : matplotlib Axes, optional
        Axes to draw into, with ``projection="3d"`` for data in 3D; by default, axes of a new
        figure.

    Returns
    -------
    matplotlib Axes
        `ax`, or the new axes; their figure is ``axes.figure``.

    Raises
    ------
    InputError
        If there is nothing to draw, or `ax` has a different dimension; see `anisomap.score`.
    MissingExtraError
        If matplotlib is not installed.
    """
    score = truth if isinstance(truth, Score) else None
    if truth is not None and not isinstance(truth, Score):
        score = score_map(sensor_map, truth, permutations=0)
    shown = _components(sensor_map, score)[0]
    with panel(ax, drawn_dimensions(sensor_map, score)) as axes:
        draw_configuration(axes, replace(shown, limits=box_around(shown.points, shown.truth)))
        if n_compared := len(places := shown.truth):
            pairs = np.arange(2 * n_compared).reshape(2, -1).T
            apart = segments(np.vstack([shown.points[:n_compared], places]), pairs)
            axes.plot(*apart.T, color=INK, linewidth=0.8, zorder=2.5)
            look = {"markersize": 7, "markerfacecolor": "none", "markeredgecolor": INK}
            axes.plot(*places.T, "o", **look, zorder=2.5)
    return axes


def _components(sensor_map: SensorMap, score: Score | None) -> list[Panel]:
    if not sensor_map.placed.any():
        raise InputError("no sensor of the map has a position; there is nothing to draw")
    return drawn_components(sensor_map, score)


def _title(sensor_map: SensorMap, score: Score | None) -> str:
    placed = f"{int(sensor_map.placed.sum())} {sensor_map.kind}s"
    parts = [shortened(printable(sensor_map.method), 60) or "map", placed]
    if score is not None:
        parts.append(f"Mantel r {score.mantel.r:.3f}")
    elif np.isfinite(sensor_map.stress):
        parts.append(f"Stress-1 {sensor_map.stress:.3f}")
    return ", ".join(parts)


def _notes(sensor_map: SensorMap, score: Score | None, hidden: int) -> list[str]:
    kind, pose = sensor_map.kind, f"The map is {sensor_map.pose}"
    joined = np.count_nonzero(sensor_map.component == 0) <= MAX_JOINED
    lines = "nearest neighbours on the map" if score is None else "true neighbours"
    told = f"Lines join {lines}. " if joined else ""
    if score is None:
        notes = [f"{pose}. {told}Each {kind} has the same colour in every view."]
    else:
        pose = f"{pose}, and was fitted to the truth"
        notes = [f"{told}Each {kind} has the same colour in both panels. {pose}."]
    unplaced = [shown_name(sensor_map.names[i]) for i in np.flatnonzero(~sensor_map.placed)]
    if unplaced:
        notes.append(f"Without a position: {join_items(unplaced, 12)}.")
    if single := sensor_map.component_sizes[1:].count(1):
        notes.append(f"Components of a single sensor, not drawn: {single}.")
    if hidden > 0:
        notes.append(f"Smaller components, not drawn: {hidden}.")
    if sensor_map.dimensions > 3:
        notes.append(f"The first three of {sensor_map.dimensions} dimensions are drawn.")
    caveats = [*sensor_map.notes, *layout_notes(sensor_map, score)]
    return notes + [f"Note: {shortened(printable(note), 400)}" for note in caveats]


def gallery_figure(
    title: str,
    panels: Sequence[Panel | Score],
    columns: int,
    note: str = "",
    *,
    size: float = 3.5,
    legend: bool = False,
) -> Figure:
    """Draw panels in rows; for a score, the distances that it compares.

    note: Text below the panels, with wrapped lines.
    size: Size of a panel, in inches.
    legend: Whether to explain the marks of faulty sensors and of sensors that were not compared.
    """
    if not panels:
        raise InputError("there are no panels to draw")
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    width = size * columns + _LEFT
    wide = int(width * _CHARACTERS_PER_INCH)
    lines = [line for part in note.splitlines() for line in textwrap.wrap(part, wide)]
    if len(lines) > _MAX_LINES:
        lines = [*lines[: _MAX_LINES - 1], "More notes are in the map file and in the report."]
    foot = _LINE * len(lines) + 0.65
    height = _HEAD + rows * size + foot
    maps = [shown for shown in panels if isinstance(shown, Panel)]
    with new_figure(width, height, title, lines) as figure:
        sides = {"left": _LEFT / width, "right": 1 - _RIGHT / width, "wspace": 0.32, "hspace": 0.34}
        cells = figure.add_gridspec(
            rows, columns, top=1 - _HEAD / height, bottom=foot / height, **sides
        )
        for i, shown in enumerate(panels):
            cell = cells[divmod(i, columns)]
            if isinstance(shown, Panel):
                draw_configuration(add_axes(figure, shown.dimensions, cell), shown)
            else:
                draw_distances(figure.add_subplot(cell), shown)
        if legend:
            marks: list[dict[str, str]] = []
            if any(shown.faulty.any() for shown in maps):
                marks.append({"marker": "x", "color": "black", "label": "faulty"})
            if any(shown.uncompared.any() for shown in maps):
                look = {"marker": "s", "mfc": "#b8b8b8", "mec": INK, "label": "not compared"}
                marks.append(look)
            add_legend(figure, marks, "upper right", (0.985, 1 - 0.12 / height))
        return figure


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
        pairs=pairs[~left_out[pairs].any(axis=1)],  # their positions on the map are arbitrary
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


def draw_configuration(axes: Axes, shown: Panel) -> None:
    """Draw a configuration with its neighbours joined, from back to front."""
    points = shown.points
    rings = points[:0] if shown.unplaced is None else shown.unplaced
    limits = box_around(points, rings) if shown.limits is None else shown.limits
    _set_up_axes(axes, limits, shown.view, shown.units)
    nearness = np.ones(len(points))
    if shown.dimensions == 3:
        depth = points @ view_axes(shown.view)[2]
        nearness = 1 - (depth.max() - depth) / np.ptp(limits, axis=1).max()
    _draw_layers(axes, shown, np.clip(nearness, 0, 1))
    if len(rings):
        axes.scatter(*rings.T, s=22, facecolors="none", edgecolors=FAINT, linewidths=0.7)
    rightwards = view_axes(shown.view)[0] if shown.dimensions == 3 else np.array([1.0, 0.0])
    middle = box_around(points).mean(axis=1)
    for i, name in shown.labels.items():
        _write_label(axes, points[i], name, bool((points[i] - middle) @ rightwards > 0))
    set_title(axes, shown.title)


def _set_up_axes(axes: Axes, limits: Points, view: View, units: str) -> None:
    """Set limits, an equal aspect, labels with units and the view. limits (k, 2)."""
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
    dot_layer = np.minimum((nearness * _N_LAYERS).astype(int), _N_LAYERS - 1)
    # A line has the depth of its further end, so that it never crosses a nearer dot.
    line_layer = dot_layer[shown.pairs].min(axis=1)
    size = _DOT_AREA * float(np.clip(np.sqrt(60 / len(points)), 0.02, 1))
    crowded, as_pixels = len(points) > _CROWDED, len(points) > MAX_VECTOR_DOTS
    common = {"rasterized": as_pixels} | ({"depthshade": False} if axes.name == "3d" else {})
    for layer in np.unique(dot_layer):
        near = (layer + 1) / _N_LAYERS
        axes.plot(
            *segments(points, shown.pairs[line_layer == layer]).T, color="#555b62",
            alpha=(0.12 + 0.5 * near**1.5) * (0.5 if crowded else 1),
            linewidth=(0.5 + 0.6 * near) * (0.6 if crowded else 1),
            rasterized=as_pixels, zorder=4 * layer + 1,
        )  # fmt: skip
        chosen = dot_layer == layer
        axes.scatter(
            *points[chosen].T, s=size * (0.4 + 0.6 * near), c=shown.colours[chosen],
            alpha=0.45 + 0.55 * near, linewidths=0 if crowded else 0.5, zorder=4 * layer + 2,
            edgecolors=np.where(shown.uncompared[chosen], FAINT, "white").tolist(), **common,
        )  # fmt: skip
        for marked, scale, style in ((shown.faulty, 1.3, _CROSS), (shown.uncompared, 2.6, _SQUARE)):
            if (here := points[marked & chosen]).size:
                area = scale * (size if as_pixels else max(size, 16))
                axes.scatter(*here.T, s=area, zorder=4 * layer + 3, **style, **common)


def _write_label(axes: Axes, point: Points, name: str, leftwards: bool) -> None:
    """Write a name to the left or right of a point, above all other marks."""
    halo = load("matplotlib.patheffects").withStroke(linewidth=2, foreground="white")
    axes.text(
        *point, f"{name}  " if leftwards else f"  {name}", ha="right" if leftwards else "left",
        va="bottom", fontsize=7.5, color=INK, parse_math=False, zorder=100, path_effects=[halo],
    )  # fmt: skip


_LOOKS = {
    "placed": ("#8a929a", MARKERS[0]),
    "anchors": (PALETTE[0], MARKERS[1]),
    "as stated": ("#a9b0b7", MARKERS[0]),
    "not tested": ("#dfe2e5", MARKERS[0]),
    **dict.fromkeys(("turned", "mirrored", "reversed"), (PALETTE[0], MARKERS[1])),
    **dict.fromkeys(
        ("exchanged", "moved", "overlapping", "contradicting"), (PALETTE[2], MARKERS[2])
    ),
    **dict.fromkeys(("swapped", "cycle", "shifted"), (PALETTE[1], MARKERS[3])),
    **dict.fromkeys(("dead", "doubled"), (PALETTE[3], "X")),
}
"""Colour and marker of each kind of sensor, by name in the legend; similar for similar kinds."""


def plot_placement(
    placement: Placement,
    anchors: Anchors | None = None,
    mesh: Mesh | None = None,
    *,
    ax: Axes | None = None,
) -> Axes:
    """Plot a placed map with its anchors.

    Parameters
    ----------
    placement : Placement
        From `anisomap.placement.place`.
    anchors : Anchors, optional
    mesh : Mesh, optional
        Drawn in 3D only.
    ax : matplotlib Axes, optional
        See `plot`, also for what is returned and raised.
    """
    placed = in_millimetres(placement.map)
    names = set(() if anchors is None else anchors.names)
    known = np.array([name in names for name in placed.names], dtype=bool)
    kinds = {"placed": placed.placed & ~known, "anchors": placed.placed & known}
    labels = {int(i): placed.names[i] for i in np.flatnonzero(kinds["anchors"])[:_MAX_LABELS]}
    nowhere = np.full_like(placed.positions, np.nan)
    title, note = f"Placed in {placed.frame}: {placement.methods[0]}", ""
    if np.isfinite(placed.errors).any():
        error = f"{float(np.nanmedian(placed.errors)):.2g} {placed.units}"
        note = f"90% of the sensors are within their error, {error} in the median."
    with panel(ax, span_dimensions(placement.map.positions), title, note, legend=4) as axes:
        _draw_displacements(axes, placed.positions, nowhere, kinds, labels, units=placed.units)
        if mesh is not None and axes.name == "3d":
            look = {"color": "#c9cdd2", "alpha": 0.25, "linewidth": 0, "zorder": 0}
            corners = mesh.vertices.T / METRES[placed.units]
            axes.plot_trisurf(*corners, triangles=mesh.faces, **look)
    return axes


def plot_layout(
    check: LayoutCheck, *, title: str = "Check of a layout", ax: Axes | None = None
) -> Axes:
    """Plot a layout, with arrows from stated to proposed positions.

    Parameters
    ----------
    check : LayoutCheck
        From `anisomap.check_layout`.
    title : str
    ax : matplotlib Axes, optional
        See `plot`, also for what is returned and raised.
    """
    layout, corrected = in_millimetres(check.layout), in_millimetres(check.corrected)
    status = np.array(["as stated" if one == "ok" else one for one in check.status])
    kinds = {kind: (status == kind) & layout.placed for kind in _LOOKS}
    start, end = layout.positions, corrected.positions
    changed = (start != end).any(axis=1) & layout.placed
    ends = [i for finding in check.findings for i in finding.sensors[[0, -1]].tolist()]
    labels = {i: layout.names[i] for i in ends[:_MAX_LABELS]}
    arrows = np.where(changed[:, None], end, np.nan)
    note = "Arrows lead from stated positions to proposed positions."
    with panel(ax, span_dimensions(start), title, note, legend=3) as axes:
        _draw_displacements(axes, start, arrows, kinds, labels, units=layout.units)
    return axes


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
    _set_up_axes(axes, limits, best_view(*shown) if k == 3 else (0.0, 0.0), units)
    size = _DOT_AREA * float(np.clip(np.sqrt(60 / drawn.sum()), 0.1, 1))
    flat = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.004}
    look = {"linewidth": 1.0, "arrow_length_ratio": 0.15} if k == 3 else flat
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
        if known.any():
            axes.quiver(*places[known].T, *arrows[known].T, color=colour, **look)
    for i, name in labels.items():
        right_half = bool(start[i, 0] > limits[0].mean())
        _write_label(axes, start[i], shown_name(name), right_half)
