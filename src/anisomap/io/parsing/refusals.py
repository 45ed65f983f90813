"""Refusal of unsupported files, and of text that resembles a table of frames, with advice.

Formats that a Python library reads are refused with the code that converts them to a recording or a
map. Text is refused if sensors would be lost or mixed: abbreviated printed arrays, frames of a CAN
bus, output of ``ros2 topic echo``, and tables with a line per reading, per board or per sensor.
"""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anisomap.base.clocks import is_time, words_of
from anisomap.errors import FileError
from anisomap.io.parsing.detection import is_list
from anisomap.io.parsing.names import COUNTER_NAMES, Roles
from anisomap.io.parsing.source import RefusedError, quote, quote_if_needed
from anisomap.io.parsing.tables import Table, all_records, is_number, is_skipped

FROM_EVENTS = (
    "in Python, anisomap.Recording.from_events(times, sensors, bin_width=..., names=...) makes a "
    "recording of them"
)
"""Advice for lists of contacts or spikes."""

_MOMENTS = {"event", "frame", "touch", "sample"}
_ACTIVE = {"taxel", "sensor", "channel", "electrode", "unit", "neuron", "id", "contact", "active"}
_VALUES = {"value", "val", "raw", "adc", "reading", "pressure", "force", "amplitude", "weight"}
_NUMBERED = re.compile(r"#\s*\d.*\d")
_KEY, _LIST = re.compile(r'"([^"\\]{1,40})"\s*+:'), re.compile(r"\[([^\[\]]*+)\]")
_ROWS_LOOKED_AT, _MIN_LENGTHS = 50, 3


class _Foreign(NamedTuple):
    """An unsupported format: advice, suffixes, and a pattern of its start."""

    what: str
    remedy: str
    suffixes: tuple[str, ...]
    start: bytes = b"(?!)"


_IN_PYTHON = "in Python it is anisomap.Recording({}), which anisomap.write saves as .npz"
# fmt: off
_FOREIGN = (
    _Foreign("Parquet", _IN_PYTHON.format("pandas.read_parquet(path)"), (".parquet",), b"PAR1"),
    _Foreign("an archive", "unpack it; only .gz is read as it is", (".zip", ".tar", ".7z", ".rar")),
    _Foreign("Arrow", _IN_PYTHON.format("pandas.read_feather(path)"), (".feather",), b"ARROW1"),
    _Foreign("a recording of electrodes", _IN_PYTHON.format("mne.io.read_raw(path).pick('eeg')"),
             (".edf", ".bdf", ".fif", ".vhdr"), rb"\0\0\0d\0\0\0\x1f|\xffBIOSEMI"),
    _Foreign("a film or an image",
             _IN_PYTHON.format("[numpy.ravel(page.convert('F')) for page in "
                               "PIL.ImageSequence.all_frames([*map(PIL.Image.open, paths)])]"),
             (".gif", ".tif", ".tiff", ".png", ".bmp", ".pgm", ".jpg", ".jpeg"),
             rb"GIF8[79]a|II\*\0|MM\0\*"),
    _Foreign("a file of probeinterface",
             "in Python it is probe = probeinterface.read_probeinterface(path).probes[0] and "
             "anisomap.SensorMap(probe.contact_positions, names=probe.device_channel_indices, "
             "units=probe.si_units)", (), rb'\s*+\{(?=[\s\S]*"probeinterface")'),
    _Foreign("a launch file", "robot_state_publisher publishes a .urdf", (".launch.xml",)),
    _Foreign("a spreadsheet", "save its table as CSV", (".xlsx", ".xlsm", ".xls", ".ods")),
    _Foreign("a mesh, as anisomap place --mesh takes it",
             "to read its vertices as positions of sensors, save them as CSV",
             (".obj", ".off", ".stl", ".glb", ".gltf")),
)
# fmt: on

