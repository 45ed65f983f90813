"""Figures of a map: beside the truth where it is known, from several sides where it is not."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from anisomap.drawing.figures.backend import (
    INK,
    Axes,
    add_axes,
    drawing_style,
    load,
    new_figure,
    open_axes,
    panel,
    set_title,
    write_notes,
    write_title,
)
from anisomap.drawing.figures.panels import draw_configuration, draw_distances
from anisomap.drawing.view import (
    MAX_JOINED,
    MAX_LABEL,
    VIEWS,
    Panel,
    Points,
    box_around,
    drawn_components,
    layout_notes,
    printable,
)
from anisomap.errors import InputError
from anisomap.evaluation import Score
from anisomap.evaluation import score as score_map
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap
from anisomap.wording import join_items

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

# Inches.
_WIDTH, _NARROW, _HEAD, _ROW, _SMALL_ROW, _FOOT, _LINE = 14.0, 8.0, 0.5, 5.4, 4.2, 0.2, 0.17
_COLUMNS, _MAX_SMALL_PANELS = 3, 9
_COMPARISON = (1.2, 1.2, 0.02, 0.95)  # the third is a gap for the z axis and its title
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
    drawn = _components(sensor_map, score)
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
        write_title(figure, _title(sensor_map, score), x=0.28, y=0.2)
        write_notes(figure, notes, x=0.28, y=0.15)
        _add_legend(figure, first + small)
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
    shown = largest_component(sensor_map, score)
    axes = open_axes(ax, shown.dimensions)
    draw_configuration(axes, shown)
    return axes


@panel()
def plot_distances(score: Score, *, ax: Axes = None) -> None:
    """Plot the distances between sensors on the map against the true distances.

    Parameters
    ----------
    score : Score
        Score of a map.
    """
    draw_distances(ax, score.truth, score.alignment.aligned, score.units)


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
    error = f"{score.rms:.3g} {printable(score.units, 24)}".strip()
    spacings = f" = {score.rms_in_spacings:.2g} sensor spacings" if score.spacing > 0 else ""
    limits = box_around(shown.truth, shown.points)
    _draw(figure, cells[0], shown.true(), "True positions", limits)
    _draw(figure, cells[1], shown, f"Map, {how} to fit\nRMS error {error}{spacings}", limits)
    axes = figure.add_subplot(cells[-1])
    label = draw_distances(axes, score.truth, score.alignment.aligned, score.units)
    set_title(axes, f"Distances: {_agreement(score)}\n{label}")


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
    kind = "nearest neighbours on the map" if score is None else "true neighbours"
    lines = f"Lines join {kind}. " if joined else ""
    pose = f"The map is {sensor_map.pose}"
    notes = [f"{pose}. {lines}A sensor has the same colour in every view."]
    if score is not None:
        same = f"{lines}A sensor has the same colour in both panels."
        notes = [f"{same} {pose}, and was fitted to the truth."]
    if sensor_map.covariances is not None and joined:
        notes.append(
            "Ellipses hold 95 % of the true positions, on average over maps of known skins."
        )
    unplaced = [
        printable(sensor_map.names[i], MAX_LABEL) for i in np.flatnonzero(~sensor_map.placed)
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


def _add_legend(figure: Figure, drawn: Sequence[Panel]) -> None:
    marks = []
    line = load("matplotlib.lines").Line2D
    if any(component.faulty.any() for component in drawn):
        marks.append(line([], [], ls="none", marker="x", color="black", label="faulty"))
    if any(component.uncompared.any() for component in drawn):
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
