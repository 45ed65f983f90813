"""Which panels a picture of a map has, where they stand, and what is written around them."""

from __future__ import annotations

import io
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from matplotlib import style
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from anisomap.drawing.figures._panels import (
    FAINT,
    INK,
    Axes,
    Look,
    draw_body,
    draw_distances,
)
from anisomap.drawing.view import (
    MOST_JOINED,
    VIEWS,
    Body,
    View,
    bodies,
    box_around,
    shown,
    view_axes,
    warn_of_pieces,
)
from anisomap.evaluation import Score
from anisomap.sensor_map import SensorMap
from anisomap.wording import join_items

_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.edgecolor": "#c9cdd2",
    "grid.color": "#d5d9dd",
    "grid.linewidth": 0.6,
    "axes.labelsize": 9,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "svg.hashsalt": "anisomap",
    "savefig.dpi": 150,
    "figure.dpi": 150,
}
_NO_TRACES = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}
# Inches.
_WIDTH, _NARROW, _HEAD, _ROW, _PIECES_ROW, _FOOT, _LINE = 14.0, 8.0, 0.5, 5.4, 4.2, 0.2, 0.17
_PIECES_A_ROW, _MOST_PIECES = 3, 9
_SIDES = (1.0, 1.0, 1.0)
_COMPARISON = (1.2, 1.2, 0.02, 0.95)  # the third is a gap, for the z axis and its title
_LABELS, _LABEL_ALL, _LONGEST_LABEL = 8, 12, 14
_CHARACTERS_AN_INCH, _MOST_LINES = 13.5, 10


