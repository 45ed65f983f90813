"""Kinds of columns of a recording, by names and values.

Units are removed from names (``T00 [kPa]`` becomes ``T00``). Taxels with three axes are at least
four names that each occur with x, y and z, such as ``c0_x``, ``c0.By``, ``Fz_c0``. One quantity of
each taxel is a sensor; flags and quantities of all taxels are not. Columns of labels, inertial
units, temperatures, counters, flags and sums are not sensors, by any word or unit in their names,
unless most columns are alike.
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.base.clocks import words_of
from anisomap.base.wording import join_items, printable

XYZ = "xyz"
MIN_TAXELS = 4
"""Minimum number of taxels with three axes."""


@dataclass(frozen=True)
class Frames:
    """Layout of frames in an array.

    time: The axis of time, the first or the last.
    shape: Shape of a frame.
    names: Names of the readings of a frame, in order; empty if a frame is a list.
    """

    time: int
    shape: tuple[int, ...]
    names: tuple[str, ...]

    @property
    def n_sensors(self) -> int:
        """Number of readings in a frame."""
        return math.prod(self.shape)

    @property
    def said(self) -> str:
        """Message about the layout of an array with more than two axes."""
        size = " x ".join(map(str, self.shape))
        return f"the {'first' if self.time == 0 else 'last'} axis is time, and a frame is {size}"


def frames_of(shape: Sequence[int]) -> Frames | None:
    """Return the layout of frames in an array; the longest axis is time; None if it is unclear.

    Arrays with two axes are frames x sensors. Cells of frames with two axes are named by row and
    column. A last axis of length 3 is x, y and z.
    """
    if len(shape) == 2:
        return Frames(0, (shape[1],), ())
    if len(shape) < 2 or not min(shape) or max(shape) not in (shape[0], shape[-1]):
        return None
    time = 0 if shape[0] == max(shape) else len(shape) - 1
    frame = tuple(shape[1:] if time == 0 else shape[:-1])
    return Frames(time, frame, names_of_frame(frame))


def names_of_frame(shape: Sequence[int]) -> tuple[str, ...]:
    """Name the readings of a frame by their indices: ``r2c0``, or ``2.0.1`` with more axes."""
    *cells, last = shape
    if last == len(XYZ) and math.prod(cells) >= MIN_TAXELS:
        inner = names_of_frame(cells) or tuple(f"taxel{i}" for i in range(cells[0]))
        return tuple(f"{name}_{axis}" for name in inner for axis in XYZ)
    if len(shape) < 2:
        return ()
    if len(shape) == 2:
        return tuple(f"r{row}c{column}" for row in range(shape[0]) for column in range(shape[1]))
    inner = names_of_frame(shape[1:])
    return tuple(f"{i}.{name}" for i in range(shape[0]) for name in inner)


Axis: TypeAlias = Literal["z", "norm", "x", "y", "all"]
"""Sensors of taxels with three axes: one axis, the length of the vector, or all axes."""

AXES: tuple[Axis, ...] = ("z", "norm", "x", "y", "all")
_QUANTITY = r"((?:[BFMHbfmh]|(?<![A-Za-z])[DTdt])?)"
_SUFFIXED = re.compile(rf"(.*?)([ _.\-/\\:\[(]*){_QUANTITY}([xyzXYZ])[\])]?")
_PREFIXED = re.compile(rf"{_QUANTITY}([xyzXYZ])([ _.\-/\\:\[(]*)(.*?\d.*?)[\])]?")
_LIKED = "tdhm bf"
"""First letters of quantities, by increasing precedence if a taxel has several."""
_NUMBERED = re.compile(r".*?\d")
_INERTIAL = re.compile(r"acc|gyr|imu|quat|euler|orient|lin", re.IGNORECASE)
_MAGNETIC = re.compile(r"mag", re.IGNORECASE)


@dataclass(frozen=True)
class Taxels:
    """Taxels with three axes among N columns.

    columns: Columns of x, y and z for each name.
    others: Other columns that are not sensors, with their kinds.
    """

    columns: dict[str, tuple[int, int, int]]
    others: dict[int, str]

    def kept(
        self, names: Sequence[str], left_out: Collection[int], axis: str = "z"
    ) -> tuple[list[int], tuple[str, ...]]:
        """Return one axis of each taxel, then columns that do not belong to taxels, and names."""
        used = {*left_out, *itertools.chain.from_iterable(self.columns.values())}
        rest = [i for i in range(len(names)) if i not in used]
        of_axis = [places[XYZ.index(axis)] for places in self.columns.values()]
        return [*of_axis, *rest], (*self.columns, *(names[i] for i in rest))


def examine(
    names: Sequence[str],
    table: NDArray[np.floating] | None,
    axis: str = "z",
    numbers: Sequence[int] = (),
) -> tuple[tuple[str, ...], dict[int, str], Taxels | None, dict[str, str]]:
    """Decide which columns are sensors.

    table (t, n_columns): First rows; None if all are sensors, or axes of them.
    numbers: Places of the columns in the file, from 0, if others are not among them.
    Returns names without units, columns that are not sensors with their kinds, taxels with three
    axes, and messages by the command-line option that changes the choice.
    """
    others, doubts = ({}, {}) if table is None else find_others(names, table)
    names, said = without_units(names), dict[str, str]()
    taxels = None if axis == "all" else find_taxels(names, others)
    others |= taxels.others if taxels else {}
    left_out = said_of(names, others, "that are not sensors are left out", numbers)
    if text := "; ".join(filter(None, (left_out, said_of(names, doubts, UNLIKE, numbers)))):
        said["--keep"] = text
    if taxels:
        read = "the length from rest" if axis == "norm" else axis
        said["--axis"] = f"{len(taxels.columns)} taxels with three axes: {read} is read"
    return names, others, taxels, said


_FEW = 3
UNLIKE = "unlike the others are read as sensors"


def said_of(
    names: Sequence[str], kinds: Mapping[int, str], what: str, numbers: Sequence[int] = ()
) -> str:
    """Return a message about some columns; empty if there are none."""
    held = dict[str, list[str]]()
    for i, kind in kinds.items():
        label = printable(names[i]) if names else f"column {1 + (numbers[i] if numbers else i)}"
        held.setdefault(kind, []).append(label)
    listed = "; ".join(f"{join_items(each, _FEW)}: {kind}" for kind, each in held.items())
    return f"columns {what} ({listed})" if held else ""


_Key: TypeAlias = tuple[str, str, str]
"""Stem of the name of a taxel, separator, and letter of a quantity."""


def find_taxels(names: Sequence[str], known: Collection[int] = ()) -> Taxels | None:
    """Find taxels with three axes by the names of their columns; None if there are fewer than 4.

    known: Columns that are not sensors.
    """
    names = [name.strip() for name in names]
    for pattern in (_SUFFIXED, _PREFIXED):
        found: dict[_Key, dict[str, int]] = {}
        for i, name in enumerate(names):
            match = None if i in known else pattern.fullmatch(name)
            if not match:
                continue
            if pattern is _SUFFIXED:
                stem, mark, quantity, axis = match.groups()
            else:
                quantity, axis, mark, stem = match.groups()
            apart = mark or quantity or stem[-1:].isdigit() or axis.isupper()
            if stem and apart and not _INERTIAL.match(stem):
                found.setdefault((stem, mark, quantity), {})[axis.lower()] = i
        whole = [key for key, places in found.items() if len(places) == len(XYZ)]
        if any(map(_INERTIAL.match, names)):
            whole = [key for key in whole if not _MAGNETIC.match(key[0])]
        numbered = [key for key in whole if _NUMBERED.search(key[0])]
        if len({stem for stem, *_ in numbered}) >= MIN_TAXELS:
            whole = numbered
        counts = Counter(key[1:] for key in whole)
        whole.sort(key=lambda key: (counts[key[1:]], _LIKED.index(key[2].lower() or " ")))
        chosen = {key[0]: key for key in whole}  # the last has precedence
        if len(chosen) >= MIN_TAXELS:
            digits = all(map(str.isdigit, chosen))
            columns = {
                f"taxel{stem}" if digits else stem: (places["x"], places["y"], places["z"])
                for stem, places in ((key[0], found[key]) for key in found if key in whole)
                if places is found[chosen[stem]]
            }
            return Taxels(columns, _beside(names, {*known}, found, chosen, whole is numbered))
    return None


def _beside(
    names: Sequence[str],
    known: set[int],
    found: Mapping[_Key, Mapping[str, int]],
    chosen: Mapping[str, _Key],
    numbered: bool,
) -> dict[int, str]:
    """Find columns other than taxels: further quantities and flags of taxels, and totals."""
    others = dict[int, str]()
    used = known | {i for key in chosen.values() for i in found[key].values()}
    kinds = {key[1:] for key in chosen.values()}
    for key, places in found.items():
        if key[0] not in chosen and key[1:] in kinds and (not numbered or len(places) < len(XYZ)):
            others |= dict.fromkeys(places.values(), "a taxel that lacks an axis")
    rests = dict[str, list[int]]()
    for i, name in enumerate(names):
        numbers = _NUMBERED.match(name)
        if i in used or i in others:
            continue
        if numbered and not numbers:
            others[i] = "a quantity of all taxels"
        elif numbers and (stem := _stem_of(name, chosen)):
            rests.setdefault(name.removeprefix(stem), []).append(i)
    for places_of_rest in rests.values():
        if len(places_of_rest) > _MAX_SHARE * len(chosen):
            others |= dict.fromkeys(places_of_rest, "another quantity of a taxel")
    return others


def _stem_of(name: str, stems: Collection[str]) -> str:
    """Return the stem of a taxel at the beginning of a name; empty if there is none."""
    ends = [match.end() for match in re.finditer(r"\d(?!\d)", name)]
    return next((name[:end] for end in reversed(ends) if name[:end] in stems), "")


_UNIT = re.compile(r"(.*\S)\s*[\[(]\s*([^\d\[\]()][^\[\]()]{0,15})\s*[\])]")
_UNITS = re.compile(
    r"(?:[kMGmunp\u00b5\u03bc]?(?:Pa|N|V|A|F|T|g|bar|Ohm|\u03a9|Hz)|psi|mmHg|%(?:RH)?|\u00b0?[CF]|LSB|G)"
    r"(?:/\w+[\d\u00b2]?)?|a\.?u\.?|counts?|raw|adc|digits?|bits?|units?|norm\w*|deg\w*|k?Pa\b.*",
    re.IGNORECASE,
)


def without_units(names: Sequence[str]) -> tuple[str, ...]:
    """Return names without units in brackets, unless units distinguish columns."""
    matches = [_UNIT.fullmatch(name) for name in names]
    pairs = zip(names, matches, strict=True)
    short = [m[1] if m and _UNITS.fullmatch(m[2].strip()) else name for name, m in pairs]
    return tuple(short) if len(set(short)) == len(set(names)) else tuple(names)


COUNTER = "a counter"
_WORDS = {
    "a label": "label labels class classes target subject participant person patient trial session "
    "condition gesture activity category episode repetition rep fold split annotation marker "
    "trigger prefix",
    "an inertial unit": "imu quat quaternion euler roll pitch yaw heading angular",
    "a temperature or humidity": "temp temperature temperatur humidity",
    "a state of the read-out": "battery batt vbat rssi",
    COUNTER: "seq sequence counter packet",
    "a sum or checksum": "sum summe total grf checksum crc",
    "a statistic of others": "mean average avg max min std",
    "a centre of pressure": "cop copx copy",
    "a flag": "flag contact slip",
}
_OTHERS = {word: kind for kind, words in _WORDS.items() for word in words.split()}
_MOTION = re.compile(r"(?:acc|accel\w*|gyr|gyro\w*|mag|magnetometer)[xyz]?", re.IGNORECASE)
_PHRASES = {
    "a centre of pressure": re.compile(r"cent(?:er|re) of (?:pressure|force|mass)"),
    "an inertial unit": re.compile(r"[\[(](?:dps|(?:deg|rad|\u00b0)/s|m/s(?:\^?2|\u00b2))[\])]"),
    "a temperature or humidity": re.compile(r"[\[(](?:\u00b0c|deg ?c)[\])]"),
    "a layout of the message": re.compile(r"\blayout\b|\bdata offset$"),
}
_MAX_SHARE, _MIN_SENSORS, _MAX_HEAD, _MOST_CLOCKS = 0.5, 3, 6, 1
_MIN_ROWS, _MAX_LEVELS, _MAX_SWITCHES = 20, 10, 0.1
_MIN_FULL, _JUMPS = 0.9, (0.25, 0.42)  # of the range of a checksum
# Shares of columns that may do as one that is unlike them, and of readings that may equal it.
_MOST_ALIKE, _RARE = 0.05, 0.01
_MIN_COMPARED, _MIN_REPEATS, _FEWER = 100, 4, 8  # rows; of each value; times fewer values
_MIN_LABELS = 500  # rows: in fewer, a sensor may not have been touched


def find_others(
    names: Sequence[str], table: NDArray[np.floating]
) -> tuple[dict[int, str], dict[int, str]]:
    """Find columns that are not sensors, and sensors that may be none, with their kinds.

    table (t, n_columns): First rows. Names are empty if there is no header.
    """
    named = {i: what for i, name in enumerate(names) if (what := _what_is_named(name))}
    kinds = Counter(named.values())  # mag0 ... mag35 are sensors
    found = {i: what for i, what in named.items() if kinds[what] <= _MAX_SHARE * len(names)}
    marked = [match[2] if (match := _UNIT.fullmatch(name)) else "" for name in names]
    for usual, count in Counter(marked).most_common(1):
        if usual and count > _MAX_SHARE * len(marked):
            others = {i: f"not in {usual}" for i, u in enumerate(marked) if u not in ("", usual)}
            found = others | found
    odd, doubts = odd_names(names), _kinds_of_names(names)
    units = {i: names[i].strip() for i in odd if len(names[i]) > 1}
    found |= {i: f"a quantity in {unit}" for i, unit in units.items() if _UNITS.fullmatch(unit)}
    if len(table) >= _MIN_ROWS:
        found |= {i: "mostly empty" for i in odd if np.isnan(table[:, i]).mean() > _MAX_SHARE}
        by_values, unlike = _by_values(names, table, found, odd)
        found, doubts = found | by_values, doubts | unlike
    n_sensors = table.shape[1] - len(found)
    return (found, doubts) if n_sensors >= _MIN_SENSORS else ({}, {})


def _are_threes(values: NDArray[np.float64]) -> bool:
    """Return whether the same one of each three columns changes most, by far."""
    n_threes, rest = divmod(values.shape[1], len(XYZ))
    if rest or n_threes < MIN_TAXELS:
        return False
    spreads = values.std(axis=0).reshape(n_threes, len(XYZ))
    middle, most = np.sort(spreads, axis=1)[:, 1:].T
    clear = (spreads.min(axis=1) > 0) & (most > 2 * middle)
    usual = np.bincount(spreads.argmax(axis=1)[clear], minlength=1).max()
    return bool(usual > _MIN_FULL * n_threes)


def _kinds_of_names(names: Sequence[str]) -> dict[int, str]:
    """Find two numbers of each sensor, by names that end differently: ``S1``, ``S1_q``."""
    parts = [re.fullmatch(r"(.*\d)(\D*)", name) for name in names]
    counts = Counter(match[2] for match in parts if match)
    stems = {match[1] for match in parts if match}
    if None in parts or len(counts) != 2 or len(stems) < MIN_TAXELS or 2 * len(stems) != len(names):
        return {}
    return {i: f"two numbers of each, {' and '.join(map(repr, counts))}" for i in (0, 1)}


def _what_is_named(name: str) -> str:
    """Return the quantity denoted by the words or the unit of a name; empty for a sensor."""
    plain, words = re.sub(r"[\s_]+", " ", name.lower()), words_of(name)
    phrases = (what for what, pattern in _PHRASES.items() if pattern.search(plain))
    motion = ("an inertial unit" for word in words if _MOTION.fullmatch(word))
    return next(iter((*phrases, *motion, *(what for w in words if (what := _OTHERS.get(w))))), "")


def _by_values(
    names: Sequence[str], table: NDArray[np.floating], known: dict[int, str], odd: Collection[int]
) -> tuple[dict[int, str], dict[int, str]]:
    """Find sums of all others, and columns with odd names, or at an edge, unlike the others.

    Returns columns that are not sensors, and columns that may be none.
    """
    rest = [i for i in range(table.shape[1]) if i not in known]
    values = table[:, rest].astype(np.float64)
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) < _MIN_ROWS or len(rest) <= _MIN_SENSORS:
        return {}, {}
    found = dict[int, str]()
    with np.errstate(over="ignore", invalid="ignore"):
        total = values.sum(axis=1, keepdims=True)
        whole = _is_whole(values)
        sums = np.abs(total - 2 * values) <= (0 if whole else 1e-6) * np.abs(total)
        varying = values.max(axis=0) > values.min(axis=0)
        varying &= np.count_nonzero(varying) > _MIN_SENSORS  # two may have been touched together
        means = np.abs(total - len(rest) * values) <= 1e-6 * np.abs(total)
        for what, fits in (("sum", sums), ("mean", means)):
            for k in np.flatnonzero(fits.all(axis=0) & varying).tolist():
                found[k] = f"the {what} of all others"
        if whole and not found and values.min() >= 0:
            size = np.where(values.max(axis=0) < 256, 256, 1 << 16)
            modulo = ((total - 2 * values) % size == 0).all(axis=0) & varying
            modulo[-1] |= (not names or rest[-1] in odd) and _is_random(values, size[-1])
            found |= dict.fromkeys(np.flatnonzero(modulo).tolist(), "a checksum of all others")
        found |= dict.fromkeys(range(0 if names else _count_sizes(values)), "a number of values")
        odd = [k for k, i in enumerate(rest) if i in odd]
        sure, doubts = _unlike_others(values, found, odd if names else None)
        if not names and not sure and _are_threes(values):
            doubts |= dict.fromkeys(range(len(XYZ)), "x, y and z of a taxel?")
    if len(found := sure | found) > _MAX_SHARE * len(rest):
        return {}, {}
    return {rest[k]: s for k, s in found.items()}, {rest[k]: s for k, s in doubts.items()}


def _unlike_others(
    values: NDArray[np.float64], known: Mapping[int, str], odd: Sequence[int] | None
) -> tuple[dict[int, str], dict[int, str]]:
    """Find columns that cannot be sensors, and that may be none, by comparison with all others.

    odd: Columns to examine; without it, both edges up to the first column like the others.
    """
    found, doubts, n_columns = dict(known), dict[int, str](), values.shape[1]
    left = range(min(_MAX_HEAD, n_columns // 2))
    right = range(n_columns - 1, n_columns - 1 - len(left), -1)
    for side in (left, right) if odd is None else ([k] for k in odd):
        for k in side:
            if k in found:
                continue
            what, is_sure = _unlike(values, k, found, named=odd is not None)
            if not what:
                break
            (found if is_sure else doubts)[k] = what
    return found, doubts


def _unlike(
    values: NDArray[np.float64], k: int, found: Collection[int], *, named: bool
) -> tuple[str, bool]:
    """Return how a column differs from all others, and whether it cannot be a sensor."""
    column, others = values[:, k], np.delete(values, [k, *found], axis=1)
    steps, kind = np.diff(column), _kind(column)
    even = np.abs(steps - np.median(steps)) <= np.median(steps) / 2
    is_even = (steps > 0).all() and np.mean(even) > 1 - _MAX_SWITCHES
    is_time = not named and is_even and np.count_nonzero(_one_way(others)) <= _MOST_CLOCKS
    if is_time or kind == COUNTER or (named and kind):
        return kind or "a time", True
    moved = others[:, np.ptp(others, axis=0) > 0]
    if moved.shape[1] <= max(MIN_TAXELS, others.shape[1] / 2):  # at rest
        return "", False
    low, high, least, most = moved.min(axis=0), moved.max(axis=0), column.min(), column.max()
    apart = bool(min(np.mean(low <= most), np.mean(high >= least)) <= _MOST_ALIKE)
    alone = apart or np.mean(others == least) < _RARE
    narrow = apart and most - least < np.median(high - low) / _FEWER
    fractions, n_levels = (moved != np.floor(moved)).any(axis=0), len(np.unique(column))
    decimals = np.mean(column != np.floor(column)) > _MAX_SHARE and not fractions.any()
    whole = _is_whole(column) and fractions.all() and n_levels > _MIN_SENSORS
    one_way = apart or (n_levels > _MIN_SENSORS and np.mean(_one_way(moved)) <= _MOST_ALIKE)
    tests = (
        (decimals or whole, f"with{'' if decimals else 'out'} decimals", bool(decimals)),
        (least == most and (named or alone), "constant", named),
        (
            one_way and _one_way(column),
            f"it never {'falls' if steps.sum() > 0 else 'rises'}",
            False,
        ),
        (_are_few(column, moved), f"only {n_levels} values", False),
        (narrow, "apart from all others", False),
    )
    return next(((what, is_sure) for fits, what, is_sure in tests if fits), ("", False))


def _one_way(columns: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether columns change, and only rise or only fall."""
    steps = np.diff(columns, axis=0)
    one_way: NDArray[np.bool_] = (steps >= 0).all(axis=0) != (steps <= 0).all(axis=0)
    return one_way


