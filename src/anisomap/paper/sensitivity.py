"""Sensitivity of maps to parameters that the paper does not give."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

from anisomap.drawing.figures.charts import CurvePanel, curves_figure
from anisomap.errors import InputError
from anisomap.paper.cases import BOMBARDED, CASES, METHODS, Case
from anisomap.paper.experiment import (
    Picture,
    Row,
    Settings,
    Table,
    Tables,
    by,
    curve,
    experiment,
    mean_by,
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
_FRAMES: tuple[float, ...] = (250, 500, 1000, 2000, 4000, 8000)
_QUICK_FRAMES: tuple[float, ...] = (60, 120, 250)


def _same(case: Case, settings: Settings, seed: int, _: float) -> Recording:
    return case.record(settings, seed)


def _truncated(case: Case, settings: Settings, seed: int, value: float) -> Recording:
    longest = (_QUICK_FRAMES if settings.quick else _FRAMES)[-1]
    whole = case.record(settings, seed, n_frames=int(longest))
    return replace(whole, readings=whole.readings[: int(value)])


def _with_radius(case: Case, settings: Settings, seed: int, value: float) -> Recording:
    usual = options_for(find_scenario(case.scenario).options, find_body(case.body))
    return case.record(settings, seed, detection_radius=value * usual.detection_radius)


def _with_balls(case: Case, settings: Settings, seed: int, value: float) -> Recording:
    return case.record(settings, seed, n_balls=int(value))


@dataclass(frozen=True)
class Parameter:
    """A parameter and the values to try.

    name: End of the name of the experiment.
    what: End of the heading on the page.
    label: Label of the x axis.
    description: What the paper says about the parameter.
    values, quick_values: In ascending order.
    default: Value in all other experiments.
    record: Makes the recording for a value.
    regularises: Whether the value is mu.
    methods: Methods that depend on the parameter.
    """

    name: str
    what: str
    label: str
    description: str
    values: tuple[float, ...]
    quick_values: tuple[float, ...]
    default: float
    record: Callable[[Case, Settings, int, float], Recording] = _same
    regularises: bool = False
    cases: tuple[Case, ...] = CASES
    methods: tuple[str, ...] = METHODS

    def rows(self, settings: Settings) -> Iterator[Row]:
        """Score the maps of all scenarios for all values; yield rows of `_COLUMNS`."""
        for case in self.cases:
            for seed in settings.few_seeds:
                for value in self.quick_values if settings.quick else self.values:
                    recording = self.record(case, settings, seed, value)
                    for method in self.methods:
                        r = self._mantel_r(recording, method, value)
                        yield (case.name, value, seed, method, r)

    def _mantel_r(self, recording: Recording, method: str, value: float) -> float:
        mu = value if self.regularises else 1.0
        try:
            return map_and_score(recording, method, 3, regularisation=mu).score.mantel.r
        except InputError:  # too few contacts for a map, which is a valid result
            return float("nan")


def draw_curves(parameter: Parameter, settings: Settings, _: Tables) -> Iterator[Picture | Table]:
    """Draw the scores of all scenarios for all values of a parameter."""
    name, label, rows = (
        f"sensitivity-{parameter.name}",
        parameter.label,
        [*parameter.rows(settings)],
    )
    every = Table(name, f"Scores by {label}.", _COLUMNS, rows, shown=False)
    panels: list[CurvePanel] = []
    means: list[Row] = []
    values: list[float] = []
    for run, of_run in by(every.records(), "run").items():
        curves = {method: curve(found, "value") for method, found in by(of_run, "method").items()}
        x = next(iter(curves.values()))[0]
        values = x.tolist()
        curves_of_run = {m: y for m, (_, y) in curves.items()}
        panels.append(CurvePanel(run.replace("-", " "), x, curves_of_run, parameter.default))
        for method, found in by(of_run, "method").items():
            means.append((run, method, *mean_by(found, "value", "mantel_r").values()))
    figure = curves_figure(f"Mantel r by {label}", panels, x_label=label, logarithmic=True)
    seeds = settings.few_seeds
    caption = (
        f"Mantel r of 3D maps; dots: runs (seeds {seeds[0]} to {seeds[-1]}), lines: means. Dotted "
        "line: value in all other experiments."
    )
    yield Picture(name, caption, figure)
    yield every
    columns = {key: _COLUMNS[key] for key in ("run", "method")} | {
        f"{value:g}": f"mean Mantel r at a value of {value:g}" for value in values
    }
    yield Table(f"{name}-means", f"Mean Mantel r by {label}.", columns, means, shown=False)


PARAMETERS = (
    Parameter(
        "frames",
        "the number of frames",
        "number of frames",
        "The paper's runs have 2,000 frames. Longer runs show how much accuracy more data gives.",
        _FRAMES,
        _QUICK_FRAMES,
        2000,
        _truncated,
    ),
    Parameter(
        "radius",
        "the detection radius",
        "detection radius, relative to the default",
        "The detection radius of the sensors is in the paper's Text S1, which was not available to "
        "us. The default here is 0.44 m for bombarded bodies that extend 1 m from their centre. No "
        "other parameter has a larger effect.",
        (0.4, 0.55, 0.7, 0.85, 1, 1.2, 1.5, 2),
        (0.7, 1),
        1,
        _with_radius,
    ),
    Parameter(
        "balls",
        "the number of balls",
        "number of balls",
        "The paper's number of balls is not known; the default here is 40.",
        (5, 10, 20, 40, 80, 160),
        (20, 40),
        40,
        _with_balls,
        cases=BOMBARDED,
    ),
    Parameter(
        "mu",
        "mu",
        "mu",
        "The paper adds mu times the smallest positive similarity to each similarity before taking "
        "the reciprocal. It gives no value for mu; the default here is 1.",
        (0.001, 0.01, 0.1, 1, 10, 100),
        (0.1, 1),
        1,
        regularises=True,
        methods=("r-anisomap", "i-anisomap"),
    ),
)
for _parameter in PARAMETERS:
    experiment(
        f"sensitivity-{_parameter.name}",
        f"Sensitivity to {_parameter.what}",
        _parameter.description,
        cost=1200 if _parameter.name == "frames" else 600,
    )(partial(draw_curves, _parameter))
