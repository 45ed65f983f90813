"""Figures of a map: beside the truth where it is known, from several sides where it is not."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.drawing.figures.backend import (
    INK,
    Axes,
    add_axes,
    drawing_style,
    load,
    new_figure,
    panel,
    set_title,
    write_notes,
    write_title,
)
from anisomap.drawing.figures.panels import Panel, draw_configuration, draw_distances
from anisomap.drawing.view import (
    MAX_JOINED,
    VIEWS,
    Component,
    View,
    box_around,
    drawn_components,
    layout_notes,
    outlines,
    printable,
    view_axes,
)
from anisomap.errors import InputError
from anisomap.evaluation import Score
from anisomap.evaluation import score as score_map
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap, is_faulty
from anisomap.wording import join_items

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.gridspec import GridSpec

# Inches.
_WIDTH, _NARROW, _HEAD, _ROW, _SMALL_ROW, _FOOT, _LINE = 14.0, 8.0, 0.5, 5.4, 4.2, 0.2, 0.17
_COLUMNS, _MAX_SMALL_PANELS = 3, 9
_SIDES = (1.0, 1.0, 1.0)
_COMPARISON = (1.2, 1.2, 0.02, 0.95)  # the third is a gap for the z axis and its title
_N_LABELS, _LABEL_ALL, _MAX_LABEL = 8, 24, 14
_CHARACTERS_PER_INCH, _MAX_LINES = 13.5, 10


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
    _check_placed(sensor_map)
    drawn = drawn_components(sensor_map, score)
    first = drawn[:1] if score is not None or len(drawn) == 1 else []
    others = drawn[len(first) :]
    small = others[:_MAX_SMALL_PANELS]
    flat = bool(first) and score is None and first[0].dimensions == 2
    width = _NARROW if flat else _WIDTH
    notes = _notes(sensor_map, score, len(others) - len(small), width)
    main_row = _ROW if first else 0.0
    height = _HEAD + main_row - (-len(small) // _COLUMNS) * _SMALL_ROW
    with drawing_style():
        figure = new_figure(width, height + _FOOT + _LINE * len(notes))
        for component in first:
            if score is None:
                cells = _cells(figure, 0, _ROW, (1.0,) if flat else _SIDES)
                _draw_alone(figure, sensor_map, component, cells)
            else:
                cells = _cells(figure, 0, _ROW, _COMPARISON)
                _draw_comparison(figure, sensor_map, component, score, cells)
        for i, component in enumerate(small):
            row, column = divmod(i, _COLUMNS)
            cells = _cells(figure, main_row + row * _SMALL_ROW, _SMALL_ROW, (1.0,) * _COLUMNS)
            axes = add_axes(figure, component.dimensions, cells[0, column])
            draw_configuration(axes, prepare_panel(sensor_map, component))
            count = len(component.points)
            set_title(axes, f"Component {component.number}: {count} sensors, own coordinate frame")
        write_title(figure, _title(sensor_map, score), x=0.28, y=0.2)
        write_notes(figure, notes, x=0.28, y=0.15)
        _add_legend(figure, sensor_map, first + small)
        return figure


def plot(
    sensor_map: SensorMap,
    truth: SensorMap | Recording | ArrayLike | None = None,
    *,
    ax: Axes | None = None,
) -> Axes:
    """Plot the largest component of a map, on its true positions if these are known.

    Parameters
    ----------
    sensor_map : SensorMap
        Of more than three dimensions, the first three are drawn.
    truth : SensorMap, Recording or array_like of shape (N, 2) or (N, 3), optional
        True positions, as for `anisomap.score`: the map is aligned with them, and lines join true
        neighbours.
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


