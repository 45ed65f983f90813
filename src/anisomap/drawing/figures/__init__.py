"""Pictures of maps: beside the truth where it is known, from several sides where it is not."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from anisomap.errors import FileError, InputError, MissingExtraError
from anisomap.evaluation import Score
from anisomap.files import atomic_write, check_target
from anisomap.sensor_map import SensorMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = ("png", "svg", "pdf")
"""What a picture can be saved as."""


def map_figure(sensor_map: SensorMap, score: Score | None = None) -> Figure:
    """Draw a map.

    With a score there are the true places, the map laid onto them (same view, same limits), and
    the distances on the map against the true ones. True neighbours are joined in both
    configurations, so that folds and tears show, and a sensor has the same colour in both: see
    `anisomap.drawing.view.place_colours`. Without one there is the map from three sides, or flat,
    with its own neighbours joined. Separate pieces of a map, which share no frame, have a panel
    each; pieces of one sensor are only counted.

    Parameters
    ----------
    sensor_map : SensorMap
        The map. Of more than three dimensions the first three are drawn.
    score : Score, optional
        The comparison of this very map with the truth, if that is known.

    Returns
    -------
    matplotlib.figure.Figure
        Bound to no window; save it with `save_figure`.

    Raises
    ------
    InputError
        If no sensor is placed.
    MissingExtraError
        If matplotlib is not installed.
    """
    if not sensor_map.placed.any():
        raise InputError("no sensor of the map is placed, so there is nothing to draw")
    figure: Figure = load_drawing("_layout").map_figure(sensor_map, score)
    return figure


def figure_bytes(figure: Figure, kind: str = "png") -> bytes:
    """Render a figure; the same figure gives the same bytes.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        From `map_figure`.
    kind : {"png", "svg", "pdf"}
        The format.

    Returns
    -------
    bytes
        The whole file.

    Raises
    ------
    InputError
        If `kind` is none of these.
    MissingExtraError
        If matplotlib is not installed.
    """
    if kind not in KINDS:
        raise InputError(f"a picture cannot be saved as {kind!r}; use {', '.join(KINDS)}")
    content: bytes = load_drawing("_layout").figure_bytes(figure, kind)
    return content


def save_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Save a figure as PNG, SVG or PDF, whichever the file's name ends with.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        From `map_figure`.
    path : path-like
        Where to. The file is replaced only once the new one is whole.

    Raises
    ------
    FileError
        If the name ends otherwise, or the file cannot be written.
    MissingExtraError
        If matplotlib is not installed.
    """
    content = figure_bytes(figure, _kind(path))
    with atomic_write(path) as aside:
        aside.write_bytes(content)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Find out before the work whether a picture could be saved to a file.

    Parameters
    ----------
    path : path-like
        As for `save_figure`.

    Raises
    ------
    FileError
        If the name ends neither in .png nor .svg nor .pdf, or there is no such folder.
    MissingExtraError
        If matplotlib is not installed.
    """
    _kind(check_target(path))
    load_drawing("_layout")


def _kind(path: str | os.PathLike[str]) -> str:
    kind = Path(path).suffix.lower().removeprefix(".")
    if kind not in KINDS:
        raise FileError(f"{path} is no name for a picture; end it with .png, .svg or .pdf")
    return kind


def load_drawing(room: str) -> ModuleType:
    """Import what draws only when something is drawn: matplotlib is heavy, and an extra.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    try:
        return import_module(f"anisomap.drawing.figures.{room}")
    except ModuleNotFoundError as error:
        raise MissingExtraError("a picture", "report") from error
