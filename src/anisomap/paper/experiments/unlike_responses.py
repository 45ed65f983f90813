"""Sensors of unlike response: linear, and radial basis functions around an optimal reading."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.drawing.figures.charts import CurvePanel, curves_figure
from anisomap.numerics.similarity.correlation import pearson
from anisomap.numerics.similarity.information import mutual_information
from anisomap.paper.cases import CASES, Case
from anisomap.paper.experiment import Experiment, Outcome, Picture, Row, Settings, Table, Tables
from anisomap.paper.map_scores import map_and_score

MEDIAN = 0.5
"""Quantile of the contact readings at which the claim is tested: the middle of the response."""

_QUANTILES = (0.25, MEDIAN, 0.75, 1.0)
_QUICK_QUANTILES = (MEDIAN, 1.0)
_WIDTH = 0.5  # standard deviation of the basis function, relative to the optimum: 14 % at rest
_SIMILARITIES = {"r-anisomap": pearson, "i-anisomap": mutual_information}
_LABEL = "optimum: quantile of contact readings"

_COLUMNS = {
    "run": "body and scenario",
    "seed": "seed of the run",
    "optimum": "reading of greatest response of the radial-basis sensors: quantile of the readings "
    "of the sensor in contact",
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
    touched = np.where(values > 0, values, np.nan)
    silent = np.isnan(touched).all(axis=0)
    optimum = np.ones(values.shape[1])
    optimum[~silent] = np.nanquantile(touched[:, ~silent], quantile, axis=0)
    return np.exp(-(((values / optimum - 1) / _WIDTH) ** 2) / 2)


def score_responses(case: Case, settings: Settings, _: Tables) -> Outcome:
    """Identify equal quantities, and map skins with both kinds of sensors."""
    rows: list[Row] = []
    for seed in settings.few_seeds:
        recording = case.record(settings, seed)
        n_sensors = recording.n_sensors
        chosen = np.random.default_rng(seed).permutation(n_sensors) < n_sensors // 2
        for quantile in _QUICK_QUANTILES if settings.quick else _QUANTILES:
            unlike = radial_basis(recording.readings, quantile)
            mixed = replace(recording, readings=np.where(chosen, unlike, recording.readings))
            both = np.hstack([recording.readings, unlike])
            for method, similarity in _SIMILARITIES.items():
                across = similarity(both)[n_sensors:, :n_sensors]
                identified = float(np.mean(across.argmax(axis=1) == np.arange(n_sensors)))
                r = map_and_score(mixed, method, 3).score.mantel.r
                rows.append((case.name, seed, quantile, method, identified, r))
    name = f"unlike-{case.name}"
    caption = f"Sensors of unlike response on {case.body}, {case.scenario}."
    return Outcome(tables=(Table(name, caption, _COLUMNS, tuple(rows), shown=False),))


def unlike_responses(settings: Settings, tables: Tables) -> Outcome:
    """Draw the scores of skins with both kinds of sensors."""
    found = [(case, tables[f"unlike-{case.name}"].records()) for case in CASES]
    panels = []
    for case, records in found:
        optima = sorted({row["optimum"] for row in records})
        curves = {
            method: np.array(
                [
                    [
                        row["mantel_r"]
                        for row in records
                        if (row["method"], row["optimum"]) == (method, optimum)
                    ]
                    for optimum in optima
                ]
            )
            for method in _SIMILARITIES
        }
        panels.append(CurvePanel(case.label.replace("\n", " "), np.array(optima), curves))
    figure = curves_figure("Maps of skins with sensors of unlike response", panels, x_label=_LABEL)
    seeds = settings.few_seeds
    caption = (
        "Mantel r of 3D maps of skins on which half of the sensors, at random, respond linearly, "
        "and half by a radial basis function with its optimum at a quantile of the readings in "
        f"contact; dots: runs (seeds {seeds[0]} to {seeds[-1]}), lines: means. At a quantile of 1 "
        "the response is increasing."
    )
    rows = tuple(row for case in CASES for row in tables[f"unlike-{case.name}"].rows)
    table = Table("unlike-responses", "Sensors of unlike response.", _COLUMNS, rows, shown=False)
    return Outcome((Picture("unlike-responses", caption, figure),), (table,))


EXPERIMENTS = (
    *(
        Experiment(
            f"unlike-{case.name}",
            "",
            f"Sensors of unlike response on {case.name}.",
            partial(score_responses, case),
            cost=20,
        )
        for case in CASES
    ),
    Experiment(
        "unlike-responses",
        "Sensors of unlike response",
        "The sensors of the paper are identical, which favours linear correlation. According to "
        "the paper, if one sensor is linear and another is a radial basis function around an "
        "optimal response point, mutual information is more likely to identify the relation "
        "between them. It has no experiment on this; here both kinds of sensors are simulated.",
        unlike_responses,
        needs=tuple(f"unlike-{case.name}" for case in CASES),
    ),
)
