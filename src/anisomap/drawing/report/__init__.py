"""Reports of maps: single HTML files that do not need a network."""

from __future__ import annotations

import base64
import hashlib
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.base.wording import UNKNOWN, join_items, number, percent, printable, shortened
from anisomap.drawing.view import (
    MAX_JOINED,
    MAX_UNITS,
    Panel,
    Points,
    checked_kind,
    drawn_components,
    ellipses_differ,
    layout_notes,
    unit_of,
)
from anisomap.errors import import_extra
from anisomap.evaluation import Score
from anisomap.files.paths import atomic_write, check_target
from anisomap.health import RecordingSummary, SensorHealth, TouchCoverage
from anisomap.health.sensors import MIN_CONTACTS
from anisomap.health.touch_coverage import ENOUGH_CONTACTS
from anisomap.method.evidence import SIMILARITIES
from anisomap.method.named import METHODS
from anisomap.placement.placing import judgement
from anisomap.sensor_map import (
    FEW_CONTACTS,
    SILENT,
    UNASSESSED,
    UNSCALED,
    SensorMap,
    ellipses,
    is_faulty,
    radius,
)

TITLES = {"sensor": "Map of a skin", "object": "Map of objects"}

SUFFIXES = ("html", "htm")
"""Suffixes of report files."""

MAX_ROWS = 2000
"""Maximum number of sensors in the table; browsers render longer tables slowly."""

_N_WORST = 5  # sensors listed first
_MAX_PRINTED = 8  # rows of the table in print; the map and facts fill the remainder of two pages
_PROVENANCE = {
    "anisomap": "version of anisomap",
    "source": "recording",
    "runs": "recordings",
    "frames": "frames",
    "similarity": "similarity",
    "dimensions_because": "reason for the dimensions",
    "repaired": "mended",
}
"""Entries of the provenance that a report shows, with labels; the map file contains all entries."""


@dataclass(frozen=True)
class Touches:
    """Contacts of a skin.

    facts: Numbers of contacts, and places to touch next.
    coverage: Contacts of the sensors of the map.
    series_png: Picture of the readings of doubtful sensors over time.
    """

    facts: Mapping[str, str]
    coverage: TouchCoverage
    series_png: bytes | None = None


_Cell: TypeAlias = tuple[str, float | str]
"""Text of a table cell, and its sort key; empty keys are last."""


def _headlines(sensor_map: SensorMap, score: Score | None) -> list[str]:
    """Describe the verdict and the known errors; the first sentence is the headline.

    Maps of objects have no verdict, since there are no readings to examine.
    """
    names, kind = sensor_map.names, sensor_map.kind
    sentences = list(judgement(sensor_map))
    if kind == "object":
        sentences = [f"The map fits the dissimilarities with Stress-1 {number(sensor_map.stress)}."]
    if score is not None:
        null = score.mantel.quantiles().get(0.95)
        if null is not None and score.mantel.r <= null:
            sentences.append(
                "The map agrees with the true positions no better than random permutations of the "
                f"{kind}s."
            )
        farthest = [
            f"{names[score.sensors[i]]} ({number(score.alignment.errors[i], 3, score.units)})"
            for i in score.worst(_N_WORST)
        ]
        sentences.append(f"Largest errors: {join_items(farthest)}.")
        if pairs := [f"{names[i]} and {names[j]}" for i, j in score.exchanged]:
            sentences.append(
                f"These look exchanged (run anisomap check): {join_items(pairs, _N_WORST)}."
            )
    sizes = sensor_map.component_sizes
    if len(sizes) > 1:
        sentences.append(
            f"Only {sizes[0]} {kind}s are in the largest component. Other components: "
            f"{len(sizes) - 1}."
        )
    fitted = "" if score is None else ", and was fitted to the true positions"
    return [*sentences, f"The map is {sensor_map.pose}{fitted}."]


