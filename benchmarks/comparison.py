"""A comparison: a stage of anisomap on an input, and reference implementations of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from benchmarks.measuring import measure_on_one_thread, measure_repeated, n_cores, threads

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
