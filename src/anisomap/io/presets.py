"""Known numberings of sensors: rectangular arrays, and robots.

A new robot is one function that returns the index and name of each sensor in a recording, and one
line in `PRESETS`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.base.channels import TACTILE, channel_name
from anisomap.errors import FileError, InputError
from anisomap.io.parsing.names import cells_of, numbers_of
from anisomap.io.parsing.source import warn
from anisomap.io.stream import Block, Stream, join_blocks
from anisomap.names import default_names
from anisomap.recording import Recording

UNITS = "spacings"
"""Unit of grid positions if the physical spacing is unknown."""


def grid_positions(rows: int, columns: int) -> NDArray[np.float64]:
    """Return the positions, (rows * columns, 2), of a rectangular array in row-major order."""
    y, x = np.mgrid[:rows, :columns].astype(np.float64)
    return np.column_stack([x.ravel(), y.ravel()])


def grid_names(rows: int, columns: int) -> tuple[str, ...]:
    """Return the names ``r0c0, r0c1, ...`` of a rectangular array in row-major order."""
    return tuple(f"r{row}c{column}" for row in range(rows) for column in range(columns))


def with_grid(recording: Recording, grid: tuple[int, int] | None) -> Recording:
    """Set the positions of a recording to those of a rectangular array in row-major order."""
    if grid is None:
        return recording
    rows, columns = grid
    recording = _without_empty_cells(recording)
    unnamed = recording.names == default_names(recording.n_sensors)
    cells: Sequence[int] | None = range(recording.n_sensors)
    if rows * columns != recording.n_sensors:
        cells = None if unnamed else cells_of(recording.names, rows, columns)
    if cells is None:
        size = f"{rows} x {columns} grid of {rows * columns}, and names give no cells, as r3c5"
        raise InputError(f"{recording.n_sensors} sensors do not fill a {size}")
    names = grid_names(rows, columns) if unnamed else recording.names
    places = grid_positions(rows, columns)[cells]
    return replace(recording, positions=places, units=UNITS, names=names)


def in_grid(stream: Stream, grid: tuple[int, int] | None) -> Stream:
    """Join the rows of frames that are stored successively, if the columns agree with the grid."""
    if grid is None or grid[0] == 1 or stream.n_sensors != grid[1]:
        return stream
    rows, columns = grid
    counted = ([*range(columns)], [*range(1, columns + 1)])
    if stream.names and numbers_of(stream.names) not in counted:
        return stream  # names of columns may give cells

    def blocks() -> Iterator[Block]:
        held: Block | None = None
        for block in stream.blocks:
            whole = join_blocks([held, block]) if held else block
            n_frames = len(whole.readings) // rows
            held = whole.part(n_frames * rows, None)
            whole = whole.part(0, n_frames * rows)
            arrays = {name: each[::rows] for name, each in whole.arrays.items()}
            arrays["readings"] = whole.readings.reshape(n_frames, rows * columns)
            yield replace(whole, **arrays)
        if held and len(held.readings):
            raise FileError(f"{stream.path}: its lines are not a multiple of the {rows} rows")

    rate = None if stream.rate_hz is None else stream.rate_hz / rows
    return stream.of_others(grid_names(rows, columns), blocks(), rate)


def _without_empty_cells(recording: Recording) -> Recording:
    empty = ~np.isfinite(recording.readings).any(axis=0)
    if not empty.any() or empty.all():
        return recording
    cells = f"{np.count_nonzero(empty)} of {recording.n_sensors} cells of the grid"
    warn(recording.source, f"{cells} have no reading; they are taken as silent")
    return replace(recording, readings=np.where(empty, 0, recording.readings))


Numbering: TypeAlias = Callable[[Recording], dict[int, str]]
"""Function that returns the index and name of each value of a recording that is a sensor."""

_BOARD, _TRIANGLE = 192, 12
_FINGERS = ("index", "middle", "ring", "little", "thumb")
_PALM, _PALM_PADS = 96, 48
_NO_PALM_PADS = (11, 23, 35, 43)
_RAW_REST = 128  # readings at rest are near 240 for raw and 0 for compensated skin


def apply_preset(recording: Recording, preset: str) -> Recording:
    """Name the sensors of a known robot, and drop values that are not sensors."""
    if not preset:
        return recording
    kept = numbering(recording, preset)
    chosen = recording.select(list(kept))
    rest = float(np.nanmedian(chosen.readings[0]))
    state = "raw, falls when pressed" if rest > _RAW_REST else "compensated, rests at 0"
    metadata = {**recording.metadata, "preset": preset, "skin": state}
    return replace(chosen, names=tuple(kept.values()), metadata=metadata)


def check_preset(preset: str) -> None:
    """Check that a preset exists."""
    if preset not in PRESETS:
        raise InputError(f"unknown preset {preset!r}; known presets: {', '.join(PRESETS)}")


def numbering(recording: Recording, preset: str) -> dict[int, str]:
    """Return the index and name of each sensor in a robot's recording."""
    check_preset(preset)
    ports, kept = dict[str, list[int]](), dict[int, str]()
    for index, name in enumerate(recording.names):
        ports.setdefault(name.rpartition("/")[0], []).append(index)
    for port, indices in ports.items():
        part, prefix = recording.select(indices), ""
        if port:
            part, prefix = replace(part, source=port, metadata={}), f"{port}/"
        kept |= {indices[i]: f"{prefix}{name}" for i, name in PRESETS[preset](part).items()}
    if not kept:
        raise InputError(f"no sensor of preset {preset} varies in this recording")
    return kept


def icub(recording: Recording) -> dict[int, str]:
    """Name the pads of an iCub: index = 192 * board + 12 * triangle + k, without thermal pads.

    Absent triangles have constant readings. Schmitz et al. (2011), IEEE Transactions on Robotics
    27(3): 389-400, doi:10.1109/TRO.2011.2132930.
    """
    named = f"{recording.source} {recording.metadata.get('port', '')}"
    if recording.n_sensors == _BOARD and re.search(r"hand(_comp)?\b", named):
        return icub_hand(recording)
    if recording.n_sensors % _TRIANGLE:
        raise InputError(
            f"an iCub port has a multiple of {_TRIANGLE} values, got {recording.n_sensors}"
        )
    varying = recording.varying().reshape(-1, _TRIANGLE)
    present = np.asarray(varying.any(axis=1))
    return {
        index: channel_name(index)
        for index in range(recording.n_sensors)
        if present[index // _TRIANGLE] and index % _TRIANGLE in TACTILE
    }


def icub_hand(recording: Recording) -> dict[int, str]:
    """Name the pads of an iCub hand: five fingertips of 12 pads, and the palm."""
    if recording.n_sensors != _BOARD:
        raise InputError(f"an iCub hand has {_BOARD} values, got {recording.n_sensors}")
    parts = {name: range(12 * i, 12 * i + 12) for i, name in enumerate(_FINGERS)}
    parts["palm"] = range(_PALM, _PALM + _PALM_PADS)
    varying = recording.varying()
    return {
        index: f"{part}.{index - indices.start}"
        for part, indices in parts.items()
        if varying[indices].any()
        for index in indices
        if part != "palm" or index - _PALM not in _NO_PALM_PADS
    }


PRESETS: Mapping[str, Numbering] = MappingProxyType({"icub": icub, "icub-hand": icub_hand})
