"""Accuracy of all methods: Figure 3, numbers of bins, prior work, ablations and dimensions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from anisomap.base.defaults import DEFAULT_BINS
from anisomap.drawing.figures.charts import CurvePanel, ScoreGroup, curves_figure, scores_figure
from anisomap.evaluation import mantel
from anisomap.evaluation.rivals import map_by_rival
from anisomap.method.pipeline import dissimilarities
from anisomap.method.reconstruction import reconstruct
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.graph.neighbour_graphs import smallest_connected_neighbour_graph
from anisomap.numerics.precision import Reals
from anisomap.numerics.scaling.multidimensional_scaling import smacof
from anisomap.paper.cases import (
    CASES,
    FAILING,
    METHODS,
    PATCH_RUNS,
    Case,
    patch_run,
    patch_runs,
    true_positions,
)
from anisomap.paper.experiment import (
    Picture,
    Row,
    Settings,
    Table,
    Tables,
    by,
    experiment,
    joined,
    mean_by,
    provide,
)
from anisomap.paper.map_scores import (
    SCORE_COLUMNS,
    SMACOF,
    compared,
    map_and_score,
    n_dimensions,
    null_box,
    published_metric,
    score_rows,
    spectrum,
    stopped,
)
from anisomap.recording import Recording

MORE_BINS = (6, 8)
"""Other numbers of bins that the paper tried."""

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
    "stopped": "number of maps whose scaling stopped before it converged, by method",
}
BINS_COLUMNS = {
    "run": _RUN,
    "method": "method",
    **{f"{bins} bins": f"mean Mantel r with {bins} bins" for bins in (DEFAULT_BINS, *MORE_BINS)},
    "largest change": f"largest absolute difference from {DEFAULT_BINS} bins",
}


def _simulated(case: Case, settings: Settings) -> Iterator[Row]:
    """Score all maps of a simulated scenario in 3D; of the plane also in 2D."""
    dimensions = (2, 3) if case.body == "plane" else (3,)
    for seed in settings.seeds:
        run = case.record(settings, seed)
        yield from score_rows(case.name, run, seed, dimensions, settings, more_bins=MORE_BINS)


def _patch(settings: Settings) -> Iterator[Row]:
    """Score all maps of the five runs of the simulated patch without the failing sensor."""
    excluding: dict[str, Any] = {"exclude": [FAILING], "more_bins": MORE_BINS}
    for number, run, seed in patch_runs(settings):
        yield from score_rows(str(number), run, seed, (2, 3), settings, **excluding)


SCORES = (
    *(
        provide(f"scores-{case.name}", SCORE_COLUMNS, partial(_simulated, case), cost=60)
        for case in CASES
    ),
    provide("scores-patch", SCORE_COLUMNS, _patch, cost=30),
)
"""Names of the tables with the scores of all maps."""


def all_scores(tables: Tables) -> list[Mapping[str, Any]]:
    """Return all rows of scores, each with the ``group`` over which means are taken."""
    rows = joined(tables, SCORES).records()
    simulated = {case.name for case in CASES}
    for row in rows:
        if row["run"] not in simulated:
            row["group"] = f"patch, {row['dimensions']}D"
        else:
            row["group"] = row["run"] + (", 2D" if row["dimensions"] == 2 else "")
    return [*rows]


@experiment(
    "figure-3",
    "Figure 3: accuracy of four methods",
    "The paper compares the methods by Mantel r, the correlation of distances on the map with true "
    "distances. It shows one run of each scenario and the five hardware runs, beside box plots of "
    "10,000 random relabellings. Here each scenario is run with several seeds, to show the "
    "variation between runs. The hardware runs are simulated; real skin has its own section.",
    needs=SCORES,
)
def figure_3(settings: Settings, tables: Tables) -> Iterator[Picture | Table]:
    """Draw the scores of all methods on all runs."""
    groups = by((row for row in all_scores(tables) if row["bins"] == DEFAULT_BINS), "group")
    simulated = [_score_group(case.label, groups[case.name]) for case in CASES]
    patch = [
        _score_group(f"run {number},\n{k}D", by(groups[f"patch, {k}D"], "run")[number])
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
    yield Picture("figure-3", caption, figure)
    rows = [(group, *_summary(found)) for group, found in groups.items()]
    yield Table("figure-3", "Mantel r by scenario and method.", SUMMARY_COLUMNS, rows)


@experiment(
    "bins",
    "4, 6 and 8 bins",
    "The paper uses 4 bins and states that 6 and 8 bins produced qualitatively similar results.",
    needs=SCORES,
)
def bins_table(_: Settings, tables: Tables) -> Iterator[Table]:
    """Compare numbers of bins."""
    rows: list[Row] = []
    for group, members in by(all_scores(tables), "group").items():
        for method in METHODS[1:]:
            by_bins = mean_by(by(members, "method")[method], "bins", "mantel_r")
            means = [by_bins[bins] for bins in (DEFAULT_BINS, *MORE_BINS)]
            change = max(abs(mean - means[0]) for mean in means[1:])
            rows.append((group, method, *means, change))
    caption = "Mean Mantel r with 4, 6 and 8 bins; r-ANISOMAP does not use bins."
    yield Table("bins", caption, BINS_COLUMNS, rows)


def _score_group(label: str, rows: list[Mapping[str, Any]]) -> ScoreGroup:
    by_method = by(rows, "method")
    return ScoreGroup(
        label,
        {method: [row["mantel_r"] for row in found] for method, found in by_method.items()},
        {method: null_box(found[0]) for method, found in by_method.items()},
    )


def _summary(rows: list[Mapping[str, Any]]) -> Row:
    cells: list[float] = []
    for found in by(rows, "method").values():
        scores = [row["mantel_r"] for row in found]
        cells += [float(np.mean(scores)), min(scores), max(scores)]
    runs = len({(row["run"], row["seed"]) for row in rows})
    return (runs, *cells, max(row["null_max"] for row in rows), stopped(rows))


POINT_SOURCES = tuple(Case(body, "pulses") for body in ("sphere", "cylinder", "plane"))
"""Stimuli of the earlier work that the paper compares its own with."""

_RIVAL_COLUMNS = {
    "run": "body and scenario; the five runs of the patch without a failing sensor, in 2D",
    "seed": "seed of the run",
    "method": "method",
    "mantel_r": "Mantel r with the true positions",
}


def _neighbours(similarity: Reals, edges: Reals) -> Reals:
    """Keep the edges of the smallest connected neighbour graph; shortest paths."""
    joined, _ = smallest_connected_neighbour_graph(similarity)
    return metricise(np.where(joined | np.eye(len(edges), dtype=bool), edges, np.inf))


def _gaussian(similarity: Reals, _: Reals) -> Reals:
    """Distances of neighbours by a Gaussian covariance, r = exp(-d^2 / 2); shortest paths."""
    return _neighbours(similarity, np.sqrt(-2 * np.log(np.clip(similarity, 1e-6, 1))))


ABLATIONS = ("r-anisomap, neighbours", "r-anisomap, not metricised")

_METRICS: Mapping[str, Callable[[Reals, Reals], Reals]] = {
    ABLATIONS[0]: _neighbours,
    ABLATIONS[1]: lambda _similarity, dissimilarity: dissimilarity,
    "gaussian, neighbours": _gaussian,
}
"""Metrics by name: functions of the correlations r (N, N) and of the dissimilarities 1 / r."""

RIVALS = (*METHODS, *_METRICS, "isomap-on-r")
RIVALS_COLUMNS = {
    "run": _RIVAL_COLUMNS["run"],
    "runs": "number of runs",
    **{name: f"mean Mantel r of {name}" for name in RIVALS},
}


def score_rivals(name: str, recording: Recording, seed: int, dimensions: int) -> Iterator[Row]:
    """Score all rivals on a recording; yield rows of `_RIVAL_COLUMNS`."""
    varying = recording.select(recording.varying())
    truth = true_positions(varying, dimensions)
    pairs = compared(varying, "r-anisomap")
    direct = dissimilarities(pairs, "r-anisomap")
    for method in RIVALS:
        if method in METHODS:
            r = map_and_score(varying, method, dimensions).score.mantel.r
        else:
            if method in _METRICS:
                metric = _METRICS[method](pairs.similarity, direct)
                positions = smacof(metric, dimensions=dimensions, options=SMACOF).positions
            else:
                positions = map_by_rival(varying, method, dimensions).positions
            r = mantel(positions, truth, permutations=0).r
        yield (name, seed, method, r)


def _rivals_simulated(case: Case, settings: Settings) -> Iterator[Row]:
    """Score all rivals on the runs of a scenario, in 3D."""
    for seed in settings.seeds:
        yield from score_rivals(case.name, case.record(settings, seed), seed, 3)


def _rivals_patch(settings: Settings) -> Iterator[Row]:
    """Score all rivals on the runs of the patch without a failing sensor, in 2D."""
    for _number, run, seed in patch_runs(settings, fails=False):
        yield from score_rivals("patch, 2D", run, seed, 2)


def _provide_rivals(case: Case) -> str:
    return provide(f"rivals-{case.name}", _RIVAL_COLUMNS, partial(_rivals_simulated, case), cost=40)


_RIVAL_SCORES = (
    *map(_provide_rivals, CASES),
    provide("rivals-patch", _RIVAL_COLUMNS, _rivals_patch, cost=10),
    *map(_provide_rivals, POINT_SOURCES),
)


@experiment(
    "rivals",
    "Prior work and ablations",
    "Methods of prior work that the paper discusses, and r-ANISOMAP with one step changed, on the "
    "same runs.\n\nThe ablations are r-ANISOMAP with only the edges of the smallest connected "
    "neighbour graph, as in ISOMAP, and r-ANISOMAP without shortest paths. Isomap on correlations "
    "uses scikit-learn.\n\nThe bodies in the last rows are stimulated by point sources. All "
    "sensors respond to each source, by their distance to it, as in the earlier simulation that "
    "the paper cites (Modayil). The method with Gaussian neighbours follows this work: it computes "
    "the distances of neighbours from a Gaussian covariance.",
    needs=_RIVAL_SCORES,
)
def rivals_table(_: Settings, tables: Tables) -> Iterator[Table]:
    """Average the scores of all rivals."""
    scores = joined(tables, _RIVAL_SCORES, "rival-scores", "Scores of all runs.")
    rows: list[Row] = []
    for run, found in by(scores.records(), "run").items():
        means = mean_by(found, "method", "mantel_r")
        rows.append((run, len(found) // len(RIVALS), *(means[method] for method in RIVALS)))
    yield Table("rivals", "Mean Mantel r of prior work and ablations.", RIVALS_COLUMNS, rows)
    yield scores


DIMENSIONS_COLUMNS = {
    "run": "body and scenario, or patch",
    "true": "dimensions of the true configuration",
    "auto": "dimensions that anisomap chooses, by the elbow of the stress",
    **{method: f"dimensions chosen from the metric of {method}" for method in METHODS},
}
_SPECTRA = {
    "run": "body and scenario, or patch",
    "method": "method",
    "dimension": "number of the dimension, by descending variance",
    "share": "variance of classical scaling, relative to the sum of the positive variances",
}
_MAX_DIMENSIONS = 8  # shown in the figure


@experiment(
    "dimensions",
    "Number of dimensions",
    "The paper assumes three dimensions and mentions that the approach of Pierce & Kuipers (1997) "
    "could choose their number: apply classical scaling, and keep the dimensions before the "
    "largest drop in variance. This rule errs on thin bodies and with long contacts. The column "
    "auto gives the choice of anisomap.",
    cost=20,
)
def dimensions(settings: Settings, _: Tables) -> Iterator[Picture | Table]:
    """Choose the number of dimensions of every body and of the patch."""
    seed = settings.seed
    runs = [(c.name, c.record(settings, seed), 2 if c.body == "plane" else 3) for c in CASES]
    runs.append(("patch, run 1", patch_run(settings, 1), 2))
    panels: list[CurvePanel] = []
    rows: list[Row] = []
    shares: list[Row] = []
    for name, recording, true in runs:
        curves, chosen = {}, []
        for method in METHODS:
            variances = spectrum(published_metric(recording, method))
            chosen.append(n_dimensions(variances))
            share = variances[:_MAX_DIMENSIONS] / variances[variances > 0].sum()
            curves[method] = share[:, None]
            shares += [(name, method, i + 1, float(value)) for i, value in enumerate(share)]
        auto = reconstruct(recording, "r-anisomap").dimensions
        rows.append((name, true, auto, *chosen))
        x = np.arange(1.0, _MAX_DIMENSIONS + 1)
        panels.append(CurvePanel(name, x, curves, float(true)))
    figure = curves_figure(
        "Variance by dimension of classical scaling",
        panels,
        x_label="dimension",
        y_label="share of variance",
    )
    caption = (
        "Share of variance of each dimension of classical scaling. Dotted line: dimensions of the "
        f"true configuration. Seed {seed}."
    )
    yield Picture("dimensions", caption, figure)
    yield Table("dimensions", "Dimensions chosen by the largest drop.", DIMENSIONS_COLUMNS, rows)
    yield Table("spectra", "Variance by dimension.", _SPECTRA, shares, shown=False)
