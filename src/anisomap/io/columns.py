"""Selection of the columns of a file that are sensors, and of axes of taxels with three axes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.base.columns import Taxels, examine, without_units
from anisomap.errors import FileError
from anisomap.io.parsing.source import warn
from anisomap.io.stream import Block, ReadOptions, Stream
from anisomap.names import default_names, find_sensors

_ROWS, _LEAST_ROWS, _CELLS = 1000, 20, 1 << 17  # that determine the kinds of columns
_REMEDIES = {
    "--keep": "give --keep to choose others",
    "--axis": "choose with --axis z, norm, x, y, or all for each by itself",
}


def sensors_of(stream: Stream, options: ReadOptions) -> Stream:
    """Leave out columns that are not sensors, and take one axis of taxels with three; warn of both.

    If `options.keep` is given, it alone determines the sensors.
    """
    if not (stream.raw_columns or options.keep):
        return stream
    first = None
    if options.keep:
        stream = replace(stream, names=without_units(stream.names))
        own = stream.names or default_names(stream.n_sensors)
        stream = _selected(stream, find_sensors(own, options.keep, "column"))
    elif options.preset or (options.grid and not stream.names):
        return replace(stream, names=without_units(stream.names))
    else:
        first, stream = _peeked(stream)
    names, others, taxels, said = examine(stream.names, first, options.axis, stream.columns)
    for option, text in said.items():
        warn(stream.path, text, _REMEDIES[option])
    stream = replace(stream, names=names)
    if others and names:
        named = ", ".join(f"({stream.names[i]})" for i in sorted(others))
        stream = replace(stream, metadata={**stream.metadata, "other_columns": named})
    if taxels:
        return _one_axis(stream, options.axis, taxels, others)
    kept = [i for i in range(stream.n_sensors) if i not in others]
    return _selected(stream, np.array(kept, dtype=np.intp))


def _peeked(stream: Stream) -> tuple[NDArray[Any], Stream]:
    """Return the first rows, and the stream of all."""
    held, wanted = list[Block](), max(_LEAST_ROWS, min(_ROWS, _CELLS // stream.n_sensors))
    for block in stream.blocks:
        if not len(block.readings):
            break  # more lines may follow
        held.append(block)
        if sum(len(each.readings) for each in held) >= wanted:
            break
    rows = [block.readings[:wanted] for block in held] or [np.empty((0, stream.n_sensors))]
    found = np.concatenate(rows)[:wanted]

    def blocks() -> Iterator[Block]:
        while held:  # and no longer, since blocks take memory
            yield held.pop(0)
        yield from stream.blocks

    return found, replace(stream, blocks=blocks())


def _selected(stream: Stream, kept: NDArray[np.intp]) -> Stream:
    """Keep some columns."""
    if np.array_equal(kept, np.arange(stream.n_sensors)):
        return stream
    names = stream.names or default_names(stream.n_sensors)
    return _converted(stream, tuple(names[i] for i in kept), kept, lambda rows: rows[:, kept])


def _one_axis(stream: Stream, axis: str, taxels: Taxels, left_out: Collection[int]) -> Stream:
    """Take an axis, or the length, of taxels with three axes; other columns are kept."""
    places = np.array([*taxels.columns.values()])
    kept, names = taxels.kept(stream.names, left_out, "z" if axis == "norm" else axis)
    if len(set(names)) < len(names):
        raise FileError(f"{stream.path}: taxels have the names of other columns; give --keep")
    if axis == "norm":
        first, stream = _peeked(stream)
        with np.errstate(invalid="ignore"):
            rest = np.median(first.astype(np.float64), axis=0)

        def length(rows: NDArray[Any]) -> NDArray[Any]:
            squares = (rows - rest)[:, places] ** 2
            return np.hstack([np.sqrt(squares.sum(axis=2)), rows[:, kept[len(places) :]]])

        return _converted(stream, names, kept, length)
    return _converted(stream, names, kept, lambda rows: rows[:, kept])


def _converted(
    stream: Stream,
    names: tuple[str, ...],
    kept: Any,
    convert: Callable[[NDArray[Any]], NDArray[Any]],
) -> Stream:
    def blocks() -> Iterator[Block]:
        for block in stream.blocks:
            yield replace(block, readings=convert(block.readings))

    chosen = np.asarray(kept, dtype=np.intp)
    positions, normals, distances = stream.positions, stream.normals, stream.surface_distances
    return replace(
        stream,
        n_sensors=len(names),
        blocks=blocks(),
        names=names,
        columns=tuple(stream.columns[i] for i in kept) if stream.columns else (),
        positions=None if positions is None else positions[chosen],
        normals=None if normals is None else normals[chosen],
        surface_distances=None if distances is None else distances[np.ix_(chosen, chosen)],
    )
