"""Missing readings, NaN or infinite."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def fill_gaps(readings: NDArray[Any]) -> NDArray[Any]:
    """Interpolate missing readings of each sensor linearly in time. readings (T, N) -> (T, N).

    Those before the first or after the last known reading take its value; all are 0 if none is
    known.
    """
    if readings.dtype.kind != "f":
        return readings
    gaps = ~np.isfinite(readings)
    if not gaps.any():
        return readings
    result = np.array(readings, dtype=np.result_type(readings.dtype, np.float32))
    for sensor in np.flatnonzero(gaps.any(axis=0)):
        missing = gaps[:, sensor]
        known = np.flatnonzero(~missing)
        result[missing, sensor] = (
            np.interp(np.flatnonzero(missing), known, readings[known, sensor])
            if known.size
            else 0.0
        )
    return result
