"""Lines that contain more than numbers and separators: constant text and varying numbers.

A line is text with numbers in between: ``10:00:00.020 -> 0, 12``, ``[0 12]``, ``S0:0 S1:12`` or
``{"t": 3, "p": [0, 12]}``. The text of the first lines is the template of all lines: each number
that varies is a value, and a number in a label (``S0:``, ``sensor 3 =``) is text. A line with
different text does not fit.
"""

from __future__ import annotations

import itertools
import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from anisomap.base.clocks import WITH_MONTH, parse_clock
from anisomap.errors import InputError
from anisomap.io.parsing.source import quote

_TIME = (
    r"(?:\d{1,6} days )?\d{1,2}:\d{2}:\d{2}(?:[.:]\d{1,9}(?:,\d{3}(?=\]))?|,\d{3}(?=\s))?"
    r"(?:\s?[AaPp][Mm]\b)?(?:Z|[-+]\d{2}:?\d{2})?"
)
_DATE = r"(?:\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/.]\d{1,2}[-/.]\d{4})"
ADDRESS = r"(?:\d{1,3}(?:\.\d{1,3}){3}(?::\d+)?|(?:[0-9A-Fa-f]{2}:){5}[0-9A-Fa-f]{2})"
"""Pattern of an address in a network."""
_WORDS = r"[-+]?(?:nan|inf|infinity|null|none|n/a|na)(?![\w/])"
_START = r"(?<![\w.:/])"
# A number that is followed by the rest of the word, as the first one of T0_1 in "T0_1: 12".
_IN_LABEL = r"\w*[A-Za-z_]\w*(?:[\])}\"']*\s*(?::|=|->|>)|\s+[-+]?\.?\d)"


def _tokens(number: str) -> re.Pattern[str]:
    return re.compile(
        rf"{_START}(?:{ADDRESS}|{WITH_MONTH}|{_DATE}(?:[T\s]+{_TIME})?|{_TIME})(?![\w:])"
        rf"|(?<![\w.])(?:[-+]?{number}(?:[eE][-+]?\d+)?|{_WORDS})"
        rf"|(?<=[A-Za-z_])\d+(?:\.\d+)?(?!{_IN_LABEL})",
        re.IGNORECASE,
    )


_TOKENS = {".": _tokens(r"(?:\d+(?:\.\d*)?|\.\d+)"), ",": _tokens(r"\d+(?:[.,]\d+)?")}
"""Numbers and clocks in a line, by the decimal mark."""

_APART = re.compile(r"[\s,;|:=>\[\](){}\"']")
_ENDS_LABEL = re.compile(r"[\])}\"']*\s*(?::|=|->|=>|>)")
_BRACKETS = re.compile(r"[\[\](){}]")
_NAME_ENDS, _NAME_STARTS = " \t\r\n\"'([{", " \t\r\n\"')]}{"
_UNIT = re.compile(r"\A[^\W\d_]+(?=[\s,;])")  # behind a value
_ID = re.compile(r".*\.\d+\.(?:id|idx|index|taxel|sensor|channel)")  # of objects in a list
_LISTED = re.compile(r"[\s,;]+")
_NAMED = re.compile(r"(?:[^\W\d_][\[(]?|[:=>])\s*\Z")  # the text before a number names it
_COMMA, _NUMBER = re.compile(r"\d,\d"), re.compile(r"(?<!\w)\d")
_LOOKED_AT = 400  # lines
_MIN_VALUES, _MIN_SHARE = 2, 0.5  # values; share of the examined lines that fit
_MIN_ALIKE, _MIN_LIST, _MIN_LISTED = 8, 3, 0.6  # lines; steps of a list; share of the values
PREFIX = "prefix"
"""Name of a number without a name before the values, such as ``17: 0, 12``."""
_SEPARATORS, _MARKS = re.compile(r"[,;|\t]"), re.compile(r"[:=>]")


class MisfitError(ValueError):
    """A line does not fit the preceding lines."""


@dataclass(frozen=True)
class Template:
    """The constant text of lines; a call converts a line to numbers.

    texts: Text before each token, and after the last, without blanks.
    fixed: Tokens that are part of the text, by index; empty if they may change.
    names: Names of the values; empty if the text contains none.
    clocks: Indices of the values that are dates or times of the day.
    """

    texts: tuple[str, ...]
    fixed: dict[int, str]
    names: tuple[str, ...]
    decimal: str
    clocks: frozenset[int]
    example: str

    @property
    def n_values(self) -> int:
        """Number of values in a line."""
        return len(self.names)

    def __call__(self, line: str) -> str:
        """Return the values of a line, separated by commas."""
        texts, tokens = _split(line, self.decimal)
        fixed = (tokens[i : i + 1] == [word] for i, word in self.fixed.items() if word)
        fits = texts == self.texts and all(fixed)
        if not fits:
            before = quote(self.example.strip())
            raise MisfitError(f"{quote(line.strip())} does not fit lines such as {before}")
        kept = [token for i, token in enumerate(tokens) if i not in self.fixed]
        return ",".join(
            _seconds(token) if i in self.clocks else _plain(token) for i, token in enumerate(kept)
        )


