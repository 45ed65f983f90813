"""Import of the physics engine, deferred until a simulation runs."""

from __future__ import annotations

import importlib
from types import ModuleType

from anisomap.errors import MissingExtraError


def load_mujoco() -> ModuleType:
    """Import MuJoCo. All other functions of the package work without it.

    Raises
    ------
    MissingExtraError
        If MuJoCo is not installed.
    """
    try:
        return importlib.import_module("mujoco")
    except ImportError as error:
        raise MissingExtraError("simulating a recording", "simulation") from error
