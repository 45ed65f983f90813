"""Figures as files."""

from __future__ import annotations

import io
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from anisomap.drawing.figures.backend import drawing_style, load
from anisomap.errors import FileError, InputError
from anisomap.files import atomic_write, check_target

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = ("png", "svg", "pdf")
"""File formats of pictures."""

# Metadata that would make two files of the same figure differ.
_METADATA = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}


def figure_bytes(figure: Figure, kind: str = "png") -> bytes:
    """Render a figure; the same figure gives the same bytes.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    kind : {"png", "svg", "pdf"}
        File format.

    Returns
    -------
    bytes
        Contents of the file.

    Raises
    ------
    InputError
        If the format is unknown.
    MissingExtraError
        If matplotlib is not installed.
    """
    if kind not in KINDS:
        raise InputError(f"unknown picture format {kind!r}; use {', '.join(KINDS)}")
    buffer = io.BytesIO()
    with drawing_style(), warnings.catch_warnings():
        # Sensor names may be in any script; a letter that the font lacks is drawn as a box.
        warnings.filterwarnings("ignore", message=r"(?s).*missing from font")
        figure.savefig(buffer, format=kind, metadata=_METADATA[kind])
    return buffer.getvalue()


def save_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Save a figure as PNG, SVG or PDF, according to the suffix of the file name.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    path : path-like
        Where to save it. An existing file is replaced only when the new one is complete.

    Raises
    ------
    FileError
        If the suffix is unknown or the file cannot be written.
    MissingExtraError
        If matplotlib is not installed.
    """
    content = figure_bytes(figure, _kind(path))
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Check, before a long computation, that a picture can be saved to a file.

    Parameters
    ----------
    path : path-like
        As for `save_figure`.

    Raises
    ------
    FileError
        If the suffix is not .png, .svg or .pdf, or the folder does not exist.
    MissingExtraError
        If matplotlib is not installed.
    """
    _kind(check_target(path))
    load("matplotlib")


def _kind(path: str | os.PathLike[str]) -> str:
    kind = Path(path).suffix.lower().removeprefix(".")
    if kind not in KINDS:
        raise FileError(f"cannot save a picture as {path}; the name must end in .png, .svg or .pdf")
    return kind
