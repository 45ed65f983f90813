"""What every reader makes of times and readings before they become a recording."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, FileError


def increasing(
    times: NDArray[np.floating], path: Path, locate: Callable[[int], str] | None = None
) -> NDArray[np.float64] | None:
    """Keep times only if they strictly increase; warn, and keep none, if they do not.

    Parameters
    ----------
    times : ndarray of shape (T,)
        In whatever unit.
    path : pathlib.Path
        The file to name.
    locate : callable, optional
        Says where in the file a frame stands, such as ``"line 12"``.

    Returns
    -------
    ndarray of float64, shape (T,), or None
    """
    values = np.asarray(times, dtype=np.float64)
    if values.ndim != 1:
        raise FileError(f"{path}: times have shape {values.shape}; they must be one a frame, (T,)")
    fine = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        fine[1:] &= np.diff(values) > 0
    if fine.all():
        return values
    frame = int(np.argmin(fine))
    where = f" ({locate(frame)})" if locate else ""
    after = f" after {float(values[frame - 1])!r}" if frame else ""
    warnings.warn(
        f"{path}: times must strictly increase, but that of frame {frame}{where} is "
        f"{float(values[frame])!r}{after}; the recording is read without times",
        AnisomapWarning,
        stacklevel=2,
    )
    return None


def narrowed(readings: NDArray[np.float64]) -> NDArray[np.floating]:
    """Store readings as float32 where that loses nothing: it halves most recordings."""
    with np.errstate(over="ignore"):
        single = readings.astype(np.float32)
    return single if np.array_equal(single, readings, equal_nan=True) else readings
