"""Numbers in messages of ROS: from JSON objects, or from objects of a decoder."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.io.ros.bags import kind_of, values_at

_MIN_SENSORS = 2
_PER_SECOND = 1e9  # nanoseconds


def readings_of(message: Any, message_type: str, field: str = "") -> NDArray[np.float64] | None:
    """Return the readings of a message. Returns (N,)."""
    kind = kind_of(message_type, []) if message_type else None
    try:
        if field:
            values = values_at(message, field)
        elif kind is not None:
            values = kind.values(message, kind.field)
        else:
            values = max(lists_in(message), key=len, default=np.empty(0))
        found = np.asarray(values, dtype=np.float64)
    except (AttributeError, TypeError, ValueError):
        return None
    return found if found.ndim == 1 and found.size >= _MIN_SENSORS else None


def lists_in(message: Any) -> Iterator[NDArray[Any]]:
    """Iterate over all lists of numbers in a message."""
    if isinstance(message, list | tuple | np.ndarray):
        try:
            array = np.asarray(message)
        except ValueError:
            array = np.empty(0)
        if array.dtype.kind in "iuf":
            yield array.ravel()
            return
        for item in message:
            yield from lists_in(item)
    elif hasattr(message, "__dict__"):
        for item in vars(message).values():
            yield from lists_in(item)


def time_of(message: Any) -> float | None:
    """Return the stamp of a message in seconds; None if it has none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    whole = getattr(stamp, "sec", getattr(stamp, "secs", None))
    parts = getattr(stamp, "nanosec", getattr(stamp, "nsecs", None))
    if not isinstance(whole, int) or not isinstance(parts, int) or not (whole or parts):
        return None
    return whole + parts / _PER_SECOND
