"""Import of the optional libraries that draw, on first use."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from anisomap.errors import MissingExtraError


def load(module: str, purpose: str) -> Any:
    """Import a module of an optional library.

    Parameters
    ----------
    module : str
        Full name, such as ``"matplotlib.figure"``.
    purpose : str
        The subject of the error message: ``"a picture"``.

    Returns
    -------
    module
        Typed as Any, because the libraries may be absent where types are checked.

    Raises
    ------
    MissingExtraError
        If the library is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise MissingExtraError(purpose, "report") from error
