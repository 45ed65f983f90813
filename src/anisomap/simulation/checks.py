"""Validation of numeric parameters."""

from __future__ import annotations

import numpy as np

from anisomap.errors import InputError


def check_positive(name: str, value: float, unit: str = "") -> None:
    """Check that a parameter is a finite, positive number."""
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"{name} must be positive, got {value:g}{unit and ' ' + unit}")


def check_count(name: str, value: int) -> None:
    """Check that a parameter is an integer of at least 1."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise InputError(f"{name} must be an integer of at least 1, got {value}")


def check_between(name: str, value: float, low: float, high: float) -> None:
    """Check that a parameter lies in the closed interval from `low` to `high`."""
    if not low <= value <= high:
        raise InputError(f"{name} must be between {low:g} and {high:g}, got {value:g}")
