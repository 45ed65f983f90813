"""Cells of a table of text: numbers, words for missing values, clocks, names and formulas."""

from __future__ import annotations

import csv
import math
import re
from contextlib import suppress

from anisomap.base.clocks import parse_clock
from anisomap.errors import InputError

_NUMPY = "nan -nan +nan nat"
_PROGRAMS = "- -- . ? na n/a #n/a <na> null none nil missing"
MISSING = frozenset(["", *_NUMPY.split(), *_PROGRAMS.split()])
"""Words for a missing value, in lower case, in recordings, layouts, maps and dissimilarities."""

_IDENTIFIER = re.compile(r"[^\W\d][\w.\-/\\]*")
_IN_TEXT = re.compile(r"\d")

FORMULA_STARTS = (*"=+-@\t\r", *"\uff1d\uff0b\uff0d\uff20")
"""First characters of a cell that spreadsheets take for a formula, some in full width."""


def is_missing(cell: str) -> bool:
    """Return whether a cell is empty or a word for a missing value."""
    return cell.strip().lower() in MISSING


def parse_number(cell: str, delimiter: str | None = ",") -> float:
    """Parse a number as numpy does, with a decimal comma too unless commas separate the fields."""
    text = (cell if delimiter == "," else cell.replace(",", ".")).strip()
    if text.lower() in MISSING:
        return math.nan
    if "_" in text or not text.isascii():
        raise ValueError(text)
    return float(text)


def parse_time(cell: str, delimiter: str | None = ",") -> float:
    """Parse a clock as seconds, or a number."""
    found = parse_clock(cell)
    return parse_number(cell, delimiter) if found is None else found


def is_number(cell: str, delimiter: str | None = ",") -> bool:
    """Return whether `parse_number` accepts a cell."""
    with suppress(ValueError):
        parse_number(cell, delimiter)
        return True
    return False


def is_clock(cell: str) -> bool:
    """Return whether a cell is a date or a time of the day."""
    return parse_clock(cell) is not None


def is_label(cell: str) -> bool:
    """Return whether a cell is text without a number: ``left``, or a name such as ``S01``."""
    text = cell.strip()
    return not _IN_TEXT.search(text) or bool(_IDENTIFIER.fullmatch(text))


_HEXADECIMAL = re.compile(r"0[xX][0-9a-fA-F]+|\d[0-9A-Fa-f]+")
_GROUPED = re.compile(r"[-+]?\d{1,3}(?:(?P<mark>[.,' \u00a0])\d{3})(?:(?P=mark)\d{3})*(?:[.,]\d+)?")


def remedy_of(cell: str) -> str:
    """Say what to do about a cell that is no number; empty if that is not known."""
    if _GROUPED.fullmatch(cell.strip()):
        return "; remove thousands separators from the file"
    if cell.strip().lower() in ("true", "false", "on", "off"):
        return "; write 1 and 0"
    return "; write decimal numbers" if _HEXADECIMAL.fullmatch(cell.strip()) else ""


def guard_formula(name: str) -> str:
    """Precede a name that a spreadsheet would run as a formula with one more apostrophe."""
    if len(name) >= csv.field_size_limit():
        raise InputError(f"a name of {len(name)} characters is too long for delimited text")
    return f"'{name}" if name.lstrip("'").startswith(FORMULA_STARTS) else name


def unguard_formula(field: str) -> str:
    """Restore a name from `guard_formula`."""
    guarded = field.startswith("'") and field.lstrip("'").startswith(FORMULA_STARTS)
    return field[1:] if guarded else field
