"""Import of optional libraries, on first use."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from anisomap.errors import MissingExtraError


def import_extra(module: str, purpose: str, extra: str) -> Any:
    """Import a library that an extra installs.

    Parameters
    ----------
    module : str
        Full name of the module, such as ``"matplotlib.figure"``.
    purpose : str
        Subject of the error message, such as ``"reading HDF5"``.
    extra : str
        Name of the extra.

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
    except ImportError as error:
        raise MissingExtraError(purpose, extra) from error
