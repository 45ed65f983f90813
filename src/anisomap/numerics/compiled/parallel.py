"""Compilation and lazy import of loops, and numbers of threads for loops and BLAS."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from sys import modules
from typing import Any, TypeVar

from threadpoolctl import ThreadpoolController

from anisomap.errors import import_extra

Task = TypeVar("Task")
Result = TypeVar("Result")
Loop = TypeVar("Loop", bound=Callable[..., Any])

MIN_COMPILED_ROWS = 500
"""Minimum rows of a matrix that require compiled loops."""

_MIN_FASTER_ROWS = 400  # for which loops save more time than importing numba takes

MIN_PARALLEL_ROWS = 1500
"""Minimum rows of a matrix for threads; for fewer, starting threads takes longer than they save."""


def loop(**flags: Any) -> Callable[[Loop], Loop]:
    """Compile a function on its first call, and cache it; it releases the interpreter lock."""
    njit = _numba().njit

    def compiled(function: Loop) -> Loop:
        try:
            fast: Loop = njit(function, nogil=True, cache=True, **flags)
        except RuntimeError:  # no folder for the cache
            fast = njit(function, nogil=True, **flags)
        return fast

    return compiled


def load_loops(name: str) -> Any:
    """Import a module of compiled loops on first use."""
    return import_module(f"anisomap.numerics.compiled.{name}")


@lru_cache
def has_loops() -> bool:
    """Return whether loops can be compiled."""
    return find_spec("numba") is not None


def uses_loops(n_rows: int) -> bool:
    """Return whether matrices with `n_rows` rows are processed by compiled loops."""
    return n_rows >= (_MIN_FASTER_ROWS if has_loops() else MIN_COMPILED_ROWS)


def thread_count() -> int:
    """Return the number of threads for compiled loops.

    The environment variable ``NUMBA_NUM_THREADS`` sets this number; joblib sets it for its workers.
    """
    return int(_numba().config.NUMBA_NUM_THREADS)


def _numba() -> Any:
    return import_extra("numba", "mapping this many sensors", "fast")


def parallel_map(
    task: Callable[[Task], Result], items: Iterable[Task], n_rows: int
) -> list[Result]:
    """Apply a function to every item, in threads if the matrix has enough rows.

    Numba's own thread pools are not used: they abort the process when two threads call them at
    once, or after a fork. Items must not depend on the number of threads; then results do not.
    """
    if n_rows < MIN_PARALLEL_ROWS or not has_loops() or thread_count() == 1:
        return [task(item) for item in items]
    with ThreadPoolExecutor(thread_count()) as pool:
        return list(pool.map(task, items))


@contextmanager
def limited_blas(n_rows: int) -> Iterator[None]:
    """Limit BLAS to one thread within the block if matrices have too few rows for threads.

    BLAS threads busy-wait for each other. On a loaded machine, small products take ten times the
    CPU time with several threads.
    """
    # Another thread may be importing scipy.linalg, and not yet have loaded its BLAS.
    with _controller(hasattr(modules.get("scipy.linalg"), "blas")).limit(
        limits=1 if n_rows < MIN_PARALLEL_ROWS else None, user_api="blas"
    ):
        yield


@lru_cache(maxsize=2)
def _controller(_with_scipy: bool) -> ThreadpoolController:
    """Find the loaded BLAS libraries once; numpy and scipy each load their own."""
    return ThreadpoolController()
