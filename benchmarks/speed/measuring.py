"""Time and memory of function calls, and comparisons of them with other libraries."""

from __future__ import annotations

import ctypes
import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from unittest.mock import patch

from numba.core.event import install_recorder
from threadpoolctl import threadpool_limits

from anisomap.numerics.compiled import parallel

Result = TypeVar("Result")

MAX_REPEATED_SECONDS = 1.0
"""Longer runs are not repeated: disturbances are a small share of them."""

MIN_SECONDS = 0.3
MIN_RUNS, MAX_RUNS = 2, 10
"""Total duration and number of repeated runs."""

_PROCESS = Path("/proc/self")
_KIBIBYTES_PER_MEGABYTE = 1000 / 1.024


@dataclass(frozen=True)
class Cost:
    """Cost of a run.

    cpu, clock: Seconds: CPU time of all threads, and wall-clock time.
    memory: Peak memory in megabytes above that before the run, including the result; NaN where the
        system does not report it.
    """

    cpu: float
    clock: float
    memory: float = math.nan


def n_cores() -> int:
    """Return the number of cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Limit linear algebra and compiled loops to a number of threads."""
    with threadpool_limits(count), patch.object(parallel, "thread_count", lambda: count):
        yield


def measure(run: Callable[[], Result]) -> tuple[Cost, Result]:
    """Run once; return the cost and the result."""
    before = _begin_peak()
    clock, cpu = time.perf_counter(), time.process_time()
    result = run()
    cpu, clock = time.process_time() - cpu, time.perf_counter() - clock
    return Cost(cpu, clock, _status("VmHWM") - before), result


def measure_repeated(run: Callable[[], object]) -> Cost:
    """Return the minimum over several runs: disturbances only add time."""
    costs = [measure(run)[0]]
    while costs[0].clock <= MAX_REPEATED_SECONDS and len(costs) < MAX_RUNS:
        if len(costs) >= MIN_RUNS and sum(cost.clock for cost in costs) >= MIN_SECONDS:
            break
        costs.append(measure(run)[0])
    return Cost(
        min(cost.cpu for cost in costs),
        min(cost.clock for cost in costs),
        max(cost.memory for cost in costs),
    )


def measure_on_one_thread(run: Callable[[], Result]) -> tuple[Cost, Result]:
    """Return the cost on one thread and the result.

    A first run that takes long is all; it is a warm-up if it is short or compiles loops.
    """
    with threads(1):
        with install_recorder("numba:compile") as compiled:
            first, result = measure(run)
        is_enough = first.clock > MAX_REPEATED_SECONDS and not compiled.buffer
        return first if is_enough else measure_repeated(run), result


def _begin_peak() -> float:
    """Reset the peak and return the current memory in megabytes; NaN where not possible."""
    try:
        # Memory that was freed but not returned to the system would be reused unnoticed, and would
        # count as part of the peak if it were returned after the reset.
        ctypes.CDLL(None).malloc_trim(0)
        (_PROCESS / "clear_refs").write_text("5")
    except (OSError, AttributeError):
        return math.nan
    return _status("VmRSS")


def _status(what: str) -> float:
    try:
        lines = (_PROCESS / "status").read_text().splitlines()
    except OSError:
        return math.nan
    kilobytes = next((line.split()[1] for line in lines if line.startswith(what)), "nan")
    return float(kilobytes) / _KIBIBYTES_PER_MEGABYTE


MIN_GOAL_SENSORS = 4000
"""Goals of speed apply from this number of sensors on."""


@dataclass(frozen=True, eq=False)
class Reference:
    """A reference implementation, which does the whole work of a stage or a share of it.

    same: ``same(result, expected)`` returns whether anisomap's result is correct.
    goal: Required ratio of CPU times, from `MIN_GOAL_SENSORS` sensors on.
    share: What is timed, if it is a share of the work.
    factor: Cost of the whole in units of the share.
    """

    name: str
    compute: Callable[[], Any]
    same: Callable[[Any, Any], bool]
    goal: float | None = None
    share: str = ""
    factor: float = 1.0

    @property
    def details(self) -> str:
        """The share that is timed and its factor; empty for the whole."""
        times = f"{self.factor:,.0f}" if self.factor >= 100 else f"{self.factor:.3g}"
        return "" if self.factor == 1 else f"{self.share} x {times}"


@dataclass(frozen=True, eq=False)
class Comparison:
    """A stage on one input, with its references.

    compute: Runs anisomap.
    """

    stage: str
    dataset: str
    compute: Callable[[], Any]
    references: tuple[Reference, ...]


@dataclass(frozen=True)
class Row:
    """Result of a comparison with one reference: a row of the table. Seconds and megabytes.

    drawn: Whether it is in the figure, which shows the first of several references.
    """

    n_sensors: int
    family: str
    stage: str
    dataset: str
    cpu: float
    clock: float
    cpu_all_cores: float
    clock_all_cores: float
    memory: float
    reference: str
    details: str
    reference_cpu: float
    reference_memory: float
    goal: float | None
    same: bool
    drawn: bool = True

    @property
    def estimated(self) -> bool:
        """Whether the time of the reference is extrapolated from a share of the work."""
        return bool(self.details)

    @property
    def ratio(self) -> float:
        """CPU time of the reference divided by that of anisomap."""
        return self.reference_cpu / self.cpu

    @property
    def missed(self) -> bool:
        """Whether the ratio is below the goal."""
        return self.goal is not None and self.ratio < self.goal


def run(comparison: Comparison, family: str, n_sensors: int) -> Iterator[Row]:
    """Time the stage, check its result, and yield one row per reference."""
    alone, result = measure_on_one_thread(comparison.compute)
    with threads(n_cores()):
        together = measure_repeated(comparison.compute)
    for number, reference in enumerate(comparison.references):
        cost, expected = measure_on_one_thread(reference.compute)
        with threads(1):
            same = reference.same(result, expected)
        yield Row(
            n_sensors,
            family,
            comparison.stage,
            comparison.dataset,
            alone.cpu,
            alone.clock,
            together.cpu,
            together.clock,
            max(alone.memory, together.memory),
            reference.name,
            reference.details,
            cost.cpu * reference.factor,
            cost.memory if reference.factor == 1 else math.nan,
            reference.goal if n_sensors >= MIN_GOAL_SENSORS else None,
            same,
            drawn=number == 0,
        )