def _are_few(column: NDArray[np.float64], others: NDArray[np.float64]) -> bool:
    """Return whether a column has few values, all of them often, and others have many."""
    counts = np.unique(column, return_counts=True)[1]
    repeats = (len(column) - counts.max()) / len(counts)
    if len(column) < _MIN_COMPARED or len(counts) == 1 or repeats < _MIN_REPEATS:
        return False
    usual = np.median([len(np.unique(each)) for each in others.T])
    return bool(usual >= _MIN_ROWS and len(counts) <= max(_MAX_LEVELS, usual / _FEWER))


def _is_random(values: NDArray[np.float64], size: float) -> bool:
    """Return whether the last column jumps over its whole range as often as others change."""
    moved = np.diff(values[:, :-1], axis=0).any(axis=1)
    if np.count_nonzero(moved) < _MIN_ROWS or values[:, -1].max() < _MIN_FULL * size:
        return False
    steps = np.abs(np.diff(values, axis=0))[moved].mean(axis=0)
    usual = float(np.median(steps[:-1] / np.maximum(np.ptp(values[:, :-1], axis=0), 1)))
    jump = float(steps[-1]) / size  # 1/3 of independent uniform numbers
    return _JUMPS[0] < jump < _JUMPS[1] and usual < jump / 2


