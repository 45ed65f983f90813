"""What an experiment is, what it is given, and what it leaves behind."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from anisomap.errors import InputError

Cell: TypeAlias = str | int | float
Row: TypeAlias = tuple[Cell, ...]


@dataclass(frozen=True)
class Settings:
    """How large everything is, and where randomness starts.

    Parameters
    ----------
    seed : int
        First seed of every row of runs; at least 0.
    quick : bool
        Take hardly enough of everything: for tests, and to see what there will be.
    recordings : Path, optional
        Folder of real recordings; what needs one that is not there is left out.

    Raises
    ------
    InputError
        If the seed is negative.
    """

    seed: int = 1
    quick: bool = False
    recordings: Path | None = None

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise InputError(f"seed is {self.seed}; it must be a whole number of at least 0")

    @property
    def n_frames(self) -> int:
        """Frames of a simulated run: the paper's 2,000."""
        return 250 if self.quick else 2000

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of the runs of a scenario: ten, where the paper had one."""
        return tuple(range(self.seed, self.seed + (2 if self.quick else 10)))

    @property
    def few_seeds(self) -> tuple[int, ...]:
        """Seeds of the runs at each point of a curve."""
        return self.seeds[: 1 if self.quick else 3]

    @property
    def permutations(self) -> int:
        """Random labellings of a null: the paper's 10,000."""
        return 200 if self.quick else 10_000

    def picked_seed(self, purpose: str) -> int:
        """Choose one of `seeds` at random, the same one whenever it is asked for.

        Parameters
        ----------
        purpose : str
            What for; different purposes have different draws.
        """
        rng = np.random.default_rng([self.seed, *purpose.encode()])
        return int(rng.choice(self.seeds))


@dataclass(frozen=True)
class Table:
    """Numbers, with words for every column.

    Parameters
    ----------
    name : str
        Of its file, without suffix.
    caption : str
        What it tells.
    columns : mapping of str to str
        Names of the columns, in order, and what each means, with its unit.
    rows : tuple of tuple
        One value a column.
    shown : bool
        Whether the page shows all rows, or links to the file only.

    Raises
    ------
    InputError
        If a row has not one value a column.
    """

    name: str
    caption: str
    columns: Mapping[str, str]
    rows: tuple[Row, ...]
    shown: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", MappingProxyType(dict(self.columns)))
        object.__setattr__(self, "rows", tuple(tuple(row) for row in self.rows))
        for row in self.rows:
            if len(row) != len(self.columns):
                raise InputError(
                    f"a row of the table {self.name} has {len(row)} values for "
                    f"{len(self.columns)} columns"
                )

    def __reduce__(self) -> tuple[Callable[..., Table], tuple[Any, ...]]:
        # A read-only view of a mapping cannot be sent to another process itself.
        return Table, (self.name, self.caption, dict(self.columns), self.rows, self.shown)

    def records(self) -> list[dict[str, Any]]:
        """Give the rows as dictionaries."""
        return [dict(zip(self.columns, row, strict=True)) for row in self.rows]


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure.

    Parameters
    ----------
    name : str
        Of its files, without suffix.
    caption : str
        What it shows, and from which runs.
    figure : matplotlib.figure.Figure
    """

    name: str
    caption: str
    figure: Any


@dataclass(frozen=True)
class Document:
    """A file of plain text.

    Parameters
    ----------
    name : str
        Of its file, with suffix.
    caption : str
        What is in it.
    text : str
    """

    name: str
    caption: str
    text: str


@dataclass(frozen=True, eq=False)
class Outcome:
    """What an experiment leaves behind."""

    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    documents: tuple[Document, ...] = ()


Tables: TypeAlias = Mapping[str, Table]
"""Tables of other experiments, by their names."""


@dataclass(frozen=True)
class Experiment:
    """Something of the paper that can be made again.

    Parameters
    ----------
    name : str
        Of its folder; unique.
    title : str
        Its heading on the page; empty for one that only measures for others.
    shows : str
        What there is to be seen, and what the paper says of it.
    make : callable
        Takes `Settings` and the tables of those that it needs; gives an `Outcome`.
    needs : tuple of str
        Names of experiments whose tables it takes.
    files : tuple of str
        Names of real recordings that it reads from `Settings.recordings`; without one of them it
        is left out.
    absent : str
        What to tell a reader then.
    cost : float
        Roughly how many seconds it takes: long ones start first.
    """

    name: str
    title: str
    shows: str
    make: Callable[[Settings, Tables], Outcome]
    needs: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    absent: str = ""
    cost: float = field(default=1.0, compare=False)

    def can_run(self, settings: Settings) -> bool:
        """Tell whether all recordings are there that it reads."""
        return all(path.is_file() for path in self.paths(settings)) and (
            not self.files or settings.recordings is not None
        )

    def paths(self, settings: Settings) -> list[Path]:
        """Give the paths of the recordings that it reads."""
        return [] if settings.recordings is None else [settings.recordings / f for f in self.files]
