"""Parameters that make no sense are refused, by name."""

from __future__ import annotations

import numpy as np

from anisomap.errors import InputError


def check_positive(name: str, value: float, unit: str = "") -> None:
    """Refuse a parameter that must be a positive number and is not.

    Raises
    ------
    InputError
        If `value` is zero, negative, infinite or not a number.
    """
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"{name} is {value:g}{unit and ' ' + unit}; it must be a positive number")


def check_count(name: str, value: int) -> None:
    """Refuse a count that is not a whole number of at least 1.

    Raises
    ------
    InputError
        If it is not.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise InputError(f"{name} is {value}; it must be a whole number of at least 1")
