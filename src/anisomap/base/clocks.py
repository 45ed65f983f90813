"""Formats of times: names of time columns, units, and times of the day.

The same rule applies to files and objects. A unit in the name of a column takes precedence. Without
a unit, large numbers are times since 1970 in s, ms, us or ns. Other numbers are seconds; if seconds
imply more than 1.5 s per frame, which is slower than any skin is read, ms, us and ns are tried.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import date

import numpy as np
from numpy.typing import ArrayLike, NDArray

_NAMES = (
    "time t timestamp ts stamp times timestamps stamps elapsed datetime date zeit zeitstempel "
    "uhrzeit laufzeit temps horodatage tiempo tempo tijd tijdstempel czas aika \u010das id\u0151 "
    "zaman waktu \u0432\u0440\u0435\u043c\u044f \u65f6\u95f4 \u6642\u9593 \u6642\u523b \uc2dc\uac04"
)
_TIME_WORDS = {*_NAMES.split()}
_UNIT_WORDS = {
    1.0: "s sec secs second seconds sek sekunden secondes segundos secondi seconden",
    1e3: "ms msec millis millisecond milliseconds millisekunden millisecondes milisegundos",
    1e6: "us usec \u00b5s \u03bcs micros microseconds",
    1e9: "ns nsec nsecs nanosec nanos nanoseconds",
    1 / 60: "min minutes minuten",
    1 / 3600: "h hours stunden",
}
_PER_SECOND = {word: unit for unit, words in _UNIT_WORDS.items() for word in words.split()}
NAMING_TIME = _TIME_WORDS - {"t", "ts", "date"}
"""Words that denote a time at any place in a name."""
# Units that can be a whole column name; the other units may also name sensors.
_TIME_UNITS = set(_PER_SECOND) - {"s", "us", "ns", "min", "h"}
# Seconds since 1970 stay below 1e11 until the year 5138; in ms, us and ns they are larger.
_EPOCHS = ((1e17, 1e9), (1e14, 1e6), (1e11, 1e3))
_UNITS = [[word] for word in _PER_SECOND]
_SYMBOLS = {1.0: "s", 1e3: "ms", 1e6: "us", 1e9: "ns"}
SINCE_1970_S = 1e9
"""Seconds since 1970, in 2001: larger numbers of seconds are dates."""
_LONGEST_S, _MOST_SINCE_1970_S = 1.5, 100.0  # between frames, without a unit
_SLOWEST_HZ, _FASTEST_HZ = 0.01, 50_000.0  # no skin or electrodes are read slower or faster
_DAY_S = 86400.0
# Counters of bits, of microseconds in ms, and of signed bits: their sizes, and least values.
_COUNTERS = [(2.0**bits / unit, 0.0) for bits in (16, 24, 32) for unit in (1, 1e3)]
_COUNTERS += [(2.0**bits, -(2.0 ** (bits - 1))) for bits in (16, 32)]
_NEAR, _MOST_FALLS = 10, 0.05  # usual steps to the ends of a range; share of the frames
_DAY_ZERO = date(1970, 1, 1).toordinal()

_OF_DAY = r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,:](\d{1,9}(?:,\d{3})?))?)?\s?([AaPp][Mm])?"
_OF_YEAR = r"(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})|(\d{1,2})([-/.])(\d{1,2})[-/.](\d{4})"
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_IN_WORDS = rf"(\d{{1,2}})[- ]({'|'.join(_MONTHS)})[a-z]*[- ](\d{{4}})"
_MONTH = re.compile(rf"{_IN_WORDS}(.*)", re.IGNORECASE)
# As ctime prints it: Tue Nov  3 14:22:01 2026.
_OF_C = rf"(?:[a-z]{{3}} )?({'|'.join(_MONTHS)}) +(\d{{1,2}}) ([\d:.]+) (\d{{4}})"
_CTIME = re.compile(_OF_C, re.IGNORECASE)
WITH_MONTH = re.sub(r"\((?!\?)", "(?:", rf"{_OF_C}|{_IN_WORDS}(?:[T ,]+[\d:.]+)?")
"""Pattern of dates with the name of a month, in any case."""
_ZONE = r"\s?(?:Z|UTC|([-+])(\d{2}):?(\d{2}))?"
_CLOCK = re.compile(
    rf"(?:(?:{_OF_YEAR})(?:(?:T|,?\s+){_OF_DAY}{_ZONE})?|(?=\d+:\d+:){_OF_DAY}{_ZONE})"
)


def words_of(name: str) -> list[str]:
    """Return the words of a name, in lower case: ``time`` and ``ms`` of ``time_ms``."""
    return re.findall(r"[^\W\d_]+", name.lower())


def is_time(name: str, column: int = 0) -> bool:
    """Return whether a column name denotes time; `column` is its index."""
    words = words_of(name)
    if not words or re.search(r"\d", name) or words == ["t"]:
        return words == ["t"] and name.strip().lower() == "t" and column < 2
    known = all(word in _TIME_WORDS or word in _PER_SECOND for word in words)
    return known and (words[0] in _TIME_WORDS or words[0] in _TIME_UNITS)


def names_time(name: str) -> bool:
    """Return whether a name has a word for a time, or ends with a unit of time in brackets."""
    words = words_of(name)
    return bool(NAMING_TIME & {*words}) or (name[-1:] in ("]", ")") and words[-1:] in _UNITS)


def parse_clock(text: str) -> float | None:
    """Return the seconds of a clock in UTC, since 1970 if it has a date; None for other text."""
    whole, _, rest = text.strip().rpartition(" days ")
    if whole.isdecimal() and len(whole) < 7 and (at := parse_clock(rest)) is not None:
        return int(whole) * _DAY_S + at  # as pandas prints durations
    if match := _CTIME.fullmatch(text.strip()):
        text = f"{match[2]} {match[1]} {match[4]} {match[3]}"
    if match := _MONTH.fullmatch(text.strip()):
        text = f"{match[3]}-{_MONTHS.index(match[2].lower()) + 1}-{match[1]}{match[4]}"
    match = _CLOCK.fullmatch(text.strip())
    if not match:
        return None
    year, month, day, first, mark, second, own_year, *times = match.groups()
    days = 0
    if own_year:  # 3/1/2026 is in March unless a month 13 would follow
        month, day = (first, second) if mark == "/" and int(first) <= 12 else (second, first)
        year = own_year
    try:
        if year:
            days = date(int(year), int(month), int(day)).toordinal() - _DAY_ZERO
    except ValueError:
        return None
    hour, minute, seconds, fraction, half, *zone = times[:8] if times[0] else times[8:]
    if hour is None:
        return days * _DAY_S
    hours = int(hour) % 12 + 12 * (half.lower() == "pm") if half else int(hour)
    of_day = 3600.0 * hours + 60.0 * int(minute) + int(seconds or 0)
    if zone[0]:
        of_day -= float(f"{zone[0]}1") * (3600 * int(zone[1]) + 60 * int(zone[2]))
    return days * _DAY_S + of_day + (float(f".{fraction}".replace(",", "")) if fraction else 0.0)


def is_date(seconds: float) -> bool:
    """Return whether a result of `parse_clock` is a date without a time, or at midnight."""
    return seconds >= _DAY_S and seconds % _DAY_S == 0


@dataclass
class Continued:
    """Continues times, given in parts, where the clock restarts.

    per_second: Units of a counter per second; a counter restarts when its bits or digits overflow.
        0 for a time of the day, which restarts at midnight.
    """

    per_second: float = 0.0
    _last: float = math.nan
    _usual: float = 0.0
    _ahead: float = 0.0

    def __call__(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the next times, (t,), in seconds."""
        with np.errstate(invalid="ignore"):
            steps, ahead = np.diff(times, prepend=self._last), np.zeros(len(times))
            falls = np.flatnonzero(np.isfinite(steps) & (steps < 0))
        if len(falls) < len(steps) and len(rising := steps[steps > 0]):
            self._usual = float(np.median(rising))
        for i in falls.tolist() if len(falls) <= max(1, _MOST_FALLS * len(times)) else ():
            ahead[i] = self._period(times[i] - steps[i], times[i])
        total = self._ahead + np.cumsum(ahead)
        if len(known := np.flatnonzero(np.isfinite(times))):
            self._last, self._ahead = float(times[known[-1]]), float(total[-1])
        return times + total

    def _period(self, before: float, after: float) -> float:
        """Return the increment where times decrease: the size of an overflowed counter, or 0."""
        if not self.per_second:
            return _DAY_S * round((before - after) / _DAY_S)
        near = _NEAR * self._usual
        for size, low in _COUNTERS:
            full, empty = (size + low) / self.per_second, low / self.per_second
            if 0 < full - before <= near and 0 <= after - empty <= near:
                return size / self.per_second
        return 0.0


