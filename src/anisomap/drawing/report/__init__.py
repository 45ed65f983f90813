"""Reports of maps: single HTML files that need no network."""

from __future__ import annotations

import os
from collections.abc import Sequence

from anisomap.drawing.report import page
from anisomap.drawing.report.interactive import interactive_views, status_colours
from anisomap.drawing.report.report_text import (
    Touches,
    alternative_text,
    caveats,
    facts,
    headlines,
    provenance,
    recording_facts,
    sensor_statuses,
    sensor_table,
)
from anisomap.drawing.view import drawn_components, printable
from anisomap.errors import FileError
from anisomap.evaluation import Score
from anisomap.files import atomic_write, check_target
from anisomap.health import RecordingSummary, SensorHealth
from anisomap.sensor_map import SensorMap

__all__ = ["SUFFIXES", "TITLE", "Touches", "check_writable", "render_report", "write_report"]

TITLE = "Map of a skin"

SUFFIXES = (".html", ".htm")
"""Suffixes of report files."""


def write_report(
    path: str | os.PathLike[str],
    sensor_map: SensorMap,
    *,
    score: Score | None = None,
    health: Sequence[SensorHealth] = (),
    summary: RecordingSummary | None = None,
    figure_png: bytes | None = None,
    touches: Touches | None = None,
    title: str = TITLE,
) -> None:
    """Write a report with an interactive view of the map, for any browser.

    Parameters
    ----------
    path : path-like
        File name ending in .html or .htm. An existing file is replaced only when the new one is
        complete.
    sensor_map, score, health, summary, figure_png, touches, title
        See `render_report`.

    Raises
    ------
    FileError
        If the suffix is wrong or the file cannot be written.
    MissingExtraError
        If jinja2 or plotly is not installed.
    """
    check_writable(path)
    text = render_report(
        sensor_map,
        score=score,
        health=health,
        summary=summary,
        figure_png=figure_png,
        touches=touches,
        title=title,
    )
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
    title: str = TITLE,
) -> str:
    """Return a report as text; the same input gives the same text.

    Names and notes are escaped. The page runs no scripts but its own and sends no requests.

    Parameters
    ----------
    sensor_map : SensorMap
        The map.
    score : Score, optional
        Score of this map against the truth.
    health : sequence of SensorHealth
        Health of the sensors; by default the statuses of the map are listed.
    summary : RecordingSummary, optional
        Summary of the recording.
    figure_png : bytes, optional
        Picture of the map as PNG, for printing and for browsers without 3D graphics.
    touches : Touches, optional
        How the skin was touched, with pictures.
    title : str
        Headline.

    Returns
    -------
    str
        An HTML document of about 5 MB, most of which is the library of the interactive view.

    Raises
    ------
    MissingExtraError
        If jinja2 or plotly is not installed.
    """
    drawn = drawn_components(sensor_map, score)
    statuses = sensor_statuses(sensor_map, health)
    return page.render(
        title=printable(title),
        verdict=headlines(sensor_map, score),
        facts=facts(sensor_map, score),
        caveats=caveats(sensor_map, score, summary),
        scene=interactive_views(sensor_map, drawn, score, statuses),
        statuses=status_colours(statuses),
        figure_png=figure_png,
        touches=touches,
        alt=alternative_text(sensor_map, score),
        compared=score is not None,
        table=sensor_table(sensor_map, score, health),
        recording=recording_facts(summary),
        provenance=provenance(sensor_map, score),
    )


def check_writable(path: str | os.PathLike[str]) -> None:
    """Check, before a long computation, that a report can be written to a file.

    Parameters
    ----------
    path : path-like
        As for `write_report`.

    Raises
    ------
    FileError
        If the suffix is not .html or .htm, or the folder does not exist.
    MissingExtraError
        If jinja2 or plotly is not installed.
    """
    if check_target(path).suffix.lower() not in SUFFIXES:
        raise FileError(f"cannot write a report to {path}; the name must end in .html or .htm")
    page.load_libraries()