def _method_sentences(sensor_map: SensorMap) -> list[str]:
    """Describe the method that made the map."""
    told = []
    if sensor_map.method in METHODS:
        told.append(f"{sensor_map.method}: {METHODS[sensor_map.method].summary}")
    if sensor_map.similarity in SIMILARITIES:
        told.append(f"similarity of readings: {SIMILARITIES[sensor_map.similarity].summary}")
    return [f"{text[:1].upper()}{text[1:]}." for text in told]


def _facts(sensor_map: SensorMap, score: Score | None) -> list[tuple[str, str, str]]:
    """List the figures of merit: name, value and explanation."""
    found = []
    if score is not None:
        null, mantel = score.mantel.quantiles(), score.mantel
        meaning = "correlation of the distances on the map with the true distances; at most 1"
        if null:
            meaning += f"; at most {null[0.95]:.3f} in 95% of random permutations"
            meaning += f", p = {number(mantel.p_value, 2)}"
        in_spacings = (
            f"or {number(score.rms_in_spacings, 3)} spacings of "
            f"{number(score.spacing, unit=score.units)}"
        )
        kept = "share of the true nearest neighbours that are also nearest on the map"
        found += [
            ("Mantel r", f"{mantel.r:.3f}", meaning),
            ("RMS error", number(score.rms, unit=score.units), in_spacings),
            ("Neighbours kept", f"{score.neighbours_kept:.0%}", kept),
        ]
    if score is not None and np.isfinite(score.scale):
        unscaled = f"of the reference; without scaling, the RMS error is {number(score.rigid_rms)}"
        found.append(("Scale", number(score.scale, 3), f"{unscaled} {score.units}"))
    placed = f"{int(sensor_map.placed.sum())} of {sensor_map.n_sensors}"
    misfit = "misfit between the distances on the map and the metric; 0 is a perfect fit"
    return [
        *found,
        ("Placed", placed, f"{sensor_map.kind}s with a position on the map"),
        ("Stress-1", number(sensor_map.stress), misfit),
    ]


def _caveats(
    sensor_map: SensorMap, score: Score | None, summary: RecordingSummary | None
) -> list[str]:
    """List the caveats of map, score and recording, without repetition."""
    notes = [*sensor_map.notes, *layout_notes(sensor_map, score)]
    unplaced = [sensor_map.names[i] for i in np.flatnonzero(~sensor_map.placed)]
    if unplaced and score is None:
        notes.append(f"{sensor_map.kind}s without a position: {join_items(unplaced, 12)}")
    if score is not None:
        notes += score.notes
    notes += summary.warnings if summary is not None else ()
    return list(dict.fromkeys(note[:1].upper() + note[1:] for note in notes))


def _sensor_statuses(sensor_map: SensorMap, health: Sequence[SensorHealth]) -> tuple[str, ...]:
    """Return the status of every sensor, from `health` or else from the map."""
    assessed = {sensor.name: sensor.status for sensor in health}
    own = zip(sensor_map.names, sensor_map.health, strict=True)
    return tuple(assessed.get(name, status) for name, status in own)


