"""Pictures of the diagnostics of multidimensional scaling, and of how a skin was touched."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from anisomap.drawing.figures.backend import (
    FAINT,
    INK,
    MARKERS,
    PALETTE,
    Axes,
    panel_axes,
    set_title,
)
from anisomap.drawing.view import printable
from anisomap.evaluation import Shepard, ShiftTest
from anisomap.health import TouchCoverage
from anisomap.health.assessment import MIN_CONTACTS
from anisomap.health.touch_coverage import ENOUGH_CONTACTS
from anisomap.sensor_map import SensorMap

# Chosen by eye.
_MAX_DOTS = 3_000
_N_LABELS = 6
_DOT_AREA = 40.0
_CLASSES = (
    "none",
    f"fewer than {MIN_CONTACTS}",
    f"{MIN_CONTACTS} to {ENOUGH_CONTACTS - 1}",
    f"{ENOUGH_CONTACTS} or more",
)
_SHADES = ("#ffffff", "#cde2f2", "#5aa5d6", "#00426b")  # from light to dark, also in greyscale
_LACKING = "#c0392b"


def plot_stress_per_point(
    shares: Sequence[float], names: Sequence[str] = (), *, ax: Axes | None = None
) -> Axes:
    """Plot the share of each sensor in the stress, the greatest first, and name the greatest.

    Parameters
    ----------
    shares : sequence of float
        From `anisomap.evaluation.stress_per_point`.
    names : sequence of str
        Names of the sensors; their indices by default.
    ax : matplotlib Axes, optional
        Axes to draw into. A new figure is created by default.

    Returns
    -------
    matplotlib Axes
    """
    axes = panel_axes(ax)
    values = 100 * np.asarray(shares, dtype=np.float64)
    order = np.argsort(-values, kind="stable")
    labels = names or [str(i) for i in range(len(values))]
    axes.plot(np.arange(1, len(order) + 1), values[order], ".", color=PALETTE[0], markersize=5)
    for rank, i in enumerate(order[:_N_LABELS].tolist(), start=1):
        axes.annotate(
            f" {printable(labels[i])}", (rank, values[i]), fontsize=7, color=INK, parse_math=False
        )
    axes.axhline(100 / len(values), color=FAINT, linewidth=0.8, linestyle=":")
    axes.set(xlabel="rank of the sensor", ylabel="share of the stress, %")
    axes.set_ylim(bottom=0)
    set_title(axes, "Stress per point (dotted: equal shares)")
    return axes


def plot_shepard(found: Shepard, *, units: str = "", ax: Axes | None = None) -> Axes:
    """Plot a Shepard diagram: distances against dissimilarities, and the monotone fit.

    Parameters
    ----------
    found : Shepard
        From `anisomap.evaluation.shepard`. Of more than 3000 pairs, evenly chosen ones are drawn.
    units : str
        Unit of the positions.
    ax : matplotlib Axes, optional
        Axes to draw into. A new figure is created by default.

    Returns
    -------
    matplotlib Axes
    """
    axes = panel_axes(ax)
    some = slice(None, None, -(-len(found.distances) // _MAX_DOTS))
    axes.plot(
        found.dissimilarities[some], found.distances[some], ".", color=PALETTE[0], alpha=0.4,
        markersize=3, markeredgewidth=0,
    )  # fmt: skip
    axes.step(
        found.dissimilarities, found.disparities, where="post", color=PALETTE[1], linewidth=1.4
    )
    axes.set(
        xlabel="dissimilarity",
        ylabel=f"distance on the map ({units})" if units else "distance on the map",
        xlim=(0, None),
        ylim=(0, None),
    )
    fit = f"monotone fit: R squared {found.nonmetric_fit:.3f}, linear {found.linear_fit:.3f}"
    set_title(axes, f"Shepard diagram ({fit})")
    return axes


def plot_shift_test(found: ShiftTest, *, label: str = "statistic", ax: Axes | None = None) -> Axes:
    """Plot the null distribution of a test by shifts, and the observed value.

    Parameters
    ----------
    found : ShiftTest
        From `anisomap.evaluation.shift_test`.
    label : str
        Name of the statistic, with its unit.
    ax : matplotlib Axes, optional
        Axes to draw into. A new figure is created by default.

    Returns
    -------
    matplotlib Axes
    """
    axes = panel_axes(ax)
    axes.hist(found.null, bins="auto", color=PALETTE[0], alpha=0.6, label="sensors shifted in time")
    axes.axvline(found.observed, color=PALETTE[1], linewidth=1.6, label="recording")
    axes.set(xlabel=label, ylabel="number of shifted recordings")
    axes.legend(frameon=False, fontsize=8)
    set_title(axes, f"Test by circular shifts: p = {found.p_value:.3g}")
    return axes


def plot_touches(sensor_map: SensorMap, coverage: TouchCoverage, *, ax: Axes | None = None) -> Axes:
    """Plot contacts by place on the map, neighbours never touched together, and where to touch.

    Parameters
    ----------
    sensor_map : SensorMap
        Its largest component is drawn, in its first two or three coordinates.
    coverage : TouchCoverage
        From `anisomap.health.touch_coverage`, of the same map.
    ax : matplotlib Axes, optional
        Axes to draw into, 3D for a map in 3D. A new figure is created by default.

    Returns
    -------
    matplotlib Axes
        Sensors are darker the more contacts they had. Red lines join neighbours that were never
        touched together; numbers mark the places to touch next, the most urgent first.
    """
    dimensions = min(3, sensor_map.dimensions)
    axes = panel_axes(ax, dimensions)
    drawn = np.flatnonzero(sensor_map.component == 0)
    points = sensor_map.positions[:, :dimensions]
    if dimensions == 1:
        points, dimensions = np.column_stack([points, np.zeros(len(points))]), 2
    apart = coverage.never_together[np.isin(coverage.never_together, drawn).all(axis=1)]
    for pair in apart.tolist():
        axes.plot(*points[pair].T, color=_LACKING, linewidth=1.0, zorder=1)
    contacts = coverage.contacts[drawn]
    classes = np.digitize(contacts, (1, MIN_CONTACTS, ENOUGH_CONTACTS))
    for i, label in enumerate(_CLASSES):
        some = points[drawn[classes == i]]
        if len(some):
            axes.scatter(
                *some.T, color=_SHADES[i], edgecolors=INK, linewidths=0.6, s=_DOT_AREA,
                marker=MARKERS[i], label=label, zorder=2,
            )  # fmt: skip
    axes.legend(frameon=False, fontsize=8, title="contacts")
    for rank, place in enumerate(coverage.places, start=1):
        if place.component == 0:
            where = points[list(place.sensors)].mean(axis=0)
            axes.text(
                *where, str(rank), fontsize=12, fontweight="bold", color=_LACKING, ha="center",
                va="center", zorder=3,
            )  # fmt: skip
    axes.set_aspect("equal")
    for name in "xyz"[:dimensions]:
        getattr(axes, f"set_{name}label")(f"{name} ({sensor_map.units})")
    set_title(axes, "Contacts, and where to touch next (1: first)")
    return axes
