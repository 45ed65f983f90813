"""Names: of columns that hold time or a frame counter instead of readings, and of sensors."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.base.clocks import SINCE_1970_S, Clock, clock_of, is_time, names_time, words_of
from anisomap.base.columns import odd_names
from anisomap.base.wording import join_items
from anisomap.errors import InputError
from anisomap.io.parsing.source import quote_if_needed, warn
from anisomap.names import default_names, find_sensors

ROWS_LOOKED_AT = 1000
"""Rows at the start of a file that determine the roles of its columns."""

COUNTER_NAMES = {
    *("", "frame", "frames", "index", "idx", "seq", "sequence", "sample", "row", "packet", "no"),
    *("frame id", "frame no", "frame number", "frame index", "unnamed: 0", "nr", "counter"),
}
"""Names of columns that count frames."""
# Chosen by hand: fewer rows do not show that a clock is steady, and a few rows may be glitches.
_MIN_FRAMES = 8
_MIN_STEADY_FRACTION = 0.95
_MIN_RISING_FRACTION = 0.99
_LEAST_NANOSECONDS = 1e5  # in the first frames; readings are smaller


@dataclass(frozen=True)
class Roles:
    """Columns that are not sensors, by index from 0; `guessed`: columns with an unusual name.

    per_second: Units of `time` per second, such as 1000 for milliseconds; `doubt` describes doubts
        about the unit.
    nanoseconds: The column of nanoseconds in addition to whole seconds, as in ROS stamps.
    """

    time: int | None = None
    per_second: float = 1.0
    doubt: str = ""
    nanoseconds: int | None = None
    counter: int | None = None
    non_sensors: tuple[int, ...] = ()
    guessed: tuple[int, ...] = ()

    def times_in(self, rows: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return the times of rows, (t,), in seconds."""
        if self.time is None:
            return None
        times = rows[:, self.time] / self.per_second
        return times if self.nanoseconds is None else times + rows[:, self.nanoseconds] / 1e9

    def mapped(self, place: Callable[[int], int | None]) -> Roles:
        """Return the roles with other indices; columns whose place is None have no role."""
        single = (self.time, self.nanoseconds, self.counter)
        several = (self.non_sensors, self.guessed)
        time, rest, counter = (None if i is None else place(i) for i in single)
        others = (tuple(i for i in map(place, each) if i is not None) for each in several)
        doubt = "" if time is None else self.doubt
        return Roles(time, self.per_second, doubt, rest, counter, *others)


def with_kept(
    names: tuple[str, ...],
    roles: Roles,
    keep: Sequence[str],
    n_columns: int,
    text: Collection[int] = (),
) -> tuple[tuple[str, ...], Roles]:
    """Return names, and roles without columns that are kept as sensors by a name or a range.

    Indices and patterns refer to sensors. Without a header, columns of time or a counter are called
    ``column 1``, as in messages, and all others ``s0``, ``s1``, ... Columns of text cannot be kept.
    """
    own = names
    if not own:
        others = iter(default_names(n_columns))
        own = tuple(
            f"column {i + 1}" if i in roles.non_sensors else next(others) for i in range(n_columns)
        )
    kept = set[int]()
    for each in keep:
        if not re.fullmatch(r"\d+(?:\s*-\s*\d+)?", each) and not {*each} & {*"*?"}:
            with suppress(InputError):
                kept |= {*find_sensors(own, [each]).tolist()} & {*roles.non_sensors}
    if lost := sorted(kept & {*text}):
        raise InputError(f"column {own[lost[0]]} holds text, so it cannot be a sensor")
    return (own, roles.mapped(lambda i: None if i in kept else i)) if kept else (names, roles)


_SECONDS, _NANOSECONDS = {"sec", "secs"}, {"nsec", "nsecs", "nanosec", "nanosecs"}


