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
from anisomap.drawing.view import axis_title, printable
from anisomap.errors import InputError
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
_LACKING = "#c0392b"
_COLUMNS, _MAX_SERIES = 3, 12
_INSTANTS = 600  # of a thumbnail; the range of the readings in each is drawn


def touch_figure(sensor_map: SensorMap, coverage: TouchCoverage) -> Figure:
    """Draw the panel of `plot_touches`; the arguments are the same."""
    return panel_figure(plot_touches, sensor_map, coverage, size=(7.0, 5.6))


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


@panel(lambda sensor_map: min(3, sensor_map.dimensions))
def plot_touches(sensor_map: SensorMap, coverage: TouchCoverage, *, ax: Axes = None) -> None:
    """Plot contacts by place on the map, neighbours never touched together, and where to touch.

    Sensors are darker the more contacts they had. Red lines join neighbours that were never
    touched together; numbers mark the places to touch next, the most urgent first.

    Parameters
    ----------
    sensor_map : SensorMap
        Its largest component is drawn, in its first two or three coordinates.
    coverage : TouchCoverage
        From `anisomap.health.touch_coverage`, of the same map.
    """
    dimensions = min(3, sensor_map.dimensions)
    drawn = np.flatnonzero(sensor_map.component == 0)
    points = sensor_map.positions[:, :dimensions]
    if dimensions == 1:
        points, dimensions = np.column_stack([points, np.zeros(len(points))]), 2
    apart = coverage.never_together[np.isin(coverage.never_together, drawn).all(axis=1)]
    for pair in apart.tolist():
        ax.plot(*points[pair].T, color=_LACKING, linewidth=1.0, zorder=1)
    contacts = coverage.contacts[drawn]
    classes = np.digitize(contacts, (1, MIN_CONTACTS, ENOUGH_CONTACTS))
    for i, label in enumerate(_CLASSES):
        some = points[drawn[classes == i]]
        if len(some):
            ax.scatter(
                *some.T, color=_SHADES[i], edgecolors=INK, linewidths=0.6, s=_DOT_AREA,
                marker=MARKERS[i], label=label, zorder=2,
            )  # fmt: skip
    ax.legend(frameon=False, fontsize=8, title="contacts")
    for rank, place in enumerate(coverage.places, start=1):
        if place.component == 0:
            where = points[list(place.sensors)].mean(axis=0)
            ax.text(
                *where, str(rank), fontsize=12, fontweight="bold", color=_LACKING, ha="center",
                va="center", zorder=3,
            )  # fmt: skip
    ax.set_aspect("equal")
    for name in "xyz"[:dimensions]:
        getattr(ax, f"set_{name}label")(axis_title(name, sensor_map.units), parse_math=False)
    set_title(ax, "Contacts, and where to touch next (1: first)")
