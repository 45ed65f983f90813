"""Interactive views: traces and layouts for plotly, as values that JSON can represent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.base.wording import printable, shortened
from anisomap.drawing.view import (
    Panel,
    Points,
    axis_title,
    outlines,
    panel_limits,
    segments,
    view_axes,
)
from anisomap.sensor_map import (
    FEW_CONTACTS,
    SILENT,
    UNASSESSED,
    UNSCALED,
    SensorMap,
    ellipses,
    is_faulty,
)

Trace: TypeAlias = dict[str, Any]

# Okabe & Ito (2008): distinct with every common colour vision deficiency.
STATUS_COLOURS = {
    "ok": "#0072b2",
    UNASSESSED: "#0072b2",
    SILENT: "#000000",
    FEW_CONTACTS: "#f0e442",
    "stuck": "#d55e00",
    "saturating": "#e69f00",
    "noisy": "#009e73",
    "isolated": "#56b4e9",
}
_OTHER = "#7f7f7f"
_LINES = "rgba(70,76,84,0.55)"
_ELLIPSES = "#8a6d3b"
_TRUE_LINES = "rgba(0,114,178,0.35)"
_ERRORS = "rgba(213,94,0,0.9)"
_EYE_DISTANCE = 2.2  # from the centre; the box has the diagonal of a unit cube
_CROWDED = 800
MAX_DOTS = 5_000
"""Largest number of sensors per view; browsers rotate this many smoothly."""

_MAX_NAME = 40
_BRACKETS = str.maketrans(
    "<>",
    "\N{SINGLE LEFT-POINTING ANGLE QUOTATION MARK}\N{SINGLE RIGHT-POINTING ANGLE QUOTATION MARK}",
)


def interactive_views(
    sensor_map: SensorMap, drawn: Sequence[Panel], statuses: Sequence[str]
) -> list[dict[str, Any]]:
    """Describe the view of every connected component."""
    views = []
    for component in drawn:
        crowded = len(component.points) > MAX_DOTS
        part = component.only(_sample(component, statuses)) if crowded else component
        names = [_without_markup(sensor_map.names[i]) for i in part.sensors]
        view = _view(part, names, [statuses[i] for i in part.sensors])
        label = f"Component {component.number}: {len(component.points)} {sensor_map.kind}s"
        left_out = len(component.points) - len(part.points)
        views.append(view | {"label": label, "left_out": left_out, "layout": _layout(component)})
    return views


def status_colours(statuses: Sequence[str]) -> dict[str, str]:
    """Return the colour of every status that occurs, in the order of `STATUS_COLOURS`."""
    found = set(statuses)
    known = {status: colour for status, colour in STATUS_COLOURS.items() if status in found}
    return known | dict.fromkeys(sorted(found - known.keys()), _OTHER)


def _sample(component: Panel, statuses: Sequence[str]) -> NDArray[np.intp]:
    """Choose the sensors of a large component to show, faulty ones first."""
    faulty = np.array([is_faulty(statuses[i]) for i in component.sensors])
    first = np.flatnonzero(faulty)[: MAX_DOTS // 2]
    others = np.flatnonzero(~faulty)
    even = np.linspace(0, len(others) - 1, min(len(others), MAX_DOTS - len(first))).astype(int)
    return np.sort(np.concatenate([first, others[even]]))


def _view(component: Panel, names: list[str], statuses: list[str]) -> dict[str, Any]:
    symbols = ["circle" if compared else "square" for compared in ~component.uncompared]
    faulty = np.array([is_faulty(status) for status in statuses])
    traces = {
        "neighbours": _lines(component.points, component.pairs, _LINES, 2),
        "map": _dots(component.points, symbols, _hover(component, names, statuses)),
        "faulty": _crosses(component.points, faulty),
    }
    if component.covariances is not None:
        traces["ellipses"] = _line(outlines(component), _ELLIPSES, 1)
    if len(component.truth):
        moves = np.arange(len(component.truth))
        ends = np.vstack([component.truth, component.points])
        true_hover = [f"<b>{name}</b><br>true position" for name in names[: len(component.truth)]]
        traces |= {
            "true-neighbours": _lines(component.truth, component.pairs, _TRUE_LINES, 1.5),
            "errors": _lines(ends, np.column_stack([moves, moves + len(moves)]), _ERRORS, 3),
            "truth": _dots(component.truth, ["circle-open"] * len(component.truth), true_hover),
        }
        traces["truth"]["marker"] |= {"color": STATUS_COLOURS["ok"], "line": {"width": 1.5}}
    return {"names": names, "traces": traces, "colours": _colours(component, statuses)}


def _dots(points: Points, symbols: list[str], hover: list[str]) -> Trace:
    line = {"width": 0.5, "color": "#ffffff"}
    return _trace(
        points,
        mode="markers",
        marker={"size": _size(points), "symbol": symbols, "line": line},
        hovertext=hover,
        hoverinfo="text",
        textposition="top center",
    )


def _crosses(points: Points, chosen: NDArray[np.bool_]) -> Trace:
    """Mark some dots with crosses.

    The crosses are text, because plotly's own 3D cross is a character that some fonts lack.
    """
    return _trace(
        points[chosen],
        mode="text",
        text="\N{MULTIPLICATION SIGN}",
        textposition="middle center",
        textfont={"size": round(10 + 1.6 * _size(points)), "color": "#000000"},
        hoverinfo="skip",
    )


def _size(points: Points) -> float:
    """Choose the diameter of dots in pixels: the more dots, the smaller."""
    size = float(np.clip(75 / len(points) ** 0.4, 2.5, 8))
    return round(size if points.shape[1] == 3 else 1.25 * size, 2)


def _lines(points: Points, pairs: NDArray[np.intp], colour: str, width: float) -> Trace:
    """Join pairs of points by lines in one trace, separated by gaps."""
    thin = width if len(pairs) < _CROWDED else width / 2
    return _line(segments(points, pairs), colour, thin)


def _line(points: Points, colour: str, width: float) -> Trace:
    """Draw one line with gaps where points are NaN."""
    line = {"color": colour, "width": width}
    return _trace(points, mode="lines", line=line, hoverinfo="skip")


def _trace(points: Points, **look: Any) -> Trace:
    kind = "scatter3d" if points.shape[1] == 3 else "scatter"
    axes = {axis: _plain(column) for axis, column in zip("xyz", points.T, strict=False)}
    return {"type": kind} | axes | look | {"showlegend": False}


def _colours(component: Panel, statuses: list[str]) -> dict[str, dict[str, Any]]:
    channels = np.round(component.colours * 255).astype(int).tolist()
    found: dict[str, dict[str, Any]] = {
        "place": {"color": [f"#{r:02x}{g:02x}{b:02x}" for r, g, b in channels]},
        "health": {"color": [STATUS_COLOURS.get(status, _OTHER) for status in statuses]},
        "index": _ramp(_plain(component.sensors), "index"),
    }
    if len(component.truth):
        padded = np.full(len(component.points), np.nan)
        padded[: len(component.errors)] = component.errors
        found["error"] = _ramp(_plain(padded), axis_title("error", component.units))
    return found


def _ramp(values: list[float | None], title: str) -> dict[str, Any]:
    return {
        "color": values,
        "colorscale": "Cividis",
        "showscale": True,
        "colorbar": {"title": {"text": _without_markup(title), "side": "right"}, "thickness": 14},
    }


def _hover(component: Panel, names: list[str], statuses: list[str]) -> list[str]:
    units = "" if component.units in UNSCALED else f" {_without_markup(component.units)}"
    radii = (
        None if component.covariances is None else ellipses(component.covariances)[0].max(axis=1)
    )
    texts = []
    for i, (name, status) in enumerate(zip(names, statuses, strict=True)):
        place = ", ".join(f"{value:.4g}" for value in component.points[i])
        lines = [f"<b>{name}</b>", f"index {component.sensors[i]}, component {component.number}"]
        lines += [f"health: {_without_markup(status)}", f"({place}){units}"]
        if radii is not None and math.isfinite(radii[i]):
            lines.append(f"95 % within {radii[i]:.3g}{units}")
        if component.uncompared[i]:
            lines.append("not compared with the truth")
        elif len(component.truth):
            lines.append(f"error {component.errors[i]:.3g}{units}")
        texts.append("<br>".join(lines))
    return texts


def _layout(component: Panel) -> dict[str, Any]:
    limits = panel_limits(component)
    axes: dict[str, Any] = {
        f"{axis}axis": {
            "title": {"text": _without_markup(axis_title(axis, component.units))},
            "range": _plain(span),
            "zeroline": False,
            "gridcolor": "#dde1e5",
        }
        for axis, span in zip("xyz", limits, strict=False)
    }
    common = {
        "margin": {"l": 0, "r": 0, "t": 8, "b": 0},
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "font": {"family": "system-ui, sans-serif", "size": 13, "color": "#22262b"},
        "hoverlabel": {"align": "left"},
        "uirevision": f"component {component.number}",
    }
    if component.points.shape[1] == 2:
        for axis in axes.values():
            axis["title"] |= {"standoff": 6}
        axes["yaxis"] |= {"scaleanchor": "x", "scaleratio": 1}
        return common | axes | {"dragmode": "pan", "margin": {"l": 70, "r": 20, "t": 20, "b": 60}}
    for axis in axes.values():
        axis |= {"backgroundcolor": "#fafbfb", "showbackground": True}
    # "aspectmode": "data" would use the extents of the data instead of the ranges of the axes.
    ratio = np.sqrt(3) * np.ptp(limits, axis=1) / np.linalg.norm(np.ptp(limits, axis=1))
    eye = _EYE_DISTANCE * view_axes(component.view)[2]
    return common | {
        "scene": axes
        | {
            "aspectmode": "manual",
            "aspectratio": dict(zip("xyz", _plain(ratio), strict=True)),
            "camera": {
                # At a distance from which the whole box is visible.
                "eye": dict(zip("xyz", _plain(eye), strict=True)),
                "center": {"x": 0, "y": 0, "z": -0.1},  # leaves space for the titles of the axes
            },
            "dragmode": "orbit",
        },
    }


def _plain(values: NDArray[Any]) -> list[float | None]:
    """Convert an array to numbers of six digits for JSON; None replaces NaN."""
    return [(float(f"{value:.6g}") if math.isfinite(value) else None) for value in values.tolist()]


def _without_markup(text: str) -> str:
    """Replace the brackets of a text, which plotly would read as markup.

    plotly's labels interpret some HTML, and its 3D labels decode no escapes. The table of sensors
    contains the text unchanged.
    """
    return shortened(printable(text), _MAX_NAME).translate(_BRACKETS)
