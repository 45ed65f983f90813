"""The interactive view: what the page draws, as values that JSON can represent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.base.wording import printable, shortened
from anisomap.drawing.view import MAX_JOINED, MAX_UNITS, Panel, Points, unit_of
from anisomap.health import TouchCoverage
from anisomap.health.sensors import MIN_CONTACTS
from anisomap.health.touch_coverage import ENOUGH_CONTACTS
from anisomap.sensor_map import FEW_CONTACTS, SILENT, UNASSESSED, SensorMap, is_faulty, radius

Colours: TypeAlias = dict[str, Any]
"""A title, and a colour for ``each`` sensor, its number ``of`` a class, or a ``ramp`` of values."""

# Okabe & Ito (2008): distinct with every common colour vision deficiency.
STATUS_COLOURS = {
    "ok": "#0072b2",
    UNASSESSED: "#0072b2",
    SILENT: "#000000",
    FEW_CONTACTS: "#f0e442",
    "stuck": "#d55e00",
    "intermittent": "#cc79a7",
    "saturating": "#e69f00",
    "noisy": "#009e73",
    "isolated": "#56b4e9",
}
_OTHER = "#7f7f7f"
_CONTACTS = {  # from light to dark, also in greyscale
    "none": "#ffffff",
    f"fewer than {MIN_CONTACTS}": "#cde2f2",
    f"{MIN_CONTACTS} to {ENOUGH_CONTACTS - 1}": "#5aa5d6",
    f"{ENOUGH_CONTACTS} or more": "#00426b",
}
MAX_DOTS = MAX_JOINED
"""Largest number of sensors per view; browsers rotate this many smoothly."""

_MAX_NAME = 40
_DIGITS = 4  # of a coordinate, relative to the extent of the map: less than a pixel


def interactive_views(
    sensor_map: SensorMap,
    drawn: Sequence[Panel],
    statuses: Sequence[str],
    coverage: TouchCoverage | None = None,
) -> list[dict[str, Any]]:
    """Describe the view of every connected component."""
    return [_view(sensor_map, component, statuses, coverage) for component in drawn]


def _view(
    sensor_map: SensorMap,
    component: Panel,
    statuses: Sequence[str],
    coverage: TouchCoverage | None,
) -> dict[str, Any]:
    n_sensors, kind = len(component.points), sensor_map.kind
    part = component
    if n_sensors > MAX_DOTS:
        part = component.only(_sample(component, statuses))
    middle = (part.points.min(axis=0) + part.points.max(axis=0)) / 2
    extent = float(np.ptp(part.points, axis=0).max()) or 1.0
    decimals = _DIGITS - int(np.floor(np.log10(extent)))
    named = [statuses[i] for i in part.sensors]
    colours = {"position": _by_place(part), "index": _ramp(part.sensors, "index")}
    found: dict[str, Any] = {
        "label": f"Component {component.number}: {n_sensors} {kind}s",
        "left_out": n_sensors - len(part.points),
        "view": component.view if component.dimensions == 3 else None,
        "units": shortened(printable(unit_of(component.units)), MAX_UNITS),
        "names": [shortened(printable(sensor_map.names[i]), _MAX_NAME) for i in part.sensors],
        "labels": list(part.labels),
        "middle": _rounded(middle, decimals),
        "points": _rounded(part.points, decimals),
        "pairs": part.pairs.tolist(),
        "faulty": np.flatnonzero([is_faulty(status) for status in named]).tolist(),
        "uncompared": np.flatnonzero(part.uncompared).tolist(),
    }
    if kind == "sensor":
        classes = status_colours(named)
        colours["health"] = _classes(classes, [list(classes).index(one) for one in named], "health")
    if len(part.truth):
        errors = np.append(part.errors, np.full(len(part.points) - len(part.errors), np.nan))
        colours["error"] = _ramp(errors, "error")
        found["truth"] = _rounded(part.truth, decimals)
    if part.covariances is not None:
        scaled = part.covariances * radius(part.dimensions) ** 2
        found["ellipses"] = _rounded(scaled, 2 * decimals)
    if coverage is not None:
        contacts = coverage.contacts[part.sensors]
        edges = (1, MIN_CONTACTS, ENOUGH_CONTACTS)
        colours["contacts"] = _classes(_CONTACTS, np.digitize(contacts, edges).tolist(), "contacts")
        colours["contacts"] |= {"values": contacts.tolist(), **_lacking(part, coverage)}
    return found | {"colours": colours}


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


def _by_place(part: Panel) -> Colours:
    channels = np.round(part.colours * 255).astype(int).tolist()
    return {"title": "position", "each": [f"#{r:02x}{g:02x}{b:02x}" for r, g, b in channels]}


def _classes(colours: Mapping[str, str], of: Sequence[int], title: str) -> Colours:
    classes = [[printable(name), colour] for name, colour in colours.items()]
    return {"title": title, "classes": classes, "of": of}


def _ramp(values: NDArray[Any], title: str) -> Colours:
    return {"title": title, "ramp": _rounded(values.astype(float), 4, significant=True)}


def _lacking(part: Panel, coverage: TouchCoverage) -> dict[str, Any]:
    """List neighbours that were never touched together, and the sensors of places to touch next."""
    row = {int(sensor): i for i, sensor in enumerate(part.sensors)}
    apart = [[row[i], row[j]] for i, j in coverage.never_together.tolist() if {i, j} <= row.keys()]
    places = [
        [row[i] for i in place.sensors if i in row] if place.component == part.number - 1 else []
        for place in coverage.places
    ]
    return {"apart": apart, "places": places}


def _rounded(values: Points, digits: int, *, significant: bool = False) -> list[Any]:
    """Round numbers for JSON; None replaces NaN."""
    if significant:
        return [float(f"{v:.{digits}g}") if np.isfinite(v) else None for v in values.tolist()]
    rounded = np.round(values, digits).astype(object)
    rounded[~np.isfinite(values)] = None
    return list(rounded.tolist())
