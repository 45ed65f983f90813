"""Recordings as delimited text, with one line per frame and one column per sensor.

`anisomap.io.parsing.tables` detects delimiter, decimal comma, header and columns of text, which
are skipped; `anisomap.io.parsing.names` detects times and frame counters. Files may be gzipped.
"""

from __future__ import annotations

import csv
import dataclasses
import functools
import io
import itertools
import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.base.clocks import Continued, is_date, words_of
from anisomap.base.wording import join_items, printable
from anisomap.errors import FileError, InputError
from anisomap.files.budget import SENSOR_BYTES, Budget
from anisomap.io.parsing import refusals
from anisomap.io.parsing.detection import find_table
from anisomap.io.parsing.facts import read_comments, write_comments
from anisomap.io.parsing.lines import as_objects
from anisomap.io.parsing.names import (
    ROWS_LOOKED_AT,
    Roles,
    roles_by_content,
    roles_by_name,
    warn_of_guesses,
    with_kept,
)
from anisomap.io.parsing.source import RefusedError, lines_of, quote_if_needed, warn
from anisomap.io.parsing.tables import (
    Table,
    first_rows,
    guard_formula,
    line_of,
    read_blocks,
    read_sample,
    unguard_formula,
)
from anisomap.io.presets import UNITS, grid_names, grid_positions
from anisomap.io.stream import Block, ReadOptions, Stream, refuse_selection, to_float32_if_exact
from anisomap.names import default_names
from anisomap.recording import Recording, Scalar

_POINTS, _UNITS = ("positions", "normals"), "units"
TITLE = "anisomap recording"
MAP_TITLE = "anisomap map"
"""First words of files written by anisomap, after ``#``."""

SIGNATURE = b"# anisomap "

_MAX_NAME_LINES = 500  # maximum lines of names among lines for the detection of the layout
_MAX_CLOCKS = 2  # columns that are a time or a frame counter
_TIME_COLUMN = "time_s"
_DELIMITERS = {"separated by commas": ",", "separated by tabs": "\t"}
_IN_FIRST_COLUMN, _NO_TIMES = "first column, seconds", "none"
_MARKED = re.compile(r"(?<![\d.,])\d++[.,]\d++(?![\d.,])")
_WHOLE = re.compile(r"(?<![\d.,])[1-9]\d{0,2}(?![\d.,])")
_THOUSANDS = re.compile(r"[1-9]\d{0,2}[,.]\d{3}")
_ROW, _CYCLIC = {"row", "line", "zeile"}, 0.9  # words; share of steps to the next row
_MIN_NUMBERED, _FRAMES = 3, {"", "frame", "frames", "sample", "index"}  # of several rows
_MOST_SAME = 0.05  # share of lines that were sent twice
_MARKS = {*(float(s * (10**k - 1)) for k in (4, 5, 6) for s in (-1, 1)), -1.0, -99.0, -999.0}
_MARKS |= {2.0**15 - 1, 2.0**16 - 1, 2.0**31 - 1, 2.0**32 - 1, -(2.0**15), -(2.0**31)}
_MIN_SPAN, _MIN_FALLS, _MOST_MISSING = 8, 3, 0.1
_MIN_USED, _MOST_USED, _MAX_HELD = 8, 0.9, 1 << 16  # sensors; share of them; readings
_MAX_FRAMES, _LEAST_CALM = 1 << 20, 0.25  # share of runs between readings at rest
_POINT = re.compile(r"[.,]\d")
_RATE = re.compile(
    r"(?i)\b(fs|(?:sampl\w*|scan\w*|frame|acquisition|update)?[ _-]*(?:rate|freq\w*))\b\W*"
    r"(?:k?Hz|fps)?[\W]*(\d+(?:\.\d+)?)\s*(?:[\]\s,;]|k?hz|fps|$)"
)
_OTHER_RATE, _FASTEST_HZ = re.compile(r"(?i)baud|bit|heart|cut|filter|pass"), 1e5
_logger = logging.getLogger(__name__)


def recognises(path: Path, head: bytes) -> bool:
    """Recognise any text; this format is tried last."""
    return bool(head) and b"\0" not in head


