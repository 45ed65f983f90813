"""Reports on maps: one HTML file each, with everything in it, that works without a network."""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType

from anisomap.drawing.report._scene import scene, status_colours
from anisomap.drawing.report._words import (
    alternative_text,
    cautions,
    contents,
    facts,
    find_statuses,
    provenance,
    sensor_table,
    verdict,
)
from anisomap.drawing.view import bodies, shown
from anisomap.errors import MissingExtraError
from anisomap.evaluation import Score
from anisomap.files import atomic_write, check_target
from anisomap.health import RecordingSummary, SensorHealth
from anisomap.sensor_map import SensorMap

TITLE = "Map of a skin"


def write_report(
    path: str | os.PathLike[str],
    sensor_map: SensorMap,
    *,
    score: Score | None = None,
    health: Sequence[SensorHealth] = (),
    summary: RecordingSummary | None = None,
    figure_png: bytes | None = None,
    title: str = TITLE,
) -> None:
    """Write a report that opens in any browser, with an interactive view of the map.

    Parameters
    ----------
    path : path-like
        The HTML file. It is replaced only once the new one is whole.
    sensor_map, score, health, summary, figure_png, title
        See `render_report`.

    Raises
    ------
    FileError
        If the file cannot be written.
    MissingExtraError
        If jinja2 or plotly is not installed.
    """
    page = render_report(
        sensor_map,
        score=score,
        health=health,
        summary=summary,
        figure_png=figure_png,
        title=title,
    )
    with atomic_write(path) as aside:
        # A name read from a damaged file may hold half a character, which no encoding takes.
        aside.write_bytes(page.encode("utf-8", errors="replace"))


def render_report(
    sensor_map: SensorMap,
    *,
    score: Score | None = None,
    health: Sequence[SensorHealth] = (),
    summary: RecordingSummary | None = None,
    figure_png: bytes | None = None,
    title: str = TITLE,
) -> str:
    """Make the text of a report.

    The same input gives the same text. Names and notes are shown as they are, whatever they hold:
    none is taken for markup, the page runs no script but its own, and it fetches nothing.

    Parameters
    ----------
    sensor_map : SensorMap
        The map.
    score : Score, optional
        The comparison of this very map with the truth, if that is known.
    health : sequence of SensorHealth
        What each sensor did; the words of the map stand in where there is none.
    summary : RecordingSummary, optional
        What the recording held.
    figure_png : bytes, optional
        A picture of the map as PNG, for print and for browsers that show no 3D view.
    title : str
        Headline.

    Returns
    -------
    str
        An HTML document; about 5 MB, for it carries the library that draws the view.

    Raises
    ------
    MissingExtraError
        If jinja2 or plotly is not installed.
    """
    page = _load_page()
    drawn = bodies(sensor_map, score)
    statuses = find_statuses(sensor_map, health)
    document: str = page.render(
        title=shown(title),
        verdict=verdict(sensor_map, score),
        facts=facts(sensor_map, score),
        cautions=cautions(sensor_map, score, summary),
        scene=scene(sensor_map, drawn, score, statuses),
        statuses=status_colours(statuses),
        figure_png=figure_png,
        alt=alternative_text(sensor_map, score),
        compared=score is not None,
        table=sensor_table(sensor_map, score, health),
        contents=contents(summary),
        provenance=provenance(sensor_map, score),
    )
    return document


def check_writable(path: str | os.PathLike[str]) -> None:
    """Find out before the work whether a report could be written to a file.

    Parameters
    ----------
    path : path-like
        As for `write_report`.

    Raises
    ------
    FileError
        If `path` is a folder, or lies in none.
    MissingExtraError
        If jinja2 or plotly is not installed.
    """
    check_target(path)
    _load_page()


def _load_page() -> ModuleType:
    """Import what needs the extra only when a report is made."""
    try:
        return import_module("anisomap.drawing.report._page")
    except ModuleNotFoundError as error:
        raise MissingExtraError("a report", "report") from error
