"""Decorator of compiled loops."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

Loop = TypeVar("Loop", bound=Callable[..., Any])


def loop(**flags: Any) -> Callable[[Loop], Loop]:
    """Compile a function on its first call, without the global interpreter lock, and cache it."""

    def compiled(function: Loop) -> Loop:
        try:
            fast: Loop = numba.njit(function, nogil=True, cache=True, **flags)
        except RuntimeError:
            fast = numba.njit(function, nogil=True, **flags)
        return fast

    return compiled
