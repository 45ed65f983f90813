"""Prior work and ablations on the paper's runs: self-organising maps, point sources, neighbours."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType

import numpy as np

from anisomap.comparison import map_by_rival
from anisomap.evaluation import mantel
from anisomap.evidence import compare
from anisomap.mapping import dissimilarities
from anisomap.methods import find_method
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.graph.neighbour_graphs import smallest_connected_neighbour_graph
from anisomap.numerics.precision import Reals
from anisomap.numerics.scaling.multidimensional_scaling import smacof
from anisomap.options import MethodOptions
from anisomap.paper.cases import CASES, METHODS, PATCH_RUNS, Case, patch_run, true_positions
from anisomap.paper.experiment import Outcome, Row, Settings, Table, Tables, experiment, mean_by
from anisomap.paper.map_scores import SMACOF, map_and_score
from anisomap.recording import Recording

POINT_SOURCES = tuple(
    Case(f"{body}-pulses", body, "pulses", f"{body},\npoint sources")
    for body in ("sphere", "cylinder", "plane")
)
"""Stimuli of the earlier work that the paper compares its own with."""

_PATCH = "patch"
_COLUMNS = {
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

_METRICS: Mapping[str, Callable[[Reals, Reals], Reals]] = MappingProxyType(
    {
        ABLATIONS[0]: _neighbours,
        ABLATIONS[1]: lambda _similarity, dissimilarity: dissimilarity,
        "gaussian, neighbours": _gaussian,
    }
)
"""Metrics by name: functions of the correlations r (N, N) and of the dissimilarities 1 / r."""

_STOCK = ("som-on-r", "isomap-on-r")
RIVALS = (*METHODS, *_METRICS, *_STOCK)
COLUMNS = {
    "run": _COLUMNS["run"],
    "runs": "number of runs",
    **{name: f"mean Mantel r of {name}" for name in RIVALS},
}


def score_rivals(name: str, recording: Recording, seed: int, dimensions: int) -> list[Row]:
    """Score all rivals on a recording; return rows of `_COLUMNS`."""
    varying = recording.select(recording.varying())
    truth = true_positions(varying, dimensions)
    similarity, bins = find_method("r-anisomap").similarity, MethodOptions().bins
    pairs = compare([varying], similarity, bins=bins, with_noise=False)
    direct = dissimilarities(pairs, "r-anisomap")

    def accuracy(method: str) -> float:
        if method in METHODS:
            return map_and_score(varying, method, dimensions).score.mantel.r
        if method in _METRICS:
            metric = _METRICS[method](pairs.similarity, direct)
            positions = smacof(metric, dimensions=dimensions, options=SMACOF).positions
        else:
            positions = map_by_rival(varying, method, dimensions).positions
        return mantel(positions, truth, permutations=0).r

    return [(name, seed, method, accuracy(method)) for method in RIVALS]


def simulated_rivals(case: Case, settings: Settings, _: Tables) -> Outcome:
    """Score all rivals on the runs of a scenario, in 3D."""
    rows: list[Row] = []
    for seed in settings.seeds:
        rows += score_rivals(case.name, case.record(settings, seed), seed, 3)
    return _outcome(case.name, rows)


for _case in (*CASES, *POINT_SOURCES):
    experiment(f"rivals-{_case.name}", "", f"Scores of rivals on {_case.name}.", cost=40)(
        partial(simulated_rivals, _case)
    )


@experiment(f"rivals-{_PATCH}", "", "Scores of rivals on the patch.", cost=10)
def patch_rivals(settings: Settings, _: Tables) -> Outcome:
    """Score all rivals on the runs of the patch without a failing sensor, in 2D."""
    rows: list[Row] = []
    for number in PATCH_RUNS:
        run = patch_run(settings, number, fails=False)
        rows += score_rivals(f"{_PATCH}, 2D", run, number, 2)
    return _outcome(_PATCH, rows)


def _outcome(name: str, rows: list[Row]) -> Outcome:
    caption = f"Scores of rivals on {name}."
    return Outcome(tables=(Table(f"rivals-{name}", caption, _COLUMNS, tuple(rows), shown=False),))


_RUNS = (*(case.name for case in CASES), _PATCH, *(case.name for case in POINT_SOURCES))


@experiment(
    "rivals",
    "Prior work and ablations",
    "Methods of the prior work that the paper discusses, and r-ANISOMAP without its parts, on the "
    "same runs.\n\nAblations: r-ANISOMAP with the edges of the smallest connected neighbour graph "
    "only, as in ISOMAP, and without shortest paths. A self-organising map places sensors instead "
    "of frames: its inputs are the standardised readings of each sensor, and a sensor lies at the "
    "node that is most like it. Isomap on correlations is scikit-learn's.\n\nThe bodies in the "
    "last rows are stimulated by point sources, to which all sensors respond by distance, as in "
    "the earlier simulation that the paper cites (Modayil). In the manner of that work, the method "
    "of Gaussian neighbours takes distances from a Gaussian covariance, and only those of "
    "neighbours.",
    needs=tuple(f"rivals-{name}" for name in _RUNS),
)
def rivals_table(_: Settings, tables: Tables) -> Outcome:
    """Average the scores of all rivals."""
    rows: list[Row] = []
    scores: list[Row] = []
    for name in _RUNS:
        found = tables[f"rivals-{name}"]
        scores += found.rows
        means = mean_by(found.records(), "method", "mantel_r")
        n_runs = len(found.rows) // len(RIVALS)
        rows.append((str(found.rows[0][0]), n_runs, *(means[method] for method in RIVALS)))
    return Outcome(
        tables=(
            Table("rivals", "Mean Mantel r of prior work and ablations.", COLUMNS, tuple(rows)),
            Table("rival-scores", "Scores of all runs.", _COLUMNS, tuple(scores), shown=False),
        )
    )
