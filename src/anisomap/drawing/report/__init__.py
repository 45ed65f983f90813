"""Reports of maps: single HTML files that need no network."""

from __future__ import annotations

import base64
import hashlib
import os
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from anisomap.drawing.report.contents import (
    Touches,
    alternative_text,
    caveats,
    facts,
    headlines,
    method_sentences,
    provenance,
    sensor_statuses,
    sensor_table,
)
from anisomap.drawing.report.interactive import interactive_views, status_colours
from anisomap.drawing.view import drawn_components, printable
from anisomap.errors import FileError, import_extra
from anisomap.evaluation import Score
from anisomap.files import atomic_write, check_target
from anisomap.health import RecordingSummary, SensorHealth
from anisomap.sensor_map import SensorMap


def load_libraries() -> tuple[Any, Any]:
    """Import jinja2 and plotly."""
    jinja2 = import_extra("jinja2", "a report", "report")
    return jinja2, import_extra("plotly.offline", "a report", "report")


def _policy(scripts: list[str]) -> str:
    """Return a content security policy without network access and without foreign scripts.

    plotly compiles its 3D drawing code at run time, which needs 'unsafe-eval'.
    """
    hashes = [base64.b64encode(hashlib.sha256(text.encode()).digest()) for text in scripts]
    allowed = " ".join(f"'sha256-{digest.decode('ascii')}'" for digest in hashes)
    return (
        f"default-src 'none'; script-src {allowed} 'unsafe-eval'; "
        "style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'"
    )


@cache
def _environment() -> Any:
    jinja, _ = load_libraries()
    environment = jinja.Environment(
        loader=jinja.PackageLoader("anisomap.drawing.report"),
        autoescape=True,
        undefined=jinja.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # JSON has no NaN: fail here rather than in the browser.
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    return environment


def _text(name: str) -> str:
    return files("anisomap.drawing.report").joinpath("templates", name).read_text(encoding="utf-8")


__all__ = ["SUFFIXES", "TITLE", "Touches", "check_writable", "render_report", "write_report"]

TITLE = "Map of a skin"

SUFFIXES = (".html", ".htm")
"""Suffixes of report files."""


def write_report(
    path: str | os.PathLike[str], sensor_map: SensorMap, *, title: str = TITLE, **contents: Any
) -> None:
    """Write a report with an interactive view of the map, for any browser.

    Parameters
    ----------
    path : path-like
        File name ending in .html or .htm. An existing file is replaced only when the new one is
        complete.
    sensor_map : SensorMap
    title : str
    **contents
        ``score``, ``health``, the ``summary`` of the recording, ``touches``, ``figure_png``, and
        ``origin``: how the map came about, by name, such as the command and digests of its inputs.

    Raises
    ------
    FileError
        If the suffix is wrong or the file cannot be written.
    MissingExtraError
        If jinja2 or plotly is not installed.
    """
    check_writable(path)
    text = render_report(sensor_map, title=title, **contents)
    with atomic_write(path) as temporary:
        # A name read from a damaged file may contain a lone surrogate, which UTF-8 cannot encode.
        temporary.write_bytes(text.encode("utf-8", errors="replace"))


def render_report(
    sensor_map: SensorMap,
    *,
    score: Score | None = None,
    health: Sequence[SensorHealth] = (),
    summary: RecordingSummary | None = None,
    figure_png: bytes | None = None,
    touches: Touches | None = None,
    origin: Mapping[str, str] | None = None,
    title: str = TITLE,
) -> str:
    """Return a report as text; the same input gives the same text.

    origin: How the map came about, by name, such as the command and digests of its inputs.

    Names and notes are escaped. The page runs no scripts but its own and sends no requests.
    """
    _, plotly = load_libraries()
    drawn = drawn_components(sensor_map, score)
    statuses = sensor_statuses(sensor_map, health)
    scene = interactive_views(sensor_map, drawn, score, statuses)
    # A script ends at the first "</script", wherever it occurs. The texts of plotly and of this
    # package contain none (tested), and tojson escapes the data.
    own = _text("report.js")
    scripts = [plotly.get_plotlyjs(), own] if scene else [own]
    page: str = (
        _environment()
        .get_template("report.html")
        .render(
            title=printable(title),
            verdict=headlines(sensor_map, score),
            facts=facts(sensor_map, score),
            caveats=caveats(sensor_map, score, summary),
            scene=scene,
            statuses=status_colours(statuses),
            alt=alternative_text(sensor_map, score),
            compared=score is not None,
            table=sensor_table(sensor_map, score, health),
            recording=summary.facts if summary else {},
            method=method_sentences(sensor_map),
            provenance=provenance(sensor_map, score, origin or {}),
            picture=_encoded(figure_png),
            touches=None
            if touches is None
            else {printable(name): printable(value) for name, value in touches.facts.items()},
            touch_picture=_encoded(None if touches is None else touches.map_png),
            series_picture=_encoded(None if touches is None else touches.series_png),
            style=_text("report.css"),
            scripts=scripts,
            policy=_policy(scripts),
        )
    )
    return page


def _encoded(png: bytes | None) -> str | None:
    return None if png is None else base64.b64encode(png).decode("ascii")


def check_writable(path: str | os.PathLike[str]) -> None:
    """Check, before a long computation, that a report can be written to a file."""
    if check_target(path).suffix.lower() not in SUFFIXES:
        raise FileError(f"cannot write a report to {path}; the name must end in .html or .htm")
    load_libraries()
