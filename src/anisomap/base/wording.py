"""Formatting of numbers, names and lists in messages, and of tables in notebooks."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Sequence

_CUT = " ... "


UNKNOWN = "-"
"""Stands for a number that is not known."""


def number(value: float | None, digits: int = 4, unit: str = "") -> str:
    """Format a number with some significant digits; `UNKNOWN` if it is not known or infinite."""
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
    r"""Escape characters that a terminal would act on or cannot show, such as ``\x1b``.

    These are control characters, line ends, characters that reverse or hide text, unassigned ones
    and lone surrogates, which also stand for the bytes of file names that are not UTF-8.
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
    """Escape the bytes of a file name that are not UTF-8, which no format of text can hold."""
    return file_name.encode("utf-8", "backslashreplace").decode()


def shortened(text: str, max_characters: int) -> str:
    """Cut the middle out of a long text, so that its beginning and end remain."""
    if len(text) <= max_characters:
        return text
    n_last = max_characters // 3
    return f"{text[: max_characters - n_last - len(_CUT)]}{_CUT}{text[-n_last:]}"