@dataclass(frozen=True)
class Clock:
    """Interpretation of a column of times: units per second, and doubts."""

    per_second: float = 1.0
    doubt: str = ""


def clock_of(name: str, times: NDArray[np.floating]) -> Clock:
    """Interpret times, (T,), by the name of the column, their size and their steps."""
    finite = times[np.isfinite(times)]
    steps = np.diff(finite)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else math.nan
    units = [word for word in words_of(name) if word in _PER_SECOND]
    start = float(finite[0]) if finite.size else 0.0
    by_size = (per_second for threshold, per_second in _EPOCHS if start > threshold)
    per_second, doubt = _PER_SECOND[units[-1]] if units else next(by_size, 1.0), ""
    since_1970 = start > SINCE_1970_S and step < _MOST_SINCE_1970_S
    if not (units or since_1970) and per_second == 1 and step > _LONGEST_S:
        per_second = next(unit for unit in (1e3, 1e6, 1e9) if step / unit <= 1 or unit == 1e9)
        taken = f"{_SYMBOLS[per_second]} ({per_second / step:.4g} frames per second)"
        implausible = f"since {step:g} s from frame to frame is implausible"
        doubt = f"its times are taken as {taken}, {implausible}; name the unit, as in time [s]"
    elif math.isfinite(rate := per_second / step) and not _SLOWEST_HZ <= rate <= _FASTEST_HZ:
        doubt = f"its times give {rate:.4g} frames per second, which is doubtful"
    return Clock(per_second, doubt)


