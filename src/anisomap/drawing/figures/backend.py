"""Access to matplotlib: the common style, panels, and picture files.

matplotlib is optional and slow to import. Functions that draw import it with `load`; no module of
this package imports it at its top.
"""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.base.wording import printable, shortened
from anisomap.drawing.view import checked_kind
from anisomap.errors import InputError, import_extra
from anisomap.files.paths import atomic_write, check_target

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Axes: TypeAlias = Any
"""A matplotlib Axes. Typed as Any, because matplotlib's 3D axes have no type annotations."""

INK = "#22262b"
FAINT = "#6a737d"

PALETTE = ("#0072b2", "#e69f00", "#009e73", "#cc79a7")
"""Colours that remain distinct with every common colour vision deficiency (Okabe & Ito 2008)."""

MARKERS = ("o", "s", "^", "D")
"""Markers that go with `PALETTE`, for printing in black and white."""

_CORNER = 0.15  # share of an axis without ticks
_SHORT = 0.6  # length of short axes, relative to the longest axis
_NOTE, _TITLE = 0.05, 0.09  # share of the height of a figure
_MARGIN, _EDGE = 0.2, 0.12  # inches beside texts, and above or below texts
_MAX_TITLE = 80  # characters
_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "text.color": INK,
    "axes.edgecolor": "#c9cdd2",
    "axes.labelcolor": INK,
    "axes.labelsize": 9,
    "grid.color": "#d5d9dd",
    "grid.linewidth": 0.6,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "svg.hashsalt": "anisomap",
    "savefig.dpi": 150,
    "figure.dpi": 150,
}


def load(module: str) -> Any:
    """Import a module of matplotlib or of a library that matplotlib requires."""
    return import_extra(module, "a picture", "report")


@contextmanager
def drawing_style() -> Iterator[None]:
    """Apply the style of this package instead of the user's matplotlibrc."""
    with load("matplotlib.style").context(["default", _STYLE]):
        yield


@contextmanager
def new_figure(
    width: float, height: float, title: str = "", notes: Sequence[str] = (), **settings: Any
) -> Iterator[Figure]:
    """Create a figure without a window, in the style of this package; sizes in inches.

    The figure has a title, and notes at the bottom.
    """
    kind = load("matplotlib.figure").Figure
    note = {"va": "bottom", "fontsize": 8.5, "color": FAINT, "linespacing": 1.35}
    with drawing_style():
        figure = kind(figsize=(width, height), facecolor="white", **settings)
        _write(figure, title, height - _EDGE, va="top", fontsize=14, fontweight="bold", color=INK)
        _write(figure, "\n".join(notes), _EDGE, **note)
        yield figure


def _write(figure: Figure, text: str, y: float, **style: Any) -> None:
    if text:
        width, height = figure.get_size_inches()
        figure.text(_MARGIN / width, y / height, text, parse_math=False, **style)


@contextmanager
def panel(
    ax: Axes | None, dimensions: int, title: str = "", note: str = "", *, legend: int = 0
) -> Iterator[Axes]:
    """Check and return given axes, or create axes in a new figure with a title and notes.

    legend: Columns of a legend above the panel; 0 for none.
    """
    if ax is not None:
        if (ax.name == "3d") != (dimensions == 3):
            wanted = "3D axes (projection='3d')" if dimensions == 3 else "2D axes"
            raise InputError(f"the data need {wanted}, got axes with projection {ax.name!r}")
        yield ax
        return
    bottom, top = (_NOTE if note else 0.0), (_TITLE if title else 0.0)
    with new_figure(8.0, 7.2, shortened(printable(title), _MAX_TITLE), [note]) as figure:
        figure.set_layout_engine("constrained", rect=(0, bottom, 1, 1 - bottom - top))
        yield add_axes(figure, dimensions)
        if legend:
            anchor = (0.99, 0.96)
            figure.legend(loc="upper right", ncols=legend, frameon=False, bbox_to_anchor=anchor)


def add_axes(figure: Figure, dimensions: int, *position: Any) -> Axes:
    """Add 2D or 3D axes to a figure; `position` as for ``Figure.add_subplot``."""
    return figure.add_subplot(*position, projection="3d" if dimensions == 3 else None)


def add_legend(
    figure: Figure,
    marks: Sequence[dict[str, str]],
    corner: Literal["upper left", "upper right"],
    anchor: tuple[float, float],
) -> None:
    """Add a one-row legend to a figure if there are marks; anchor relative to the figure."""
    line = load("matplotlib.lines").Line2D
    handles = [line([], [], ls="none", **mark) for mark in marks]
    if handles:
        figure.legend(
            handles=handles, loc=corner, bbox_to_anchor=anchor, ncols=len(handles), frameon=False
        )


def set_ticks(axes: Axes, extents: NDArray[np.float64], count: int) -> None:
    """Limit the number of ticks to about `count`, on short axes to two. extents (k,)."""
    locator = load("matplotlib.ticker").MaxNLocator
    for name, extent in zip("xyz", extents, strict=False):
        # In 3D, labels lie along foreshortened axes.
        few = extent <= _SHORT * extents.max() or (len(extents) == 3 and name == "y")
        chosen = locator(2 if few else count)
        axis = getattr(axes, f"{name}axis")
        axis.set_major_locator(chosen)
        if len(extents) == 3 and name != "x":
            # A label in the corner of two axes would overlap a label of the other axis.
            low, high = axis.get_view_interval()
            ticks = chosen.tick_values(low, high)
            axis.set_ticks(ticks[(ticks > low + _CORNER * extent) & (ticks < high)])


def set_title(axes: Axes, title: str) -> None:
    """Set the title of a panel; names are never interpreted as mathematics."""
    axes.set_title(title, fontsize=10, color=INK, parse_math=False)


KINDS = ("png", "svg", "pdf")
"""File formats of pictures."""

# Metadata that would differ between two files of the same figure.
_METADATA = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}


def figure_bytes(figure: Figure, kind: str = "png") -> bytes:
    """Render a figure; the result is reproducible.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    kind : {"png", "svg", "pdf"}

    Returns
    -------
    bytes
        Content of the picture file.

    Raises
    ------
    InputError
        If the format is unknown.
    """
    if kind not in KINDS:
        raise InputError(f"unknown picture format {kind!r}; use {', '.join(KINDS)}")
    buffer = io.BytesIO()
    with drawing_style(), warnings.catch_warnings():
        # Sensor names may be in any script; letters that the font lacks are drawn as boxes.
        warnings.filterwarnings("ignore", message=r"(?s).*missing from font")
        figure.savefig(buffer, format=kind, metadata=_METADATA[kind])
    return buffer.getvalue()


def save_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Save a figure as PNG, SVG or PDF, according to the suffix of the file name.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    path : path-like
        Target file. An existing file is replaced only when the new one is complete.

    Raises
    ------
    FileError
        If the suffix is unknown or the file cannot be written.
    MissingExtraError
        If matplotlib is not installed.
    """
    content = figure_bytes(figure, checked_kind(path, KINDS, "a picture"))
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Check, before a long computation, that a picture can be saved to a file."""
    checked_kind(check_target(path), KINDS, "a picture")
    load("matplotlib")
