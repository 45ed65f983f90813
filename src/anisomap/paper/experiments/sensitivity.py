"""What the paper's lost parameters decide: Mantel r over frames, radius, balls, mu and bins."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from anisomap.drawing.figures.charts import CurvePanel, curves_figure
from anisomap.errors import InputError
from anisomap.methods import MethodOptions
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.paper.experiment import Experiment, Outcome, Picture, Row, Settings, Table, Tables
from anisomap.paper.runs import BOMBARDED, CASES, METHODS, Case, make_map
from anisomap.recording import Recording
from anisomap.simulation import find_body, find_scenario
from anisomap.simulation.options import options_for

_COLUMNS = {
    "run": "body and scenario",
    "value": "value of the parameter",
    "seed": "seed of the run",
    "method": "method",
    "mantel_r": "Mantel r of the 3D map with the true positions; nan if there is no map",
}

Trial = tuple[float, Recording, MethodOptions]


@dataclass(frozen=True)
class Sweep:
    """A parameter, and the values that it takes.

    Attributes
    ----------
    name : str
    label : str
        For the x axis.
    shows : str
        What the paper says of it, and what to look for.
    values, quick_values : tuple of float
        Rising.
    trials : callable
        Takes case, settings, seed and values; yields value, recording and options of methods.
    default : callable
        Gives the value that a case has elsewhere.
    cases : tuple of Case
    methods : tuple of str
        Those that the parameter can change.
    """

    name: str
    label: str
    shows: str
    values: tuple[float, ...]
    quick_values: tuple[float, ...]
    trials: Callable[[Case, Settings, int, tuple[float, ...]], Iterator[Trial]]
    default: float
    cases: tuple[Case, ...] = CASES
    methods: tuple[str, ...] = METHODS

    def chosen(self, settings: Settings) -> tuple[float, ...]:
        """Give the values to try."""
        return self.quick_values if settings.quick else self.values


def _frames(
    case: Case, settings: Settings, seed: int, values: tuple[float, ...]
) -> Iterator[Trial]:
    """Beginnings of one long run."""
    longest = case.record(settings, seed, n_frames=int(max(values)))
    for value in values:
        yield value, replace(longest, readings=longest.readings[: int(value)]), MethodOptions()


def _radius(
    case: Case, settings: Settings, seed: int, values: tuple[float, ...]
) -> Iterator[Trial]:
    usual = _usual(case)["detection_radius"]
    for value in values:
        yield value, case.record(settings, seed, detection_radius=value * usual), MethodOptions()


def _balls(case: Case, settings: Settings, seed: int, values: tuple[float, ...]) -> Iterator[Trial]:
    for value in values:
        yield value, case.record(settings, seed, n_balls=int(value)), MethodOptions()


def _mu(case: Case, settings: Settings, seed: int, values: tuple[float, ...]) -> Iterator[Trial]:
    recording = case.record(settings, seed)
    for value in values:
        yield value, recording, MethodOptions(mu=value)


def _bins(case: Case, settings: Settings, seed: int, values: tuple[float, ...]) -> Iterator[Trial]:
    recording = case.record(settings, seed)
    for value in values:
        yield value, recording, MethodOptions(bins=int(value))


def _usual(case: Case) -> Mapping[str, Any]:
    return dict(vars(options_for(find_scenario(case.scenario).options, find_body(case.body))))


def measure(sweep: Sweep, case: Case, settings: Settings, _: Tables) -> Outcome:
    """Score the maps of one scenario over the values of a parameter."""
    rows: list[Row] = []
    for seed in settings.few_seeds:
        for value, recording, options in sweep.trials(case, settings, seed, sweep.chosen(settings)):
            for method in sweep.methods:
                r = _mantel_r(recording, method, options)
                rows.append((case.name, value, seed, method, r))
    name = f"{sweep.name}-{case.name}"
    caption = f"{case.body}, {case.scenario}, over {sweep.label}."
    return Outcome(tables=(Table(name, caption, _COLUMNS, tuple(rows), shown=False),))


def draw(sweep: Sweep, settings: Settings, tables: Tables) -> Outcome:
    """Draw what `measure` measured of all scenarios."""
    found = {case.name: tables[f"{sweep.name}-{case.name}"] for case in sweep.cases}
    panels = [
        _panel(sweep, case.label.replace("\n", " "), found[case.name].records())
        for case in sweep.cases
    ]
    figure = curves_figure(
        f"Mantel r over {sweep.label}", panels, x_label=sweep.label, logarithmic=True
    )
    seeds = settings.few_seeds
    caption = (
        f"3D maps; dots are runs (seeds {seeds[0]} to {seeds[-1]}), lines their means. The dotted "
        "line is the value used everywhere else."
    )
    rows = tuple(row for table in found.values() for row in table.rows)
    table = Table(sweep.name, f"Scores over {sweep.label}.", _COLUMNS, rows, shown=False)
    return Outcome((Picture(sweep.name, caption, figure),), (table,))


def _mantel_r(recording: Recording, method: str, options: MethodOptions) -> float:
    try:
        return make_map(recording, method, 3, options=options).score.mantel.r
    except InputError:  # too little was touched for a map, which is a result, too
        return float("nan")


def _panel(sweep: Sweep, title: str, rows: list[dict[str, Any]]) -> CurvePanel:
    values = sorted({row["value"] for row in rows})
    curves = {
        method: np.array(
            [
                [r["mantel_r"] for r in rows if r["method"] == method and r["value"] == value]
                for value in values
            ],
            dtype=np.float64,
        )
        for method in sweep.methods
    }
    return CurvePanel(title, np.array(values, dtype=np.float64), curves, sweep.default)


SWEEPS = (
    Sweep(
        "sensitivity-frames",
        "number of frames",
        "The paper's runs have 2,000 frames. How much more would more have told?",
        (250, 500, 1000, 2000, 4000, 8000, 16000, 32000),
        (60, 120, 250),
        _frames,
        2000,
    ),
    Sweep(
        "sensitivity-radius",
        "detection radius, times our default",
        "How far a sensor sees is lost with the paper's Text S1. Our default is 0.44 m for bodies "
        "that reach to 1 m in a bombardment; it decides more than any other parameter.",
        (0.4, 0.55, 0.7, 0.85, 1, 1.2, 1.5, 2),
        (0.7, 1),
        _radius,
        1,
    ),
    Sweep(
        "sensitivity-balls",
        "number of balls",
        "How many balls fly about is lost, too; we take 40.",
        (5, 10, 20, 40, 80, 160),
        (20, 40),
        _balls,
        40,
        BOMBARDED,
    ),
    Sweep(
        "sensitivity-mu",
        "mu",
        "The paper adds a small term, mu times the smallest positive similarity, to each "
        "similarity before it takes the reciprocal, and does not tell mu; we take 1.",
        (0.001, 0.01, 0.1, 1, 10, 100),
        (0.1, 1),
        _mu,
        1,
        methods=("r-anisomap", "i-anisomap"),
    ),
    Sweep(
        "sensitivity-bins",
        "bins a sensor",
        "The paper bins readings into 4, and tried 6 and 8. r-ANISOMAP bins nothing.",
        (2, 3, 4, 6, 8, 12, 16),
        (4, 8),
        _bins,
        DEFAULT_BINS,
        methods=METHODS[1:],
    ),
)

EXPERIMENTS = tuple(
    experiment
    for sweep in SWEEPS
    for experiment in (
        *(
            Experiment(
                f"{sweep.name}-{case.name}",
                "",
                f"Scores of {case.name} over {sweep.label}.",
                partial(measure, sweep, case),
                cost=150 if sweep.name == "sensitivity-frames" else 50,
            )
            for case in sweep.cases
        ),
        Experiment(
            sweep.name,
            f"How much it depends on the {sweep.label.split(',')[0].removesuffix(' a sensor')}",
            sweep.shows,
            partial(draw, sweep),
            needs=tuple(f"{sweep.name}-{case.name}" for case in sweep.cases),
        ),
    )
)
