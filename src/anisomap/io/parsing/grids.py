"""Names and positions of the sensors of rectangular arrays."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, InputError
from anisomap.io.parsing.naming import cells_of
from anisomap.recording import Recording, default_names

UNITS = "spacings"
"""Unit of grid positions if the physical spacing is unknown."""


def grid_positions(rows: int, columns: int) -> NDArray[np.float64]:
    """Return the positions of a rectangular array in row-major order.

    Parameters
    ----------
    rows, columns : int

    Returns
    -------
    ndarray of shape (rows * columns, 2)
        x is the column and y the row; spacing 1.
    """
    y, x = np.mgrid[:rows, :columns].astype(np.float64)
    return np.column_stack([x.ravel(), y.ravel()])


def grid_names(rows: int, columns: int) -> tuple[str, ...]:
    """Return the names ``r0c0, r0c1, ...`` of a rectangular array in row-major order."""
    return tuple(f"r{row}c{column}" for row in range(rows) for column in range(columns))


def with_grid(recording: Recording, grid: tuple[int, int] | None) -> Recording:
    """Set the positions of a recording to those of a rectangular array in row-major order.

    Parameters
    ----------
    recording : Recording
        Of all cells in order. A recording of some cells needs names that give them, such as
        ``r3c5`` or ``cell50``.
    grid : (int, int) or None
        Rows and columns; None returns the recording unchanged.

    Returns
    -------
    Recording
        Sensors with default names are renamed by row and column. Cells without any finite reading
        read 0, so that they are assessed as dead.

    Raises
    ------
    InputError
        If the recording has more sensors than cells, or its names do not give their cells.
    """
    if grid is None:
        return recording
    rows, columns = grid
    recording = _without_empty_cells(recording)
    unnamed = recording.names == default_names(recording.n_sensors)
    if rows * columns != recording.n_sensors:
        cells = None if unnamed else cells_of(recording.names, rows, columns)
        if cells is None:
            raise InputError(
                f"a {rows} x {columns} grid has {rows * columns} sensors, "
                f"but the recording has {recording.n_sensors}, and their names do not give the "
                "cells, as r3c5 or cell50 do"
            )
        return replace(recording, positions=grid_positions(rows, columns)[cells], units=UNITS)
    return replace(
        recording,
        positions=grid_positions(rows, columns),
        units=UNITS,
        names=grid_names(rows, columns) if unnamed else recording.names,
    )


def _without_empty_cells(recording: Recording) -> Recording:
    empty = ~np.isfinite(recording.readings).any(axis=0)
    if not empty.any() or empty.all():
        return recording
    warnings.warn(
        f"{recording.source}: {np.count_nonzero(empty)} of {recording.n_sensors} cells of the grid "
        "have no reading; they are taken as dead",
        AnisomapWarning,
        stacklevel=2,
    )
    return replace(recording, readings=np.where(empty, 0, recording.readings))
