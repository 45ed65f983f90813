"""What a run takes: CPU time, time on the clock, and memory beyond what was held before."""

from __future__ import annotations

import ctypes
import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar
from unittest.mock import patch

from threadpoolctl import threadpool_limits

from anisomap.numerics.compiled import parallel

Result = TypeVar("Result")

MAX_REPEATED_SECONDS = 5.0
"""Seconds after which a run is not repeated: what disturbs it is a small part of it."""

MIN_SECONDS = 0.3
MAX_RUNS = 10
_OWN = Path("/proc/self")
_KILOBYTES_A_MEGABYTE = 1000 / 1.024


@dataclass(frozen=True)
class Cost:
    """What a run took.

    Parameters
    ----------
    cpu, clock : float
        Seconds: of all threads together, and on the clock.
    memory : float
        Megabytes that were held at the worst moment beyond those held before, the result included;
        NaN where the system does not tell.
    """

    cpu: float
    clock: float
    memory: float = math.nan

    def times(self, factor: float) -> Cost:
        """Give what so many times the work takes; the memory is not known."""
        return self if factor == 1 else Cost(self.cpu * factor, self.clock * factor)

    def and_then(self, other: Cost) -> Cost:
        """Give what both take, one after the other."""
        return Cost(self.cpu + other.cpu, self.clock + other.clock)


def cores() -> int:
    """Count the cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Let linear algebra, and the compiled loops of anisomap, use so many threads."""
    with threadpool_limits(count), patch.object(parallel, "thread_count", lambda: count):
        yield


def measured(run: Callable[[], Result]) -> tuple[Cost, Result]:
    """Run once."""
    before = _begin_peak()
    clock, cpu = time.perf_counter(), time.process_time()
    result = run()
    cpu, clock = time.process_time() - cpu, time.perf_counter() - clock
    return Cost(cpu, clock, _status("VmHWM") - before), result


def least(run: Callable[[], object]) -> Cost:
    """Give the least of some runs, since what disturbs a run only ever slows it."""
    costs: list[Cost] = []
    while not costs or (sum(cost.clock for cost in costs) < MIN_SECONDS and len(costs) < MAX_RUNS):
        costs.append(measured(run)[0])
    return Cost(
        min(cost.cpu for cost in costs),
        min(cost.clock for cost in costs),
        max(cost.memory for cost in costs),
    )


def on_one_thread(run: Callable[[], Result]) -> tuple[Cost, Result]:
    """Give the least cost on one thread, and the result; the first run warms up, unless long."""
    with threads(1):
        first, result = measured(run)
        return (first if first.clock > MAX_REPEATED_SECONDS else least(run)), result


def _begin_peak() -> float:
    """Forget the most memory ever held, and give the megabytes held now; NaN if that cannot be."""
    try:
        (_OWN / "clear_refs").write_text("5")
        # What was freed but not given back would be used again unseen.
        ctypes.CDLL(None).malloc_trim(0)
    except (OSError, AttributeError):
        return math.nan
    return _status("VmRSS")


def _status(what: str) -> float:
    try:
        lines = (_OWN / "status").read_text().splitlines()
    except OSError:
        return math.nan
    kilobytes = next((line.split()[1] for line in lines if line.startswith(what)), "nan")
    return float(kilobytes) / _KILOBYTES_A_MEGABYTE
