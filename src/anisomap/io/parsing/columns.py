"""Which columns of a table are not sensors, but time or a frame counter."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ROWS_LOOKED_AT = 1000
"""How many rows from the start tell what the columns are: a long file need not be read twice."""

_TIME_WORDS = {"time", "t", "timestamp", "stamp", "elapsed"}
_PER_SECOND = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millis", "millisecond", "milliseconds"), 1e3),
    **dict.fromkeys(("us", "usec", "\u00b5s", "\u03bcs", "micros", "microseconds"), 1e6),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanoseconds"), 1e9),
}
# Units that may be a whole name; the shorter ones could as well be sensors.
_TIME_UNITS = set(_PER_SECOND) - {"s", "us", "ns"}
_COUNTER_NAMES = {
    *("", "frame", "frames", "index", "idx", "seq", "sequence", "sample", "row", "packet", "no"),
    *("frame id", "frame no", "frame number", "frame index", "unnamed: 0"),
}
# Seconds since 1970 stay below 1e11 until the year 5138; the same in ms, us and ns lie above.
_EPOCHS = ((1e17, 1e9), (1e14, 1e6), (1e11, 1e3))
_FEWEST_FRAMES = 8
_MOSTLY = 0.95
_ALL_BUT_A_GLITCH = 0.99


@dataclass(frozen=True)
class Roles:
    """Columns that are not sensors; all counted from 0.

    Parameters
    ----------
    time : int or None
        The column of times.
    per_second : float
        How many of its units make a second.
    counter : int or None
        A column that counts frames.
    left_out : tuple of int
        Every column that is no sensor.
    """

    time: int | None = None
    per_second: float = 1.0
    counter: int | None = None
    left_out: tuple[int, ...] = ()


def roles_by_name(header: Sequence[str], table: NDArray[np.float64]) -> Roles:
    """Find time and counter by the names of columns.

    A time column is called time, t, timestamp, stamp, elapsed, seconds, ms or the like, with a
    unit or without: ``time [ms]``, ``stamp_ns``. ``t`` alone counts among the first two columns
    only. Without a unit it is in seconds, or in what fits seconds since 1970. Of several, the
    first gives the times, and the others are left out, too. A counter is called frame, index,
    seq or the like (or nothing at all), stands among the first two columns, and counts.

    Parameters
    ----------
    header : sequence of str
        One name a column.
    table : ndarray of shape (t, n_columns)
        The first `ROWS_LOOKED_AT` rows below.

    Returns
    -------
    Roles
    """
    times = [i for i, name in enumerate(header) if is_time(name, i)]
    counters = [
        i
        for i, name in enumerate(header[:2])
        if name.lower().replace("_", " ").strip() in _COUNTER_NAMES and _is_counter(table[:, i])
    ]
    return Roles(
        time=times[0] if times else None,
        per_second=units_per_second(header[times[0]], table[:, times[0]]) if times else 1.0,
        counter=counters[0] if counters else None,
        left_out=tuple(sorted({*times, *counters})),
    )


def roles_by_content(table: NDArray[np.float64]) -> Roles:
    """Find time and counter in a table without a header, and only where there is no doubt.

    In at least 8 frames, the first column alone (or the first two alone) must rise all the time.
    Consecutive whole numbers are a counter; near-equal steps are seconds. Sensors do neither.

    Parameters
    ----------
    table : ndarray of shape (t, n_columns)
        All columns of the first `ROWS_LOOKED_AT` rows.

    Returns
    -------
    Roles
    """
    n_frames, n_columns = table.shape
    if n_frames < _FEWEST_FRAMES:
        return Roles()
    rising = [i for i in range(n_columns) if _rises(table[:, i])]
    if rising not in ([0], [0, 1]) or len(rising) == n_columns:
        return Roles()
    first, last = table[:, 0], table[:, rising[-1]]
    counts = _counts_by_one(first)
    if len(rising) == 1 and counts:
        return Roles(counter=0, left_out=(0,))
    if not _is_steady(last) or (len(rising) == 2 and not counts):
        return Roles()
    return Roles(
        time=rising[-1],
        per_second=units_per_second("", last),
        counter=0 if len(rising) == 2 else None,
        left_out=tuple(rising),
    )


def _words(name: str) -> list[str]:
    return re.findall(r"[a-z\u00b5\u03bc]+", name.lower())


def is_time(name: str, column: int = 0) -> bool:
    """Tell whether a column, the how-manieth counts, has the name of one that holds times."""
    words = _words(name)
    if not words or re.search(r"\d", name) or words == ["t"]:
        return words == ["t"] and name.strip().lower() == "t" and column < 2
    known = all(word in _TIME_WORDS or word in _PER_SECOND for word in words)
    return known and (words[0] in _TIME_WORDS or words[0] in _TIME_UNITS)


def units_per_second(name: str, times: NDArray[np.float64]) -> float:
    """Tell the unit of times by the name of their column, or else by their size."""
    units = [word for word in _words(name) if word in _PER_SECOND]
    if units:
        return _PER_SECOND[units[-1]]
    finite = times[np.isfinite(times)]
    start = float(finite[0]) if finite.size else 0.0
    return next((per_second for least, per_second in _EPOCHS if start > least), 1.0)


def _is_counter(column: NDArray[np.float64]) -> bool:
    """Tell whether a column counts; it may start anew or leave frames out."""
    whole = np.isfinite(column).all() and (column == np.floor(column)).all()
    return bool(whole and (len(column) == 1 or np.mean(np.diff(column) > 0) >= _MOSTLY))


def _counts_by_one(column: NDArray[np.float64]) -> bool:
    whole = np.isfinite(column).all() and (column == np.floor(column)).all()
    return bool(whole and (np.diff(column) == 1).all())


def _rises(column: NDArray[np.float64]) -> bool:
    with np.errstate(invalid="ignore"):
        return bool(np.isfinite(column[0]) and np.mean(np.diff(column) > 0) >= _ALL_BUT_A_GLITCH)


def _is_steady(times: NDArray[np.float64]) -> bool:
    with np.errstate(invalid="ignore"):
        steps = np.diff(times)
        usual = np.nanmedian(steps)
        return bool(np.mean(np.abs(steps - usual) <= usual / 2) >= _MOSTLY)