def _seconds(token: str) -> str:
    if (at := parse_clock(token)) is None:
        raise MisfitError(f"{quote(token)} is not a time of day")
    return repr(at)


def _plain(token: str) -> str:
    """Return a number with a decimal point; words for missing values are NaN."""
    if token[-1:].isalpha() and "inf" not in token.lower():
        return "nan"
    return token.replace(",", ".")


def _split(line: str, decimal: str) -> tuple[tuple[str, ...], list[str]]:
    """Return the texts around the tokens of a line, without blanks, and the tokens."""
    raw, tokens = _raw_split(line, decimal)
    texts = ["".join(text.split()) or (" " if text else "") for text in raw]
    # Brackets around a whole table occur only in its first and last lines.
    texts[0], texts[-1] = texts[0].lstrip("[(").strip(), texts[-1].rstrip("]),;").strip()
    return tuple(texts), tokens


def _raw_split(line: str, decimal: str) -> tuple[list[str], list[str]]:
    texts, tokens, end = list[str](), list[str](), 0
    for match in _TOKENS[decimal].finditer(line := line.strip()):
        texts.append(line[end : match.start()])
        tokens.append(match[0])
        end = match.end()
    return [*texts, line[end:]], tokens


def find_template(lines: Sequence[str]) -> Template | None:
    """Find the template of lines with text between the numbers; None if most do not fit it."""
    lines = lines[:_LOOKED_AT]
    marks = ".," if any(map(_COMMA.search, lines)) else "."  # decimal marks to try
    found = (_template(lines, decimal) for decimal in marks)
    plain, comma = ((each or (0.0, set(), None)) for each in [*found, None][:2])
    # With decimal commas, a single separator remains where commas and others alternate.
    commas = comma[0] >= plain[0] and len(comma[1]) < len(plain[1])
    if commas and not any(_BRACKETS.search(text) for text in comma[1]):
        return comma[2]
    return plain[2]


def _template(lines: Sequence[str], decimal: str) -> tuple[float, set[str], Template] | None:
    """Return the share of lines that fit, the texts between values, and the template."""
    split = [_split(line, decimal) for line in lines]
    counts = Counter(texts for texts, tokens in split if tokens)
    if not counts:
        return None
    texts, count = counts.most_common(1)[0]
    if count < _MIN_SHARE * len(lines) or any(map(_NUMBER.search, texts)):
        return None
    alike = [tokens for each, tokens in split if each == texts]
    example = next(line for line, (each, _) in zip(lines, split, strict=True) if each == texts)
    raw, _ = _raw_split(example, decimal)
    if len(texts) <= _MIN_VALUES or not all(_APART.search(text) for text in raw[1:-1]):
        return None
    columns = list(zip(*alike, strict=True))
    stamped = parse_clock(columns[0][0]) is not None and raw[1].isspace() and raw[1] not in raw[2:]
    if not stamped and not "".join(raw).strip(" ,;|\t"):  # a table with some wrong cells
        return None
    first = [tokens[0] for tokens in columns]
    times = [":" in s or parse_clock(s) is not None for s in first]
    clocks = frozenset(i for i, s in enumerate(first) if times[i] and not re.fullmatch(ADDRESS, s))
    labels = [
        i for i in range(1, len(columns)) if _is_glued(raw, i) and _ENDS_LABEL.match(raw[i + 1])
    ]
    if any(len(set(columns[i])) > 1 for i in labels):
        raise InputError(
            f"the labels of the values must not change, as in {quote(example.strip())}"
        )
    constant = [i for i, tokens in enumerate(columns) if len({*tokens}) == 1 and i not in clocks]
    fixed = {i: first[i] for i in constant if _labels(raw, i) or re.fullmatch(ADDRESS, first[i])}
    kept = [i for i in range(len(columns)) if i not in fixed]
    if len(alike) >= _MIN_ALIKE and len(kept) > _MIN_LIST:
        apart = _outside(kept, raw) & {*constant}
        fixed |= {i: "" for i in apart if not _NAMED.search(raw[i]) or raw[i + 1][:1] == "]"}
    names = _names(raw, columns, fixed, clocks)
    if not names:
        return None
    kept = [i for i in range(len(columns)) if i not in fixed]
    at = frozenset(kept.index(i) for i in clocks)
    return count / len(lines), {*texts[1:-1]}, Template(texts, fixed, names, decimal, at, example)