def map_figure(sensor_map: SensorMap, score: Score | None) -> Figure:
    """See `anisomap.drawing.figures.map_figure`."""
    drawn = bodies(sensor_map, score)
    first = drawn[:1] if score is not None or len(drawn) == 1 else []
    others = drawn[len(first) :]
    pieces = others[:_MOST_PIECES]
    flat = bool(first) and score is None and first[0].points.shape[1] == 2
    width = _NARROW if flat else _WIDTH
    notes = _notes(sensor_map, score, len(others) - len(pieces), width)
    main_row = _ROW if first else 0.0
    height = _HEAD + main_row - (-len(pieces) // _PIECES_A_ROW) * _PIECES_ROW
    with drawing_style():
        figure = Figure(figsize=(width, height + _FOOT + _LINE * len(notes)), facecolor="white")
        for body in first:
            ratios = (1.0,) if flat else _SIDES if score is None else _COMPARISON
            cells = _cells(figure, 0, _ROW, ratios)
            if score is None:
                _draw_alone(figure, sensor_map, body, cells)
            else:
                _draw_comparison(figure, sensor_map, body, score, cells)
        for i, body in enumerate(pieces):
            row, column = divmod(i, _PIECES_A_ROW)
            top = main_row + row * _PIECES_ROW
            cells = _cells(figure, top, _PIECES_ROW, (1.0,) * _PIECES_A_ROW)
            _draw_piece(figure, sensor_map, body, cells, column)
        _write_around(figure, _title(sensor_map, score), notes)
        _explain_marks(figure, sensor_map, first + pieces)
        return figure


def figure_bytes(figure: Figure, kind: str) -> bytes:
    """See `anisomap.drawing.figures.figure_bytes`."""
    buffer = io.BytesIO()
    with drawing_style(), warnings.catch_warnings():
        # A sensor's name may be in any script; a box in place of a letter is no reason to worry.
        warnings.filterwarnings("ignore", message=r"(?s).*missing from font")
        figure.savefig(buffer, format=kind, metadata=_NO_TRACES[kind])
    return buffer.getvalue()


@contextmanager
def drawing_style() -> Iterator[None]:
    """Draw alike whatever a user's matplotlibrc says."""
    with style.context(["default", _STYLE]):
        yield


def _cells(figure: Figure, top: float, height: float, ratios: Sequence[float]) -> GridSpec:
    """Make a row of cells for panels, `top` inches below the head."""
    total = figure.get_figheight()
    upper = total - _HEAD - top - 0.55
    return figure.add_gridspec(
        1,
        len(ratios),
        left=0.045,
        right=0.985,
        top=upper / total,
        bottom=(upper - height + 1.15) / total,
        wspace=0.2,
        width_ratios=ratios,
    )


def _draw_comparison(
    figure: Figure, sensor_map: SensorMap, body: Body, score: Score, cells: GridSpec
) -> None:
    alignment = score.alignment
    how = "turned, scaled, mirrored" if alignment.reflected else "turned and scaled"
    error = f"{score.rms:.3g} {shown(score.units, 24)}".strip()
    spacings = f" = {score.rms_in_spacings:.2g} sensor spacings" if score.spacing > 0 else ""
    titles = ("True places", f"Map, {how} to fit\nRMS error {error}{spacings}")
    look = _look(sensor_map, body, _spread_out(body.truth, body.view))
    for column, (title, points) in enumerate(zip(titles, (body.truth, body.points), strict=True)):
        axes = _add_body(figure, cells, column, points.shape[1])
        draw_body(
            axes,
            points,
            look.first(len(points)),
            limits=box_around(body.truth, body.points),
            view=body.view,
            units=body.units,
        )
        _entitle(axes, title)
    axes = figure.add_subplot(cells[0, len(_COMPARISON) - 1])
    label = draw_distances(axes, score.truth, alignment.aligned, score.units)
    _entitle(axes, f"Distances: {_agreement(score)}\n{label}")


def _draw_alone(figure: Figure, sensor_map: SensorMap, body: Body, cells: GridSpec) -> None:
    limits = box_around(body.points)
    sides: tuple[tuple[str, View], ...] = (("", VIEWS[0]),)
    if body.points.shape[1] == 3:
        sides = tuple(zip(("From the front", "From the right", "From above"), VIEWS, strict=True))
    look = _look(sensor_map, body, _spread_out(body.points, VIEWS[0]))
    for column, (title, view) in enumerate(sides):
        axes = _add_body(figure, cells, column, body.points.shape[1])
        draw_body(axes, body.points, look, limits=limits, view=view, units=body.units)
        _entitle(axes, title)


def _draw_piece(
    figure: Figure, sensor_map: SensorMap, body: Body, cells: GridSpec, column: int
) -> None:
    points = body.points
    look = _look(sensor_map, body, _spread_out(points, body.view))
    axes = _add_body(figure, cells, column, points.shape[1])
    draw_body(axes, points, look, limits=box_around(points), view=body.view, units=body.units)
    _entitle(axes, f"Piece {body.number}: {len(points)} sensors, in a frame of its own")


def _look(sensor_map: SensorMap, body: Body, labelled: Sequence[int]) -> Look:
    return Look(
        colours=body.colours,
        pairs=body.pairs,
        ailing=_ailing(sensor_map, body),
        unscored=~body.compared,
        labels={i: shown(sensor_map.names[body.sensors[i]], _LONGEST_LABEL) for i in labelled},
    )


def _ailing(sensor_map: SensorMap, body: Body) -> NDArray[np.bool_]:
    return np.array([sensor_map.health[i] != "ok" for i in body.sensors], dtype=bool)


def _add_body(figure: Figure, cells: GridSpec, column: int, dimensions: int) -> Axes:
    if dimensions == 2:
        return figure.add_subplot(cells[0, column])
    return figure.add_subplot(
        cells[0, column], projection="3d", proj_type="ortho", computed_zorder=False
    )


def _spread_out(points: NDArray[np.float64], view: View) -> list[int]:
    """Pick sensors far from one another, in space those in front, to write their names by."""
    candidates = np.arange(len(points))
    if len(points) <= _LABEL_ALL:
        return candidates.tolist()
    if points.shape[1] == 3:
        nearness = points @ view_axes(view)[2]
        candidates = np.flatnonzero(nearness >= np.median(nearness))
    chosen = [int(candidates[np.argmin(points[candidates].sum(axis=1))])]
    distances = np.full(len(candidates), np.inf)
    while len(chosen) < _LABELS:
        step = np.linalg.norm(points[candidates] - points[chosen[-1]], axis=1)
        distances = np.minimum(distances, step)
        chosen.append(int(candidates[np.argmax(distances)]))
    return chosen


def _entitle(axes: Axes, title: str) -> None:
    axes.set_title(title, fontsize=10, color=INK, parse_math=False)


def _title(sensor_map: SensorMap, score: Score | None) -> str:
    sensors = f"{int(sensor_map.placed.sum())} sensors"
    parts = [shown(sensor_map.method, 60) or "map", sensors]
    if sensor_map.approximate:
        parts.insert(1, "approximate")
    if score is None:
        if np.isfinite(sensor_map.stress):
            parts.append(f"Stress-1 {sensor_map.stress:.3f}")
        return ", ".join(parts)
    return ", ".join([*parts, _agreement(score)])


def _agreement(score: Score) -> str:
    quantiles = score.mantel.quantiles()
    null = f" (null 95 %: {quantiles[0.95]:.2f})" if quantiles else ""
    return f"Mantel r {score.mantel.r:.3f}{null}"


def _notes(sensor_map: SensorMap, score: Score | None, hidden: int, width: float) -> list[str]:
    joined = np.count_nonzero(sensor_map.component == 0) <= MOST_JOINED
    if score is None:
        lines = "Lines join nearest neighbours on the map. " if joined else ""
        notes = [
            f"This map is known up to {sensor_map.known_up_to}. {lines}"
            "A sensor has the same colour in every view."
        ]
    else:
        lines = "Lines join true neighbours in both pictures. " if joined else ""
        notes = [
            f"{lines}A sensor has the same colour in both pictures. "
            "Rotation, scale and mirror image cannot be read from a map: they were fitted."
        ]
    unplaced = [
        shown(sensor_map.names[i], _LONGEST_LABEL) for i in np.flatnonzero(~sensor_map.placed)
    ]
    if unplaced:
        notes.append(f"Not on the map: {join_items(unplaced, 12)}.")
    single = np.count_nonzero(np.bincount(sensor_map.component[sensor_map.placed]) == 1)
    if single and len(sensor_map.component_sizes) > 1:
        notes.append(f"Pieces of a single sensor, not drawn: {single}.")
    if hidden > 0:
        notes.append(f"Smaller pieces, not drawn: {hidden}.")
    if sensor_map.dimensions > 3:
        notes.append(f"Drawn are the first three of {sensor_map.dimensions} dimensions.")
    doubts = [*sensor_map.notes, *warn_of_pieces(sensor_map)]
    notes += [f"Note: {shown(note, 400)}" for note in doubts]
    wrapped = [
        line for note in notes for line in textwrap.wrap(note, int(width * _CHARACTERS_AN_INCH))
    ]
    if len(wrapped) > _MOST_LINES:
        wrapped = [
            *wrapped[: _MOST_LINES - 1],
            "There are more notes: see the map itself, or a report.",
        ]
    return wrapped


def _write_around(figure: Figure, title: str, notes: list[str]) -> None:
    height = figure.get_figheight()
    figure.text(
        0.02,
        1 - 0.2 / height,
        title,
        fontsize=15,
        fontweight="bold",
        color=INK,
        va="top",
        parse_math=False,
    )
    figure.text(
        0.02,
        0.15 / height,
        "\n".join(notes),
        fontsize=8.5,
        color=FAINT,
        va="bottom",
        linespacing=1.35,
        parse_math=False,
    )


def _explain_marks(figure: Figure, sensor_map: SensorMap, drawn: Sequence[Body]) -> None:
    marks = []
    if any(_ailing(sensor_map, body).any() for body in drawn):
        marks.append(Line2D([], [], ls="none", marker="x", color="black", label="unhealthy"))
    if any(not body.compared.all() for body in drawn):
        marks.append(
            Line2D([], [], ls="none", marker="s", mfc="#b8b8b8", mec=INK, label="not compared")
        )
    if marks:
        figure.legend(
            handles=marks,
            loc="upper right",
            bbox_to_anchor=(0.985, 1 - 0.12 / figure.get_figheight()),
            ncols=len(marks),
            frameon=False,
            fontsize=9,
        )
