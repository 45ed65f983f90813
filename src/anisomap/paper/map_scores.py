"""Maps of the runs by all methods, scores, and estimates of statistics over runs."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t

from anisomap.drawing.figures.backend import load
from anisomap.drawing.figures.charts import METHOD_LOOKS
from anisomap.drawing.figures.maps import map_panel, truth_panel
from anisomap.drawing.view import Panel
from anisomap.evaluation import Mantel, Score, score
from anisomap.method.named import MethodOptions
from anisomap.method.pipeline import reconstruct_from
from anisomap.numerics.precision import Reals
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.numerics.similarity.correlation import pearson
from anisomap.numerics.similarity.information import mutual_information
from anisomap.paper.cases import METHODS, true_positions
from anisomap.paper.experiment import Row, Settings
from anisomap.paper.shapes import cylinder_shape, sphericity
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

MORE_BINS = (6, 8)
"""Other numbers of bins in the paper."""

SMACOF = SmacofOptions(solver="majorization")
"""The paper's algorithm for its methods."""


def similarity_of(recording: Recording, method: str, bins: int = DEFAULT_BINS) -> Reals:
    """Compute the similarity of sensors by a method of the paper, (N, N); 0 if constant."""
    varying = recording.varying()
    readings = recording.readings[:, varying]
    found = pearson(readings) if method == "r-anisomap" else mutual_information(readings, bins)
    similarity = np.eye(recording.n_sensors, dtype=found.dtype)
    similarity[np.ix_(varying, varying)] = found
    return similarity


class ScoredMap(NamedTuple):
    """A map and its score."""

    sensor_map: SensorMap
    score: Score


def map_and_score(
    recording: Recording,
    method: str,
    dimensions: int,
    *,
    permutations: int = 0,
    exclude: Iterable[str] = (),
    mu: float = 1.0,
    similarity: Reals | None = None,
) -> ScoredMap:
    """Reconstruct a map and score it against the true positions of the recording.

    Maps in 2D are compared with the first two coordinates of the true positions. The similarity of
    all pairs is computed if not given.
    """
    sensor_map = reconstruct_from(
        similarity=similarity_of(recording, method) if similarity is None else similarity,
        method=method,
        dimensions=dimensions,
        options=MethodOptions(regularisation=mu),
        names=recording.names,
        drop=[recording.names[i] for i in np.flatnonzero(~recording.varying())],
    )
    truth, units = true_positions(recording, dimensions), recording.units
    return ScoredMap(
        sensor_map,
        score(sensor_map, truth, exclude=exclude, units=units, permutations=permutations),
    )


def draw_run(
    recording: Recording,
    settings: Settings,
    dimensions: Iterable[int] = (3,),
    methods: Iterable[str] = METHODS,
    labels: Mapping[int, str] | None = None,
) -> tuple[list[Panel], list[ScoredMap]]:
    """Draw the true positions, and the maps by all methods, in each number of dimensions.

    labels: Labels of sensors that are left out of the scores.
    """
    panels: list[Panel] = []
    found: list[ScoredMap] = []
    left_out = [recording.names[i] for i in labels or ()]
    for k in dimensions:
        truth = true_positions(recording, k)
        panels.append(
            truth_panel(
                "true positions",
                truth,
                units=recording.units,
                on_maps=recording.varying(),
                excluded=np.isin(recording.names, left_out),
                labels=labels,
            )
        )
        for method in methods:
            scored = map_and_score(recording, method, k, exclude=left_out, mu=settings.mu)
            title = f"{METHOD_LOOKS[method].label}, r = {scored.score.mantel.r:.3f}"
            panels.append(map_panel(title, *scored, truth, labels=labels))
            found.append(scored)
    return panels, found


_NULL = {
    "whislo": "lower whisker, 1.5 interquartile ranges",
    "q1": "first quartile",
    "med": "median",
    "q3": "third quartile",
    "whishi": "upper whisker",
}
SCORE_COLUMNS = {
    "run": "body and scenario, the patch or real skin; dimensions of its maps if there are several",
    "seed": "seed of the run",
    "method": "method",
    "dimensions": "dimensions of the map",
    "bins": "bins per sensor for entropies",
    "zeros": "share of the readings of the sensors that vary that are 0",
    "mantel_r": "Mantel r of the map with the true positions",
    **{
        f"null_{key}": f"null distribution of Mantel r (random relabelling): {meaning}"
        for key, meaning in _NULL.items()
    },
    "null_max": "null distribution: maximum",
    "z": "Mantel r minus the mean of its null distribution, in standard deviations of it",
    "null_outliers": "null distribution: all values beyond the whiskers, separated by spaces",
    "rms_in_spacings": "RMS error after alignment, in distances between neighbouring sensors",
    "neighbours_kept": "share of the six true nearest neighbours that are nearest on the map",
    "sphericity": "RMS distance of the sensors in 3D from the best plane minus that from the best "
    "sphere, relative to what a whole sphere has: 1 on a sphere, 0 on a plane",
    "axial_scale": "cylinder in 3D: axial scale divided by radial scale of the map aligned with "
    "the true positions; below 1: compressed along the axis",
    "local_axial_scale": "cylinder in 3D: distance of axial neighbours divided by distance of "
    "circumferential neighbours, relative to the true ratio; below 1: compressed along the axis",
    "order_around": "cylinder in 3D: share of the lines parallel to the axis that are beside the "
    "right ones; chance gives 0.22",
    "order_along": "cylinder in 3D: rank correlation of distances on the map with true distances "
    "within these lines; chance gives 0",
    "stress": "Stress-1 of the scaling",
    "iterations": f"iterations of the scaling; {SMACOF.max_iterations:,} if it stopped before it "
    "converged",
}


