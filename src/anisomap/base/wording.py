"""Formatting of numbers, names and lists in messages, and of tables in notebooks."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Sequence

_CUT = " ... "


UNKNOWN = "-"
"""Placeholder for an unknown number."""


def number(value: float | None, digits: int = 4, unit: str = "") -> str:
    """Format a number with `digits` significant digits; `UNKNOWN` if it is unknown or infinite."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    rounded = float(f"{value:.{digits}g}")
    if 1000 <= abs(rounded) < 1e7:  # "g" would write an exponent
        decimals = max(0, digits - len(str(int(abs(rounded)))))
        text = f"{rounded:.{decimals}f}"
    else:
        text = f"{rounded:.{digits}g}"
    return f"{text} {unit}".strip()


def percent(share: float) -> str:
    """Format a share as a percentage."""
    return f"{share:.1%}"


def join_items(items: Sequence[object], max_items: int = 8) -> str:
    """Join items with commas, abbreviating long lists: ``a, b and 3 more``."""
    more = f" and {len(items) - max_items} more" if len(items) > max_items else ""
    return ", ".join(map(str, items[:max_items])) + more


def printable(text: str) -> str:
    r"""Escape characters that a terminal interprets or cannot display, such as ``\x1b``.

    These are control characters, line ends, characters that reverse or hide text, unassigned
    characters, and lone surrogates, which also represent non-UTF-8 bytes of file names.
    """
    if text.isprintable():
        return text
    return "".join(
        character
        if character.isprintable() or unicodedata.category(character) == "Zs"
        else character.encode("unicode_escape").decode()
        for character in text
    )


def as_text(file_name: str) -> str:
    """Escape the non-UTF-8 bytes of a file name, which text formats cannot represent."""
    return file_name.encode("utf-8", "backslashreplace").decode()


def shortened(text: str, max_characters: int) -> str:
    """Remove the middle of a long text, and keep its beginning and end."""
    if len(text) <= max_characters:
        return text
    n_last = max_characters // 3
    return f"{text[: max_characters - n_last - len(_CUT)]}{_CUT}{text[-n_last:]}"