def _count_sizes(values: NDArray[np.float64]) -> int:
    """Count first columns that contain the number of following ones, as in ROS and YARP lists."""
    head = values[:, :_MAX_HEAD]
    constant = int(np.cumprod((head == head[:1]).all(axis=0)).sum())
    n_after = values.shape[1] - 1 - np.arange(constant)
    ends = [k + 1 for k in range(constant) if (head[0, : k + 1] == n_after[k]).any()]
    return max(ends, default=0)


def odd_names(names: Sequence[str]) -> list[int]:
    """Return indices of names that differ from most names, if most are numbered alike."""
    forms = [re.sub(r"\d+", "#", name) for name in names]
    usual, count = Counter(forms).most_common(1)[0] if forms else ("", 0)
    few = "#" not in usual or count <= _MAX_SHARE * len(forms)
    return [] if few else [i for i, form in enumerate(forms) if form != usual]


def _is_whole(values: NDArray[Any]) -> bool:
    return bool((values == np.floor(values)).all())


def _kind(values: NDArray[Any]) -> str:
    """Return the kind of a column of whole numbers: a counter or a label; otherwise empty."""
    if not _is_whole(values):
        return ""
    steps, levels = np.diff(values), np.unique(values)
    again = (steps == 1) | (steps == levels[0] - levels[-1])  # of a counter of few levels
    if np.mean(steps == 1) > 1 - _MAX_SWITCHES or (again.all() and len(levels) > 2):
        return COUNTER
    few = len(levels) <= _MAX_LEVELS and len(values) >= _MIN_LABELS
    return "a label" if few and np.mean(steps != 0) < _MAX_SWITCHES else ""
