"""Validation of times, and compact storage of readings."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, FileError


def increasing_times(
    times: NDArray[np.floating], path: Path, locate: Callable[[int], str] | None = None
) -> NDArray[np.float64] | None:
    """Return times if they are finite and strictly increase, else warn and return None.

    Parameters
    ----------
    times : ndarray of shape (T,)
        In any unit.
    path : pathlib.Path
        The file, for messages.
    locate : callable, optional
        Maps a frame index to its place in the file, such as ``"line 12"``.

    Returns
    -------
    ndarray of float64, shape (T,), or None

    Raises
    ------
    FileError
        If `times` is not one-dimensional.
    """
    values = np.asarray(times, dtype=np.float64)
    if values.ndim != 1:
        raise FileError(f"{path}: times must have shape (T,), got {values.shape}")
    valid = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        valid[1:] &= np.diff(values) > 0
    if valid.all():
        return values
    frame = int(np.argmin(valid))
    where = f" ({locate(frame)})" if locate else ""
    after = f" after {float(values[frame - 1])!r}" if frame else ""
    warnings.warn(
        f"{path}: times must strictly increase, but frame {frame}{where} is at "
        f"{float(values[frame])!r}{after}; the times are ignored",
        AnisomapWarning,
        stacklevel=2,
    )
    return None


def to_float32_if_exact(readings: NDArray[np.float64]) -> NDArray[np.floating]:
    """Convert readings to float32 if that is exact, which halves the memory of most recordings."""
    with np.errstate(over="ignore"):
        single = readings.astype(np.float32)
    return single if np.array_equal(single, readings, equal_nan=True) else readings
