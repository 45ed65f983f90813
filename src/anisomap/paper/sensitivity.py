"""Sensitivity of maps to what the paper does not give: parameters, unlike sensors, and physics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.base.defaults import DEFAULT_BINS
from anisomap.drawing.figures.charts import METHOD_LOOKS, CurvePanel, curves_figure
from anisomap.errors import InputError
from anisomap.method.options import MethodOptions
from anisomap.numerics.similarity.correlation import pearson
from anisomap.numerics.similarity.information import mutual_information
from anisomap.paper.cases import BOMBARDED, CASES, METHODS, Case, true_positions
from anisomap.paper.experiment import (
    Picture,
    Row,
    Settings,
    Table,
    Tables,
    by,
    curve,
    experiment,
    joined,
    mean_by,
    provide,
)
from anisomap.paper.map_scores import SCORE_COLUMNS, cylinder_shape, map_and_score
from anisomap.recording import Recording
from anisomap.simulation import find_body, find_scenario, simulate
from anisomap.simulation.options import options_for
from anisomap.simulation.solids import cylinder

_COLUMNS = {
    "run": "body and scenario",
    "value": "value of the parameter",
    "seed": "seed of the run",
    "method": "method",
    "mantel_r": "Mantel r of the 3D map with the true positions; nan if there is no map",
}
_FRAMES: tuple[float, ...] = (250, 500, 1000, 2000, 4000, 8000, 16000, 32000)
_QUICK_FRAMES: tuple[float, ...] = (60, 120, 250)


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
    options: Makes the options of the method for a value.
    methods: Methods that depend on the parameter.
    """

    name: str
    what: str
    label: str
    description: str
    values: tuple[float, ...]
    quick_values: tuple[float, ...]
    default: float
    record: Callable[[Case, Settings, int, float], Recording] = lambda case, settings, seed, _: (
        case.record(settings, seed)
    )
    options: Callable[[float], MethodOptions] = lambda _: MethodOptions()
    cases: tuple[Case, ...] = CASES
    methods: tuple[str, ...] = METHODS


_recorded = lru_cache(maxsize=1)(Case.record)  # one long run is truncated to all lengths


def _truncated(case: Case, settings: Settings, seed: int, value: float) -> Recording:
    longest = (_QUICK_FRAMES if settings.quick else _FRAMES)[-1]
    whole = _recorded(case, settings, seed, n_frames=int(longest))
    return replace(whole, readings=whole.readings[: int(value)])


def _with_radius(case: Case, settings: Settings, seed: int, value: float) -> Recording:
    usual = options_for(find_scenario(case.scenario).options, find_body(case.body))
    radius = value * vars(usual)["detection_radius"]
    return case.record(settings, seed, detection_radius=radius)


def _scores(parameter: Parameter, case: Case, settings: Settings) -> Iterator[Row]:
    """Score the maps of one scenario for all values of a parameter."""
    values = parameter.quick_values if settings.quick else parameter.values
    for seed in settings.few_seeds:
        for value in values:
            recording = parameter.record(case, settings, seed, value)
            for method in parameter.methods:
                r = _mantel_r(recording, method, parameter.options(value))
                yield (case.name, value, seed, method, r)


def _mantel_r(recording: Recording, method: str, options: MethodOptions) -> float:
    try:
        return map_and_score(recording, method, 3, options=options).score.mantel.r
    except InputError:  # too few contacts for a map, which is a valid result
        return float("nan")


def draw_curves(
    parameter: Parameter, name: str, needs: Sequence[str], settings: Settings, tables: Tables
) -> Iterator[Picture | Table]:
    """Draw the scores of all scenarios for all values of a parameter."""
    every = joined(tables, needs, name, f"Scores by {parameter.label}.")
    scores = every.records()
    figure = curves_figure(
        f"Mantel r by {parameter.label}",
        _panels(scores, "value", parameter.default),
        x_label=parameter.label,
        logarithmic=True,
    )
    caption = (
        f"Mantel r of 3D maps; {_runs_drawn(settings.few_seeds)}. Dotted line: value in all other "
        "experiments."
    )
    yield Picture(name, caption, figure)
    yield every
    values = sorted({row["value"] for row in scores})
    means: list[Row] = []
    for run, of_run in by(scores, "run").items():
        for method, found in by(of_run, "method").items():
            by_value = mean_by(found, "value", "mantel_r")
            means.append((run, method, *(by_value[value] for value in values)))
    columns = {key: _COLUMNS[key] for key in ("run", "method")} | {
        f"{value:g}": f"mean Mantel r at a value of {value:g}" for value in values
    }
    caption = f"Mean Mantel r by {parameter.label}."
    yield Table(f"{name}-means", caption, columns, means, shown=False)


