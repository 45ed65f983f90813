"""Ranges of numeric parameters, and the message about a value outside its range."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from anisomap.errors import InputError


@dataclass(frozen=True)
class Range:
    """Finite values that a parameter may take; `text` follows "must be" in messages."""

    text: str
    contains: Callable[[float], bool]
    whole: bool = False

    def check(self, name: str, value: float, unit: str = "") -> None:
        """Check that a parameter is within the range."""
        types = (int, np.integer) if self.whole else (int, float, np.integer, np.floating)
        valid = isinstance(value, types) and not isinstance(value, bool) and np.isfinite(value)
        if not (valid and self.contains(value)):
            shown = f"{value:g}{unit and ' ' + unit}" if isinstance(value, float) else repr(value)
            raise InputError(f"{name} must be {self.text}, got {shown}")


def at_least(low: float, *, whole: bool = False) -> Range:
    """Return the range from `low` upwards."""
    kind = "an integer of " if whole else ""
    return Range(f"{kind}at least {low:g}", lambda value: value >= low, whole)


def between(low: float, high: float) -> Range:
    """Return the closed interval from `low` to `high`."""
    return Range(f"between {low:g} and {high:g}", lambda value: low <= value <= high)


def check_ranges(options: object, ranges: Mapping[str, Range]) -> None:
    """Check the attributes of an object that have a range; those that are None are not set."""
    for name, values in ranges.items():
        if (value := getattr(options, name)) is not None:
            values.check(name, value)


NOT_NEGATIVE = at_least(0)
POSITIVE = Range("positive", lambda value: value > 0)
COUNT = at_least(1, whole=True)
