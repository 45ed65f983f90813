"""The physics engine, imported when a simulation runs and not before."""

from __future__ import annotations

import importlib
from types import ModuleType

from anisomap.errors import MissingExtraError


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
