"""The interactive view: traces and layouts for plotly, as plain values that JSON can hold."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.drawing.view import Body, View, axis_title, box_around, shown, view_axes
from anisomap.evaluation import Score
from anisomap.sensor_map import SensorMap

Trace: TypeAlias = dict[str, Any]

# Okabe & Ito (2008): told apart with every common kind of colour blindness.
STATUS_COLOURS: Mapping[str, str] = MappingProxyType(
    {
        "ok": "#0072b2",
        "dead": "#000000",
        "stuck": "#d55e00",
        "saturating": "#e69f00",
        "intermittent": "#cc79a7",
        "noisy": "#009e73",
        "isolated": "#56b4e9",
    }
)
_OTHER = "#7f7f7f"
_LINES = "rgba(70,76,84,0.55)"
_TRUE_LINES = "rgba(0,114,178,0.35)"
_ERRORS = "rgba(213,94,0,0.9)"
_EYE = 2.15
_CROWD = 800
_MOST_DOTS = 5_000  # of a piece: a browser turns so many smoothly
_LONGEST_NAME = 40
_BRACKETS = str.maketrans(
    "<>",
    "\N{SINGLE LEFT-POINTING ANGLE QUOTATION MARK}\N{SINGLE RIGHT-POINTING ANGLE QUOTATION MARK}",
)


def scene(
    sensor_map: SensorMap, drawn: Sequence[Body], score: Score | None, statuses: Sequence[str]
) -> list[dict[str, Any]]:
    """Describe the view of every piece of a map.

    Parameters
    ----------
    sensor_map : SensorMap
    drawn : sequence of Body
        Its pieces.
    score : Score or None
        The comparison with the truth, of the first piece.
    statuses : sequence of str
        Health of every sensor of the map.

    Returns
    -------
    list of dict
        For each piece: ``label``; ``traces`` by what they show (``map``, ``neighbours``,
        ``ailing``; with a truth also ``truth``, ``true-neighbours``, ``errors``); ``colours``, the
        marker colours to choose from; ``names``; ``left_out``, how many sensors the view leaves
        out; and plotly's ``layout``.
    """
    pieces = []
    for body in drawn:
        errors = score.alignment.errors if score is not None and len(body.truth) else None
        seen = _seen(body, statuses)
        part = body if seen is None else _part(body, seen)
        if errors is not None and seen is not None:
            errors = errors[seen[seen < len(errors)]]
        pieces.append(
            _piece(
                part,
                names=[_inert(sensor_map.names[i]) for i in part.sensors],
                statuses=[statuses[i] for i in part.sensors],
                errors=errors,
            )
            | {
                "label": f"Piece {body.number}: {len(body.points)} sensors",
                "left_out": len(body.points) - len(part.points),
                "layout": _layout(body),
            }
        )
    return pieces


def status_colours(statuses: Sequence[str]) -> dict[str, str]:
    """Tell the colour of every status that occurs, in the order of `STATUS_COLOURS`."""
    found = set(statuses)
    known = {status: colour for status, colour in STATUS_COLOURS.items() if status in found}
    return known | dict.fromkeys(sorted(found - known.keys()), _OTHER)


def _seen(body: Body, statuses: Sequence[str]) -> NDArray[np.intp] | None:
    """Choose the sensors of a large piece that are shown; None if all are."""
    if len(body.points) <= _MOST_DOTS:
        return None
    ailing = np.array([statuses[i] != "ok" for i in body.sensors])
    first = np.flatnonzero(ailing)[: _MOST_DOTS // 2]
    others = np.flatnonzero(~ailing)
    even = np.linspace(0, len(others) - 1, min(len(others), _MOST_DOTS - len(first))).astype(int)
    return np.sort(np.concatenate([first, others[even]]))


def _part(body: Body, seen: NDArray[np.intp]) -> Body:
    """Keep some sensors of a piece, without lines between them."""
    return replace(
        body,
        sensors=body.sensors[seen],
        points=body.points[seen],
        truth=body.truth[seen[seen < len(body.truth)]],
        colours=body.colours[seen],
        pairs=body.pairs[:0],
    )


def _piece(
    body: Body, *, names: list[str], statuses: list[str], errors: NDArray[np.float64] | None
) -> dict[str, Any]:
    symbols = ["circle" if compared else "square" for compared in body.compared]
    ailing = np.array([status != "ok" for status in statuses])
    traces = {
        "neighbours": _lines(body.points, body.pairs, _LINES, 2),
        "map": _dots(body.points, symbols, _hover(body, names, statuses, errors)),
        "ailing": _crosses(body.points, ailing),
    }
    if errors is not None:
        moves = np.arange(len(body.truth))
        ends = np.vstack([body.truth, body.points])
        true_hover = [f"<b>{name}</b><br>its true place" for name in names[: len(body.truth)]]
        traces |= {
            "true-neighbours": _lines(body.truth, body.pairs, _TRUE_LINES, 1.5),
            "errors": _lines(ends, np.column_stack([moves, moves + len(moves)]), _ERRORS, 3),
            "truth": _dots(body.truth, ["circle-open"] * len(body.truth), true_hover),
        }
        traces["truth"]["marker"] |= {"color": STATUS_COLOURS["ok"], "line": {"width": 1.5}}
    return {"names": names, "traces": traces, "colours": _colours(body, statuses, errors)}


def _dots(points: NDArray[np.float64], symbols: list[str], hover: list[str]) -> Trace:
    return _coordinates(points) | {
        "mode": "markers",
        "marker": {
            "size": _size(points),
            "symbol": symbols,
            "line": {"width": 0.5, "color": "#ffffff"},
        },
        "hovertext": hover,
        "hoverinfo": "text",
        "textposition": "top center",
        "showlegend": False,
    }


def _crosses(points: NDArray[np.float64], chosen: NDArray[np.bool_]) -> Trace:
    """Mark some dots; a cross stands out whatever colour its dot has.

    The crosses are letters, for plotly's own in space is a sign that not every font holds.
    """
    return _coordinates(points[chosen]) | {
        "mode": "text",
        "text": "\N{MULTIPLICATION SIGN}",
        "textposition": "middle center",
        "textfont": {"size": round(10 + 1.6 * _size(points)), "color": "#000000"},
        "hoverinfo": "skip",
        "showlegend": False,
    }


def _size(points: NDArray[np.float64]) -> float:
    """Choose the size of dots, in pixels: smaller where there are many."""
    size = float(np.clip(75 / len(points) ** 0.4, 2.5, 8))
    return round(size if points.shape[1] == 3 else 1.25 * size, 2)


def _lines(
    points: NDArray[np.float64], pairs: NDArray[np.intp], colour: str, width: float
) -> Trace:
    """Join pairs of points: one trace, with a gap after each line."""
    segments = np.full((len(pairs), 3, points.shape[1]), np.nan)
    segments[:, :2] = points[pairs]
    return _coordinates(segments.reshape(-1, points.shape[1])) | {
        "mode": "lines",
        "line": {"color": colour, "width": width if len(pairs) < _CROWD else width / 2},
        "hoverinfo": "skip",
        "showlegend": False,
    }


def _coordinates(points: NDArray[np.float64]) -> Trace:
    kind = "scatter3d" if points.shape[1] == 3 else "scatter"
    axes = {axis: _plain(column) for axis, column in zip("xyz", points.T, strict=False)}
    return {"type": kind} | axes


def _colours(
    body: Body, statuses: list[str], errors: NDArray[np.float64] | None
) -> dict[str, dict[str, Any]]:
    channels = np.round(body.colours * 255).astype(int).tolist()
    found: dict[str, dict[str, Any]] = {
        "place": {"color": [f"#{r:02x}{g:02x}{b:02x}" for r, g, b in channels]},
        "health": {"color": [STATUS_COLOURS.get(status, _OTHER) for status in statuses]},
        "index": _ramp(_plain(body.sensors), "index"),
    }
    if errors is not None:
        padded = np.full(len(body.points), np.nan)
        padded[: len(errors)] = errors
        found["error"] = _ramp(_plain(padded), axis_title("error", body.units))
    return found


def _ramp(values: list[float | None], title: str) -> dict[str, Any]:
    return {
        "color": values,
        "colorscale": "Cividis",
        "showscale": True,
        "colorbar": {"title": {"text": _inert(title), "side": "right"}, "thickness": 14},
    }


def _hover(
    body: Body, names: list[str], statuses: list[str], errors: NDArray[np.float64] | None
) -> list[str]:
    units = "" if body.units in ("", "arbitrary") else f" {_inert(body.units)}"
    texts = []
    for i, (name, status) in enumerate(zip(names, statuses, strict=True)):
        place = ", ".join(f"{value:.4g}" for value in body.points[i])
        lines = [f"<b>{name}</b>", f"index {body.sensors[i]}, piece {body.number}"]
        lines += [f"health: {_inert(status)}", f"({place}){units}"]
        if not body.compared[i]:
            lines.append("not compared with the truth")
        elif errors is not None:
            lines.append(f"{errors[i]:.3g}{units} from its true place")
        texts.append("<br>".join(lines))
    return texts


def _layout(body: Body) -> dict[str, Any]:
    limits = box_around(body.points, body.truth) if len(body.truth) else box_around(body.points)
    axes: dict[str, Any] = {
        f"{axis}axis": {
            "title": {"text": _inert(axis_title(axis, body.units))},
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
        "uirevision": f"piece {body.number}",
    }
    if body.points.shape[1] == 2:
        for axis in axes.values():
            axis["title"] |= {"standoff": 6}
        axes["yaxis"] |= {"scaleanchor": "x", "scaleratio": 1}
        return common | axes | {"dragmode": "pan", "margin": {"l": 70, "r": 20, "t": 20, "b": 60}}
    for axis in axes.values():
        axis |= {"backgroundcolor": "#fafbfb", "showbackground": True}
    return common | {
        "scene": axes
        | {"aspectmode": "data", "camera": _camera(limits, body.view), "dragmode": "orbit"},
    }


def _camera(limits: NDArray[np.float64], view: View) -> dict[str, Any]:
    """Look from a side, from so far that all of the box is seen."""
    spans = np.ptp(limits, axis=1)
    sides = spans / np.cbrt(spans.prod())  # as plotly scales them
    eye = _EYE * np.linalg.norm(sides) / np.sqrt(3) * view_axes(view)[2]
    # Looking a little below the middle leaves room for the titles of the axes.
    return {
        "eye": dict(zip("xyz", _plain(eye), strict=True)),
        "center": {"x": 0, "y": 0, "z": -0.1},
    }


def _plain(values: NDArray[Any]) -> list[float | None]:
    """Turn an array into what JSON can hold: no more digits than can be seen, no NaN."""
    return [(float(f"{value:.6g}") if math.isfinite(value) else None) for value in values.tolist()]


def _inert(text: str) -> str:
    """Take what plotly would read as markup out of a text.

    Its labels know some HTML, but those in space decode no escapes; so brackets are replaced by
    others that look much the same. The table of sensors has the text as it is.
    """
    return shown(text, _LONGEST_NAME).translate(_BRACKETS)