_DOTS = r"(?:\.{3}|\u2026)"
_LEFT_OUT = re.compile(rf"(?:^|[\s,;|\[])(?:{_DOTS})(?=[\s,;|\]]|$)")
_ROWS_LEFT_OUT = re.compile(r"[\s\[]*+(?:(?:\.{2,3}|\u2026)[\s,]*+)++")
_MIN_SHARE = 0.3  # of lines without their middle
_DOCUMENT, _FRAMES = re.compile(r"\s*+\[\s*+\["), re.compile(r"[\])]\s*+,\s*+[\[(]")
_BYTES = r"(?<![\w.])(?:(?:[0-9A-F]{2}){1,2}h?[\s,]+)"
# Minimum share of lines that match a pattern, and the message.
# fmt: off
_KINDS = (
    (0.5, r"\b[0-9A-F]{3,8}(?:##?[0-9A-F]*(?: [RT])?$|\s+\[\d+\](?:\s+[0-9A-F]{2})*$)"
     r"|\s[dsx]\s+\d(?:\s+[0-9A-F]{2})+\b|^T[0-9A-F]{4}(?:[0-9A-F]{2}){1,8}$",
     "holds frames of a CAN bus in hexadecimal, as in {}: decode them to lines of numbers first"),
    (_MIN_SHARE, rf"{_BYTES}{{3,}}(?=\w{{1,3}}[A-F])[0-9A-F]{{2,4}}h?(?![\w.+-])",
     "holds hexadecimal numbers, as in {}: write decimal numbers"),
    (0.9, r"^(?:[01]{4,16}[\s,;]*){3,}$", "holds binary digits, as in {}: write decimal numbers"),
    (0.5, r"(?<![\w.])(?:\d{21,}|(?:\d+\.){4,}\d)",
     "has no separators between numbers, as in {}: write commas"),
    (0.0, r"^\s*Columns 1 (?:through|and) \d+:?$|^\s*[\d.]+e[-+]\d+ \*$"
     r"|^\[[-+.\de]+[\s,][^\[\];]*;(?:[^\[\];]*;){64,}[^\[\]]*\]$",
     "holds an array as MATLAB prints it, as in {}: use writematrix(array, 'run.csv')"),
    (0.5, r"\bb(['\"]).*\\x[0-9a-f]{2}.*\1",
     "holds bytes as Python prints them, as in {}: print list(data)"),
    (0.5, r"\0", "is UTF-16 text or binary, as in {}: write UTF-8"),
    (0.0, r"\w +\\$", "wraps its lines, as in {}: in pandas, use to_csv"),
    (0.0, r"^#(?:group|datatype),", "is a table of InfluxDB, with {}: pivot it by _time, _field"),
    (0.02, r"^\s*\{$", "has objects of JSON on several lines, as in {}: write each on one line"),
)
# fmt: on
_ECHO, _ECHO_KEY = re.compile(r"---\s*"), re.compile(r"\s*(?:- )?[A-Za-z_]\w*:(?:\s|$)")
_OF_BOARDS = "names boards, whose lines are no frames: write all readings of a frame in one line"
_KEEP = "give --keep if it is a sensor"
_MOST_LINES, _LEAST_ROWS, _CYCLIC = 64, 20, 0.95  # of a frame; of a table; share of steps
_COLUMNS_LOOKED_AT = 3
_LEAST_CHANGING, _MOST_COLUMNS, _RESEMBLING = 3, 64, 0.75  # to find lines that resemble each other
_GROUPED, _WHOLE = re.compile(r"[1-9]\d{0,2}(?:,\d{3})+"), re.compile(r"[1-9]\d{0,2}")
_MIN_GROUPED = 3
_SENSOR_WORDS = {"sensor", "taxel", "channel", "electrode", "unit", "neuron", "pixel", "cell"}
_LINE_WORDS = _SENSOR_WORDS | {
    *("board", "module", "patch", "node", "device", "mux", "port", "pin", "address", "addr"),
    *("id", "ch", "row", "col", "column", "line", "side", "hand", "foot", "finger"),
}


def refuse_foreign(path: Path, suffix: str, head: bytes = b"") -> None:
    """Raise FileError for a file of a format that another program reads, by suffix or content."""
    for each in _FOREIGN:
        if suffix in each.suffixes or re.match(each.start, head):
            raise FileError(f"{path} is {each.what}", each.remedy)


