"""Rectangular arrays: positions and names of sensors in rows and columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.recording import Recording, default_names

UNITS = "spacings"
"""What the positions of a grid are in, where its spacing is not known."""


def grid_positions(rows: int, columns: int) -> NDArray[np.float64]:
    """Place the sensors of a rectangular array, row after row.

    Parameters
    ----------
    rows, columns : int

    Returns
    -------
    ndarray of shape (rows * columns, 2)
        x along a row, y down the rows, spacing 1.
    """
    y, x = np.mgrid[:rows, :columns].astype(np.float64)
    return np.column_stack([x.ravel(), y.ravel()])


def grid_names(rows: int, columns: int) -> tuple[str, ...]:
    """Name the sensors of a rectangular array, row after row: ``r0c0, r0c1, ...``."""
    return tuple(f"r{row}c{column}" for row in range(rows) for column in range(columns))


def with_grid(recording: Recording, grid: tuple[int, int] | None) -> Recording:
    """Give the sensors of a recording the positions of a rectangular array, in row-major order.

    Parameters
    ----------
    recording : Recording
    grid : (int, int) or None
        Rows and columns; None leaves the recording as it is.

    Returns
    -------
    Recording
        Sensors without names of their own are named by row and column.

    Raises
    ------
    InputError
        If it has another number of sensors.
    """
    if grid is None:
        return recording
    rows, columns = grid
    if rows * columns != recording.n_sensors:
        raise InputError(
            f"a grid of {rows} x {columns} has {rows * columns} sensors, "
            f"but the recording has {recording.n_sensors}"
        )
    unnamed = recording.names == default_names(recording.n_sensors)
    return replace(
        recording,
        positions=grid_positions(rows, columns),
        units=UNITS,
        names=grid_names(rows, columns) if unnamed else recording.names,
    )
