"""Import of the physics engine, deferred until a simulation runs."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

from anisomap.extras import import_extra

_STANDARD_ERROR = 2  # the file descriptor: the compiler does not write to sys.stderr
_logger = logging.getLogger(__name__)


def load_mujoco() -> ModuleType:
    """Import MuJoCo. All other functions of the package work without it.

    Its warnings are logged; by default it prints them and appends them to ``MUJOCO_LOG.TXT`` in
    the working folder. A handler that the caller has set is kept.

    Raises
    ------
    MissingExtraError
        If MuJoCo is not installed.
    """
    mujoco: ModuleType = import_extra("mujoco", "simulating a recording", "simulation")
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_log_warning)
    return mujoco


@contextmanager
def silent_compiler() -> Iterator[None]:
    """Discard what MuJoCo's compiler of models prints on standard error: reports of Qhull.

    The exception that follows them states the problem in one sentence.
    """
    sys.stderr.flush()
    original, null = os.dup(_STANDARD_ERROR), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, _STANDARD_ERROR)
        yield
    finally:
        os.dup2(original, _STANDARD_ERROR)
        os.close(original)
        os.close(null)


def _log_warning(message: str) -> None:
    _logger.info("MuJoCo warns: %s", message)