def _outside(kept: Sequence[int], raw: Sequence[str]) -> set[int]:
    """Return the values before and after a list of most values, with equal text between them."""
    pairs = itertools.pairwise(kept)
    between = {(i, k): "".join("".join(raw[i + 1 : k + 1]).split()) for i, k in pairs}
    longest = max(([*run] for _, run in itertools.groupby(between, between.get)), key=len)
    is_list = len(longest) >= max(_MIN_LIST, _MIN_LISTED * len(kept))
    return {*kept} - {i for pair in longest for i in pair} if is_list else set()


def _labels(raw: Sequence[str], i: int) -> bool:
    """Return whether a token is part of the label of the next one, by the texts around it."""
    if i + 2 == len(raw):  # behind the values, as in tensor([0, 12], device='cuda:0')
        return any(map(str.isalpha, raw[i])) and any(mark in raw[i] for mark in ")]}")
    if _ENDS_LABEL.match(raw[i + 1]):
        return True
    following = raw[i + 1]  # np.int64(12)
    return _is_glued(raw, i) and bool(following) and (following.isspace() or following == "(")


def _is_glued(raw: Sequence[str], i: int) -> bool:
    return raw[i][-1:].isalpha() or raw[i].endswith("_")


def _names(
    raw: Sequence[str], columns: Sequence[Any], fixed: dict[int, str], clocks: frozenset[int]
) -> tuple[str, ...]:
    """Return a name for each value; values without a name are a list of the preceding name."""
    names, text = list[str](), ""
    for i in range(len(columns)):
        text += raw[i]
        if i in fixed:
            text += fixed[i]
            continue
        parts = _MARKS.split(_SEPARATORS.split(_UNIT.sub("", text) if names else text)[-1])
        words = [part.lstrip(_NAME_STARTS).rstrip(_NAME_ENDS) for part in parts]
        words = [word for word in words if any(map(str.isalnum, word))]
        names.append("" if i in clocks or not words else words[-1])
        text = ""
    known = [name for name in names if name]
    if len(set(known)) < len(known):  # units
        names = [""] * len(names)
    # Whether a colon or an arrow follows each value.
    marked = [bool(_ENDS_LABEL.match(raw[i + 1])) for i in range(len(raw) - 1) if i not in fixed]
    if marked[0] and not any(marked[1:]) and not names[0] and 0 not in clocks:
        names[0] = PREFIX
    heads = [i for i, name in enumerate(names) if name]
    lists = [i for i in heads if i + 1 < len(names) and not names[i + 1] and not marked[i]]
    for head in lists:
        end = next((i for i in heads if i > head), len(names))
        for i in range(head, end) if len(lists) > 1 else ():
            names[i] = f"{names[head]}.{i - head}" if i > head else names[i]
        names[head] = f"{names[head]}.0" if len(lists) > 1 else ""
    return tuple(names)


def as_objects(lines: Sequence[str]) -> tuple[tuple[str, ...], Callable[[str], str]] | None:
    """Return the names of the numbers in lines of JSON objects, and a function to read a line."""
    first = _flat(lines[0]) if lines else None
    if not first or any(_flat(line) is None for line in lines[1:2]):
        return None
    ids = {name: value for name, value in first.items() if _ID.fullmatch(name)}
    names = tuple(name for name in first if name not in ids)

    def convert(line: str) -> str:
        found = _flat(line)
        if found is None or {*found} != {*first} or not ids.items() <= found.items():
            what = "is no JSON object" if found is None else "has other keys than the lines before"
            raise MisfitError(f"{quote(line.strip())} {what}")
        return ",".join(found[name] for name in names)

    return names, convert


def _flat(line: str) -> dict[str, str] | None:
    """Return the numbers and clocks of a JSON object by name; items of lists by index."""
    with suppress(ValueError, RecursionError):
        found = json.loads(line)
        if isinstance(found, dict):
            return dict(_leaves("", found))
    return None


def _leaves(name: str, value: Any) -> Iterable[tuple[str, str]]:
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, each in items:
            yield from _leaves(f"{name}.{key}" if name else str(key), each)
    elif value is None or isinstance(value, int | float):
        yield name, "nan" if value is None else repr(float(value))
    elif isinstance(value, str) and (at := parse_clock(value)) is not None:
        yield name, repr(at)
    elif isinstance(value, str) and len(parts := _LISTED.split(value.strip("[] \r\n"))) > 2:
        with suppress(ValueError):  # a message of a board
            yield from _leaves(name, list(map(float, parts)))
