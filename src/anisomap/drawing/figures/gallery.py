"""Several maps of one skin side by side, or of several skins: the paper's Figures 1, 2 and 7."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.drawing.figures import load_drawing
from anisomap.drawing.view import VIEWS, View, best_view, neighbour_pairs, place_colours
from anisomap.errors import InputError
from anisomap.evaluation import Score
from anisomap.sensor_map import SensorMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FLAT: View = (0.0, 0.0)
_OBLIQUE: View = (38.0, -68.0)  # at flat bodies, so that a map that is bent shows it


@dataclass(frozen=True, eq=False)
class Panel:
    """One configuration as it is drawn.

    Parameters
    ----------
    title : str
    points : ndarray of shape (n, k)
        k = 2 or 3.
    colours : ndarray of shape (n, 3)
        sRGB in [0, 1].
    pairs : ndarray of int, shape (E, 2)
        Which points a line joins.
    view : tuple of float
        Elevation and azimuth of the eye, in degrees.
    units : str
        Of the axes.
    unscored : ndarray of bool, shape (n,)
        Which sensors no score counts; they bear a mark.
    labels : mapping of int to str
        Names to write beside points.
    ghosts : ndarray of shape (m, k)
        Places of sensors that are on no map.
    """

    title: str
    points: NDArray[np.float64]
    colours: NDArray[np.float64]
    pairs: NDArray[np.intp]
    view: View
    units: str
    unscored: NDArray[np.bool_]
    labels: Mapping[int, str] = field(default_factory=dict)
    ghosts: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3)))


def truth_panel(
    title: str,
    truth: ArrayLike,
    *,
    units: str = "",
    on_maps: ArrayLike | None = None,
    excluded: ArrayLike | None = None,
    labels: Mapping[int, str] | None = None,
) -> Panel:
    """Show where sensors truly are.

    Parameters
    ----------
    title : str
    truth : array_like of shape (N, k)
        Where the sensors are, k = 2 or 3.
    units : str
        Of `truth`.
    on_maps, excluded : array_like of bool, shape (N,), optional
        Which sensors maps place (all unless given), and which scores leave out (none).
    labels : mapping of int to str, optional
        Names to write beside some sensors.

    Returns
    -------
    Panel
    """
    places = np.asarray(truth, dtype=np.float64)
    placed = _mask(on_maps, len(places), default=True)
    left_out = _mask(excluded, len(places), default=False)
    return _panel(
        title,
        places,
        places,
        placed=placed,
        excluded=left_out,
        units=units,
        labels=labels or {},
        with_ghosts=True,
    )


def map_panel(
    title: str,
    sensor_map: SensorMap,
    score: Score,
    truth: ArrayLike,
    *,
    labels: Mapping[int, str] | None = None,
) -> Panel:
    """Show a map, laid onto the truth: a sensor has the colour that it has there.

    Parameters
    ----------
    title : str
    sensor_map : SensorMap
    score : Score
        Of this very map; its alignment lays the map onto the truth.
    truth : array_like of shape (N, k)
        As for `truth_panel`, in the order of the map; k as many dimensions as are drawn.
    labels : mapping of int to str, optional
        Names to write beside some sensors.

    Returns
    -------
    Panel
    """
    places = np.asarray(truth, dtype=np.float64)
    fit = score.alignment
    padding = len(fit.translation) - sensor_map.dimensions
    positions = np.pad(sensor_map.positions, ((0, 0), (0, padding)))
    laid = (fit.scale * positions @ fit.rotation.T + fit.translation)[:, : places.shape[1]]
    return _panel(
        title,
        laid,
        places,
        placed=sensor_map.placed & (sensor_map.component == 0),
        excluded=np.isin(np.arange(sensor_map.n_sensors), score.excluded),
        units=score.units,
        labels=labels or {},
        with_ghosts=False,
    )


def gallery_figure(
    title: str, panels: Sequence[Panel], columns: int, note: str = "", *, size: float = 3.5
) -> Figure:
    """Draw panels, row by row.

    Parameters
    ----------
    title : str
    panels : sequence of Panel
    columns : int
        Panels a row.
    note : str
        What to say below.
    size : float
        Inches, of a panel.

    Returns
    -------
    matplotlib.figure.Figure
        Axes of a panel are equal; save it with `anisomap.drawing.figures.save_figure`.

    Raises
    ------
    InputError
        If there is no panel.
    MissingExtraError
        If matplotlib is not installed.
    """
    if not panels:
        raise InputError("there is no panel to draw")
    figure: Figure = load_drawing("_gallery").gallery_figure(title, panels, columns, note, size)
    return figure


def _panel(
    title: str,
    points: NDArray[np.float64],
    truth: NDArray[np.float64],
    *,
    placed: NDArray[np.bool_],
    excluded: NDArray[np.bool_],
    units: str,
    labels: Mapping[int, str],
    with_ghosts: bool,
) -> Panel:
    view = _view(truth)
    rows = np.flatnonzero(placed)
    place = {int(sensor): i for i, sensor in enumerate(rows)}
    return Panel(
        title=title,
        points=points[rows],
        colours=place_colours(truth, view)[rows],
        pairs=_joined(truth, rows, excluded),
        view=view,
        units=units,
        unscored=excluded[rows],
        labels={place[sensor]: name for sensor, name in labels.items() if sensor in place},
        ghosts=points[~placed] if with_ghosts else points[:0],
    )


def _view(truth: NDArray[np.float64]) -> View:
    if truth.shape[1] == 2:
        return _FLAT
    return VIEWS[0] if best_view(truth) == VIEWS[0] else _OBLIQUE


def _joined(
    truth: NDArray[np.float64], rows: NDArray[np.intp], excluded: NDArray[np.bool_]
) -> NDArray[np.intp]:
    """Join true neighbours; one that is left out of scores may be anywhere, and is not joined."""
    pairs = neighbour_pairs(truth[rows])
    return pairs[~excluded[rows][pairs].any(axis=1)]


def _mask(given: ArrayLike | None, count: int, *, default: bool) -> NDArray[np.bool_]:
    return np.full(count, default) if given is None else np.asarray(given, dtype=bool)
