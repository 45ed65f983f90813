"""A comparison: a stage of anisomap on an input, and reference implementations of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks.measuring import (
    Cost,
    measure_on_one_thread,
    measure_repeated,
    n_cores,
    threads,
)

MIN_GOAL_SENSORS = 4000
"""Goals of speed apply from this number of sensors on."""


@dataclass(frozen=True)
class Setting:
    """Size and inputs of a run of the benchmarks.

    torso: Real recording, tiled to the number of sensors.
    max_slow_sensors: Number of sensors up to which the slowest comparisons are made: scikit-learn's
        MDS and the scaling with missing pairs.
    more: Whether to make comparisons that are similar to others, too.
    """

    n_sensors: int
    n_frames: int
    torso: Path | None = None
    max_slow_sensors: int = 1000
    more: bool = False


@dataclass(frozen=True, eq=False)
class Reference:
    """A reference implementation and its cost.

    cost: On one thread.
    same: ``same(result)`` returns whether anisomap's result is correct, or a description if the two
        are not expected to agree.
    goal: Required ratio of CPU times, from `MIN_GOAL_SENSORS` sensors on.
    details: Parameters, and how the time was estimated.
    estimated: Whether the time is extrapolated from a share of the work.
    """

    name: str
    cost: Cost
    same: Callable[[Any], bool | str]
    goal: float | None = None
    details: str = ""
    estimated: bool = False


@dataclass(frozen=True, eq=False)
class Comparison:
    """A stage on one input, with its references.

    compute: Runs anisomap.
    drawn: Whether it is drawn in the figure, which shows one of several similar comparisons.
    """

    stage: str
    dataset: str
    compute: Callable[[], Any]
    references: tuple[Reference, ...] = ()
    drawn: bool = True


@dataclass(frozen=True)
class Row:
    """Result of a comparison with one reference: a row of the table. Seconds and megabytes."""

    n_sensors: int
    family: str
    stage: str
    dataset: str
    cpu: float
    clock: float
    cpu_all_cores: float
    clock_all_cores: float
    memory: float
    reference: str = ""
    details: str = ""
    reference_cpu: float = math.nan
    reference_memory: float = math.nan
    estimated: bool = False
    goal: float | None = None
    same: bool | str = ""
    drawn: bool = True

    @property
    def ratio(self) -> float:
        """CPU time of the reference divided by that of anisomap."""
        return self.reference_cpu / self.cpu

    @property
    def missed(self) -> bool:
        """Whether the ratio is below the goal."""
        return self.goal is not None and self.ratio < self.goal


def run(comparison: Comparison, family: str, n_sensors: int) -> Iterator[Row]:
    """Check the result, time the stage, and yield one row per reference."""
    alone, result = measure_on_one_thread(comparison.compute)
    with threads(1):
        verdicts = [reference.same(result) for reference in comparison.references]
    del result
    with threads(n_cores()):
        together = measure_repeated(comparison.compute)
    row = Row(
        n_sensors,
        family,
        comparison.stage,
        comparison.dataset,
        alone.cpu,
        alone.clock,
        together.cpu,
        together.clock,
        max(alone.memory, together.memory),
        drawn=comparison.drawn,
    )
    if not comparison.references:
        yield row
    for number, (reference, same) in enumerate(zip(comparison.references, verdicts, strict=True)):
        yield replace(
            row,
            reference=reference.name,
            details=reference.details,
            reference_cpu=reference.cost.cpu,
            reference_memory=reference.cost.memory,
            estimated=reference.estimated,
            goal=reference.goal if n_sensors >= MIN_GOAL_SENSORS else None,
            same=same,
            drawn=comparison.drawn and number == 0,
        )


def describe_share(share: str, factor: float) -> str:
    """Describe the share of the work that was timed and its factor; empty for the whole."""
    times = f"{factor:,.0f}" if factor >= 100 else f"{factor:.3g}"
    return "" if factor == 1 else f"{share} x {times}"


def timed_reference(
    name: str,
    compute: Callable[[], Any],
    same: Callable[[Any, Any], bool],
    *,
    share: str = "",
    factor: float = 1.0,
    goal: float | None = None,
) -> Reference:
    """Time a reference on the whole work or a share of it, and keep its result for comparison.

    same: ``same(result, expected)``.
    share: Description of the share.
    factor: Cost of the whole in units of the share; 1 if the whole is timed.
    """
    cost, expected = measure_on_one_thread(compute)
    return Reference(
        name,
        cost.times(factor),
        lambda result: same(result, expected),
        goal,
        describe_share(share, factor),
        estimated=factor != 1,
    )
