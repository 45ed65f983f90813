"""Names of sensors from files: made distinct, and matched between files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from anisomap.io.parsing.source import quote_if_needed, warn
from anisomap.wording import noun_and_items

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
    example = next(iter(counts))
    warn(
        path,
        f"several sensors have the {noun_and_items('name', repeated)}; they are numbered in order, "
        f"as in {quote_if_needed(example)} and {quote_if_needed(f'{example}_2')}",
    )
    return tuple(found)


def match_names(names: Sequence[str], known: Sequence[str]) -> list[int | None]:
    """Find each name among known names.

    Names that are not equal match by the numbers at their ends (``17`` and ``taxel17``) if no name
    is equal to a known one, and the numbers are unique in both lists.
    """
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
    cells: list[int] | None
    if len(places) == len(names):
        inside = all(row < rows and column < columns for row, column in places)
        cells = [row * columns + column for row, column in places] if inside else None
    else:
        cells = numbers_of(names)
    if cells is None or len(set(cells)) < len(cells) or max(cells, default=0) >= rows * columns:
        return None
    return cells