def _sensor_table(
    sensor_map: SensorMap, score: Score | None, health: Sequence[SensorHealth]
) -> dict[str, Any]:
    """Tabulate the sensors: the greatest errors first, or without errors, the problems first.

    Returns the meanings of the columns between status and reason, by title; at most `MAX_ROWS`
    rows; the numbers of sensors with each status, of all sensors, and of rows in print.
    """
    assessed = {sensor.name: sensor for sensor in health}
    statuses = _sensor_statuses(sensor_map, health)
    errors = {} if score is None else dict(zip(score.sensors, score.alignment.errors, strict=True))
    listed = sorted(
        range(len(statuses)), key=lambda i: (not is_faulty(statuses[i]), -errors.get(i, 0))
    )
    printed = set(listed[:_MAX_PRINTED])
    shown = sorted(listed[:MAX_ROWS], key=lambda i: -errors.get(i, 0))
    columns: dict[str, tuple[str, list[_Cell]]] = {}
    if len(sensor_map.component_sizes) > 1 or not sensor_map.placed.all():
        numbers = (sensor_map.component[shown] + 1).tolist()
        columns["Component"] = (
            "connected component of the map; 1 is the largest",
            [(str(label), label) if label else ("not placed", "") for label in numbers],
        )
    if score is not None:
        unit = f" ({score.units})" if score.units else ""
        cells = [_cell(errors.get(i)) for i in shown]
        columns[f"Error{unit}"] = "distance from the true position", cells
    if sensor_map.covariances is not None and ellipses_differ(sensor_map.covariances):
        units, scale = sensor_map.units, np.ones(len(shown))
        if score is not None:  # in the frame and unit of the errors
            units = score.units
            scale = np.where(sensor_map.component[shown] == 0, score.alignment.scale, np.nan)
        unit = "" if units in UNSCALED else f" ({units})"
        radii = scale * ellipses(sensor_map.covariances[shown])[0].max(axis=1)
        cells = [_cell(radius) for radius in radii.tolist()]
        columns[f"95%{unit}"] = "longest half axis of the 95% ellipse", cells
    if health:
        known = [assessed.get(sensor_map.names[i]) for i in shown]
        for title, (meaning, attribute, written) in _MEASURED.items():
            cells = [_cell(getattr(one, attribute) if one else None, written) for one in known]
            columns[title] = meaning, cells
    reasons = {sensor.name: [sensor.reason] for sensor in health}
    for pair in () if score is None else score.exchanged:
        for i, j in (pair, pair[::-1]):
            said = f"looks exchanged with {sensor_map.names[j]}: run anisomap check"
            reasons.setdefault(sensor_map.names[i], []).insert(0, said)
    rows = [
        {
            "name": (name := sensor_map.names[i]),
            "status": statuses[i],
            "reason": "; ".join(filter(None, reasons.get(name, ()))),
            "cells": [cells[row] for _, cells in columns.values()],
            "printed": i in printed,
        }
        for row, i in enumerate(shown)
    ]
    counts = ", ".join(f"{statuses.count(status)} {status}" for status in sorted(set(statuses)))
    return {
        "columns": {title: meaning for title, (meaning, _) in columns.items()},
        "rows": rows,
        "counts": counts,
        "n_sensors": len(statuses),
        "n_printed": len(printed),
    }


def _provenance(
    sensor_map: SensorMap, score: Score | None, origin: Mapping[str, str]
) -> list[tuple[str, object]]:
    """List the information needed to reproduce the map."""
    known = sensor_map.provenance
    return [
        *origin.items(),
        ("method", sensor_map.method or "not recorded"),
        ("dimensions", sensor_map.dimensions),
        ("units of the map", sensor_map.units),
        *([("random permutations", len(score.mantel.null))] if score is not None else ()),
        *((words, known[name]) for name, words in _PROVENANCE.items() if name in known),
    ]


def _cell(value: float | None, written: Callable[[Any], str] = number) -> _Cell:
    if value is None or not math.isfinite(value):
        return UNKNOWN, ""
    return written(value), value


_MEASURED: dict[str, tuple[str, str, Callable[[Any], str]]] = {
    "Active": ("share of frames in which the reading is not at rest", "active", percent),
    "Contacts": ("number of separate contacts", "contacts", str),
    "Best match": (
        "highest Pearson r with another sensor", "best_match", lambda r: number(r, 2)
    ),
}  # fmt: skip
"""Columns of the table of sensors from `SensorHealth`: meaning, attribute, format."""


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")


def _policy(script: str, style: str) -> str:
    """Return a content security policy without network access and without foreign scripts."""
    own = {
        name: _base64(hashlib.sha256(text.encode()).digest())
        for name, text in (("script", script), ("style", style))
    }
    return (
        f"default-src 'none'; script-src 'sha256-{own['script']}'; "
        f"style-src 'sha256-{own['style']}'; img-src data:; base-uri 'none'; form-action 'none'"
    )


def _shown(value: object) -> object:
    """Replace unprintable characters in a value of the page, except in its own markup."""
    if isinstance(value, str) and not hasattr(value, "__html__"):
        return printable(value)
    return value