def _panels(
    scores: Iterable[Mapping[str, Any]], parameter: str, default: float | None = None
) -> list[CurvePanel]:
    """Arrange the scores of each case over a parameter, by method."""
    panels, found = [], by(scores, "run")
    for case in CASES:
        if case.name in found:
            curves = {
                m: curve(rows, parameter) for m, rows in by(found[case.name], "method").items()
            }
            (x, _), *_ = curves.values()
            title = case.label.replace("\n", " ")
            panels.append(CurvePanel(title, x, {m: y for m, (_, y) in curves.items()}, default))
    return panels


def _runs_drawn(seeds: Sequence[int]) -> str:
    return f"dots: runs (seeds {seeds[0]} to {seeds[-1]}), lines: means"


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
        "The detection radius of the sensors is in the paper's Text S1, which is not available. "
        "The default here is 0.44 m for bombarded bodies that extend 1 m from their centre. No "
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
        lambda case, settings, seed, value: case.record(settings, seed, n_balls=int(value)),
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
        options=lambda value: MethodOptions(regularisation=value),
        methods=("r-anisomap", "i-anisomap"),
    ),
    Parameter(
        "bins",
        "the number of bins",
        "bins per sensor",
        "The paper uses 4 bins and tried 6 and 8. r-ANISOMAP does not use bins.",
        (2, 3, 4, 6, 8, 12, 16),
        (4, 8),
        DEFAULT_BINS,
        options=lambda value: MethodOptions(entropy_bins=int(value)),
        methods=METHODS[1:],
    ),
)
for _parameter in PARAMETERS:
    _name = f"sensitivity-{_parameter.name}"
    _cost = 150 if _parameter.name == "frames" else 50
    _needs = tuple(
        provide(f"{_name}-{_case.name}", _COLUMNS, partial(_scores, _parameter, _case), _cost)
        for _case in _parameter.cases
    )
    experiment(_name, f"Sensitivity to {_parameter.what}", _parameter.description, needs=_needs)(
        partial(draw_curves, _parameter, _name, _needs)
    )


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
    "optimum": "optimum of the radial-basis sensors, as a quantile of the readings of the sensor "
    "in contact",
    "noise": "standard deviation of the noise of each sensor, relative to its response to a median "
    "contact",
    "method": "method; r-ANISOMAP uses linear correlation, I-ANISOMAP mutual information",
    "identified": "share of radial-basis sensors whose most similar linear sensor measures the "
    "same quantity",
    "mantel_r": "Mantel r of the 3D map of a skin with half of its sensors of each kind",
}


def radial_basis(readings: ArrayLike, quantile: float) -> NDArray[np.float64]:
    """Replace linear readings by Gaussian radial basis functions of the same quantity.

    readings (T, N) -> (T, N).
    """
    values = np.asarray(readings, dtype=np.float64)
    optimum = _in_contact(values, quantile, untouched=1.0)
    return np.exp(-(((values / optimum - 1) / _WIDTH) ** 2) / 2)


def _in_contact(
    readings: NDArray[np.float64], quantile: float, *, untouched: float
) -> NDArray[np.float64]:
    """Return a quantile of the readings of each sensor in contact, (T, N) -> (N,)."""
    found = np.full(readings.shape[1], untouched)
    touched = (readings > 0).any(axis=0)
    inside = np.where(readings > 0, readings, np.nan)[:, touched]
    found[touched] = np.nanquantile(inside, quantile, axis=0)
    return found


