"""When compiled loops are worth their start, and how they are spread over cores."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from typing import Any, Protocol, TypeVar

Piece = TypeVar("Piece")
Result = TypeVar("Result")

COMPILED_FROM = 500
"""Matrices of so many rows go through compiled loops; below, loading them would cost more."""

SPREAD_FROM = 1500
"""From so many rows a pass takes long enough to be shared between threads."""


class Map(Protocol):
    """What `spread` gives."""

    def __call__(self, task: Callable[[Piece], Result], pieces: Iterable[Piece], /) -> list[Result]:
        """Run the task on every piece; list the results in the order of the pieces."""
        ...


def kernels() -> Any:
    """Load the compiled loops; only the first call takes time."""
    return import_module("anisomap.numerics.compiled.kernels")


def thread_count() -> int:
    """Give the number of threads that compiled loops may use.

    ``NUMBA_NUM_THREADS`` sets it, as it does for numba, and as joblib does for its workers.
    """
    return int(import_module("numba").config.NUMBA_NUM_THREADS)


def spreads(n_rows: int) -> bool:
    """Tell whether `spread` shares work on so many rows between threads."""
    return n_rows >= SPREAD_FROM and thread_count() > 1


@contextmanager
def spread(n_rows: int) -> Iterator[Map]:
    """Give a `map` that runs pieces on all cores if the matrix has rows enough.

    Threads of our own, not numba's: its pools abort the process when two threads call them at
    once, or after a fork. Pieces must not depend on how many threads there are, so that results
    do not either.
    """
    if not spreads(n_rows):
        yield in_turn
        return
    with ThreadPoolExecutor(thread_count()) as pool:
        yield lambda task, pieces: list(pool.map(task, pieces))


def in_turn(task: Callable[[Piece], Result], pieces: Iterable[Piece], /) -> list[Result]:
    """Run the task on one piece after the other."""
    return [task(piece) for piece in pieces]
