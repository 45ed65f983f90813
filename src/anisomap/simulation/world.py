"""What every scenario shares: the physics engine, and what a scenario hands back."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError, MissingExtraError
from anisomap.recording import Scalar

Progress: TypeAlias = Callable[[float], None]
"""Told the share done, from 0 to 1."""


@dataclass(frozen=True, eq=False)
class Run:
    """What a scenario hands back.

    Attributes
    ----------
    readings : ndarray of shape (T, N)
        One row a frame, one column a sensor of the body.
    rate_hz : float
        Frames a second.
    facts : mapping of str to str, int, float or bool
        Every parameter as it was used, and what was measured of the physics.
    """

    readings: NDArray[np.floating]
    rate_hz: float
    facts: Mapping[str, Scalar]


def load_mujoco() -> ModuleType:
    """Import MuJoCo: the one place that does, so that all else works without it.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    try:
        return importlib.import_module("mujoco")
    except ImportError as error:
        raise MissingExtraError("simulating a recording", "simulation") from error


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
