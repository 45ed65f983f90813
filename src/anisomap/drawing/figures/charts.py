"""Charts: scores with their nulls, curves over a parameter, distances, stress and readings."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from anisomap.base.wording import printable
from anisomap.drawing.figures.backend import (
    FAINT,
    INK,
    MARKERS,
    PALETTE,
    Axes,
    add_legend,
    load,
    new_figure,
    set_title,
)
from anisomap.drawing.view import axis_title
from anisomap.errors import InputError
from anisomap.evaluation import Score
from anisomap.health import SensorHealth
from anisomap.recording import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Values: TypeAlias = NDArray[Any]

_WIDTH, _HEAD = 12.0, 0.75  # inches
_GAP = 1.0  # between groups, in widths of a method
_COLUMNS, _MAX_SERIES = 3, 12
_INSTANTS = 600  # intervals of a series; the range of the readings in each is drawn
_MAX_DOTS = 3_000  # pairs drawn as dots
_MAX_SENSORS = 1_500  # sensors whose distances are all drawn
_CELL, _ROW_LABEL, _COLUMN_LABEL = (0.4, 0.34), 5.0, 2.6  # of counts, in inches
_DARK = 0.5  # share below which a cell is dark
_SPREAD = 0.22  # of the scores of a method, relative to its width


@dataclass(frozen=True)
class MethodLook:
    """Label, colour and marker of a method in every chart."""

    label: str
    colour: str
    marker: str


METHOD_LOOKS = {
    "r-anisomap": MethodLook("r-ANISOMAP", PALETTE[0], MARKERS[0]),
    "i-anisomap": MethodLook("I-ANISOMAP", PALETTE[1], MARKERS[1]),
    "information-distance": MethodLook("information distance", PALETTE[2], MARKERS[2]),
    "isomap": MethodLook("ISOMAP", PALETTE[3], MARKERS[3]),
}


@dataclass(frozen=True)
class ScoreGroup:
    """Scores of several methods on one kind of run.

    scores: One value per run, by method.
    nulls: Box plots of null distributions, by method: arguments of matplotlib's ``bxp``.
    """

    label: str
    scores: Mapping[str, Sequence[float]]
    nulls: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, eq=False)
class CurvePanel:
    """Curves of several methods over a parameter x (L,).

    curves (L, S): One value per run, by method; NaN for missing values.
    """

    title: str
    x: Values
    curves: Mapping[str, Values]


@dataclass(frozen=True, eq=False)
class CountPanel:
    """Columns of counts and totals, (rows, columns); cells with a total of 0 remain empty.

    labels: Labels of the columns.
    """

    title: str
    labels: Sequence[str]
    held: Values
    totals: Values


def scores_figure(title: str, rows: Sequence[Sequence[ScoreGroup]]) -> Figure:
    """Draw scores as dots with their mean, and box plots of their nulls."""
    if not any(rows):
        raise InputError("there are no scores to draw")
    used = {method for groups in rows for group in groups for method in group.scores}
    with new_figure(_WIDTH, 0.9 + 3.6 * len(rows), title) as figure:
        _add_head(figure, METHOD_LOOKS, used)
        for i, groups in enumerate(rows):
            _draw_scores(figure.add_subplot(len(rows), 1, i + 1), groups)
        return figure


def curves_figure(
    title: str,
    panels: Sequence[CurvePanel],
    *,
    x_label: str,
    looks: Mapping[str, MethodLook] = METHOD_LOOKS,
) -> Figure:
    """Draw scores over a parameter: every run, and the mean over the runs.

    looks: Looks of the curves; by default, looks of methods.
    """
    if not panels:
        raise InputError("there are no curves to draw")
    columns = min(_COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    used = {method for panel in panels for method in panel.curves}
    with new_figure(max(4.2 * columns, 8.5), 0.9 + 3.0 * rows, title) as figure:
        _add_head(figure, looks, used)
        first: Axes = None
        for i, panel in enumerate(panels):
            axes = figure.add_subplot(rows, columns, i + 1, sharey=first)
            first = first or axes
            for method, values in panel.curves.items():
                _draw_runs(axes, panel.x, values, looks[method].colour, looks[method].marker)
            set_title(axes, panel.title)
            rotation = 90 if len(panel.x) > _COLUMNS else 0
            axes.set_xticks(panel.x, [f"{value:g}" for value in panel.x], rotation=rotation)
            axes.minorticks_off()
            axes.grid()
            axes.set_axisbelow(True)
            axes.set_xlabel(x_label)
            if i % columns == 0:
                axes.set_ylabel("Mantel r")
        return figure


def counts_figure(
    title: str, panels: Sequence[CountPanel], rows: Sequence[str], note: str
) -> Figure:
    """Draw tables of counts, coloured by the share of the total; cells with share 1 are framed."""
    if not panels:
        raise InputError("there are no counts to draw")
    n_columns = [len(panel.labels) for panel in panels]
    width, height = _ROW_LABEL + _CELL[0] * (sum(n_columns) + len(panels)), _CELL[1] * len(rows)
    with new_figure(width, height + _COLUMN_LABEL + 1.2, title, [note]) as figure:
        figure.set_layout_engine("constrained", rect=(0, 0.04, 1, 0.92))
        axes = figure.subplots(1, len(panels), sharey=True, width_ratios=n_columns, squeeze=False)
        for ax, panel in zip(axes[0], panels, strict=True):
            shares = np.where(panel.totals > 0, panel.held / np.maximum(panel.totals, 1), np.nan)
            ax.imshow(shares, cmap="cividis", vmin=0, vmax=1, aspect="auto")
            for i, j in np.argwhere(panel.totals > 0):
                text = f"{panel.held[i, j]}/{panel.totals[i, j]}"
                look = {"ha": "center", "va": "center", "fontsize": 7}
                ax.text(j, i, text, color="white" if shares[i, j] < _DARK else INK, **look)
                if shares[i, j] == 1:
                    box = {"fill": False, "edgecolor": INK, "linewidth": 1.5}
                    ax.add_patch(
                        load("matplotlib.patches").Rectangle((j - 0.5, i - 0.5), 1, 1, **box)
                    )
            set_title(ax, panel.title)
            ax.set_xticks(range(len(panel.labels)), panel.labels, rotation=90, fontsize=8)
            ax.set_yticks(range(len(rows)), rows, fontsize=8)
            ax.tick_params(length=0)
        return figure


def _add_head(figure: Figure, looks: Mapping[str, MethodLook], used: set[str]) -> None:
    """Make space for the title, and add a legend of the looks used."""
    height = figure.get_figheight()
    figure.set_layout_engine("constrained", rect=(0, 0, 1, 1 - _HEAD / height))
    marks = [
        {"marker": look.marker, "color": look.colour, "label": look.label}
        for method, look in looks.items()
        if method in used
    ]
    add_legend(figure, marks, "upper left", (0.005, 1 - 0.38 / height))


def _draw_scores(axes: Axes, groups: Sequence[ScoreGroup]) -> None:
    start, middles = 0.0, []
    for group in groups:
        for i, (method, scores) in enumerate(group.scores.items()):
            look, x = METHOD_LOOKS[method], start + i
            if method in group.nulls:
                _draw_null(axes, x, group.nulls[method], look)
            shift = np.linspace(-_SPREAD, _SPREAD, len(scores)) if len(scores) > 1 else [0.0]
            axes.plot(
                x + np.asarray(shift), scores, look.marker, color=look.colour, markersize=5,
                alpha=0.75, markeredgewidth=0,
            )  # fmt: skip
            if len(scores) > 1:
                axes.plot([x - 0.36, x + 0.36], [np.mean(scores)] * 2, color=INK, linewidth=1.2)
        middles.append(start + (len(group.scores) - 1) / 2)
        start += len(group.scores) + _GAP
    axes.set_xticks(middles, [group.label for group in groups], fontsize=9.5, color=INK)
    axes.tick_params(axis="x", length=0)
    axes.set(xlim=(-0.9, start - _GAP - 0.1), ylim=(-0.24, 1.04), ylabel="Mantel r")
    axes.grid(axis="y")
    axes.set_axisbelow(True)
    axes.axhline(0, color=FAINT, linewidth=0.8)


def _draw_runs(axes: Axes, x: Values, values: Values, colour: str, marker: str) -> None:
    """Draw every run as a dot and their mean as a curve. x (L,), values (L, S)."""
    axes.plot(x, values, ".", color=colour, alpha=0.35, markersize=4)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # all runs may be NaN
        mean = np.nanmean(values, axis=1)
    axes.plot(x, mean, color=colour, marker=marker, markersize=4.5)


def _draw_null(axes: Axes, x: float, box: Mapping[str, Any], look: MethodLook) -> None:
    line = {"color": look.colour, "linewidth": 1.0}
    axes.bxp(
        [box],
        positions=[x],
        widths=0.55,
        boxprops=line,
        whiskerprops=line,
        capprops=line,
        medianprops={"color": INK, "linewidth": 1.0},
        flierprops={"marker": "+", "markeredgecolor": look.colour, "markersize": 4},
        manage_ticks=False,
    )


def draw_distances(axes: Axes, score: Score) -> None:
    """Draw the distances of pairs of sensors on the map against the true ones.

    Many pairs are drawn as a density. Of many sensors, an evenly spaced sample is drawn.
    """
    n_sensors, quantiles = len(score.truth), score.mantel.quantiles()
    kept = np.unique(np.linspace(0, n_sensors - 1, min(n_sensors, _MAX_SENSORS)).astype(int))
    both = pdist(score.truth[kept]), pdist(score.alignment.aligned[kept])
    longest = 1.04 * float(np.max(both))
    label = f"{both[0].size} pairs of sensors"
    if len(kept) < n_sensors:
        label = f"{both[0].size} pairs among {len(kept)} of {n_sensors} sensors"
    axes.plot([0, longest], [0, longest], color=INK, linewidth=1, linestyle="--", zorder=3)
    if both[0].size <= _MAX_DOTS:
        look = {"markersize": 5, "alpha": 0.5, "markeredgewidth": 0, "color": PALETTE[0]}
        axes.plot(*both, ".", rasterized=True, **look)
    else:
        look = {"bins": "log", "mincnt": 1, "cmap": "Blues", "linewidths": 0.1}
        extent = (0, longest, 0, longest)
        axes.hexbin(*both, gridsize=60, extent=extent, rasterized=True, **look)
        label += ", as a density"
    axes.set(xlim=(0, longest), ylim=(0, longest))
    axes.set_aspect("equal")
    axes.set_xlabel(axis_title("true distance", score.units), parse_math=False, color=INK)
    axes.set_ylabel(axis_title("distance on the map", score.units), parse_math=False, color=INK)
    axes.locator_params(nbins=5)
    null = f" (null, 95%: {quantiles[0.95]:.2f})" if quantiles else ""
    set_title(axes, f"Distances: Mantel r {score.mantel.r:.3f}{null}\n{label}")


def series_figure(recording: Recording, doubted: Sequence[SensorHealth]) -> Figure:
    """Draw the readings of sensors over time, as thumbnails.

    Parameters
    ----------
    recording : Recording
    doubted : sequence of SensorHealth
        Sensors to draw, from `anisomap.assess`; the first 12 are drawn.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If there is no sensor to draw.
    MissingExtraError
        If matplotlib is not installed.
    """
    if not doubted:
        raise InputError("there is no sensor to draw")
    shown = list(doubted)[:_MAX_SERIES]
    rows = -(-len(shown) // _COLUMNS)
    with new_figure(10.0, 0.3 + 1.5 * rows, layout="constrained") as figure:
        for i, sensor in enumerate(shown):
            axes = figure.add_subplot(rows, _COLUMNS, i + 1)
            readings = recording.readings[:, recording.names.index(sensor.name)]
            _draw_series(axes, readings, recording.rate_hz)
            set_title(axes, f"{printable(sensor.name)}: {sensor.status}")
        return figure


def _draw_series(axes: Axes, readings: NDArray[np.floating], rate_hz: float | None) -> None:
    """Draw the range of the readings of a sensor over time. readings (T,)."""
    step = -(-len(readings) // _INSTANTS)
    starts = np.arange(0, len(readings), step)
    known = np.where(np.isfinite(readings), readings, np.nan)
    low, high = (extreme.reduceat(known, starts) for extreme in (np.fmin, np.fmax))
    times = starts / (rate_hz or 1)
    axes.fill_between(times, low, high, step="post", color=PALETTE[0], linewidth=0.8)
    axes.set_xlabel("time (s)" if rate_hz else "frame")
    axes.set_ylabel("reading")