@cache
def templates(package: str, finalize: Callable[[object], object] | None = None) -> Any:
    """Return the environment of the templates of a package, which escapes all values.

    finalize: Applied to every value first.
    """
    jinja = import_extra("jinja2", "a report", "report")
    environment = jinja.Environment(
        loader=jinja.PackageLoader(package),
        autoescape=True,
        finalize=finalize,
        undefined=jinja.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["base64"] = _base64
    # JSON has no NaN: fail here rather than in the browser.
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    return environment


def _text(name: str) -> str:
    return files("anisomap.drawing.report").joinpath("templates", name).read_text(encoding="utf-8")


def write_report(
    path: str | os.PathLike[str], sensor_map: SensorMap, *, title: str = "", **contents: Any
) -> None:
    """Write a report with an interactive view of the map, for any browser.

    Parameters
    ----------
    path : path-like
        File name ending in .html or .htm. An existing file is replaced only when the new one is
        complete.
    sensor_map : SensorMap
    title : str
        By default, according to the map, of a skin or of objects.
    **contents
        ``score``, ``health``, the ``summary`` of the recording, ``touches``, and ``origin``:
        named facts about the origin of the map, such as the command and digests of its inputs.

    Raises
    ------
    FileError
        If the suffix is wrong or the file cannot be written.
    MissingExtraError
        If jinja2 is not installed.
    """
    check_writable(path)
    text = render_report(sensor_map, title=title, **contents)
    with atomic_write(path) as temporary:
        # Names from damaged files may contain lone surrogates, which UTF-8 cannot encode.
        temporary.write_bytes(text.encode("utf-8", errors="replace"))


def render_report(
    sensor_map: SensorMap,
    *,
    score: Score | None = None,
    health: Sequence[SensorHealth] = (),
    summary: RecordingSummary | None = None,
    touches: Touches | None = None,
    origin: Mapping[str, str] | None = None,
    title: str = "",
) -> str:
    """Return a report as text; the result is reproducible.

    origin: Named facts about the origin of the map, such as the command and digests of its inputs.

    Names and notes are escaped. The page runs only its own script, and sends no requests.
    """
    page = templates("anisomap.drawing.report", _shown).get_template("report.html")
    statuses = _sensor_statuses(sensor_map, health)
    # A script ends at the first "</script": the script of this package does not contain it
    # (tested), and tojson escapes the data.
    script, style = _text("report.js"), _text("report.css")
    text: str = page.render(
        title=title or TITLES[sensor_map.kind],
        verdict=_headlines(sensor_map, score),
        facts=_facts(sensor_map, score),
        caveats=_caveats(sensor_map, score, summary),
        scene=[
            _view(sensor_map, component, statuses, None if touches is None else touches.coverage)
            for component in drawn_components(sensor_map, score)
        ],
        compared=score is not None,
        kind=sensor_map.kind,
        table=_sensor_table(sensor_map, score, health),
        recording=summary.facts if summary else {},
        method=_method_sentences(sensor_map),
        provenance=_provenance(sensor_map, score, origin or {}),
        touches=touches,
        style=style,
        script=script,
        policy=_policy(script, style),
    )
    return text


def check_writable(path: str | os.PathLike[str]) -> None:
    """Check, before a long computation, that a report can be written to a file."""
    checked_kind(check_target(path), SUFFIXES, "a report")
    import_extra("jinja2", "a report", "report")


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
"""Maximum number of sensors per view; browsers rotate this number smoothly."""

_MAX_NAME = 40
_DIGITS = 4  # of a coordinate, relative to the extent of the map: less than a pixel


def _view(
    sensor_map: SensorMap, component: Panel, statuses: Sequence[str], coverage: TouchCoverage | None
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
    """Return the colour of every status present, in the order of `STATUS_COLOURS`."""
    found = set(statuses)
    known = {status: colour for status, colour in STATUS_COLOURS.items() if status in found}
    return known | dict.fromkeys(sorted(found - known.keys()), _OTHER)


def _sample(component: Panel, statuses: Sequence[str]) -> NDArray[np.intp]:
    """Choose the sensors to show of a large component, faulty sensors first."""
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
    """List neighbours never touched simultaneously, and the sensors of places to touch next."""
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
