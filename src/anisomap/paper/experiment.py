"""Experiments: settings, inputs and results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from anisomap.errors import InputError
from anisomap.numerics.ranges import NOT_NEGATIVE

Cell: TypeAlias = str | int | float
Row: TypeAlias = tuple[Cell, ...]

INFERRED: Mapping[str, float] = MappingProxyType(
    {
        "cylinder.length": 2,
        "bombardment.ball_radius": 0.2,
        "bombardment.detection_radius": 0.35,
        "bombardment.frame_interval": 0.2,
        "locomotion.correlation": 0.25,
        "locomotion.detection_radius": 0.25,
        "locomotion.roughness": 0.04,
        "rubbing.hand_size": 0.017,
        "rubbing.detection_radius": 0.004,
        "patch.mean_span": 100,
    }
)
"""Settings that agree with the paper's sentences and maximise the number of cases that hold on
seeds 1 and 2, see `anisomap.paper.sensitivity`; all other settings are defaults."""


@dataclass(frozen=True)
class Settings:
    """Size and randomness of all experiments.

    seed: First seed of each scenario; at least 0.
    quick: Use fewer frames, seeds and permutations, for previews.
    recordings: Folder of real recordings; experiments that need an absent recording are skipped.
    inferred, changes: Values of settings in `anisomap.paper.cases.OPEN`, by name; changes take
        precedence.
    """

    seed: int = 1
    quick: bool = False
    recordings: Path | None = None
    inferred: tuple[tuple[str, float], ...] = tuple(INFERRED.items())
    changes: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        NOT_NEGATIVE.check("seed", self.seed)

    @property
    def chosen(self) -> dict[str, float]:
        """Values of open settings that differ from the defaults of the simulator."""
        return dict(self.inferred) | dict(self.changes)

    def value(self, name: str, default: float) -> float:
        """Return the value of a setting that the paper leaves open."""
        return self.chosen.get(name, default)

    @property
    def n_frames(self) -> int:
        """Frames per simulated run: 2,000, as in the paper."""
        return int(self.value("frames", 1000 if self.quick else 2000))

    @property
    def mu(self) -> float:
        """The paper's mu, for which it gives no value."""
        return self.value("mu", 1.0)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of each scenario: ten (the paper has one run each)."""
        return tuple(range(self.seed, self.seed + (2 if self.quick else 10)))

    @property
    def few_seeds(self) -> tuple[int, ...]:
        """Seeds for each combination of settings."""
        return self.seeds[: 1 if self.quick else 2]

    @property
    def permutations(self) -> int:
        """Random relabellings in a null distribution: 10,000, as in the paper."""
        return 200 if self.quick else 10_000

    def picked_seed(self, purpose: str) -> int:
        """Pick one of `seeds` at random, reproducibly."""
        rng = np.random.default_rng([self.seed, *purpose.encode()])
        return int(rng.choice(self.seeds))


@dataclass(frozen=True)
class Table:
    """A table with a description of each column.

    name: File name without suffix.
    columns: Column names, in order, and their meanings with units.
    rows: One value per column.
    shown: Whether the page shows the rows, or only links to the file.
    """

    name: str
    caption: str
    columns: Mapping[str, str]
    rows: Sequence[Row]
    shown: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "rows", tuple(self.rows))
        for row in self.rows:
            if len(row) != len(self.columns):
                raise InputError(f"{self.name}: a row has {len(row)} of {len(self.columns)} values")

    def records(self) -> list[dict[str, Any]]:
        """Return the rows as dictionaries."""
        return [dict(zip(self.columns, row, strict=True)) for row in self.rows]


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure; its name is a file name without suffix."""

    name: str
    caption: str
    figure: Any


@dataclass(frozen=True)
class Document:
    """A plain-text file; its name has a suffix."""

    name: str
    caption: str
    text: str


Result: TypeAlias = Picture | Table | Document

Tables: TypeAlias = Mapping[str, Table]
"""Tables of other experiments, by name."""


def joined(tables: Tables, names: Iterable[str], name: str = "", caption: str = "") -> Table:
    """Join the existing tables, with equal columns, to a table that the page only links to."""
    parts = [tables[one] for one in names if one in tables]
    rows = [row for part in parts for row in part.rows]
    return Table(name, caption, parts[0].columns if parts else {}, rows, shown=False)


Compute: TypeAlias = Callable[[Settings, Tables], Iterable[Result]]


@dataclass(frozen=True)
class Experiment:
    """A figure, table or text of the paper, and its computation.

    name: Unique; also the name of its folder.
    compute: ``compute(settings, tables)`` yields the results; `tables` contains the tables of the
        experiments in `needs`, except skipped ones.
    title: Heading on the page; empty for experiments that only provide data to others.
    description: Paragraphs shown on the page, separated by blank lines.
    needs: Names of experiments that must run first; these do not need any.
    files: Real recordings in `Settings.recordings` that are read. If one is absent, the experiment
        is skipped.
    absent: Text shown on the page if the experiment is skipped.
    cost: Approximate duration in seconds; the longest experiments start first.
    """

    name: str
    compute: Compute
    title: str = ""
    description: str = ""
    needs: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    absent: str = ""
    cost: float = field(default=1.0, compare=False)

    def paths(self, settings: Settings) -> list[Path]:
        """Return the paths of the real recordings to read; [] without a folder of recordings."""
        return [] if settings.recordings is None else [settings.recordings / f for f in self.files]

    def can_run(self, settings: Settings) -> bool:
        """Whether all recordings that are read exist."""
        paths = self.paths(settings)
        return len(paths) == len(self.files) and all(path.is_file() for path in paths)


REGISTRY: dict[str, Experiment] = {}
"""Experiments by name, in the order of their definition."""


def experiment(
    name: str, title: str = "", description: str = "", **options: Any
) -> Callable[[Compute], Compute]:
    """Register a function as an experiment; the arguments are the fields of `Experiment`."""

    def register(compute: Compute) -> Compute:
        REGISTRY[name] = Experiment(name, compute, title, description, **options)
        return compute

    return register


def mean_by(rows: Iterable[Mapping[str, Any]], key: str, value: str) -> dict[Any, float]:
    """Average the values of rows that agree in `key`, in order of appearance."""
    return {
        group: float(np.mean([row[value] for row in found]))
        for group, found in by(rows, key).items()
    }


def by(rows: Iterable[Mapping[str, Any]], key: str) -> dict[Any, list[Mapping[str, Any]]]:
    """Group rows that agree in `key`, in order of appearance."""
    groups: dict[Any, list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(row[key], []).append(row)
    return groups
