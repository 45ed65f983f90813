"""Sensitivity of Mantel r to parameters that the paper does not give."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from anisomap.drawing.figures.charts import CurvePanel, curves_figure
from anisomap.errors import InputError
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.options import MethodOptions
from anisomap.paper.cases import BOMBARDED, CASES, METHODS, Case
from anisomap.paper.experiment import Experiment, Outcome, Picture, Row, Settings, Table, Tables
from anisomap.paper.map_scores import map_and_score
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
class Parameter:
    """A parameter and the values to try.

    name: Name of the experiment.
    title: Heading on the page.
    label: Label of the x axis.
    description: What the paper says about the parameter.
    values, quick_values: In ascending order.
    trials: ``trials(case, settings, seed, values)`` yields values, recordings and options.
    default: Value in all other experiments.
    methods: Methods that depend on the parameter.
    """

    name: str
    title: str
    label: str
    description: str
    values: tuple[float, ...]
    quick_values: tuple[float, ...]
    trials: Callable[[Case, Settings, int, tuple[float, ...]], Iterator[Trial]]
    default: float
    cases: tuple[Case, ...] = CASES
    methods: tuple[str, ...] = METHODS


def _vary_frames(
    case: Case, settings: Settings, seed: int, values: tuple[float, ...]
) -> Iterator[Trial]:
    """Truncate one long run."""
    longest = case.record(settings, seed, n_frames=int(max(values)))
    for value in values:
        yield value, replace(longest, readings=longest.readings[: int(value)]), MethodOptions()


def _vary_radius(
    case: Case, settings: Settings, seed: int, values: tuple[float, ...]
) -> Iterator[Trial]:
    options = options_for(find_scenario(case.scenario).options, find_body(case.body))
    default = vars(options)["detection_radius"]
    for value in values:
        yield value, case.record(settings, seed, detection_radius=value * default), MethodOptions()


def _vary_balls(
    case: Case, settings: Settings, seed: int, values: tuple[float, ...]
) -> Iterator[Trial]:
    for value in values:
        yield value, case.record(settings, seed, n_balls=int(value)), MethodOptions()


def _vary_mu(
    case: Case, settings: Settings, seed: int, values: tuple[float, ...]
) -> Iterator[Trial]:
    recording = case.record(settings, seed)
    for value in values:
        yield value, recording, MethodOptions(mu=value)


def _vary_bins(
    case: Case, settings: Settings, seed: int, values: tuple[float, ...]
) -> Iterator[Trial]:
    recording = case.record(settings, seed)
    for value in values:
        yield value, recording, MethodOptions(bins=int(value))


def score_values(parameter: Parameter, case: Case, settings: Settings, _: Tables) -> Outcome:
    """Score the maps of one scenario for all values of a parameter."""
    values = parameter.quick_values if settings.quick else parameter.values
    rows: list[Row] = []
    for seed in settings.few_seeds:
        for value, recording, options in parameter.trials(case, settings, seed, values):
            rows += [
                (case.name, value, seed, method, _mantel_r(recording, method, options))
                for method in parameter.methods
            ]
    name = f"{parameter.name}-{case.name}"
    caption = f"{case.body}, {case.scenario}, by {parameter.label}."
    return Outcome(tables=(Table(name, caption, _COLUMNS, tuple(rows), shown=False),))


def draw_curves(parameter: Parameter, settings: Settings, tables: Tables) -> Outcome:
    """Draw the scores of all scenarios for all values of a parameter."""
    found = {case: tables[f"{parameter.name}-{case.name}"] for case in parameter.cases}
    panels = [
        _panel(parameter, case.label.replace("\n", " "), table.records())
        for case, table in found.items()
    ]
    figure = curves_figure(
        f"Mantel r by {parameter.label}", panels, x_label=parameter.label, logarithmic=True
    )
    seeds = settings.few_seeds
    caption = (
        f"Mantel r of 3D maps; dots: runs (seeds {seeds[0]} to {seeds[-1]}), lines: means. Dotted "
        "line: value in all other experiments."
    )
    rows = tuple(row for table in found.values() for row in table.rows)
    table = Table(parameter.name, f"Scores by {parameter.label}.", _COLUMNS, rows, shown=False)
    return Outcome((Picture(parameter.name, caption, figure),), (table, _means(parameter, rows)))


def _means(parameter: Parameter, rows: tuple[Row, ...]) -> Table:
    """Return the mean Mantel r over seeds by scenario, method and value of the parameter."""
    groups: dict[tuple[str, str], dict[float, list[float]]] = {}
    for run, value, _seed, method, r in rows:
        by_value = groups.setdefault((str(run), str(method)), {})
        by_value.setdefault(float(value), []).append(float(r))
    values = sorted({value for by_value in groups.values() for value in by_value})
    columns = {name: _COLUMNS[name] for name in ("run", "method")} | {
        f"{value:g}": f"mean Mantel r at a value of {value:g}" for value in values
    }
    means: tuple[Row, ...] = tuple(
        (*group, *(float(np.mean(by_value[value])) for value in values))
        for group, by_value in groups.items()
    )
    caption = f"Mean Mantel r by {parameter.label}."
    return Table(f"{parameter.name}-means", caption, columns, means, shown=False)


def _mantel_r(recording: Recording, method: str, options: MethodOptions) -> float:
    try:
        return map_and_score(recording, method, 3, options=options).score.mantel.r
    except InputError:  # too few contacts for a map, which is a valid result
        return float("nan")


def _panel(parameter: Parameter, title: str, rows: list[dict[str, Any]]) -> CurvePanel:
    values = sorted({row["value"] for row in rows})
    curves = {
        method: np.array(
            [
                [r["mantel_r"] for r in rows if r["method"] == method and r["value"] == value]
                for value in values
            ],
            dtype=np.float64,
        )
        for method in parameter.methods
    }
    return CurvePanel(title, np.array(values, dtype=np.float64), curves, parameter.default)


PARAMETERS = (
    Parameter(
        "sensitivity-frames",
        "Sensitivity to the number of frames",
        "number of frames",
        "The paper's runs have 2,000 frames. Longer runs show how much accuracy more data gives.",
        (250, 500, 1000, 2000, 4000, 8000, 16000, 32000),
        (60, 120, 250),
        _vary_frames,
        2000,
    ),
    Parameter(
        "sensitivity-radius",
        "Sensitivity to the detection radius",
        "detection radius, relative to the default",
        "The detection radius of the sensors was given in the paper's Text S1, which is no longer "
        "available. The default here is 0.44 m for bombarded bodies that extend 1 m from their "
        "centre. No other parameter has a larger effect.",
        (0.4, 0.55, 0.7, 0.85, 1, 1.2, 1.5, 2),
        (0.7, 1),
        _vary_radius,
        1,
    ),
    Parameter(
        "sensitivity-balls",
        "Sensitivity to the number of balls",
        "number of balls",
        "The paper's number of balls is not known; the default here is 40.",
        (5, 10, 20, 40, 80, 160),
        (20, 40),
        _vary_balls,
        40,
        BOMBARDED,
    ),
    Parameter(
        "sensitivity-mu",
        "Sensitivity to mu",
        "mu",
        "The paper adds mu times the smallest positive similarity to each similarity before taking "
        "the reciprocal. It gives no value for mu; the default here is 1.",
        (0.001, 0.01, 0.1, 1, 10, 100),
        (0.1, 1),
        _vary_mu,
        1,
        methods=("r-anisomap", "i-anisomap"),
    ),
    Parameter(
        "sensitivity-bins",
        "Sensitivity to the number of bins",
        "bins per sensor",
        "The paper uses 4 bins and tried 6 and 8. r-ANISOMAP does not use bins.",
        (2, 3, 4, 6, 8, 12, 16),
        (4, 8),
        _vary_bins,
        DEFAULT_BINS,
        methods=METHODS[1:],
    ),
)

EXPERIMENTS = tuple(
    experiment
    for parameter in PARAMETERS
    for experiment in (
        *(
            Experiment(
                f"{parameter.name}-{case.name}",
                "",
                f"Scores of {case.name} by {parameter.label}.",
                partial(score_values, parameter, case),
                cost=150 if parameter.name == "sensitivity-frames" else 50,
            )
            for case in parameter.cases
        ),
        Experiment(
            parameter.name,
            parameter.title,
            parameter.description,
            partial(draw_curves, parameter),
            needs=tuple(f"{parameter.name}-{case.name}" for case in parameter.cases),
        ),
    )
)
