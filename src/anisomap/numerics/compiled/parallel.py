"""When compiled loops are worth their start, and how they are spread over cores."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from typing import Any, Protocol, TypeVar

Piece = TypeVar("Piece")
Result = TypeVar("Result")

MIN_COMPILED_ROWS = 500
"""Matrices of so many rows go through compiled loops; below, loading them would cost more."""

MIN_PARALLEL_ROWS = 1500
"""From so many rows a pass takes long enough to be shared between threads."""


class MapFunction(Protocol):
    """What `spread` gives."""

    def __call__(self, task: Callable[[Piece], Result], pieces: Iterable[Piece], /) -> list[Result]:
        """Run the task on every piece; list the results in the order of the pieces."""
        ...


def load_loops(name: str) -> Any:
    """Import a module of compiled loops on first use.

    Parameters
    ----------
    name : str
        Module of `anisomap.numerics.compiled`, such as ``"paths"``.
    """
    return import_module(f"anisomap.numerics.compiled.{name}")


def thread_count() -> int:
    """Give the number of threads that compiled loops may use.

    ``NUMBA_NUM_THREADS`` sets it, as it does for numba, and as joblib does for its workers.
    """
    return int(import_module("numba").config.NUMBA_NUM_THREADS)


def is_parallel(n_rows: int) -> bool:
    """Tell whether `spread` shares work on so many rows between threads."""
    return n_rows >= MIN_PARALLEL_ROWS and thread_count() > 1


@contextmanager
def parallel_map(n_rows: int) -> Iterator[MapFunction]:
    """Give a `map` that runs pieces on all cores if the matrix has rows enough.

    Threads of our own, not numba's: its pools abort the process when two threads call them at
    once, or after a fork. Pieces must not depend on how many threads there are, so that results
    do not either.
    """
    if not is_parallel(n_rows):
        yield serial_map
        return
    with ThreadPoolExecutor(thread_count()) as pool:
        yield lambda task, pieces: list(pool.map(task, pieces))


def serial_map(task: Callable[[Piece], Result], pieces: Iterable[Piece], /) -> list[Result]:
    """Run the task on one piece after the other."""
    return [task(piece) for piece in pieces]
