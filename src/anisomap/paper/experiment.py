"""Experiments: their settings, their inputs and their results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError

Cell: TypeAlias = str | int | float
Row: TypeAlias = tuple[Cell, ...]


@dataclass(frozen=True)
class Settings:
    """Size and randomness of all experiments.

    seed: First seed of each scenario; at least 0.
    quick: Use far fewer frames, seeds and permutations, for tests and previews.
    recordings: Folder of real recordings; experiments that need an absent recording are skipped.
    """

    seed: int = 1
    quick: bool = False
    recordings: Path | None = None

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise InputError(f"seed must be at least 0, got {self.seed}")

    @property
    def n_frames(self) -> int:
        """Frames per simulated run: 2,000, as in the paper."""
        return 250 if self.quick else 2000

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of each scenario: ten (the paper has one run each)."""
        return tuple(range(self.seed, self.seed + (2 if self.quick else 10)))

    @property
    def few_seeds(self) -> tuple[int, ...]:
        """Seeds at each value of a parameter in the sensitivity experiments."""
        return self.seeds[: 1 if self.quick else 3]

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
    rows: tuple[Row, ...]
    shown: bool = True

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise InputError(
                    f"table {self.name}: a row has {len(row)} values for "
                    f"{len(self.columns)} columns"
                )

    def records(self) -> list[dict[str, Any]]:
        """Return the rows as dictionaries."""
        return [dict(zip(self.columns, row, strict=True)) for row in self.rows]


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure.

    name: File name without suffix.
    """

    name: str
    caption: str
    figure: Any


@dataclass(frozen=True)
class Document:
    """A plain-text file.

    name: File name with suffix.
    """

    name: str
    caption: str
    text: str


@dataclass(frozen=True, eq=False)
class Outcome:
    """Result of an experiment."""

    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    documents: tuple[Document, ...] = ()


Tables: TypeAlias = Mapping[str, Table]
"""Tables of other experiments, by name."""


@dataclass(frozen=True)
class Experiment:
    """A figure, table or text of the paper, and how it is computed.

    name: Unique; also the name of its folder.
    title: Heading on the page; empty for experiments that only provide data to others.
    description: Paragraphs shown on the page, separated by blank lines.
    compute: ``compute(settings, tables)`` returns an `Outcome`; `tables` holds the tables of the
        experiments in `needs`.
    needs: Names of experiments that must run first.
    files: Real recordings that are read from `Settings.recordings`. If one is absent, the
        experiment is skipped.
    absent: Text shown on the page if the experiment is skipped.
    cost: Approximate duration in seconds; the longest experiments start first.
    """

    name: str
    title: str
    description: str
    compute: Callable[[Settings, Tables], Outcome]
    needs: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    absent: str = ""
    cost: float = field(default=1.0, compare=False)

    def paths(self, settings: Settings) -> list[Path]:
        """Return the paths of the real recordings that are read; [] without a folder of them."""
        return [] if settings.recordings is None else [settings.recordings / f for f in self.files]

    def can_run(self, settings: Settings) -> bool:
        """Whether all recordings that are read exist."""
        paths = self.paths(settings)
        return len(paths) == len(self.files) and all(path.is_file() for path in paths)


REGISTRY: dict[str, Experiment] = {}
"""Experiments by name, in the order of their definition."""

Compute = TypeVar("Compute", bound=Callable[[Settings, Tables], Outcome])


def experiment(
    name: str,
    title: str,
    description: str,
    *,
    needs: tuple[str, ...] = (),
    files: tuple[str, ...] = (),
    absent: str = "",
    cost: float = 1.0,
) -> Callable[[Compute], Compute]:
    """Register a function as an experiment; the arguments are the fields of `Experiment`."""

    def register(compute: Compute) -> Compute:
        REGISTRY[name] = Experiment(name, title, description, compute, needs, files, absent, cost)
        return compute

    return register


def mean_by(rows: Iterable[Mapping[str, Any]], key: str, value: str) -> dict[Any, float]:
    """Average the values of rows that agree in `key`, in order of appearance."""
    groups: dict[Any, list[float]] = {}
    for row in rows:
        groups.setdefault(row[key], []).append(row[value])
    return {group: float(np.mean(values)) for group, values in groups.items()}


def curves_by_method(
    rows: Sequence[Mapping[str, Any]], methods: Iterable[str], parameter: str
) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """Arrange Mantel r over a parameter, one column per run. Returns (L,), and (L, S) by method."""
    values = sorted({row[parameter] for row in rows})
    curves = {
        method: np.array(
            [
                [r["mantel_r"] for r in rows if r["method"] == method and r[parameter] == value]
                for value in values
            ],
            dtype=np.float64,
        )
        for method in methods
    }
    return np.array(values, dtype=np.float64), curves
