"""Runs that end too early: tasks for worker processes, in a module that these can import."""

import os
import signal
from dataclasses import dataclass
from pathlib import Path

from threadpoolctl import threadpool_info

from anisomap.numerics.similarity.correlation import Moments

KILL = getattr(signal, "SIGKILL", signal.SIGTERM)  # Windows has only the latter, which is as final


class PowerCutError(Exception):
    """Interrupts a run."""


def failing(parts, n_chunks, passes=1):
    """Return a function that opens chunks, and fails after some of them in its last pass."""
    opened = []

    def chunks():
        opened.append(True)
        for i, part in enumerate(parts):
            if len(opened) == passes and i == n_chunks:
                raise PowerCutError
            yield part

    return chunks


class Dying:
    """Computes moments of chunks, but kills the first worker process that runs it."""

    def __init__(self, folder: Path) -> None:
        self.mark, self.owner = folder / "dead", os.getpid()

    def __call__(self, chunk):
        if os.getpid() != self.owner and not self.mark.exists():
            self.mark.touch()
            os.kill(os.getpid(), KILL)
        return Moments.of(chunk)


@dataclass(frozen=True)
class Killing:
    """Computes moments of chunks; during the second chunk, a process is killed."""

    mark: Path
    victim: int

    def __call__(self, chunk):
        if self.mark.exists():
            os.kill(self.victim, KILL)
        self.mark.touch()
        return Moments.of(chunk)


@dataclass(frozen=True)
class ThreadLimits:
    """Thread limits of linear algebra in the workers."""

    limits: frozenset

    @classmethod
    def of(cls, _):
        pools = threadpool_info()
        return cls(frozenset(p["num_threads"] for p in pools if p["user_api"] == "blas"))

    def merged(self, other):
        return ThreadLimits(self.limits | other.limits)