def seconds(times: ArrayLike, name: str = "") -> tuple[NDArray[np.float64], str]:
    """Convert times, (T,), to seconds, and return doubts about the conversion.

    times: Numbers, ISO 8601 texts, datetimes, or pandas or numpy dates. Dates start at 0.
    """
    values = np.asarray(times)
    if values.dtype.kind in "OUST" and values.ndim == 1 and values.size:
        if isinstance(values[0], str):
            parsed = [parse_clock(str(value)) for value in values]
            if None not in parsed:
                found = Continued()(np.array(parsed, dtype=np.float64))
                return found - found[0], ""
        elif hasattr(values[0], "timestamp"):
            stamps = np.array([value.timestamp() for value in values])
            return stamps - stamps[0], ""
        elif hasattr(values[0], "total_seconds"):
            return np.array([value.total_seconds() for value in values]), ""
    if values.dtype.kind in "mM":
        if values.dtype.kind == "M" and values.size:
            values = values - values.flat[0]
        found = values / np.timedelta64(1, "s")
        return np.where(np.isnat(values), np.nan, found), ""
    found = values.astype(np.float64)
    if found.ndim != 1 or not name:
        return found, ""
    clock = clock_of(name, found)
    return Continued(clock.per_second)(found / clock.per_second), clock.doubt