def is_json_lines(path: Path, head: bytes) -> bool:
    """Recognise two lines with one JSON object each that contains numbers."""
    lines = [line for line in lines_of(head) if line.strip()][:2]
    return len(lines) == 2 and as_objects(lines) is not None


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a recording in delimited text; its metadata name the columns that are not sensors."""
    sample, known, metadata = _read_start(path)
    refuse_selection(f"{path} (delimited text)", options.select)
    table = layout_of(path, sample, known, options)
    start = first_rows(table, ROWS_LOOKED_AT)
    read = functools.partial(read_blocks, table)
    again = functools.partial(first_rows, table, _MAX_FRAMES)
    yield stream_of(
        table, sample, start, read, options, again=again, known=known, metadata=metadata
    )


def layout_of(
    path: Path, sample: Sequence[str], known: Mapping[str, Scalar], options: ReadOptions
) -> Table:
    """Find the layout of lines; raise FileError unless they are a table of frames."""
    own = _DELIMITERS.get(str(known.get("fields")), "") if known else None
    if not known:
        refusals.refuse_text(path, sample)
    table = find_table(path, sample, own)
    n_least = table.n_columns - len(table.text_columns) - _MAX_CLOCKS
    Budget(path).check(SENSOR_BYTES * n_least, "its list of sensors")
    if not known:
        refusals.refuse_lists(table, sample)
    if not table.n_columns:
        content = "only a header" if table.names else "no line of numbers"
        raise FileError(f"{path} holds {content}; it must have one line of numbers per frame")
    if table.doubt and options.grid != table.block:
        raise FileError(f"{path}: {table.doubt}")
    if not known:
        _say(table, sample)
    return table


def stream_of(
    table: Table,
    sample: Sequence[str],
    start: NDArray[np.float64],
    read: Callable[..., Iterator[tuple[NDArray[np.float64], float]]],
    options: ReadOptions,
    *,
    again: Callable[[], NDArray[np.float64]] | None = None,
    known: Mapping[str, Scalar] = MappingProxyType({}),
    metadata: Mapping[str, Scalar] = MappingProxyType({}),
) -> Stream:
    """Create a stream of the sensors of a table, in a file or in lines that are being received.

    start: The first rows, (t, n_columns).
    read: Yields rows, and the fraction of the file read so far.
    again: Reads more of the first rows of a file.
    known: Entries of a file of anisomap.
    """
    path = table.path
    parse_name = unguard_formula if known else str.strip
    names, matrix = tuple(map(parse_name, table.names)), None
    roles = Roles() if known else detected_roles(table, names, start)
    if known.get("times") == _IN_FIRST_COLUMN:
        roles = Roles(time=0, non_sensors=(0,))
    if not known:
        text = (*table.text_columns, *table.clocks)
        names, roles = with_kept(names, roles, options.keep, table.n_columns, text)
        warn_of_guesses(path, names, roles)
        if not options.keep:
            matrix = find_matrix(table, names, roles, start)
        if matrix:
            numbers = _column_label(table, matrix.columns[0])
            warn(path, f"{numbers} numbers the {matrix.height} rows of a frame")
            non_sensors = (*roles.non_sensors, *matrix.columns)
            roles = dataclasses.replace(roles, non_sensors=non_sensors)
        elif not options.keep:
            refusals.refuse_turned(table, sample, roles, start)
            roles = _without_frame_numbers(table, roles, options.grid, start)
            rows = refusals.rows_of(table, sample[: table.first_line + 99])
            roles = _without_offset(table, roles, rows)
    kept = [i for i in range(table.n_columns) if i not in roles.non_sensors]
    if (n_sensors := len(kept)) < 1:
        raise FileError(f"{path} holds times or a frame counter, but no sensor")
    names = tuple(names[i] for i in kept) if names else ()
    facts: dict[str, Any] = {"names": names if all(names) or known or table.delimiter else ()}
    size = (matrix.height, n_sensors) if matrix else table.block or (0, 0)
    if matrix or size[0] * size[1] == n_sensors:
        n_sensors = size[0] * size[1]
        facts = {"names": grid_names(*size), "positions": grid_positions(*size), "units": UNITS}
    in_rows = options.grid is not None and options.grid[0] > 1 and options.grid[1] == n_sensors
    lines = table.block is None and matrix is None
    read = functools.partial(read, repeats=(roles.time is None or in_rows) and lines)
    facts |= _known_points(path, known, n_sensors)
    present = None
    if not known and not matrix:
        frames = again and (lambda: np.delete(again(), roles.non_sensors, axis=1))
        present = _Present(path, facts["names"], frames)
    rate_hz = known.get("rate_hz")
    if not known and roles.time is None:
        n_above = next((i for i, line in enumerate(sample) if not table.is_skipped(line)), 0)
        rate_hz = _rate_above(sample[: max(n_above, table.first_line - 1)])
    return Stream(
        path,
        n_sensors,
        _blocks(table, roles, matrix, read, present),
        rate_hz=float(rate_hz) if isinstance(rate_hz, int | float) else None,
        source=str(known.get("source", path.name)),
        metadata=metadata if known else _column_metadata(table, roles),
        from_zero=roles.time in table.clocks,
        raw_columns=not known,
        columns=() if size[0] else tuple(kept),
        locate=None if known or matrix else functools.partial(line_of, table),
        **facts,
    )


def _say(table: Table, sample: Sequence[str]) -> None:
    """Warn of skipped contents, and of the interpretation of an ambiguous file."""
    if table.text_columns:
        columns = join_items([_column_label(table, column) for column in table.text_columns])
        warn(table.path, f"skipped text in {columns}")
    if table.skipped:
        warn(table.path, f"skipped {table.skipped}")
    if table.block:
        size = "{} rows and {} columns".format(*table.block)
        apart = "brackets" if table.nested else "empty lines, comments or words"
        warn(table.path, f"{apart} divide frames of {size}")
    if table.separator != ",":
        refusals.refuse_thousands(table, sample)
        _warn_of_commas(table.path, sample)


def write_recording(recording: Recording, path: Path) -> None:
    """Write a recording as text, with tabs if the suffix is ``.tsv``; positions are comments."""
    delimiter = "\t" if path.suffix.lower() == ".tsv" else ","
    if recording.surface_distances is not None:
        problem = "text cannot store distances along the surface, so they are not written"
        warn(path.suffix, f"{problem}; use .npz to keep them")
    points = {key: getattr(recording, key) for key in _POINTS}
    facts = {key: _points_text(array) for key, array in points.items() if array is not None}
    header = header_text(
        recording.names,
        delimiter=delimiter,
        source=recording.source,
        timed=recording.times is not None,
        rate_hz=recording.rate_hz,
        metadata=recording.metadata,
        facts=facts | ({_UNITS: recording.units} if recording.units else {}),
    )
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(header)
        for frame, readings in enumerate(recording.readings):
            values = readings.tolist()
            if recording.times is not None:
                values.insert(0, float(recording.times[frame]))
            stream.write(delimiter.join(map(repr, values)) + "\n")


def header_text(
    names: Sequence[str],
    *,
    delimiter: str = ",",
    source: str = "",
    timed: bool = True,
    rate_hz: float | None = None,
    metadata: Mapping[str, Scalar] | None = None,
    facts: Mapping[str, str] | None = None,
) -> str:
    """Format the lines before the frames: names of a time, if `timed`, and of the readings."""
    if sum(name.count("\n") for name in names) > _MAX_NAME_LINES:
        raise InputError("the names have too many line ends for a header of text; use .npz")
    fields = next(name for name, mark in _DELIMITERS.items() if mark == delimiter)
    entries: list[tuple[str, Scalar]] = [
        ("fields", fields),
        ("source", source),
        ("times", _IN_FIRST_COLUMN if timed else _NO_TIMES),
    ]
    if rate_hz is not None:
        entries.append(("rate_hz", rate_hz))
    entries += (facts or {}).items()
    text = io.StringIO(newline="")
    text.write(write_comments(TITLE, entries, "metadata", metadata or {}))
    csv.writer(text, delimiter=delimiter, quoting=csv.QUOTE_ALL, lineterminator="\n").writerow(
        map(guard_formula, (_TIME_COLUMN, *names) if timed else names)
    )
    return text.getvalue()


def _points_text(points: np.ndarray[Any, Any]) -> str:
    return "; ".join(" ".join(map(repr, row)) for row in points.tolist())


def _known_points(path: Path, known: Mapping[str, Scalar], n_sensors: int) -> dict[str, Any]:
    """Parse the positions and normals of all sensors, (N, 2 or 3), in comments."""
    found: dict[str, Any] = {}
    for key in _POINTS:
        if key in known:
            try:
                rows = [row.split() for row in str(known[key]).split(";")]
                found[key] = np.array(rows, dtype=np.float64)
            except ValueError:
                found[key] = np.empty(0)
            if found[key].shape not in ((n_sensors, 2), (n_sensors, 3)):
                raise FileError(f"{path}: {key} must be 2 or 3 numbers for each sensor")
    return found | ({"units": str(known[_UNITS])} if _UNITS in known else {})


def _read_start(path: Path) -> tuple[list[str], dict[str, Scalar], dict[str, Scalar]]:
    """Read the first lines, and the entries and metadata of a file written by anisomap."""
    sample = read_sample(path)
    title = sample[0] if sample else ""
    if title.startswith(f"# {MAP_TITLE}"):
        raise FileError(f"{path} is a map, not a recording; read it with read_map")
    if not title.startswith(f"# {TITLE}"):
        return sample, {}, {}
    leading = itertools.takewhile(lambda line: line.startswith("#"), sample)
    entries, metadata = read_comments(leading, "metadata")
    return sample, dict(entries), metadata


def detected_roles(table: Table, names: tuple[str, ...], start: NDArray[np.float64]) -> Roles:
    """Find the columns that are not sensors, by names and by the first rows."""
    never = {*table.text_columns, *table.clocks}
    numeric = [i for i in range(table.n_columns) if i not in never]
    if all(names[i] for i in numeric) if names else False:
        roles = roles_by_name([names[i] for i in numeric], start[:, numeric])
    elif table.block:
        roles = Roles()
    else:  # lines of a log may name some of their numbers
        named = [i for i in numeric if names and names[i]]
        roles = roles_by_name([names[i] for i in named], start[:, named]) if named else Roles()
        if not roles.non_sensors:
            roles = roles_by_content(start[:, numeric])
        else:
            numeric = named
    roles = roles.mapped(numeric.__getitem__)
    non_sensors = tuple(sorted({*roles.non_sensors, *never}))
    roles = dataclasses.replace(roles, non_sensors=non_sensors)
    if table.clocks:  # a time counts before a date without one
        dates = [i for i in table.clocks if is_date(float(np.nanmin(start[:, i], initial=np.inf)))]
        clock = next((i for i in table.clocks if i not in dates), table.clocks[0])
        roles = dataclasses.replace(roles, time=clock, per_second=1.0, doubt="")
    return roles


def _rate_above(lines: Sequence[str]) -> float | None:
    """Return the rate in Hz in lines above the first frame; None if there is none."""
    stated = (_RATE.search(line) for line in lines if not _OTHER_RATE.search(line))
    rates = (float(m[2]) * (1e3 if "khz" in m[0].lower() else 1) for m in stated if m)
    return next((rate for rate in rates if 0 < rate < _FASTEST_HZ), None)


def _without_frame_numbers(
    table: Table, roles: Roles, grid: tuple[int, int] | None, start: NDArray[np.float64]
) -> Roles:
    """Treat a first column that numbers frames of several rows as a counter, or require a grid.

    Also raises RefusedError if lines resemble earlier lines more than the preceding line.
    """
    if table.block or table.nested:
        return roles
    starts = np.flatnonzero(np.diff(start[:, 0]) != 0) + 1
    heights = np.diff(starts, prepend=0)
    named = table.names and _FRAMES.isdisjoint(words_of(table.names[0]))
    numbered = not named and 0 not in roles.non_sensors and len(starts) >= _MIN_NUMBERED
    numbered = numbered and heights[0] > 1 and bool((heights == heights[0]).all())
    if numbered and (np.diff(start[:, 0])[starts - 1] == 1).all():
        height, problem = int(heights[0]), "column 1 numbers frames of {} rows and {} columns"
        roles = dataclasses.replace(roles, non_sensors=tuple(sorted({0, *roles.non_sensors})))
    else:
        height = refusals.lines_per_frame(np.delete(start, roles.non_sensors, axis=1))
        problem = "each line resembles the one {} lines before it, not the line before"
    n_columns = table.n_columns - len(roles.non_sensors)
    if not height or grid in ((1, n_columns), (height, n_columns)):
        return roles
    raise RefusedError(
        f"{table.path}: {problem.format(height, n_columns)}: if {height} lines are a frame, give "
        f"--grid {height}x{n_columns}, and --grid 1x{n_columns} if each line is a frame"
    )


def _without_offset(table: Table, roles: Roles, rows: Sequence[Sequence[str]]) -> Roles:
    """Leave out a first number without decimals before others with decimals, as ROS 2 prints it."""
    first, rest = {row[0] for row in rows}, [cell for row in rows for cell in row[1:]]
    if table.names or roles.non_sensors or len(first) != 1 or table.n_columns <= _MIN_NUMBERED:
        return roles
    if _POINT.search(min(first)) or not all(map(_POINT.search, rest)):
        return roles
    problem = "column 1 is left out: it is constant without decimals, unlike all others"
    warn(table.path, problem, "give --keep to choose others")
    return dataclasses.replace(roles, non_sensors=(0,))


def _warn_of_commas(path: Path, sample: Sequence[str]) -> None:
    """Warn if all numbers with a comma could also have thousands separators."""
    marks = {"commas": ","} | ({"points": "."} if any(map(_WHOLE.search, sample[1:])) else {})
    for mark, sign in marks.items():
        found = [number for line in sample for number in _MARKED.findall(line) if sign in number]
        if found and all(map(_THOUSANDS.fullmatch, found)):
            shown = f"{found[0]} as {found[0].replace(',', '.')}"
            problem = f"{mark} are read as decimal {mark} ({shown})"
            warn(path, f"{problem}; remove thousands separators from the file")


def _column_label(table: Table, column: int) -> str:
    name = quote_if_needed(table.names[column].strip()) if table.names else "no header"
    if not name:
        return f"column {column + 1}"
    return f"column {column + 1} ({name})"


def _blocks(
    table: Table,
    roles: Roles,
    matrix: MatrixRows | None,
    read: Callable[..., Iterator[tuple[NDArray[np.float64], float]]],
    present: _Present | None,
) -> Iterator[Block]:
    unrolled = Continued(0.0 if roles.time in table.clocks else roles.per_second)
    lines = table.block is None and matrix is None  # that are a frame each
    fresh = _Fresh(table.path)
    for rows, fraction in read():
        values = fresh(rows) if lines and roles.time is not None else rows
        times = roles.times_in(values)
        times = None if times is None else unrolled(times)
        readings = np.delete(values, roles.non_sensors, axis=1)
        if matrix:
            readings, times = matrix.join(values[:, matrix.columns[0]], readings, times)
        readings = present(readings) if present else readings
        yield Block(to_float32_if_exact(readings), fraction, times)


@dataclasses.dataclass
class _Fresh:
    """Drops lines that were sent twice: equal to the preceding line, including time, and few."""

    path: Path
    _before: Any = None
    _n_same: int = 0
    _n_rows: int = 0

    def __call__(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the rows, (t, n_columns), without such lines."""
        bits = np.ascontiguousarray(rows).view(np.int64)  # NaN equals itself
        before = np.vstack([~bits[:1] if self._before is None else self._before, bits])
        same, self._before = (bits == before[:-1]).all(axis=1), before[-1:]
        first, self._n_rows = self._n_same == 0, self._n_rows + len(rows)
        self._n_same += int(np.count_nonzero(same))
        few = 0 < self._n_same <= max(1, _MOST_SAME * self._n_rows)
        if few and first:
            warn(self.path, "lines that repeat the one before, with its time, are left out")
        return np.delete(rows, np.flatnonzero(same & few), axis=0)