def _responses(case: Case, settings: Settings) -> Iterator[Row]:
    """Identify equal quantities, and map skins with both kinds of sensors."""
    for seed in settings.seeds:
        recording, rng = case.record(settings, seed), np.random.default_rng(seed)
        n_sensors = recording.n_sensors
        chosen = rng.permutation(n_sensors) < n_sensors // 2
        for quantile, noise in _TRIALS:
            linear = np.asarray(recording.readings, dtype=np.float64)
            unlike = radial_basis(linear, quantile)
            medians = _in_contact(linear, 0.5, untouched=0.0)
            linear = linear + noise * medians * rng.standard_normal(linear.shape)
            unlike = unlike + noise * rng.standard_normal(unlike.shape)
            mixed = replace(recording, readings=np.where(chosen, unlike, linear))
            both = np.hstack([linear, unlike])
            for method, similarity in _SIMILARITIES.items():
                across = similarity(both)[n_sensors:, :n_sensors]
                identified = float(np.mean(across.argmax(axis=1) == np.arange(n_sensors)))
                r = map_and_score(mixed, method, 3).score.mantel.r
                yield (case.name, seed, quantile, noise, method, identified, r)


_UNLIKE = tuple(
    provide(f"unlike-{case.name}", _RESPONSE_COLUMNS, partial(_responses, case), cost=60)
    for case in CASES
)


@experiment(
    "unlike-responses",
    "Sensors of unlike response",
    "The sensors of the paper are identical, which favours linear correlation. According to "
    "the paper, if one sensor is linear and another is a radial basis function around an "
    "optimal response point, mutual information is more likely to identify the relation "
    "between them. The paper has no experiment on this. Here both kinds of sensors are simulated "
    "without noise and, for an optimum at the median, with noise in every reading.",
    needs=_UNLIKE,
)
def unlike_responses(settings: Settings, tables: Tables) -> Iterator[Picture | Table]:
    """Draw the scores of skins with both kinds of sensors."""
    scores = joined(tables, _UNLIKE, "unlike-responses", "Sensors of unlike response.")
    panels = _panels((row for row in scores.records() if not row["noise"]), "optimum")
    figure = curves_figure("Maps of skins with sensors of unlike response", panels, x_label=_LABEL)
    caption = (
        "Mantel r of 3D maps. On each skin, half of the sensors, chosen at random, respond "
        "linearly, and the others by a radial basis function whose optimum is at a quantile of the "
        f"readings in contact; {_runs_drawn(settings.seeds)}. At a quantile of 1, the response "
        "increases everywhere."
    )
    yield Picture("unlike-responses", caption, figure)
    yield scores


CYLINDER = "sensitivity-cylinder"

_LENGTH = "length"
_CYLINDER_PARAMETERS: Mapping[str, tuple[str, tuple[float, ...]]] = {
    "correlation": ("correlation length of the ground", (0.45, 0.55, 0.75, 1, 2, 4)),
    "roughness": ("height of the ground", (0.2, 0.5, 1, 1.5)),
    "friction": ("friction; with less, it slips", (0.1, 0.3, 1)),
    "frame_interval": ("time between frames", (0.5, 1, 2)),
    _LENGTH: ("length of the cylinder over its radius", (0.5, 0.75, 1, 1.5)),
    "detection_radius": ("detection radius", (0.5, 0.7, 1, 1.4)),
}
"""Label of each parameter, and its values relative to the default."""

_CYLINDER_QUICK_VALUES = (0.75, 1)
_STEEPEST = 0.35  # height of the ground over its correlation length
_MEASURES = ("mantel_r", "order_around", "order_along", "local_axial_scale")
_LOOKS = {
    measure: replace(look, label=measure.replace("_", " ").replace("mantel", "Mantel"))
    for measure, look in zip(_MEASURES, METHOD_LOOKS.values(), strict=True)
}
_KEPT = 0.5  # order of the sensors; a large correlation
_CYLINDER_COLUMNS = {
    "parameter": "parameter of the simulation",
    "value": "value relative to the default",
    "seed": "seed of the run",
    **{name: SCORE_COLUMNS[name] for name in _MEASURES},
}