def plot_map(sensor_map: SensorMap, score: Score | None = None, *, ax: Axes | None = None) -> Axes:
    """Plot the largest component of a map in one panel.

    Parameters
    ----------
    sensor_map : SensorMap
        Of more than three dimensions, the first three are drawn.
    score : Score, optional
        Score of this map: the map is aligned with the truth, and true neighbours are joined.
    ax : matplotlib Axes, optional
        Axes to draw into, with ``projection="3d"`` for a map in 3D or a truth in 3D. A new figure
        is created by default.

    Returns
    -------
    matplotlib Axes
        `ax`, or the new axes; their figure is ``axes.figure``.

    Raises
    ------
    InputError
        If no sensor has a position, or `ax` has another number of dimensions.
    MissingExtraError
        If matplotlib is not installed.
    """
    _check_placed(sensor_map)
    drawn = drawn_components(sensor_map, score)
    if not drawn:
        raise InputError("every component of the map has a single sensor; there is nothing to draw")
    return plot_component(prepare_panel(sensor_map, drawn[0]), ax=ax)


@panel(lambda shown: shown.points.shape[1])
def plot_component(shown: Panel, *, ax: Axes = None) -> None:
    """Plot one component of a map."""
    draw_configuration(ax, shown)


@panel()
def plot_distances(score: Score, *, ax: Axes = None) -> None:
    """Plot the distances between sensors on the map against the true distances.

    Parameters
    ----------
    score : Score
        Score of a map.
    """
    draw_distances(ax, score.truth, score.alignment.aligned, score.units)


def _check_placed(sensor_map: SensorMap) -> None:
    if not sensor_map.placed.any():
        raise InputError("no sensor of the map has a position; there is nothing to draw")


def _cells(figure: Figure, top: float, height: float, ratios: Sequence[float]) -> GridSpec:
    """Create a row of cells for panels, `top` inches below the head."""
    total = figure.get_figheight()
    upper = total - _HEAD - top - 0.55
    return figure.add_gridspec(
        1,
        len(ratios),
        left=0.045,
        right=0.985,
        top=upper / total,
        bottom=(upper - height + 1.15) / total,
        wspace=0.2,
        width_ratios=ratios,
    )


def _draw_comparison(
    figure: Figure, sensor_map: SensorMap, component: Component, score: Score, cells: GridSpec
) -> None:
    alignment = score.alignment
    how = "rotated, scaled and reflected" if alignment.reflected else "rotated and scaled"
    error = f"{score.rms:.3g} {printable(score.units, 24)}".strip()
    spacings = f" = {score.rms_in_spacings:.2g} sensor spacings" if score.spacing > 0 else ""
    shown = prepare_panel(sensor_map, component)
    n_compared = len(component.truth)
    truth = replace(
        shown,
        points=component.truth,
        colours=shown.colours[:n_compared],
        uncompared=shown.uncompared[:n_compared],
        faulty=shown.faulty[:n_compared],
        labels={i: name for i, name in shown.labels.items() if i < n_compared},
        outlines=None,
    )
    titles = ("True positions", f"Map, {how} to fit\nRMS error {error}{spacings}")
    for column, (title, one) in enumerate(zip(titles, (truth, shown), strict=True)):
        axes = add_axes(figure, component.dimensions, cells[0, column])
        draw_configuration(axes, one, box_around(component.truth, component.points))
        set_title(axes, title)
    axes = figure.add_subplot(cells[0, len(_COMPARISON) - 1])
    label = draw_distances(axes, score.truth, alignment.aligned, score.units)
    set_title(axes, f"Distances: {_agreement(score)}\n{label}")


def _draw_alone(
    figure: Figure, sensor_map: SensorMap, component: Component, cells: GridSpec
) -> None:
    sides: tuple[tuple[str, View], ...] = (("", VIEWS[0]),)
    if component.dimensions == 3:
        sides = tuple(zip(("From the front", "From the right", "From above"), VIEWS, strict=True))
    for column, (title, view) in enumerate(sides):
        axes = add_axes(figure, component.dimensions, cells[0, column])
        draw_configuration(axes, prepare_panel(sensor_map, component, view))
        set_title(axes, title)


