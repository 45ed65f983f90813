"""Words that several messages share."""

from __future__ import annotations

from collections.abc import Sequence


def join_items(items: Sequence[object], most: int = 8) -> str:
    """Write out the first few of many: ``a, b and 3 more``.

    Parameters
    ----------
    items : sequence
        What to list.
    most : int
        How many to write out at the most.

    Returns
    -------
    str
    """
    more = f" and {len(items) - most} more" if len(items) > most else ""
    return ", ".join(map(str, items[:most])) + more


def noun_and_items(noun: str, items: Sequence[object], most: int = 5) -> str:
    """Put a noun, in the plural if need be, before a `join_items`: ``frames 3, 4``."""
    return f"{noun}{'s' if len(items) > 1 else ''} {join_items(items, most)}"