def remedy_of(name: str) -> str:
    """Return advice for an unsupported output format; empty for an unknown format."""
    return next((each.remedy for each in _FOREIGN if name.endswith(each.suffixes)), "")


def refuse_text(path: Path, sample: Sequence[str]) -> None:
    """Raise RefusedError for lines that do not occur in tables."""
    lines = [line for line in sample if not is_skipped(line)]
    if not lines and any(map(_NUMBERED.match, sample)):
        raise RefusedError(f"{path}: all lines begin with #, which marks comments: remove it")
    if lines:
        _refuse_events(path, lines[:_ROWS_LOOKED_AT])
    if len(lines) == 1 and _DOCUMENT.match(lines[0]):
        raise RefusedError(f"{path} is a single line of JSON", _IN_PYTHON.format("json.load(file)"))
    if len(lines) == 1 and len(_FRAMES.findall(lines[0])) > _MIN_GROUPED:
        raise RefusedError(f"{path} holds several frames in a single line: write a line for each")
    numeric = [any(map(str.isdigit, line)) for line in lines]
    cut = [i for i, line in enumerate(lines) if numeric[i] and _LEFT_OUT.search(line)]
    inside = (i for i in range(1, len(lines)) if numeric[i - 1])
    rows = [i for i in inside if _ROWS_LEFT_OUT.fullmatch(lines[i])]
    if len(cut) > _MIN_SHARE * len(lines) or rows:
        shown = quote(lines[(cut + rows)[0]].strip())
        raise RefusedError(f"{path} leaves out numbers, as in {shown}: use numpy.savetxt")
    head = [line for line in sample if line.strip()][:_ROWS_LOOKED_AT]
    for share, pattern, said in _KINDS:
        match = re.compile(pattern, re.IGNORECASE).search
        found = [line.strip() for line in head if match(line.rstrip())]
        if len(found) > share * len(head):
            raise RefusedError(f"{path} {said.format(quote(found[0]))}")
    keys = sum(bool(_ECHO_KEY.match(line)) for line in lines)
    if keys > 1 and sum(bool(_ECHO.fullmatch(line)) for line in lines) > 1:
        raise RefusedError(f"{path} is output of ros2 topic echo: record a bag, or use --csv")


def refuse_thousands(table: Table, sample: Sequence[str]) -> None:
    """Raise RefusedError if some numbers of a column have commas as in 1,234, and others none."""
    for cells in zip(*rows_of(table, sample), strict=False):
        grouped = [cell for cell in map(str.strip, cells) if _GROUPED.fullmatch(cell)]
        others = [cell for cell in map(str.strip, cells) if cell and not _GROUPED.fullmatch(cell)]
        whole = any(map(_WHOLE.fullmatch, others)) and all(map(str.isdecimal, others))
        if whole and len(set(grouped)) >= _MIN_GROUPED:
            shown = quote(grouped[0])
            raise RefusedError(
                f"{table.path}: commas separate thousands, as in {shown}; remove them"
            )


def refuse_lists(table: Table, sample: Sequence[str]) -> None:
    """Raise RefusedError for a column with a list of readings in each cell, as mats export."""
    rows = [] if table.numeric or table.block else rows_of(table, sample)[:_ROWS_LOOKED_AT]
    for i, cells in enumerate(zip(*rows, strict=False)):
        if len(cells) > 1 and all(map(is_list, cells)):
            named = f"[{table.names[i].strip()!r}]" if table.names else f".iloc[:, {i}]"
            mark = "',', " if "," in cells[0] else ""
            header = "" if table.names else ", header=None"
            read = f"pandas.read_csv(path{header}){named}.str.strip('[]').str.split({mark}"
            raise RefusedError(
                f"{table.path}: column {i + 1} holds lists of readings",
                _IN_PYTHON.format(f"{read}expand=True).astype(float)"),
            )


