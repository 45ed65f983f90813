"""Maps side by side, as in Figures 1, 2 and 7 of the paper."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.drawing.colours import VIEWS, View, place_colours
from anisomap.drawing.figures.backend import (
    FAINT,
    Axes,
    add_axes,
    drawing_style,
    new_figure,
    panel_axes,
    set_ticks,
    set_title,
    write_notes,
    write_title,
)
from anisomap.drawing.figures.panels import Look, draw_configuration
from anisomap.drawing.view import best_view, box_around, neighbour_pairs
from anisomap.errors import InputError
from anisomap.evaluation import Score
from anisomap.sensor_map import SensorMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FLAT_VIEW: View = (0.0, 0.0)  # ignored in 2D
_OBLIQUE_VIEW: View = (38.0, -68.0)  # of flat bodies, so that bending of the map is visible
# Inches.
_HEAD, _LINE, _BELOW = 0.45, 0.17, 0.35
_CHARACTERS_PER_INCH = 13.5


@dataclass(frozen=True, eq=False)
class Panel:
    """A configuration, with its appearance.

    Parameters
    ----------
    title : str
    points : ndarray of shape (n, k)
        Positions, k = 2 or 3.
    colours : ndarray of shape (n, 3)
        sRGB in [0, 1].
    pairs : ndarray of int, shape (E, 2)
        Points joined by lines.
    view : tuple of float
        Elevation and azimuth in degrees.
    units : str
        Of the axes.
    uncompared : ndarray of bool, shape (n,)
        Sensors that the score excludes; they are marked.
    labels : mapping of int to str
        Names written beside points.
    unplaced : ndarray of shape (m, k)
        True positions of sensors that maps do not place, drawn as rings.
    """

    title: str
    points: NDArray[np.float64]
    colours: NDArray[np.float64]
    pairs: NDArray[np.intp]
    view: View
    units: str
    uncompared: NDArray[np.bool_]
    labels: Mapping[int, str] = field(default_factory=dict)
    unplaced: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3)))


def truth_panel(
    title: str,
    truth: ArrayLike,
    *,
    units: str = "",
    on_maps: ArrayLike | None = None,
    excluded: ArrayLike | None = None,
    labels: Mapping[int, str] | None = None,
) -> Panel:
    """Prepare a panel of the true positions.

    Parameters
    ----------
    title : str
    truth : array_like of shape (N, k)
        True positions, k = 2 or 3.
    units : str
        Of `truth`.
    on_maps, excluded : array_like of bool, shape (N,), optional
        Sensors that maps place (default: all), and that scores exclude (default: none).
    labels : mapping of int to str, optional
        Names to write beside sensors.

    Returns
    -------
    Panel
    """
    places = np.asarray(truth, dtype=np.float64)
    return _panel(
        title,
        places,
        places,
        placed=_mask(on_maps, len(places), default=True),
        excluded=_mask(excluded, len(places), default=False),
        units=units,
        labels=labels or {},
        with_unplaced=True,
    )


def map_panel(
    title: str,
    sensor_map: SensorMap,
    score: Score,
    truth: ArrayLike,
    *,
    labels: Mapping[int, str] | None = None,
) -> Panel:
    """Prepare a panel of a map aligned with the truth, in the colours of the truth panel.

    Parameters
    ----------
    title : str
    sensor_map : SensorMap
    score : Score
        Score of this map, whose alignment is applied.
    truth : array_like of shape (N, k)
        As for `truth_panel`, in the order of the map; k is the number of dimensions drawn.
    labels : mapping of int to str, optional
        Names to write beside sensors.

    Returns
    -------
    Panel
    """
    places = np.asarray(truth, dtype=np.float64)
    fit = score.alignment
    padding = len(fit.translation) - sensor_map.dimensions
    positions = np.pad(sensor_map.positions, ((0, 0), (0, padding)))
    aligned = (fit.scale * positions @ fit.rotation.T + fit.translation)[:, : places.shape[1]]
    return _panel(
        title,
        aligned,
        places,
        placed=sensor_map.placed & (sensor_map.component == 0),
        excluded=np.isin(np.arange(sensor_map.n_sensors), score.excluded),
        units=score.units,
        labels=labels or {},
        with_unplaced=False,
    )


def gallery_figure(
    title: str, panels: Sequence[Panel], columns: int, note: str = "", *, size: float = 3.5
) -> Figure:
    """Draw panels in rows.

    Parameters
    ----------
    title : str
    panels : sequence of Panel
    columns : int
        Number of panels in a row.
    note : str
        Text below the panels.
    size : float
        Width and height of a panel, in inches.

    Returns
    -------
    matplotlib.figure.Figure
        With equal scales on all axes of a panel; save it with
        `anisomap.drawing.figures.save_figure`.

    Raises
    ------
    InputError
        If there are no panels.
    MissingExtraError
        If matplotlib is not installed.
    """
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
        cells = figure.add_gridspec(
            rows,
            columns,
            left=0.7 / width,
            right=1 - 0.5 / width,
            top=1 - (_HEAD + _BELOW) / height,
            bottom=(foot + _BELOW + 0.2) / height,
            wspace=0.22,
            hspace=0.34,
        )
        for i, panel in enumerate(panels):
            cell = cells[divmod(i, columns)]
            plot_panel(panel, ax=add_axes(figure, panel.points.shape[1], cell))
        write_title(figure, title)
        write_notes(figure, lines)
        return figure


def plot_panel(panel: Panel, *, ax: Axes | None = None) -> Axes:
    """Plot one panel.

    Parameters
    ----------
    panel : Panel
        From `truth_panel` or `map_panel`.
    ax : matplotlib Axes, optional
        Axes to draw into, with ``projection="3d"`` for 3D positions. A new figure is created by
        default.

    Returns
    -------
    matplotlib Axes
        `ax`, or the new axes; their figure is ``axes.figure``.

    Raises
    ------
    InputError
        If `ax` has another number of dimensions than the panel.
    MissingExtraError
        If matplotlib is not installed.
    """
    dimensions = panel.points.shape[1]
    axes = panel_axes(ax, dimensions)
    look = Look(
        colours=panel.colours,
        pairs=panel.pairs,
        faulty=np.zeros(len(panel.points), dtype=bool),
        uncompared=panel.uncompared,
        labels=dict(panel.labels),
    )
    limits = box_around(panel.points, panel.unplaced[:, :dimensions])
    draw_configuration(axes, panel.points, look, limits=limits, view=panel.view, units=panel.units)
    set_ticks(axes, np.ptp(limits, axis=1), 3)
    for name in "xyz"[:dimensions]:
        axis = getattr(axes, f"{name}axis")
        axis.label.set_size(8)
        axis.set_tick_params(labelsize=7)
    if len(panel.unplaced):
        axes.scatter(*panel.unplaced.T, s=22, facecolors="none", edgecolors=FAINT, linewidths=0.7)
    set_title(axes, panel.title)
    return axes


def _panel(
    title: str,
    points: NDArray[np.float64],
    truth: NDArray[np.float64],
    *,
    placed: NDArray[np.bool_],
    excluded: NDArray[np.bool_],
    units: str,
    labels: Mapping[int, str],
    with_unplaced: bool,
) -> Panel:
    view = _view(truth)
    rows = np.flatnonzero(placed)
    row_of = {int(sensor): i for i, sensor in enumerate(rows)}
    return Panel(
        title=title,
        points=points[rows],
        colours=place_colours(truth, view)[rows],
        pairs=_joined(truth, rows, excluded),
        view=view,
        units=units,
        uncompared=excluded[rows],
        labels={row_of[sensor]: name for sensor, name in labels.items() if sensor in row_of},
        unplaced=points[~placed] if with_unplaced else points[:0],
    )


def _view(truth: NDArray[np.float64]) -> View:
    if truth.shape[1] == 2:
        return _FLAT_VIEW
    return VIEWS[0] if best_view(truth) == VIEWS[0] else _OBLIQUE_VIEW


def _joined(
    truth: NDArray[np.float64], rows: NDArray[np.intp], excluded: NDArray[np.bool_]
) -> NDArray[np.intp]:
    """Join true neighbours, except excluded sensors, whose position on the map is arbitrary."""
    pairs = neighbour_pairs(truth[rows])
    return pairs[~excluded[rows][pairs].any(axis=1)]


def _mask(given: ArrayLike | None, count: int, *, default: bool) -> NDArray[np.bool_]:
    return np.full(count, default) if given is None else np.asarray(given, dtype=bool)
