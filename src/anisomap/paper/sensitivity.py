"""Sensitivity of Mantel r to parameters that the paper does not give, and to unlike sensors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.defaults import DEFAULT_BINS
from anisomap.drawing.figures.charts import CurvePanel, curves_figure
from anisomap.errors import InputError
from anisomap.numerics.similarity.correlation import pearson
from anisomap.numerics.similarity.information import mutual_information
from anisomap.options import MethodOptions
from anisomap.paper.cases import BOMBARDED, CASES, METHODS, Case
from anisomap.paper.experiment import (
    Outcome,
    Picture,
    Row,
    Settings,
    Table,
    Tables,
    curves_by_method,
    experiment,
)
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
_FRAMES: tuple[float, ...] = (250, 500, 1000, 2000, 4000, 8000, 16000, 32000)
_QUICK_FRAMES: tuple[float, ...] = (60, 120, 250)

Trial = tuple[Recording, MethodOptions]


@dataclass(frozen=True)
class Parameter:
    """A parameter and the values to try.

    name: Name of the experiment.
    title: Heading on the page.
    label: Label of the x axis.
    description: What the paper says about the parameter.
    values, quick_values: In ascending order.
    vary: ``vary(case, settings, seed, value)`` returns a recording and options.
    default: Value in all other experiments.
    methods: Methods that depend on the parameter.
    """

    name: str
    title: str
    label: str
    description: str
    values: tuple[float, ...]
    quick_values: tuple[float, ...]
    vary: Callable[[Case, Settings, int, float], Trial]
    default: float
    cases: tuple[Case, ...] = CASES
    methods: tuple[str, ...] = METHODS


_recorded = lru_cache(maxsize=1)(Case.record)  # one long run is truncated to all lengths


def _truncated(case: Case, settings: Settings, seed: int, value: float) -> Trial:
    longest = (_QUICK_FRAMES if settings.quick else _FRAMES)[-1]
    whole = _recorded(case, settings, seed, n_frames=int(longest))
    return replace(whole, readings=whole.readings[: int(value)]), MethodOptions()


def _with_radius(case: Case, settings: Settings, seed: int, value: float) -> Trial:
    options = options_for(find_scenario(case.scenario).options, find_body(case.body))
    radius = value * vars(options)["detection_radius"]
    return case.record(settings, seed, detection_radius=radius), MethodOptions()


def _with_balls(case: Case, settings: Settings, seed: int, value: float) -> Trial:
    return case.record(settings, seed, n_balls=int(value)), MethodOptions()


def _with_mu(case: Case, settings: Settings, seed: int, value: float) -> Trial:
    return case.record(settings, seed), MethodOptions(mu=value)


def _with_bins(case: Case, settings: Settings, seed: int, value: float) -> Trial:
    return case.record(settings, seed), MethodOptions(bins=int(value))


def score_values(parameter: Parameter, case: Case, settings: Settings, _: Tables) -> Outcome:
    """Score the maps of one scenario for all values of a parameter."""
    values = parameter.quick_values if settings.quick else parameter.values
    rows: list[Row] = []
    for seed in settings.few_seeds:
        for value in values:
            recording, options = parameter.vary(case, settings, seed, value)
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
    figure = curves_figure(
        f"Mantel r by {parameter.label}",
        _panels(found, parameter.methods, "value", parameter.default),
        x_label=parameter.label,
        logarithmic=True,
    )
    caption = (
        f"Mantel r of 3D maps; {_runs_drawn(settings.few_seeds)}. Dotted line: value in all other "
        "experiments."
    )
    table = _joined(parameter.name, f"Scores by {parameter.label}.", found)
    means = _means(parameter, table.rows)
    return Outcome((Picture(parameter.name, caption, figure),), (table, means))


def _panels(
    tables: Mapping[Case, Table],
    methods: Iterable[str],
    parameter: str,
    default: float | None = None,
) -> list[CurvePanel]:
    return [
        CurvePanel(
            case.label.replace("\n", " "),
            *curves_by_method(table.records(), methods, parameter),
            default,
        )
        for case, table in tables.items()
    ]


def _joined(name: str, caption: str, tables: Mapping[Case, Table]) -> Table:
    """Concatenate the tables of all cases."""
    every = list(tables.values())
    rows = tuple(row for table in every for row in table.rows)
    return Table(name, caption, every[0].columns, rows, shown=False)


def _runs_drawn(seeds: Sequence[int]) -> str:
    return f"dots: runs (seeds {seeds[0]} to {seeds[-1]}), lines: means"


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


_EVERY = (
    Parameter(
        "sensitivity-frames",
        "Sensitivity to the number of frames",
        "number of frames",
        "The paper's runs have 2,000 frames. Longer runs show how much accuracy more data gives.",
        _FRAMES,
        _QUICK_FRAMES,
        _truncated,
        2000,
    ),
    Parameter(
        "sensitivity-radius",
        "Sensitivity to the detection radius",
        "detection radius, relative to the default",
        "The detection radius of the sensors is in the paper's Text S1, which could not be had. "
        "The default here is 0.44 m for bombarded bodies that extend 1 m from their centre. No "
        "other parameter has a larger effect.",
        (0.4, 0.55, 0.7, 0.85, 1, 1.2, 1.5, 2),
        (0.7, 1),
        _with_radius,
        1,
    ),
    Parameter(
        "sensitivity-balls",
        "Sensitivity to the number of balls",
        "number of balls",
        "The paper's number of balls is not known; the default here is 40.",
        (5, 10, 20, 40, 80, 160),
        (20, 40),
        _with_balls,
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
        _with_mu,
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
        _with_bins,
        DEFAULT_BINS,
        methods=METHODS[1:],
    ),
)
PARAMETERS = {parameter.name: parameter for parameter in _EVERY}

for _parameter in _EVERY:
    for _case in _parameter.cases:
        experiment(
            f"{_parameter.name}-{_case.name}",
            "",
            f"Scores of {_case.name} by {_parameter.label}.",
            cost=150 if _parameter.name == "sensitivity-frames" else 50,
        )(partial(score_values, _parameter, _case))
    experiment(
        _parameter.name,
        _parameter.title,
        _parameter.description,
        needs=tuple(f"{_parameter.name}-{case.name}" for case in _parameter.cases),
    )(partial(draw_curves, _parameter))


MEDIAN = 0.5
"""Quantile of the contact readings at which the claim is tested: the middle of the response."""

CLAIMED_NOISE = 0.1
"""Noise of each sensor with which the claim is tested."""

_TRIALS = ((0.25, 0.0), (MEDIAN, 0.0), (1.0, 0.0), (MEDIAN, CLAIMED_NOISE))  # quantile, noise
_WIDTH = 0.5  # standard deviation of the basis function, relative to the optimum: 14 % at rest
_SIMILARITIES = {"r-anisomap": pearson, "i-anisomap": mutual_information}
_LABEL = "optimum: quantile of contact readings"

_RESPONSE_COLUMNS = {
    "run": "body and scenario",
    "seed": "seed of the run",
    "optimum": "reading of greatest response of the radial-basis sensors: quantile of the readings "
    "of the sensor in contact",
    "noise": "standard deviation of the noise of each sensor, relative to its response to a median "
    "contact",
    "method": "method; r-ANISOMAP uses linear correlation, I-ANISOMAP mutual information",
    "identified": "share of radial-basis sensors whose most similar linear sensor measures the "
    "same quantity",
    "mantel_r": "Mantel r of the 3D map of a skin with half of its sensors of each kind",
}
_NOISE = list(_RESPONSE_COLUMNS).index("noise")


def radial_basis(readings: ArrayLike, quantile: float) -> NDArray[np.float64]:
    """Replace linear readings by Gaussian radial basis functions of the same quantity.

    readings (T, N) -> (T, N).
    """
    values = np.asarray(readings, dtype=np.float64)
    touched = np.where(values > 0, values, np.nan)
    silent = np.isnan(touched).all(axis=0)
    optimum = np.ones(values.shape[1])
    optimum[~silent] = np.nanquantile(touched[:, ~silent], quantile, axis=0)
    return np.exp(-(((values / optimum - 1) / _WIDTH) ** 2) / 2)


def score_responses(case: Case, settings: Settings, _: Tables) -> Outcome:
    """Identify equal quantities, and map skins with both kinds of sensors."""
    rows: list[Row] = []
    for seed in settings.seeds:
        recording, rng = case.record(settings, seed), np.random.default_rng(seed)
        n_sensors = recording.n_sensors
        chosen = rng.permutation(n_sensors) < n_sensors // 2
        for quantile, noise in _TRIALS:
            linear = np.asarray(recording.readings, dtype=np.float64)
            unlike = radial_basis(linear, quantile)
            medians = np.nanmedian(np.where(linear > 0, linear, np.nan), axis=0)
            linear = linear + noise * medians * rng.standard_normal(linear.shape)
            unlike = unlike + noise * rng.standard_normal(unlike.shape)
            mixed = replace(recording, readings=np.where(chosen, unlike, linear))
            both = np.hstack([linear, unlike])
            for method, similarity in _SIMILARITIES.items():
                across = similarity(both)[n_sensors:, :n_sensors]
                identified = float(np.mean(across.argmax(axis=1) == np.arange(n_sensors)))
                r = map_and_score(mixed, method, 3).score.mantel.r
                rows.append((case.name, seed, quantile, noise, method, identified, r))
    name = f"unlike-{case.name}"
    caption = f"Sensors of unlike response on {case.body}, {case.scenario}."
    return Outcome(tables=(Table(name, caption, _RESPONSE_COLUMNS, tuple(rows), shown=False),))


for _case in CASES:
    experiment(f"unlike-{_case.name}", "", f"Sensors of unlike response on {_case.name}.", cost=60)(
        partial(score_responses, _case)
    )


@experiment(
    "unlike-responses",
    "Sensors of unlike response",
    "The sensors of the paper are identical, which favours linear correlation. According to "
    "the paper, if one sensor is linear and another is a radial basis function around an "
    "optimal response point, mutual information is more likely to identify the relation "
    "between them. It has no experiment on this; here both kinds of sensors are simulated, without "
    "noise and, at the median, with noise in every reading.",
    needs=tuple(f"unlike-{case.name}" for case in CASES),
)
def unlike_responses(settings: Settings, tables: Tables) -> Outcome:
    """Draw the scores of skins with both kinds of sensors."""
    found = {case: tables[f"unlike-{case.name}"] for case in CASES}
    exact = {
        case: replace(table, rows=tuple(row for row in table.rows if not row[_NOISE]))
        for case, table in found.items()
    }
    panels = _panels(exact, _SIMILARITIES, "optimum")
    figure = curves_figure("Maps of skins with sensors of unlike response", panels, x_label=_LABEL)
    caption = (
        "Mantel r of 3D maps of skins on which half of the sensors, at random, respond linearly, "
        "and half by a radial basis function with its optimum at a quantile of the readings in "
        f"contact; {_runs_drawn(settings.seeds)}. At a quantile of 1 the response is increasing."
    )
    table = _joined("unlike-responses", "Sensors of unlike response.", found)
    return Outcome((Picture("unlike-responses", caption, figure),), (table,))
