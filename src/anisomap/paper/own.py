"""Experiments of one's own, described by a TOML file."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.errors import FileError, InputError
from anisomap.evaluation import Score, score
from anisomap.files.paths import read_small
from anisomap.method.named import find_method
from anisomap.method.pipeline import reconstruct
from anisomap.paper.cases import true_positions
from anisomap.paper.experiment import Row, Table
from anisomap.simulation import find_body, find_scenario, simulate

SCORES: Mapping[str, tuple[str, Callable[[Score], float]]] = MappingProxyType(
    {
        "mantel_r": ("Mantel r", lambda found: found.mantel.r),
        "error": ("RMS error in spacings", lambda found: found.rms_in_spacings),
        "neighbours_kept": ("share of neighbours kept", lambda found: found.neighbours_kept),
    }
)
"""Scores of a map, and what they mean."""

_MAX_CHARACTERS = 100_000  # of a file


@dataclass(frozen=True)
class OwnExperiment:
    """Maps of one body under one scenario.

    Parameters
    ----------
    body, scenario : str
        Keys of `anisomap.simulation.BODIES` and `SCENARIOS`.
    methods : tuple of str
        Keys of `anisomap.METHODS`.
    seeds : tuple of int
        One recording each.
    scores : tuple of str
        Keys of `SCORES`.
    n_frames : int
        Frames of a recording.
    dimensions : int
        Of the maps, 2 or 3. Maps in 2D are compared with the first two true coordinates.
    settings : mapping
        Parameters of the scenario that differ from its defaults.
    """

    body: str
    scenario: str
    methods: tuple[str, ...] = (DEFAULT_METHOD,)
    seeds: tuple[int, ...] = (1,)
    scores: tuple[str, ...] = tuple(SCORES)
    n_frames: int = 2000
    dimensions: int = 3
    settings: Mapping[str, Any] = field(default_factory=dict)

    def run(self, name: str, progress: Callable[[float], None]) -> Table:
        """Simulate, map and score; return a table with a row for each seed and method."""
        rows, total = list[Row](), len(self.seeds) * len(self.methods)
        for seed in self.seeds:
            recording = simulate(
                self.body, self.scenario, n_frames=self.n_frames, seed=seed, **self.settings
            )
            truth = true_positions(recording, self.dimensions)
            for method in self.methods:
                made = reconstruct(recording, method, self.dimensions)
                found = score(made, truth, permutations=0)
                rows.append((seed, method, *(SCORES[one][1](found) for one in self.scores)))
                progress(len(rows) / total)
        columns = {"seed": "seed of the recording", "method": "method of the map"}
        columns |= {one: SCORES[one][0] for one in self.scores}
        return Table(name, f"{self.body}, {self.scenario}", columns, rows)

    def medians(self, table: Table) -> dict[str, NDArray[np.float64]]:
        """Return the medians of the scores of each method over the seeds."""
        scores = {method: [r[2:] for r in table.rows if r[1] == method] for method in self.methods}
        return {method: np.median(np.array(s, float), axis=0) for method, s in scores.items()}


_LISTS = {"methods": str, "seeds": int, "scores": str}
_KINDS: Mapping[str, type] = {
    "body": str, "scenario": str, "n_frames": int, "dimensions": int, "settings": dict,
}  # fmt: skip


def read_experiment(path: Path) -> OwnExperiment:
    """Read and check an experiment.

    Raises
    ------
    InputError
        If the file cannot be read, or a key, a name or a type is wrong; it says what is possible.
    """
    text = read_small(path, _MAX_CHARACTERS, "an experiment")
    try:
        given = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FileError(f"{path} cannot be read as TOML: {error}") from error
    known = (*_KINDS, *_LISTS)
    for key, value in given.items():
        _check(path, key in known, f"unknown key {key!r}; choose from {', '.join(known)}")
        if key in _LISTS:
            right = isinstance(value, list) and value and {*map(type, value)} == {_LISTS[key]}
            _check(path, right, f"{key} must be a list of {_LISTS[key].__name__}, got {value!r}")
        else:
            right = type(value) is _KINDS[key]
            _check(path, right, f"{key} must be of type {_KINDS[key].__name__}, got {value!r}")
    for key in ("body", "scenario"):
        _check(path, key in given, f"{key} is missing")
    lists = {key: tuple(given[key]) for key in _LISTS if key in given}
    found = OwnExperiment(**(given | lists))
    _check(path, found.dimensions in (2, 3), f"dimensions must be 2 or 3, got {found.dimensions}")
    try:
        scenario, _ = find_scenario(found.scenario), find_body(found.body)
        for method in found.methods:
            find_method(method)
    except InputError as error:
        raise FileError(f"{path}: {error}") from error
    for name in found.scores:
        _check(path, name in SCORES, f"unknown score {name!r}; choose from {', '.join(SCORES)}")
    possible = [entry.name for entry in fields(scenario.options)]
    for name in found.settings:
        what = f"{found.scenario} has no parameter {name!r}; choose from {', '.join(possible)}"
        _check(path, name in possible, what)
    return found


def _check(path: Path, right: object, problem: str) -> None:
    if not right:
        raise FileError(f"{path}: {problem}")