def prepare_panel(sensor_map: SensorMap, component: Component, view: View | None = None) -> Panel:
    """Prepare a component of a map for drawing, with the names of distant sensors."""
    reference = component.truth if len(component.truth) else component.points
    labelled = _sensors_to_label(reference, component.view)
    view = view or component.view
    return Panel(
        points=component.points,
        colours=component.colours,
        pairs=component.pairs,
        view=view,
        units=component.units,
        uncompared=~component.compared,
        faulty=_faulty(sensor_map, component),
        labels={i: printable(sensor_map.names[component.sensors[i]], _MAX_LABEL) for i in labelled},
        outlines=outlines(component, view),
    )


def _faulty(sensor_map: SensorMap, component: Component) -> NDArray[np.bool_]:
    return np.array([is_faulty(sensor_map.health[i]) for i in component.sensors], dtype=bool)


def _sensors_to_label(points: NDArray[np.float64], view: View) -> list[int]:
    """Choose distant sensors, in 3D from the nearer half, by farthest-point sampling."""
    candidates = np.arange(len(points))
    if len(points) <= _LABEL_ALL:
        return candidates.tolist()
    if points.shape[1] == 3:
        nearness = points @ view_axes(view)[2]
        candidates = np.flatnonzero(nearness >= np.median(nearness))
    chosen = [int(candidates[np.argmin(points[candidates].sum(axis=1))])]
    distances = np.full(len(candidates), np.inf)
    while len(chosen) < _N_LABELS:
        step = np.linalg.norm(points[candidates] - points[chosen[-1]], axis=1)
        distances = np.minimum(distances, step)
        chosen.append(int(candidates[np.argmax(distances)]))
    return chosen


def _title(sensor_map: SensorMap, score: Score | None) -> str:
    parts = [printable(sensor_map.method, 60) or "map", f"{int(sensor_map.placed.sum())} sensors"]
    if sensor_map.approximate:
        parts.insert(1, "approximate")
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
    if score is None:
        lines = "Lines join nearest neighbours on the map. " if joined else ""
        notes = [
            f"The map is {sensor_map.pose}. {lines}A sensor has the same colour in every view."
        ]
    else:
        lines = "Lines join true neighbours. " if joined else ""
        notes = [
            f"{lines}A sensor has the same colour in both panels. "
            f"The map is {sensor_map.pose}, and was fitted to the truth."
        ]
    if sensor_map.covariances is not None and joined:
        notes.append(
            "Ellipses hold 95 % of the true positions, on average over maps of known skins."
        )
    unplaced = [
        printable(sensor_map.names[i], _MAX_LABEL) for i in np.flatnonzero(~sensor_map.placed)
    ]
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
    notes += [f"Note: {printable(note, 400)}" for note in caveats]
    wrapped = [
        line for note in notes for line in textwrap.wrap(note, int(width * _CHARACTERS_PER_INCH))
    ]
    if len(wrapped) > _MAX_LINES:
        wrapped = [*wrapped[: _MAX_LINES - 1], "More notes are in the map file and in the report."]
    return wrapped


def _add_legend(figure: Figure, sensor_map: SensorMap, drawn: Sequence[Component]) -> None:
    marks = []
    line = load("matplotlib.lines").Line2D
    if any(_faulty(sensor_map, component).any() for component in drawn):
        marks.append(line([], [], ls="none", marker="x", color="black", label="faulty"))
    if any(not component.compared.all() for component in drawn):
        marks.append(
            line([], [], ls="none", marker="s", mfc="#b8b8b8", mec=INK, label="not compared")
        )
    if marks:
        figure.legend(
            handles=marks,
            loc="upper right",
            bbox_to_anchor=(0.985, 1 - 0.12 / figure.get_figheight()),
            ncols=len(marks),
            frameon=False,
            fontsize=9,
        )