def score_rows(
    name: Callable[[int], str],
    recording: Recording,
    seed: int,
    dimensions: Iterable[int],
    settings: Settings,
    *,
    exclude: Iterable[str] = (),
    more_bins: Iterable[int] = MORE_BINS,
) -> Iterator[Row]:
    """Score every method on a recording; yield rows of `SCORE_COLUMNS`.

    Methods with bins are also scored with the numbers of bins in `more_bins`, without a null
    distribution.

    name: Returns the name of the run for a number of dimensions.
    """
    excluded, all_bins = list(exclude), (DEFAULT_BINS, *more_bins)
    is_cylinder = recording.metadata.get("body") == "cylinder"
    correlation = similarity_of(recording, "r-anisomap")
    zeros = float((recording.readings[:, recording.varying()] == 0).mean())
    information = {bins: similarity_of(recording, "isomap", bins) for bins in all_bins}
    for k in dimensions:
        for method in METHODS:
            by_bins = {DEFAULT_BINS: correlation} if method == "r-anisomap" else information
            for bins, similarity in by_bins.items():
                found, result = map_and_score(
                    recording,
                    method,
                    k,
                    permutations=settings.permutations if bins == DEFAULT_BINS else 0,
                    exclude=excluded,
                    mu=settings.mu,
                    similarity=similarity,
                )
                mapped = found.positions[result.sensors]
                shape: Row = (math.nan,) * 4
                if is_cylinder and k == 3:
                    shape = cylinder_shape(mapped, result.truth)
                yield (
                    *(name(k), seed, method, k, bins, zeros, result.mantel.r),
                    *_null_cells(result.mantel),
                    *(result.rms_in_spacings, result.neighbours_kept),
                    *(sphericity(mapped) if k == 3 else math.nan, *shape),
                    *(found.stress, found.n_iterations),
                )


def stopped(rows: Iterable[Mapping[str, Any]]) -> str:
    """Count the scalings in score rows that did not converge, by method."""
    counts = Counter(r["method"] for r in rows if r["iterations"] >= SMACOF.max_iterations)
    return ", ".join(f"{method} {count}" for method, count in counts.items()) or "none"


def null_box(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the box plot of a null distribution from a row of `SCORE_COLUMNS`."""
    outliers = [float(value) for value in str(row["null_outliers"]).split()]
    return {key: row[f"null_{key}"] for key in _NULL} | {"fliers": outliers}


def _null_cells(mantel: Mantel) -> Row:
    null = mantel.null
    if not null.size:
        return (*[math.nan] * 7, "")
    (box,) = load("matplotlib.cbook").boxplot_stats(null)  # whiskers as in the paper's Figure 3
    outliers = " ".join(f"{value:.4f}" for value in np.sort(box["fliers"]))
    z = (mantel.r - float(null.mean())) / float(null.std())
    return (*(float(box[key]) for key in _NULL), float(null.max()), z, outliers)


_ERROR = 0.05  # probability of error of an interval, and of all cases of a claim together
_RESAMPLES = 1000

Runs: TypeAlias = NDArray[np.float64]
"""A value of each run, (S, ...), in the same order for all methods; NaN if a map is at chance."""


@dataclass(frozen=True)
class Estimate:
    """A statistic over runs with its interval, or the range of the runs.

    error: Standard error; 0 for a single run.
    """

    value: float
    low: float
    high: float
    error: float = 0.0
    n_runs: int = 1

    def p_value(self, bound: float) -> float:
        """Two-sided p-value of a bound; 0 for a single run, which has no error."""
        if not self.error:
            return 0.0
        return float(2 * t.sf(abs(self.value - bound) / self.error, self.n_runs - 1))


def estimate(runs: Runs, statistic: Callable[[Runs], Runs] | None = None) -> Estimate:
    """Estimate the mean of runs, or another statistic by resampling of runs. runs (S, ...).

    statistic: Takes samples of runs, (B, S, ...), and returns a value for each sample, (B,).
    """
    n_runs = len(runs)
    if statistic is None:
        value = float(runs.mean())
        error = float(runs.std(ddof=1)) / math.sqrt(n_runs) if n_runs > 1 else 0.0
    else:
        value = float(statistic(runs[None])[0])
        drawn = np.random.default_rng(0).integers(n_runs, size=(_RESAMPLES, n_runs))
        error = float(np.nanstd(statistic(runs[drawn])))
    half = error * float(t.isf(_ERROR / 2, n_runs - 1)) if error else 0.0
    return Estimate(value, value - half, value + half, error, n_runs)


def holm(p_values: Sequence[float]) -> list[bool]:
    """Mark the hypotheses that Holm's step-down procedure rejects."""
    found = [False] * len(p_values)
    for i, place in enumerate(np.argsort(p_values, kind="stable")):
        if p_values[place] > _ERROR / (len(p_values) - i):
            break
        found[place] = True
    return found
