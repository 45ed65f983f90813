"""Figure 3: accuracy of all methods against null distributions; effect of the number of bins."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np

from anisomap.defaults import DEFAULT_BINS
from anisomap.drawing.figures.charts import ScoreGroup, scores_figure
from anisomap.paper.cases import CASES, FAILING, METHODS, PATCH_RUNS, Case, patch_run, patch_seed
from anisomap.paper.experiment import (
    Outcome,
    Picture,
    Row,
    Settings,
    Table,
    Tables,
    experiment,
    mean_by,
)
from anisomap.paper.map_scores import SCORE_COLUMNS, null_box, score_rows, stopped

MORE_BINS = (6, 8)
"""Other numbers of bins that the paper tried."""

PATCH = "patch"
SCORES = (*(f"scores-{case.name}" for case in CASES), f"scores-{PATCH}")
"""Names of the tables with the scores of all maps."""

_RUN = "body and scenario; the patch in 2D or 3D"
SUMMARY_COLUMNS = {
    "run": _RUN,
    "runs": "number of runs",
    **{
        f"{method}{suffix}": f"{statistic} Mantel r of {method}"
        for method in METHODS
        for suffix, statistic in (("", "mean"), (" min", "minimum"), (" max", "maximum"))
    },
    "null max": "maximum of the null distributions of all maps",
    "stopped": "number of maps, by method, whose scaling stopped before it converged",
}
BINS_COLUMNS = {
    "run": _RUN,
    "method": "method",
    **{f"{bins} bins": f"mean Mantel r with {bins} bins" for bins in (DEFAULT_BINS, *MORE_BINS)},
    "largest change": f"largest absolute difference from {DEFAULT_BINS} bins",
}


def simulated_scores(case: Case, settings: Settings, _: Tables) -> Outcome:
    """Score all maps of a simulated scenario in 3D; of the plane also in 2D."""
    dimensions = (2, 3) if case.body == "plane" else (3,)
    rows: list[Row] = []
    for seed in settings.seeds:
        recording = case.record(settings, seed)
        rows += score_rows(case.name, recording, seed, dimensions, settings, more_bins=MORE_BINS)
    name = f"scores-{case.name}"
    caption = f"Scores of all maps of {case.body}, {case.scenario}."
    return Outcome(tables=(Table(name, caption, SCORE_COLUMNS, tuple(rows), shown=False),))


for _case in CASES:
    experiment(
        f"scores-{_case.name}",
        "",
        f"Scores of {_case.name}, for Figure 3 and the claims.",
        cost=60,
    )(partial(simulated_scores, _case))


@experiment(f"scores-{PATCH}", "", "Scores of the patch, for Figure 3 and the claims.", cost=30)
def patch_scores(settings: Settings, _: Tables) -> Outcome:
    """Score all maps of the five runs of the simulated patch without the failing sensor."""
    rows: list[Row] = []
    for number in PATCH_RUNS:
        rows += score_rows(
            str(number),
            patch_run(settings, number),
            patch_seed(settings, number),
            (2, 3),
            settings,
            exclude=[FAILING],
            more_bins=MORE_BINS,
        )
    name = f"scores-{PATCH}"
    caption = "Scores of all maps of the five runs of the simulated patch."
    return Outcome(tables=(Table(name, caption, SCORE_COLUMNS, tuple(rows), shown=False),))


def all_scores(tables: Tables) -> list[dict[str, Any]]:
    """Return all rows of scores, each with the ``group`` over which means are taken."""
    rows = [row for name in SCORES for row in tables[name].records()]
    for row in rows:
        simulated = any(case.name == row["run"] for case in CASES)
        row["group"] = row["run"] if simulated else f"{PATCH}, {row['dimensions']}D"
        if simulated and row["dimensions"] == 2:
            row["group"] += ", 2D"
    return rows


def by_group(rows: Iterable[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Sort rows by their group, in order of appearance."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(row["group"], []).append(row)
    return groups


@experiment(
    "figure-3",
    "Figure 3: accuracy of four methods",
    "The paper compares the methods by the correlation of distances on the map with true "
    "distances (Mantel r), on one run of each scenario and on the five hardware runs, beside "
    "box plots of 10,000 random relabellings. Here each scenario is run with several seeds, to "
    "show the variation between runs. The hardware runs are simulated; real skin has a section "
    "of its own.",
    needs=SCORES,
)
def figure_3(settings: Settings, tables: Tables) -> Outcome:
    """Draw the scores of all methods on all runs."""
    groups = by_group(row for row in all_scores(tables) if row["bins"] == DEFAULT_BINS)
    simulated = [_score_group(case.label, groups[case.name]) for case in CASES]
    patch = [
        _score_group(
            f"run {number},\n{k}D",
            [row for row in groups[f"{PATCH}, {k}D"] if row["run"] == number],
        )
        for k in (2, 3)
        for number in PATCH_RUNS
    ]
    figure = scores_figure(
        "Figure 3. Accuracy of the maps: simulation (3D) and simulated patch (2D and 3D)",
        [simulated, patch],
    )
    seeds = settings.seeds
    caption = (
        f"Mantel r of all maps; dots: runs (seeds {seeds[0]} to {seeds[-1]} of each simulated "
        "scenario, one run each of the patch), lines: means. Boxes: null distribution of the map "
        f"of the first seed ({settings.permutations:,} random relabellings); whiskers: 1.5 "
        "interquartile ranges; +: all values beyond the whiskers."
    )
    table = Table("figure-3", "Mantel r by scenario and method.", SUMMARY_COLUMNS, _summary(groups))
    return Outcome((Picture("figure-3", caption, figure),), (table,))


@experiment(
    "bins",
    "4, 6 and 8 bins",
    "The paper uses 4 bins and states that 6 and 8 bins produced qualitatively similar results.",
    needs=SCORES,
)
def bins_table(_: Settings, tables: Tables) -> Outcome:
    """Compare numbers of bins."""
    rows: list[Row] = []
    for group, members in by_group(all_scores(tables)).items():
        for method in METHODS[1:]:
            by_bins = mean_by((r for r in members if r["method"] == method), "bins", "mantel_r")
            means = [by_bins[bins] for bins in (DEFAULT_BINS, *MORE_BINS)]
            change = max(abs(mean - means[0]) for mean in means[1:])
            rows.append((group, method, *means, change))
    caption = "Mean Mantel r with 4, 6 and 8 bins; r-ANISOMAP does not use bins."
    return Outcome(tables=(Table("bins", caption, BINS_COLUMNS, tuple(rows)),))


def _score_group(label: str, rows: list[dict[str, Any]]) -> ScoreGroup:
    by_method = {m: [row for row in rows if row["method"] == m] for m in METHODS}
    return ScoreGroup(
        label,
        {method: [row["mantel_r"] for row in found] for method, found in by_method.items()},
        {method: null_box(found[0]) for method, found in by_method.items()},
    )


def _summary(groups: dict[str, list[dict[str, Any]]]) -> tuple[Row, ...]:
    summary = []
    for group, rows in groups.items():
        cells: list[float] = []
        for method in METHODS:
            scores = [row["mantel_r"] for row in rows if row["method"] == method]
            cells += [float(np.mean(scores)), min(scores), max(scores)]
        runs = len({(row["run"], row["seed"]) for row in rows})
        highest = max(row["null_max"] for row in rows)
        summary.append((group, runs, *cells, highest, stopped(rows)))
    return tuple(summary)