def _find_stamps(header: Sequence[str], table: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Find columns of whole seconds, and columns of nanoseconds with similar names."""
    found: dict[tuple[str, ...], dict[bool, int]] = {}
    for i, name in enumerate(header):
        *before, unit = words_of(name) or [""]
        if unit in _SECONDS | _NANOSECONDS:
            found.setdefault(tuple(before), {}).setdefault(unit in _NANOSECONDS, i)
    pairs = [(each[False], each[True]) for each in found.values() if len(each) == 2]
    return [pair for pair in pairs if _is_stamp(table[:, pair])]


def _is_stamp(pair: NDArray[np.float64]) -> bool:
    """Return whether two columns are whole seconds and nanoseconds below 1e9."""
    below = bool(((pair[:, 1] >= 0) & (pair[:, 1] < 1e9)).all())
    return _is_whole(pair) and below and bool(pair[:, 1].max() >= _LEAST_NANOSECONDS)


def roles_by_name(header: Sequence[str], table: NDArray[np.float64]) -> Roles:
    """Find the columns of time, the first of which is used, and of a frame counter by name.

    An increasing column is assumed to be time if its name has a time word (``host_time``), and time
    or counter if it is the first and its name differs from all later ones (``s0``, ``s1``).

    table (t, n_columns).
    """
    stamps = _find_stamps(header, table)
    times = [*itertools.chain.from_iterable(stamps)]
    times += [i for i, name in enumerate(header) if is_time(name, i) and i not in times]
    plain = [name.lower().replace("_", " ").strip() for name in header[:2]]
    counters = [i for i, name in enumerate(plain) if name in COUNTER_NAMES]
    counters = [i for i in counters if _is_counter(table[:, i])]
    guessed = []
    if len(table) >= _MIN_FRAMES:
        known = set(times)
        worded = (i for i, name in enumerate(header) if names_time(name))
        guessed = [i for i in worded if i not in known and _rises(table[:, i])]
        times += guessed
        known = {*times, *counters}
        first = next((i for i in range(len(header)) if i not in known), len(header))
        odd = odd_names(header)
        for i in {first, len(header) - 1} - {*known, len(header)}:
            if i in odd and _rises(table[:, i]) and _is_steady(table[:, i]):
                guessed.append(i)
                (counters if _counts_by_one(table[:, i]) else times).append(i)
    clock = clock_of(header[times[0]], table[:, times[0]]) if times else Clock()
    return Roles(
        time=times[0] if times else None,
        per_second=clock.per_second,
        doubt=clock.doubt,
        nanoseconds=stamps[0][1] if stamps else None,
        counter=counters[0] if counters else None,
        non_sensors=tuple(sorted({*times, *counters})),
        guessed=tuple(guessed),
    )


def roles_by_content(table: NDArray[np.float64]) -> Roles:
    """Find the columns of time and frame counter in a table without a header, (t, n_columns).

    The first column alone, or the first two alone, must increase throughout.
    """
    n_frames, n_columns = table.shape
    if n_frames < _MIN_FRAMES:
        return Roles()
    since_1970 = n_columns > 2 and (table[:, 0] > SINCE_1970_S).all()
    if since_1970 and _is_stamp(table[:, :2]) and _rises(table[:, 0] + table[:, 1] / 1e9):
        return Roles(0, nanoseconds=1, non_sensors=(0, 1))
    rising = [i for i in range(n_columns) if _rises(table[:, i])]
    if rising not in ([0], [0, 1]) or len(rising) == n_columns:
        return Roles()
    first, last = table[:, 0], table[:, rising[-1]]
    counts, steady = _counts_by_one(first), _is_steady(last)
    if len(rising) == 1 and counts:
        return Roles(counter=0, non_sensors=(0,))
    if not steady or not (len(rising) == 1 or counts or _is_steady(first)):
        return Roles()
    counter, time = (0, rising[-1]) if len(rising) == 2 and counts else (None, 0)
    clock = clock_of("", table[:, time])
    return Roles(time, clock.per_second, clock.doubt, counter=counter, non_sensors=tuple(rising))


def warn_of_guesses(path: Path, header: Sequence[str], roles: Roles) -> None:
    """Warn about columns with unknown names that are assumed to be time or counter, and units."""
    if roles.doubt:
        warn(path, f"column {(roles.time or 0) + 1}: {roles.doubt}")
    for column in roles.guessed:
        role = "a frame counter" if column == roles.counter else "time"
        taken = f"({header[column]}) increases steadily and is taken as {role}"
        remedy = "if it is a sensor, name it like the other sensors"
        warn(path, f"column {column + 1} {taken}; {remedy}")


def _is_counter(column: NDArray[np.float64]) -> bool:
    """Return whether a column contains mostly increasing integers; restarts are allowed."""
    steps = np.diff(column)
    mostly = not steps.size or bool(np.mean(steps > 0) >= _MIN_STEADY_FRACTION)
    return _is_whole(column) and mostly


def _counts_by_one(column: NDArray[np.float64]) -> bool:
    return _is_whole(column) and bool(np.mean(np.diff(column) == 1) >= _MIN_STEADY_FRACTION)


def _is_whole(column: NDArray[np.float64]) -> bool:
    return bool(np.isfinite(column).all() and (column == np.floor(column)).all())


def _rises(column: NDArray[np.float64]) -> bool:
    with np.errstate(invalid="ignore"):
        rising = np.mean(np.diff(column) > 0) >= _MIN_RISING_FRACTION
        return bool(np.isfinite(column[0]) and rising)


def _is_steady(times: NDArray[np.float64]) -> bool:
    with np.errstate(invalid="ignore"):
        steps = np.diff(times)
        usual = np.nanmedian(steps)
        return bool(np.mean(np.abs(steps - usual) <= usual / 2) >= _MIN_STEADY_FRACTION)


# At most 15 digits, so that the number of a name is exact and converted in linear time.
_LAST_NUMBER = re.compile(r"(?<!\d)(\d{1,15})\Z")
_CELL = re.compile(r"r(\d{1,9})c(\d{1,9})")


def distinct_names(path: Path, names: Sequence[str]) -> tuple[str, ...]:
    """Make repeated names distinct, with a warning: ``a, a, b`` becomes ``a, a_2, b``."""
    if len(set(names)) == len(names):
        return tuple(names)
    taken, found, counts = set(names), dict[str, None](), dict[str, int]()
    for name in names:
        unique = name
        while unique in found or (unique != name and unique in taken):
            counts[name] = counts.get(name, 1) + 1
            unique = f"{name}_{counts[name]}"
        found[unique] = None
    repeated = [quote_if_needed(name) for name in counts]
    example = quote_if_needed(f"{next(iter(counts))}_2")
    warn(path, f"names of several sensors: {join_items(repeated, 5)}; numbered as in {example}")
    return tuple(found)


def match_names(names: Sequence[str], known: Sequence[str]) -> list[int | None]:
    """Find each name among known names; if none is there, by unique numbers at the ends."""
    where = {name: i for i, name in enumerate(known)}
    found = [where.get(name) for name in names]
    if any(index is not None for index in found):
        return found
    own, others = numbers_of(names), numbers_of(known)
    if own is None or others is None:
        return found
    by_number = {number: i for i, number in enumerate(others)}
    return [by_number.get(number) for number in own]


def numbers_of(names: Sequence[str]) -> list[int] | None:
    """Return the numbers at the ends of names; None unless all have one and these are unique."""
    matches = [_LAST_NUMBER.search(name) for name in names]
    numbers = [int(match[1]) for match in matches if match]
    return numbers if len(set(numbers)) == len(names) == len(numbers) else None


def cells_of(names: Sequence[str], rows: int, columns: int) -> list[int] | None:
    """Return the cells of a grid, in row-major order, that names give."""
    matches = [_CELL.fullmatch(name) for name in names]
    places = [(int(match[1]), int(match[2])) for match in matches if match]
    if len(places) == len(names):
        cells = [row * columns + column if column < columns else -1 for row, column in places]
    else:
        cells = numbers_of(names) or [-1]
    fit = len(set(cells)) == len(cells) and min(cells) >= 0 and max(cells) < rows * columns
    return cells if fit else None


def natural_key(name: str) -> list[tuple[int, str]]:
    """Return a sort key that orders image2 before image10."""
    parts = re.split(r"(\d{1,15})", name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]