@dataclasses.dataclass
class _Present:
    """Replaces numbers for missing readings by NaN, with a warning for each such number.

    again: Reads the first frames of a file, (t, N), which decide for all; None for lines that are
        being received, of which the last ones decide.
    """

    path: Path
    names: Sequence[str]
    again: Callable[[], NDArray[np.float64]] | None
    _last: Any = None
    _n_frames: int = 0
    _limits: dict[float, Any] = dataclasses.field(default_factory=dict)
    _said: tuple[float, ...] = ()

    def __call__(self, readings: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the next readings, (t, N)."""
        if not readings.size:
            return readings
        n_held = 1 if self.again else 1 + _MAX_HELD // readings.shape[1]
        rows = readings if self._last is None else np.vstack([self._last, readings])
        self._last, found = rows[-n_held:], readings
        for mark in {float(end.reduce(readings, axis=None)) for end in (np.fmin, np.fmax)}:
            if mark not in _MARKS and not 3.4e38 < abs(mark) < 3.41e38:
                continue
            if not self.again or mark not in self._limits:
                self._limits[mark] = _limits_of(self.again() if self.again else rows, mark)
            if self._limits[mark] is not None:
                places = _is_missing(rows, mark, self._limits[mark])[-len(readings) :]
                found = np.where(places, np.nan, found)
                if mark not in self._said and places.any():
                    self._say(mark, places)
        self._n_frames += len(readings)
        return found

    def _say(self, mark: float, places: NDArray[np.bool_]) -> None:
        self._said = (*self._said, mark)
        names = self.names or default_names(places.shape[1])
        found = [quote_if_needed(names[i]) for i in np.flatnonzero(places.any(axis=0)).tolist()]
        frame = self._n_frames + int(np.argmax(places.any(axis=1)))
        listed = f"{join_items(found, 3)} (first in frame {frame}), and perhaps later"
        keep = "to keep it, make the recording in Python: anisomap.Recording(pandas.read_csv(path))"
        warn(self.path, f"{mark:g} stands for a missing reading in {listed}", keep)


def _is_missing(rows: NDArray[np.float64], mark: float, limits: Any) -> NDArray[np.bool_]:
    """Return where a number, in frames (t, N), stands for a missing reading.

    It fills nearly all sensors, or is between two frames with readings up to the limits, (N,),
    which are -inf for sensors that are not connected.
    """
    marked, used = rows == mark, limits > -np.inf
    calm = np.pad((rows <= limits) & ~marked, ((1, 1), (0, 0)), mode="reflect")
    n_used = int(np.count_nonzero(used))
    full = (n_used >= _MIN_USED) & ((marked & used).sum(axis=1) >= _MOST_USED * n_used)
    missing: NDArray[np.bool_] = marked & ((calm[:-2] & calm[2:]) | (full[:, None] & used))
    return missing


def _limits_of(rows: NDArray[np.float64], mark: float) -> NDArray[np.float64] | None:
    """Return limits of sensors at rest, (N,), if a number stands for missing readings; else None.

    It has a gap to all other readings, and many runs of it are one frame between readings in the
    lower half of the range of the sensor, unlike saturation; and -1 is one if no other reading is
    negative, and pressed sensors have it for one frame.
    """
    others, marked = np.isfinite(rows) & ~np.isin(rows, [*_MARKS, mark]), rows == mark
    low = np.min(rows, axis=0, initial=np.inf, where=others)
    high = np.max(rows, axis=0, initial=-np.inf, where=others)
    used = low <= high  # some may not be connected
    least, most = np.min(low, initial=np.inf), np.max(high, initial=-np.inf)
    span = most - least
    marked &= used
    if not span > 0 or np.count_nonzero(marked) >= _MOST_MISSING * marked.size:
        return None
    below = mark < min(least - span / 8, 0) and least >= -span / 8
    if mark == -1:
        below = span >= _MIN_SPAN and least >= 0
        at_rest = ~marked[1:-1] & (rows[1:-1] <= least + span / 50)
        pressed = np.minimum(rows[:-2], rows[2:]) - least
        falls = (np.sum((pressed > span / n) * (1 * marked[1:-1] - at_rest)) for n in (4, 2))
        # Few that are pressed before and after fall to other low readings.
        below = below and max(falls) >= _MIN_FALLS
    if not below and not mark > most + span:
        return None
    spans = np.where(used, high - low, 0)
    middle = low + np.maximum(spans, np.median(spans[used])) / 2
    missing = _is_missing(rows, mark, np.where(used, np.inf if below else middle, -np.inf))
    runs = (np.diff(1 * each, axis=0, prepend=0) > 0 for each in (missing, marked & ~missing))
    n_missing, n_others = map(np.count_nonzero, runs)
    few = n_missing < _LEAST_CALM * (n_missing + n_others)
    return None if few else np.where(used, np.inf, -np.inf)


@dataclasses.dataclass
class MatrixRows:
    """Lines that are rows of a matrix, numbered by a column; each frame ends with the last row.

    Missing rows are copied from the preceding frame; frames without a first row are left out.

    columns: The column of row numbers, and columns of frame numbers.
    """

    columns: tuple[int, ...]
    first: int
    height: int
    _held: Any = None
    _before: Any = None

    def join(
        self, rows: NDArray[np.float64], readings: NDArray[np.float64], times: Any
    ) -> tuple[NDArray[np.float64], Any]:
        """Join lines, (t,) and (t, n_columns), to frames, (T, height * n_columns)."""
        clock = np.zeros(len(rows)) if times is None else times
        lines = np.column_stack([rows - self.first, clock, readings])
        if self._held is not None:
            lines = np.concatenate([self._held, lines])
        starts = np.flatnonzero(np.diff(lines[:, 0]) <= 0) + 1
        if len(lines) and lines[-1, 0] == self.height - 1:
            starts = np.append(starts, len(lines))
        parts = np.split(lines, starts)
        self._held = parts.pop()
        frames, begins = [], []
        for part in parts:
            frame = np.full((self.height, readings.shape[1]), np.nan)
            frame[part[:, 0].astype(int)] = part[:, 2:]
            if self._before is not None:
                frame = np.where(np.isfinite(frame), frame, self._before)
            elif part[0, 0]:
                continue
            self._before = frame
            frames.append(frame.ravel())
            begins.append(part[0, 1])
        joined = np.array(frames).reshape(len(frames), self.height * readings.shape[1])
        return joined, None if times is None else np.array(begins)


def find_matrix(
    table: Table, names: Sequence[str], roles: Roles, start: NDArray[np.float64]
) -> MatrixRows | None:
    """Find a column that numbers the rows of a matrix: named row, and 0, 1, ... or 1, 2, ..."""
    named = [i for i, name in enumerate(names) if _ROW & {*words_of(name)}]
    rest = (i for i in range(table.n_columns) if i not in roles.non_sensors)
    column = next((i for i in rest if i in named or not (named or names)), None)
    if column is None or table.block or table.nested:
        return None
    rows = start[:, column]
    levels = np.unique(rows)
    in_order = 1 < len(levels) <= len(rows) / 3 and (np.diff(levels) == 1).all()
    steps = np.diff(rows) - 1
    if not (in_order and levels[0] in (0, 1) and np.mean(steps % len(levels) == 0) >= _CYCLIC):
        return None
    others = np.delete(start, [column, *roles.non_sensors], axis=1)
    height = 0 if named else refusals.lines_per_frame(others)
    if not named and height != len(levels):
        return None
    frames = (i for i, name in enumerate(names) if _FRAMES & {*words_of(name)})
    frames = (i for i in frames if i != column and (np.diff(start[:, i]) >= 0).all())
    return MatrixRows((column, *frames), int(levels[0]), len(levels))


def _column_metadata(table: Table, roles: Roles) -> dict[str, Scalar]:
    """Name the columns that are not sensors, in the metadata and in the log."""
    metadata: dict[str, Scalar] = {}
    for key, column in (("time_column", roles.time), ("counter_column", roles.counter)):
        if column is not None:
            metadata[key] = _column_label(table, column)
            kind = key.replace("_", " ")
            _logger.info("%s: %s is the %s", printable(str(table.path)), metadata[key], kind)
    if table.text_columns:
        metadata["text_columns"] = ", ".join(_column_label(table, i) for i in table.text_columns)
    return metadata