def _roll(settings: Settings, seed: int, parameter: str, value: float) -> Recording:
    """Simulate a run with one parameter changed."""
    body = find_body("cylinder")
    if parameter == _LENGTH:
        (solid,) = body.solids
        solids = [cylinder(solid.size[0], value * solid.size[1])]
        body = replace(body, positions=body.positions * [1, 1, value], solids=solids)
        return simulate(body, "locomotion", n_frames=settings.n_frames, seed=seed)
    usual = vars(options_for(find_scenario("locomotion").options, body))
    changed: dict[str, Any] = {parameter: value * usual[parameter]}
    if parameter == "correlation":  # smaller bumps have finer cells, and are less high
        longest = changed[parameter]
        changed["cell"] = min(usual["cell"], longest / 2)
        changed["roughness"] = min(usual["roughness"], _STEEPEST * longest)
    return Case("cylinder", "locomotion").record(settings, seed, **changed)


def _cylinder_scores(parameter: str, settings: Settings) -> Iterator[Row]:
    """Score the maps by r-ANISOMAP for all values of a parameter."""
    values = _CYLINDER_QUICK_VALUES if settings.quick else _CYLINDER_PARAMETERS[parameter][1]
    for seed in settings.few_seeds:
        for value in values:
            recording = _roll(settings, seed, parameter, value)
            touched = recording.select(recording.varying())
            scored = map_and_score(touched, "r-anisomap", 3)
            shape = cylinder_shape(scored.sensor_map.positions, true_positions(touched))
            scores = {"mantel_r": scored.score.mantel.r, **shape._asdict()}
            yield (parameter, value, seed, *(scores[name] for name in _MEASURES))


_CYLINDER_SCORES = {
    parameter: provide(
        f"{CYLINDER}-{parameter}", _CYLINDER_COLUMNS, partial(_cylinder_scores, parameter), cost=60
    )
    for parameter in _CYLINDER_PARAMETERS
}


@experiment(
    CYLINDER,
    "Sensitivity of the rolling cylinder",
    "According to the paper, the map of the rolling cylinder is compressed along the axis, and has "
    "the topology of the sensors reasonably well. The paper does not give the ground, the slip, "
    "the interval between frames, the length of the cylinder over its radius, or the detection "
    "radius. With the defaults here, the order around the axis is correct, but the order along the "
    "axis is lost: the bumps of the ground are longer than the distance between sensors, so a "
    "whole line of sensors is pressed alike. On ground with bumps as short as this distance, the "
    "order along the axis is kept.",
    needs=tuple(_CYLINDER_SCORES.values()),
)
def rolling_cylinder(settings: Settings, tables: Tables) -> Iterator[Picture | Table]:
    """Draw accuracy, order and compression for all values of all parameters."""
    panels: list[CurvePanel] = []
    for parameter, (label, _values) in _CYLINDER_PARAMETERS.items():
        found = tables[_CYLINDER_SCORES[parameter]].records()
        x, _ = curve(found, "value")
        curves = {name: curve(found, "value", name)[1] for name in _MEASURES}
        means = {name: values.mean(axis=1) for name, values in curves.items()}
        ordered = np.minimum(means["order_around"], means["order_along"]) > _KEPT
        holds = ordered & (means["local_axial_scale"] < 1)
        panels.append(CurvePanel(label, x, curves, 1.0, x[holds].tolist()))
    figure = curves_figure(
        "The rolling cylinder by parameters of the simulation",
        panels,
        x_label="value relative to the default",
        y_label="score",
        logarithmic=True,
        looks=_LOOKS,
    )
    seeds = settings.few_seeds
    caption = (
        f"r-ANISOMAP in 3D; dots: runs (seeds {seeds[0]} to {seeds[-1]}), lines: means. Dotted "
        f"line: default. Stars: both orders are above {_KEPT:g} and the map is compressed, as "
        "in the paper."
    )
    yield Picture(CYLINDER, caption, figure)
    caption = "Scores of the rolling cylinder."
    yield joined(tables, _CYLINDER_SCORES.values(), CYLINDER, caption)