def lines_per_frame(rows: NDArray[np.float64]) -> int:
    """Return the number of lines after which rows, (t, n), resemble earlier ones; 0 for the next.

    Changes are compared with changes between successive lines. The rule applies in none of 1,670
    parts of real recordings, and in most matrices with a row per line, if contacts are slow.
    """
    rows = np.where(np.abs(rows) < 1e30, rows, 0)[:, :: 1 + rows.shape[1] // _MOST_COLUMNS]
    last = np.abs(np.diff(rows, axis=0))
    changing, n_changed = last.any(axis=0), np.count_nonzero(last.any(axis=1))
    if np.count_nonzero(changing) < _LEAST_CHANGING or n_changed < _LEAST_ROWS:
        return 0
    rows, usual = rows[:, changing], np.mean(last[:, changing], axis=0)
    heights = range(2, min(_MOST_LINES, len(rows) // 3) + 1)
    changes = [np.mean(np.abs(rows[height:] - rows[:-height]), axis=0) for height in heights]
    ratios = [1.0, *(float(np.median(change / usual)) for change in changes), 1.0]
    least = int(np.argmin(ratios[:-1]))
    beside, twice = min(ratios[least - 1], ratios[least + 1]), ratios[2 * least + 1 :][:1] or [0.0]
    fits = ratios[least] < _RESEMBLING * min(beside, 1) and twice[0] < 1
    return least + 1 if least and fits else 0


def refuse_turned(
    table: Table, sample: Sequence[str], roles: Roles, start: NDArray[np.float64]
) -> None:
    """Raise RefusedError for a table with several lines per frame, or a line per sensor.

    start (t, n_columns): The first rows.
    """
    if table.block or table.nested:
        return
    rows, known = rows_of(table, sample), {*roles.non_sensors} - {*table.text_columns}
    others = roles.non_sensors
    for i in range(min(_COLUMNS_LOOKED_AT, table.n_columns)):
        named = table.names[i].strip() if table.names else ""
        cells = [row[i] for row in rows]
        label = f"column {i + 1}" + (f" ({quote_if_needed(named)})" if named else "")
        words = {word.removesuffix("s") for word in words_of(named)}
        whole = i == 0 and i not in known and len(sample) <= len(rows) + 1
        text = not any(map(is_number, cells)) and 4 * len(cells) < table.n_columns
        named_so = whole and (words & _SENSOR_WORDS or text)
        if named_so and len(set(cells)) == len(cells) < table.n_columns - 1:
            problem = f"{label} names a sensor in each line; write a line for each frame"
            raise RefusedError(f"{table.path}: {problem}, that is, transpose the table")
        counts = i in known or (named and named.lower() in COUNTER_NAMES)
        levels = [] if counts else _cycle(cells)
        labels = words & _LINE_WORDS or not (named or any(map(is_number, cells)))
        if not counts and labels and _alternate(cells, np.delete(start, [i, *others], axis=1)):
            raise RefusedError(f"{table.path}: {label} {_OF_BOARDS}", _KEEP)
        text = bool(levels) and not is_number(levels[0])
        evident = text or bool(table.numeric) or words & _LINE_WORDS
        if levels and (evident or _number_frames(rows, len(levels))):
            long = f"; {_pivot(*table.names)}" if len(table.names) == 3 and i == 1 else ""
            shown = ", ".join([*map(quote_if_needed, levels[:3]), "..."][: len(levels) + 1])
            problem = f"repeats {shown}, so that {len(levels)} lines seem to be a frame"
            problem = f"{problem}: write them in one line"
            raise RefusedError(f"{table.path}: {label} {problem}", f"{_KEEP}{long}")


def rows_of(table: Table, sample: Sequence[str]) -> list[list[str]]:
    """Return the cells of the frames, except lines that do not fit."""
    body = sample[table.first_line - 1 :]
    if table.numeric == "":
        found = (fields for _, fields in all_records(body, table.delimiter))
    else:
        found = (_cells(table, line) for line in body if not table.is_skipped(line))
    return [fields for fields in found if len(fields) >= table.n_columns]


def _cells(table: Table, line: str) -> list[str]:
    try:
        return table.clean(line).split(",") if table.clean else []
    except ValueError:
        return []


def _number_frames(rows: Sequence[Sequence[str]], height: int) -> bool:
    """Return whether a column is constant in all lines of a frame, and changes between frames."""
    columns = ([len([*run]) for _, run in itertools.groupby(c)] for c in zip(*rows, strict=False))
    # The first and the last may be cut.
    return any({*runs[1:-1]} == {height} == {max(runs)} for runs in columns)


def _cycle(cells: Sequence[str]) -> list[str]:
    """Return the labels or whole numbers that a column repeats in the same order; empty if none."""
    levels = list(dict.fromkeys(cells))
    if not 2 <= len(levels) <= min(_MOST_LINES, len(cells) / 3) or len(cells) < _LEAST_ROWS:
        return []
    if any(is_number(cell) and not cell.strip().isdecimal() for cell in levels):
        return []
    steps = Counter(itertools.pairwise(cells))
    following = dict(zip(levels, [*levels[1:], levels[0]], strict=True))
    in_order = sum(steps[pair] for pair in following.items())
    return levels if in_order >= _CYCLIC * (len(cells) - 1) else []


def _alternate(cells: Sequence[str], readings: NDArray[np.float64]) -> bool:
    """Return whether lines resemble the line before with the same cell, more than that before."""
    (levels, places), n_rows = np.unique(cells, return_inverse=True), min(len(cells), len(readings))
    places, readings = places[:n_rows], np.where(np.abs(readings) < 1e30, readings, 0)[:n_rows]
    usual = np.abs(np.diff(readings, axis=0))[np.diff(places) != 0]
    if not 2 <= len(levels) <= min(_MOST_LINES, n_rows / _LEAST_ROWS) or len(usual) < n_rows / 10:
        return False
    if any(is_number(level) and not level.strip().isdecimal() for level in levels.tolist()):
        return False
    same = [np.abs(np.diff(readings[places == k], axis=0)) for k in range(len(levels))]
    usual, change = usual.mean(axis=0), np.concatenate(same).mean(axis=0)
    moved = usual > 0
    few = np.count_nonzero(moved) < _LEAST_CHANGING
    return not few and bool(np.median(change[moved] / usual[moved]) < _RESEMBLING)


def _refuse_events(path: Path, lines: Sequence[str]) -> None:
    """Raise RefusedError for lines of a time and a sensor, or of all active sensors.

    The header, or JSON keys, name both; without a header, rows of distinct whole numbers have
    several lengths.
    """
    mark = next((mark for mark in ";\t," if mark in lines[0]), None)
    cells = ([cell.strip("\"' []") for cell in line.strip().split(mark)] for line in lines)
    header, *rows = cells
    lists = [len(found[1].split(",")) for line in lines if (found := _LIST.search(line))]
    keys = list(dict.fromkeys(_KEY.findall(lines[0])))
    if keys:  # lists of equal length, an object in each line, are readings
        header, rows = keys, [[]] * (lines[0][0] == "[" or not lists or len(set(lists)) > 1)
    elif is_number(header[0]):
        ids = [row[1:] for row in (header, *rows)]
        whole = all(len(set(row)) == len(row) and all(map(str.isdecimal, row)) for row in ids)
        if whole and len(set(map(len, ids))) >= _MIN_LENGTHS:
            raise RefusedError(f"{path} lists events", FROM_EVENTS)
        return
    words = [{word.removesuffix("s") for word in words_of(name)} for name in header]
    moments = [
        i for i, name in enumerate(header) if is_time(name, i) or set() < words[i] <= _MOMENTS
    ]
    active = [i for i, each in enumerate(words) if set() < each <= _ACTIVE]
    values = [i for i, each in enumerate(words) if set() < each <= _VALUES]
    whole = bool(keys) or len(header) == 2 + len(values[:1])
    if not (rows and whole and len(moments) == len(active) == 1):
        return
    sensors = (row[active[0]] for row in rows if len(row) > active[0])
    if all(not cell or cell.isdecimal() or not is_number(cell) for cell in sensors):
        if values and not keys:
            by = _pivot(*(header[i] for i in (*moments, *active, *values)))
            raise RefusedError(f"{path} has a line for each reading", by)
        raise RefusedError(f"{path} lists events", FROM_EVENTS)


def _pivot(index: str, columns: str, values: str) -> str:
    by = f"index={index!r}, columns={columns!r}, values={values!r}"
    return f"in Python it is anisomap.Recording(pandas.read_csv(path).pivot({by}).fillna(0))"
