"""Accuracy of all methods on the paper's runs: Figure 3, numbers of bins, ablations, responses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.drawing.figures.charts import ScoreGroup, scores_figure
from anisomap.evaluation import mantel
from anisomap.numerics.graph.dissimilarity import regularised_reciprocal
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.graph.neighbour_graphs import (
    neighbour_graph,
    smallest_connected_neighbour_graph,
)
from anisomap.numerics.precision import Reals
from anisomap.numerics.scaling.multidimensional_scaling import smacof
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.paper.cases import (
    CASES,
    FAILING,
    METHODS,
    PATCH_RUNS,
    REAL_RECORDING,
    Case,
    patch_run,
    patch_runs,
    real_recording,
)
from anisomap.paper.cases import true_positions as positions_of
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
)
from anisomap.paper.map_scores import (
    MORE_BINS,
    SCORE_COLUMNS,
    SMACOF,
    map_and_score,
    null_box,
    score_rows,
    similarity_of,
    stopped,
)
from anisomap.paper.shapes import isolation
from anisomap.paper.similarities import PAIR_COLUMNS, RESPONSE_COLUMNS, pair_rows, response_rows
from anisomap.recording import Recording

ALL_PAIRS, SMALLEST, DIRECT = "all pairs", "smallest connected graph", "no shortest paths"
NEIGHBOURS = (4, 6, 8, 12)
"""Numbers of neighbours in alternative graphs."""

_ABLATION_COLUMNS = {
    "run": SCORE_COLUMNS["run"],
    "seed": "seed of the run",
    "edges": "pairs of sensors that paths lead along: all, as in r-ANISOMAP; those of a graph of k "
    "neighbours; all, without paths",
    "k": "neighbours of each sensor, at least those of the smallest connected graph; 0 for all",
    "mantel_r": "Mantel r of the map",
}


def ablation_rows(
    run: str, recording: Recording, seed: int, dimensions: int, mu: float
) -> Iterator[Row]:
    """Score r-ANISOMAP with one step changed; yield rows of `_ABLATION_COLUMNS`."""
    varying = recording.select(recording.varying())
    truth, similarity = positions_of(varying, dimensions), similarity_of(varying, "r-anisomap")
    direct = regularised_reciprocal(similarity, mu)

    def score(metric: Reals) -> float:
        positions = smacof(metric, dimensions=dimensions, options=SMACOF).positions
        return mantel(positions, truth, permutations=0).r

    def along(graph: NDArray[np.bool_]) -> float:
        joined = graph | np.eye(len(direct), dtype=bool)
        return score(metricise(np.where(joined, direct, np.inf)))

    smallest, least = smallest_connected_neighbour_graph(similarity)
    found = {
        ALL_PAIRS: (0, score(metricise(direct))),
        DIRECT: (0, score(direct)),
        SMALLEST: (least, along(smallest)),
    }
    for k in NEIGHBOURS:
        graph = (k, along(neighbour_graph(similarity, k))) if k > least else found[SMALLEST]
        found[f"k = {k}"] = graph
    for edges, (k, r) in found.items():
        yield (run, seed, edges, k, r)


_FAILURE_COLUMNS = {
    "run": "number of the run",
    "sensor": "sensor that fails",
    "saturated": "share of frames in which it is saturated",
    "mantel_r_before": "Mantel r of the other sensors without the failure",
    "mantel_r": "Mantel r of the other sensors with the failure",
    "isolation_before": "isolation of the sensor without the failure: its distance to the nearest "
    "one on the map, divided by the median of this distance over all others",
    "isolation": "isolation of the sensor with the failure",
}
_N_FAILING = 4


def failure_rows(settings: Settings, runs: Iterable[tuple[int, Recording, int]]) -> Iterator[Row]:
    """Let each sensor of the patch fail in turn; compare with equal runs without a failure."""
    rng = np.random.default_rng(settings.seed)
    for number, sound, _seed in runs:
        names = np.array(sound.names)[sound.varying()]
        others = rng.permutation(names[names != FAILING])[: _N_FAILING - 1]
        for name in (FAILING, *others.tolist()):
            failed = patch_run(settings, number, failing=name, fails=True)
            sensor = failed.names.index(name)
            share = np.mean(failed.readings[:, sensor] == failed.readings.max())
            before, after = (_failure(run, sensor, settings) for run in (sound, failed))
            values = (value for pair in zip(before, after, strict=True) for value in pair)
            yield (number, name, float(share), *values)


def _failure(recording: Recording, sensor: int, settings: Settings) -> tuple[float, float]:
    """Return Mantel r of all other sensors, and the isolation of a sensor."""
    name = recording.names[sensor]
    made, found = map_and_score(recording, "r-anisomap", 2, exclude=[name], mu=settings.mu)
    placed = np.flatnonzero(made.placed)
    row = int(np.searchsorted(placed, sensor))
    return found.mantel.r, isolation(made.positions[placed], row)


_KINDS = {
    "scores": SCORE_COLUMNS,
    "ablations": _ABLATION_COLUMNS,
    "responses": RESPONSE_COLUMNS,
    "pairs": PAIR_COLUMNS,
    "failures": _FAILURE_COLUMNS,
}


def _tables(name: str, rows: Mapping[str, list[Row]]) -> Iterator[Table]:
    for kind, found in rows.items():
        yield Table(f"{kind}-{name}", "Scores of all runs.", _KINDS[kind], found, shown=False)


def case_tables(case: Case, settings: Settings, seeds: Iterable[int]) -> Iterator[Table]:
    """Score all maps of a simulated scenario in 3D; of the plane also in 2D."""
    dimensions, mu = (2, 3) if case.body == "plane" else (3,), settings.mu
    rows: dict[str, list[Row]] = {"scores": [], "ablations": [], "responses": [], "pairs": []}
    for seed in seeds:
        run = case.record(settings, seed)
        rows["scores"] += score_rows(
            case.run_name, run, seed, dimensions, settings, more_bins=MORE_BINS
        )
        rows["ablations"] += ablation_rows(case.name, run, seed, 3, mu)
        rows["pairs"] += pair_rows(case.name, run, seed, 3, mu)
        rows["responses"] += response_rows(case.name, run, seed, mu)
    yield from _tables(case.name, rows)


def _patch_name(dimensions: int) -> str:
    return f"patch, {dimensions}D"


def patch_tables(settings: Settings, n_runs: int) -> Iterator[Table]:
    """Score all maps of the simulated patch without the failing sensor, and failures in turn."""
    rows: dict[str, list[Row]] = {"scores": [], "ablations": [], "pairs": [], "failures": []}
    for _number, run, seed in patch_runs(settings, n_runs=n_runs):
        rows["scores"] += score_rows(
            _patch_name, run, seed, (2, 3), settings, exclude=[FAILING], more_bins=MORE_BINS
        )
    sound = [*patch_runs(settings, fails=False, n_runs=n_runs)]
    for _number, run, seed in sound:
        rows["ablations"] += ablation_rows(_patch_name(2), run, seed, 2, settings.mu)
        rows["pairs"] += pair_rows(_patch_name(2), run, seed, 2, settings.mu)
    rows["failures"] += failure_rows(settings, sound)
    yield from _tables("patch", rows)


def _simulated(case: Case, settings: Settings, _: Tables) -> Iterator[Table]:
    return case_tables(case, settings, settings.seeds)


for _case in CASES:
    experiment(f"runs-{_case.name}", cost=150)(partial(_simulated, _case))


@experiment("runs-patch", cost=100)
def _patch(settings: Settings, _: Tables) -> Iterator[Table]:
    return patch_tables(settings, len(settings.seeds))


@experiment("runs-real", files=(REAL_RECORDING,), cost=20)
def _real(settings: Settings, _: Tables) -> Iterator[Table]:
    run = real_recording(settings)
    scores = score_rows(lambda k: f"real skin, {k}D", run, 0, (2, 3), settings)
    ablated = ablation_rows("real skin, 2D", run, 0, 2, settings.mu)
    yield from _tables("real", {"scores": [*scores], "ablations": [*ablated]})


_NAMES = (*(case.name for case in CASES), "patch", "real")
RUNS = tuple(f"runs-{name}" for name in _NAMES)
"""Experiments that score all maps."""


def tables_of(kind: str, tables: Tables, name: str = "", caption: str = "") -> Table:
    """Join the ``scores``, ``ablations`` or ``responses`` of all runs."""
    return joined(tables, [f"{kind}-{one}" for one in _NAMES], name, caption)


_RUN = "body and scenario; the patch and real skin in 2D or 3D"
SUMMARY_COLUMNS = {
    "run": _RUN,
    "runs": "number of runs",
    **{
        f"{method}{suffix}": f"{statistic} Mantel r of {method}"
        for method in METHODS
        for suffix, statistic in (("", "mean"), (" min", "minimum"), (" max", "maximum"))
    },
    "least z": "lowest of all maps: Mantel r minus the mean of its null distribution, in standard "
    "deviations",
    "null max": "maximum of the null distributions of all maps",
    "stopped": "number of maps whose scaling stopped before it converged, by method",
}


@experiment(
    "figure-3",
    "Figure 3: accuracy of four methods",
    "The paper compares the methods by Mantel r, the correlation of distances on the map with true "
    "distances. It shows one run of each scenario and the five hardware runs, beside box plots of "
    "10,000 random relabellings. Here each scenario is run with several seeds, to show the "
    "variation between runs. The hardware runs are simulated; real skin has its own section.",
    needs=RUNS,
)
def figure_3(settings: Settings, tables: Tables) -> Iterator[Picture | Table]:
    """Draw the scores of all methods on all runs."""
    scores = tables_of("scores", tables).records()
    groups = by([row for row in scores if row["bins"] == DEFAULT_BINS], "run")
    simulated = [_score_group(case.label, groups[case.name]) for case in CASES]
    patch = [
        _score_group(f"run {number},\n{k}D", found)
        for k in (2, 3)
        for number, found in enumerate(by(groups[_patch_name(k)], "seed").values(), 1)
        if number in PATCH_RUNS
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
    n_runs = len({row["seed"] for row in rows})
    least_z, highest = min(row["z"] for row in rows), max(row["null_max"] for row in rows)
    return (n_runs, *cells, least_z, highest, stopped(rows))


_EDGES = (ALL_PAIRS, SMALLEST, *(f"k = {k}" for k in NEIGHBOURS), DIRECT)
ABLATIONS_COLUMNS = {
    "run": _RUN,
    "smallest k": "neighbours of the smallest connected graph, median over the runs",
    **{edges: f"mean Mantel r: {edges}" for edges in _EDGES},
}


@experiment(
    "ablations",
    "r-ANISOMAP with one step changed",
    "The paper gives two reasons for the accuracy of ANISOMAP: it considers all pairs of sensors, "
    "not only neighbours as in ISOMAP, and it replaces distances by shortest paths. Here paths "
    "lead along all pairs (r-ANISOMAP), along the smallest connected graph of neighbours, as in "
    "the paper's ISOMAP, or along graphs of 4 to 12 neighbours; or distances are not replaced. "
    "Where the smallest connected graph has more neighbours than k, it takes the place of k.",
    needs=RUNS,
)
def ablations(_: Settings, tables: Tables) -> Iterator[Table]:
    """Average the scores of all variants."""
    scores = tables_of("ablations", tables, "ablation-scores", "Scores of all runs.")
    rows: list[Row] = []
    for run, found in by(scores.records(), "run").items():
        means = mean_by(found, "edges", "mantel_r")
        smallest = float(np.median([row["k"] for row in found if row["edges"] == SMALLEST]))
        rows.append((run, smallest, *(means[edges] for edges in _EDGES)))
    yield Table("ablations", "Mean Mantel r.", ABLATIONS_COLUMNS, rows)
    yield scores
