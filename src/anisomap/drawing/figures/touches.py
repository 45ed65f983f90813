"""Pictures of how a skin was touched: contacts by place, and readings of single sensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from anisomap.drawing.figures.backend import (
    INK,
    MARKERS,
    PALETTE,
    Axes,
    drawing_style,
    new_figure,
    panel,
    panel_figure,
    set_title,
)
from anisomap.drawing.figures.maps import prepare_panel
from anisomap.drawing.figures.panels import set_up_axes, write_labels
from anisomap.drawing.view import box_around, drawn_components, printable, segments
from anisomap.errors import InputError
from anisomap.evaluation import Score
from anisomap.health import SensorHealth, TouchCoverage
from anisomap.health.sensors import MIN_CONTACTS
from anisomap.health.touch_coverage import ENOUGH_CONTACTS
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Chosen by eye.
_DOT_AREA = 40.0
_CLASSES = (
    "none",
    f"fewer than {MIN_CONTACTS}",
    f"{MIN_CONTACTS} to {ENOUGH_CONTACTS - 1}",
    f"{ENOUGH_CONTACTS} or more",
)
_SHADES = ("#ffffff", "#cde2f2", "#5aa5d6", "#00426b")  # from light to dark, also in greyscale
_LACKING, _LINES = "#c0392b", "#c4c9ce"
_COLUMNS, _MAX_SERIES = 3, 12
_INSTANTS = 600  # of a thumbnail; the range of the readings in each is drawn


def touch_figure(
    sensor_map: SensorMap, coverage: TouchCoverage, score: Score | None = None
) -> Figure:
    """Draw the panel of `plot_touches`; the arguments are the same."""
    return panel_figure(plot_touches, sensor_map, coverage, score, size=(8.0, 5.6))


def series_figure(recording: Recording, doubted: Sequence[SensorHealth]) -> Figure:
    """Draw the readings of sensors over time, as thumbnails."""
    if not doubted:
        raise InputError("there is no sensor to draw")
    shown = list(doubted)[:_MAX_SERIES]
    rows = -(-len(shown) // _COLUMNS)
    with drawing_style():
        figure = new_figure(10.0, 0.3 + 1.5 * rows, layout="constrained")
        for i, sensor in enumerate(shown):
            axes = figure.add_subplot(rows, _COLUMNS, i + 1)
            readings = recording.readings[:, recording.names.index(sensor.name)]
            plot_series(readings, rate_hz=recording.rate_hz, ax=axes)
            set_title(axes, f"{printable(sensor.name)}: {sensor.status}")
        return figure


@panel()
def plot_series(
    readings: NDArray[np.floating], *, rate_hz: float | None = None, ax: Axes = None
) -> None:
    """Plot the range of the readings of a sensor over time. readings (T,)."""
    step = -(-len(readings) // _INSTANTS)
    starts = np.arange(0, len(readings), step)
    known = np.where(np.isfinite(readings), readings, np.nan)
    low = np.fmin.reduceat(known, starts)
    high = np.fmax.reduceat(known, starts)
    times = starts / (rate_hz or 1)
    ax.fill_between(times, low, high, step="post", color=PALETTE[0], linewidth=0.8)
    ax.set_xlabel("time (s)" if rate_hz else "frame")
    ax.set_ylabel("reading")


@panel(lambda sensor_map: 3 if sensor_map.dimensions > 2 else 2)
def plot_touches(
    sensor_map: SensorMap,
    coverage: TouchCoverage,
    score: Score | None = None,
    *,
    ax: Axes = None,
) -> None:
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
    drawn = drawn_components(sensor_map, score)
    if not drawn:
        raise InputError("every component of the map has a single sensor; there is nothing to draw")
    shown = prepare_panel(sensor_map, drawn[0])
    points = shown.points[:, : 3 if sensor_map.dimensions > 2 else 2]
    row = {int(sensor): i for i, sensor in enumerate(drawn[0].sensors)}
    set_up_axes(ax, box_around(points), shown.view, shown.units)
    ax.plot(*segments(points, shown.pairs).T, color=_LINES, linewidth=0.6, zorder=1)
    apart = [[row[i], row[j]] for i, j in coverage.never_together.tolist() if {i, j} <= row.keys()]
    if apart:
        ax.plot(*segments(points, np.array(apart)).T, color=_LACKING, linewidth=1.2, zorder=2)
    classes = np.digitize(coverage.contacts[drawn[0].sensors], (1, MIN_CONTACTS, ENOUGH_CONTACTS))
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
