"""Figure 3: how good the maps are that each method makes, against the null; and other bins."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np

from anisomap.drawing.figures.charts import ScoreGroup, scores_figure
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.paper.experiment import Experiment, Outcome, Picture, Row, Settings, Table, Tables
from anisomap.paper.runs import (
    CASES,
    FAILING,
    METHODS,
    PATCH_FRAMES,
    SCORE_COLUMNS,
    Case,
    null_box,
    patch_run,
    score_rows,
)

MORE_BINS = (6, 8)
"""Numbers of bins that the paper tried, too."""

PATCH = "patch"
PATCH_RUNS = range(1, len(PATCH_FRAMES) + 1)
SCORES = (*(f"scores-{case.name}" for case in CASES), f"scores-{PATCH}")
"""Tables of the scores of all maps."""

_SUMMARY = {
    "run": "body and scenario; the patch in 2D or 3D",
    "runs": "how many runs",
    **{
        f"{method}{what}": f"Mantel r of {method}, {meaning}"
        for method in METHODS
        for what, meaning in (("", "mean"), (" least", "least"), (" most", "greatest"))
    },
    "null most": "greatest Mantel r of all random relabellings of all maps",
}
_BINS = {
    "run": "body and scenario; the patch in 2D or 3D",
    "method": "method",
    **{f"{bins} bins": f"mean Mantel r with {bins} bins" for bins in (DEFAULT_BINS, *MORE_BINS)},
    "largest change": "how far any of these is from that with 4 bins",
}


def simulated_scores(case: Case, settings: Settings, _: Tables) -> Outcome:
    """Score all maps of a simulated scenario; of the plane in 2D, too."""
    dimensions = (2, 3) if case.body == "plane" else (3,)
    rows: list[Row] = []
    for seed in settings.seeds:
        recording = case.record(settings, seed)
        rows += score_rows(case.name, recording, seed, dimensions, settings, more_bins=MORE_BINS)
    name = f"scores-{case.name}"
    caption = f"Scores of all maps of {case.body}, {case.scenario}."
    return Outcome(tables=(Table(name, caption, SCORE_COLUMNS, tuple(rows), shown=False),))


def patch_scores(settings: Settings, _: Tables) -> Outcome:
    """Score all maps of the five runs on the simulated patch, without the failing sensor."""
    rows: list[Row] = []
    for number in PATCH_RUNS:
        recording = patch_run(settings, number)
        rows += score_rows(
            str(number),
            recording,
            settings.seed + number - 1,
            (2, 3),
            settings,
            exclude=[FAILING],
            more_bins=MORE_BINS,
        )
    name = f"scores-{PATCH}"
    caption = "Scores of all maps of the five runs on the simulated patch."
    return Outcome(tables=(Table(name, caption, SCORE_COLUMNS, tuple(rows), shown=False),))


def all_scores(tables: Tables) -> list[dict[str, Any]]:
    """Give all rows of scores, with the ``group`` that they are averaged over."""
    rows = [row for name in SCORES for row in tables[name].records()]
    for row in rows:
        simulated = any(case.name == row["run"] for case in CASES)
        row["group"] = row["run"] if simulated else f"{PATCH}, {row['dimensions']}D"
        if simulated and row["dimensions"] == 2:
            row["group"] += ", 2D"
    return rows


def in_groups(rows: Iterable[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Sort rows by their group, in the order in which groups come up."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(row["group"], []).append(row)
    return groups


def figure_3(settings: Settings, tables: Tables) -> Outcome:
    """Draw the scores of all methods on all runs."""
    rows = [row for row in all_scores(tables) if row["bins"] == DEFAULT_BINS]
    groups = in_groups(rows)
    simulated = [_group(case.label, groups[case.name]) for case in CASES]
    patch = [
        _group(
            f"run {number},\n{k}D",
            [row for row in groups[f"{PATCH}, {k}D"] if row["run"] == number],
        )
        for k in (2, 3)
        for number in PATCH_RUNS
    ]
    figure = scores_figure(
        "Figure 3. Reconstruction quality: simulation (3D) and the simulated patch (2D and 3D)",
        [simulated, patch],
    )
    seeds = settings.seeds
    caption = (
        f"Mantel r of every map: one dot a run (seeds {seeds[0]} to {seeds[-1]} for each "
        "simulated scenario, one run each of the patch), a line at their mean. Boxes: the same "
        f"map after {settings.permutations:,} random relabellings, of the first seed; whiskers at "
        "1.5 times the distance between the quartiles, + the least and greatest beyond them."
    )
    table = Table("figure-3", "Mantel r by scenario and method.", _SUMMARY, _summary(groups))
    return Outcome((Picture("figure-3", caption, figure),), (table,))


def bins_table(_: Settings, tables: Tables) -> Outcome:
    """Tell what other numbers of bins change."""
    rows: list[Row] = []
    for group, members in in_groups(all_scores(tables)).items():
        for method in METHODS[1:]:
            means = [
                _mean(row for row in members if row["method"] == method and row["bins"] == bins)
                for bins in (DEFAULT_BINS, *MORE_BINS)
            ]
            change = max(abs(mean - means[0]) for mean in means[1:])
            rows.append((group, method, *means, change))
    caption = "Mantel r with 4, 6 and 8 bins, means over the runs; r-ANISOMAP bins nothing."
    return Outcome(tables=(Table("bins", caption, _BINS, tuple(rows)),))


def _group(label: str, rows: list[dict[str, Any]]) -> ScoreGroup:
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
        summary.append((group, runs, *cells, max(row["null_most"] for row in rows)))
    return tuple(summary)


def _mean(rows: Iterable[dict[str, Any]]) -> float:
    return float(np.mean([row["mantel_r"] for row in rows]))


EXPERIMENTS = (
    *(
        Experiment(
            f"scores-{case.name}",
            "",
            f"Scores of {case.name}, for Figure 3 and the claims.",
            partial(simulated_scores, case),
            cost=60,
        )
        for case in CASES
    ),
    Experiment(
        f"scores-{PATCH}",
        "",
        "Scores of the patch, for Figure 3 and the claims.",
        patch_scores,
        cost=30,
    ),
    Experiment(
        "figure-3",
        "Figure 3: reconstruction quality of four methods",
        "The paper compares the methods by the correlation of distances on the map with true "
        "distances (Mantel r here), on one run of each scenario and on the five hardware runs, "
        "beside box plots of 10,000 random relabellings. Here each scenario is run with several "
        "seeds, so the spread over runs shows, too. The hardware is our simulated twin; real skin "
        "has a section of its own.",
        figure_3,
        needs=SCORES,
    ),
)

BINS = Experiment(
    "bins",
    "4, 6 and 8 bins",
    "The paper bins readings into 4 and says that 6 and 8 bins produced qualitatively similar "
    "results.",
    bins_table,
    needs=SCORES,
)
