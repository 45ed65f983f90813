"""How inner loops are compiled: with numba, without the interpreter's lock, and kept on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

Loop = TypeVar("Loop", bound=Callable[..., Any])


def loop(**flags: Any) -> Callable[[Loop], Loop]:
    """Compile a function when it is first called, and keep what comes out for the next time.

    Parameters
    ----------
    **flags
        More for ``numba.njit``.

    Returns
    -------
    callable
        A decorator. Where there is no folder that compiled code could be kept in, as for a user
        without a home and an installation that only others may write to, it is compiled each time.
    """

    def compiled(function: Loop) -> Loop:
        try:
            fast: Loop = numba.njit(function, nogil=True, cache=True, **flags)
        except RuntimeError:
            fast = numba.njit(function, nogil=True, **flags)
        return fast

    return compiled
