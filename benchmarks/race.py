"""One shape for all that is compared: a stage on an input, ours, and its rivals."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks.measuring import (
    MAX_REPEATED_SECONDS,
    Cost,
    cores,
    least,
    measured,
    on_one_thread,
    threads,
)

GOALS_FROM = 4000
"""Goals were set for so many sensors."""


@dataclass(frozen=True)
class Setting:
    """What a bench is run on.

    Parameters
    ----------
    n_sensors, n_frames : int
    torso : Path, optional
        The recording of a real skin that is tiled.
    patience : int
        Sensors up to which the default method is run, which takes many times as long as all else.
    """

    n_sensors: int
    n_frames: int
    torso: Path | None = None
    patience: int = 1000


@dataclass(frozen=True, eq=False)
class Rival:
    """What a user would pick instead.

    Parameters
    ----------
    name : str
    cost : Cost
        On one thread.
    same : callable
        ``same(result)`` tells whether ours is what it should be; or, where the rival makes
        something else, how the two compare.
    goal : float, optional
        How many times its CPU time ours should fit into, from `GOALS_FROM` sensors on.
    how : str
        How it was run, and how its time was come by if it was not simply measured.
    estimated : bool
        Whether its time is that of a part of the work, multiplied.
    """

    name: str
    cost: Cost
    same: Callable[[Any], bool | str]
    goal: float | None = None
    how: str = ""
    estimated: bool = False


@dataclass(frozen=True, eq=False)
class Race:
    """A stage on one input.

    Parameters
    ----------
    stage, given : str
        What is computed, and of what.
    ours : callable
        Computes it.
    rivals : tuple of Rival
        None if there is nothing that does the same.
    drawn : bool
        Whether it has lines in the picture, which shows one of several that run alike.
    """

    stage: str
    given: str
    ours: Callable[[], Any]
    rivals: tuple[Rival, ...] = ()
    drawn: bool = True


@dataclass(frozen=True)
class Row:
    """How a race came out against one rival: a line of the table. Seconds, megabytes."""

    n_sensors: int
    family: str
    stage: str
    given: str
    cpu: float
    clock: float
    cpu_of_all_cores: float
    clock_of_all_cores: float
    memory: float
    against: str = ""
    how: str = ""
    its_cpu: float = math.nan
    its_memory: float = math.nan
    estimated: bool = False
    goal: float | None = None
    same: bool | str = ""
    drawn: bool = True

    @property
    def ratio(self) -> float:
        """How many times ours fits into the rival's CPU time."""
        return self.its_cpu / self.cpu

    @property
    def missed(self) -> bool:
        """Whether a goal was set, and not reached."""
        return self.goal is not None and self.ratio < self.goal


def run(race: Race, family: str, n_sensors: int) -> Iterator[Row]:
    """Check a result, then time it, and give a row a rival."""
    with threads(1):
        first, result = measured(race.ours)
        verdicts = [rival.same(result) for rival in race.rivals]
        del result
        alone = first if first.clock > MAX_REPEATED_SECONDS else least(race.ours)
    with threads(cores()):
        together = least(race.ours)
    ours = Row(
        n_sensors,
        family,
        race.stage,
        race.given,
        alone.cpu,
        alone.clock,
        together.cpu,
        together.clock,
        max(alone.memory, together.memory),
        drawn=race.drawn,
    )
    if not race.rivals:
        yield ours
    for number, (rival, same) in enumerate(zip(race.rivals, verdicts, strict=True)):
        yield replace(
            ours,
            against=rival.name,
            how=rival.how,
            its_cpu=rival.cost.cpu,
            its_memory=rival.cost.memory,
            estimated=rival.estimated,
            goal=rival.goal if n_sensors >= GOALS_FROM else None,
            same=same,
            drawn=race.drawn and number == 0,
        )


def of_part(part: str, factor: float) -> str:
    """Say of what part of the work a time is, and how many times it was taken."""
    times = f"{factor:,.0f}" if factor >= 100 else f"{factor:.3g}"
    return "" if factor == 1 else f"{part} x {times}"


def timed_rival(
    name: str,
    compute: Callable[[], Any],
    same: Callable[[Any, Any], bool],
    *,
    part: str = "",
    factor: float = 1.0,
    goal: float | None = None,
) -> Rival:
    """Run a rival on the whole or a part of the work, and keep its result for comparison.

    Parameters
    ----------
    name : str
    compute : callable
    same : callable
        ``same(ours, theirs)``.
    part : str
        What the part is.
    factor : float
        How many times the whole takes as long as the part; 1 if it is the whole.
    goal : float, optional
    """
    cost, theirs = on_one_thread(compute)
    return Rival(
        name,
        cost.times(factor),
        lambda ours: same(ours, theirs),
        goal,
        of_part(part, factor),
        estimated=factor != 1,
    )
