"""Maps of the runs by all methods, their scores, and statistics of their shapes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist, pdist
from scipy.stats import spearmanr

from anisomap.base.defaults import DEFAULT_BINS
from anisomap.drawing.figures.charts import METHOD_LOOKS
from anisomap.drawing.figures.maps import map_panel, truth_panel
from anisomap.drawing.view import Panel
from anisomap.evaluation import Mantel, Score, align, score
from anisomap.method.evidence import PairStatistics, compare
from anisomap.method.named import find_method
from anisomap.method.options import MethodOptions
from anisomap.method.pipeline import dissimilarities
from anisomap.method.reconstruction import reconstruct, reconstruct_from
from anisomap.numerics.neighbours import nearest_distances, nearest_others
from anisomap.numerics.precision import Reals
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions
from anisomap.paper.cases import METHODS, true_positions
from anisomap.paper.experiment import Row, Settings
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

_EQUAL = 1e-6  # largest difference of coordinates on one line of a lattice, in metres


def straightness(positions: ArrayLike, truth: ArrayLike) -> float:
    """Measure how straight the straight lines of sensors are on a map: 1 is straight.

    positions (N, k), truth (N, 3). For triples of sensors of which one is midway between the
    others, at least half as far apart as the farthest: the mean ratio of the distance of the outer
    sensors to that through the middle one; 0.71 for a semicircle, NaN without triples.
    """
    points, true = np.asarray(positions, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    first, last = np.triu_indices(len(true), 1)
    off, middle = map(np.asarray, KDTree(true).query((true[first] + true[last]) / 2))
    inside = off < _EQUAL
    lengths = np.linalg.norm(true[first] - true[last], axis=1)
    inside &= lengths >= lengths[inside].max(initial=0) / 2
    a, b, c = (points[index[inside]] for index in (first, middle, last))
    path = np.linalg.norm(b - a, axis=1) + np.linalg.norm(c - b, axis=1)
    return float(np.mean(np.linalg.norm(c - a, axis=1) / path)) if inside.any() else math.nan


class CylinderShape(NamedTuple):
    """Shape and topology of a map of a cylinder with sensors on lines parallel to its axis.

    All are 1 if correct; `SCORE_COLUMNS` describes them. Scales do not depend on the alignment,
    except the axial scale; orders do not depend on the scale along the axis.
    """

    axial_scale: float
    local_axial_scale: float
    order_around: float
    order_along: float


def cylinder_shape(positions: ArrayLike, truth: ArrayLike) -> CylinderShape:
    """Measure what the paper's Figure 4 shows. positions (N, 3), truth (N, 3)."""
    points, true = np.asarray(positions, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    true = true - true.mean(axis=0)
    aligned = align(points, true).aligned
    outwards = true[:, :2] / np.linalg.norm(true[:, :2], axis=1, keepdims=True)
    axial = float(aligned[:, 2] @ true[:, 2] / (true[:, 2] @ true[:, 2]))
    radial = float(np.mean((aligned[:, :2] * outwards).sum(axis=1)))
    radius = float(np.linalg.norm(true[:, :2], axis=1).mean())
    angles = np.arctan2(true[:, 1], true[:, 0]) % (2 * np.pi - _EQUAL)
    labels = np.unique(np.round(angles / _EQUAL), return_inverse=True)[1]
    lines = [np.flatnonzero(labels == label) for label in range(labels.max() + 1)]
    centroids = np.array([points[line].mean(axis=0) for line in lines])
    _, nearest = nearest_others(centroids, 2)
    steps = (nearest - np.arange(len(lines))[:, None]) % len(lines)
    along = [spearmanr(_rounded(points[line]), _rounded(true[line])).statistic for line in lines]
    return CylinderShape(
        axial / (radial / radius),
        _neighbour_ratio(points, true) / _neighbour_ratio(true, true),
        float(np.isin(steps, [1, len(lines) - 1]).mean()),
        float(np.mean(along)),
    )


def _rounded(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute distances in which ties are exact."""
    distances = pdist(points)
    return np.asarray(np.round(distances / distances.max(), 6))


def _neighbour_ratio(points: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    """Divide the mean distance of axial neighbours by that of circumferential neighbours."""
    axial = _mean_step(points, truth[:, :2], truth[:, 2:])
    return axial / _mean_step(points, truth[:, 2:], truth[:, :2])


def _mean_step(
    points: NDArray[np.float64], same: NDArray[np.float64], other: NDArray[np.float64]
) -> float:
    """Mean distance of points that are equal in `same` and nearest neighbours in `other`."""
    apart = cdist(other, other)
    line = (cdist(same, same) < _EQUAL) & (apart > _EQUAL)
    nearest = line & (apart < np.min(apart, axis=1, where=line, initial=np.inf)[:, None] + _EQUAL)
    return float(np.mean(cdist(points, points)[nearest]))


def isolation(positions: ArrayLike, sensor: int) -> float:
    """Measure how far a sensor lies from all others on a map. positions (n, k)."""
    points = np.asarray(positions, dtype=np.float64)
    nearest = nearest_distances(points)
    return float(nearest[sensor] / np.median(np.delete(nearest, sensor)))


def compared(recording: Recording, method: str, bins: int = DEFAULT_BINS) -> PairStatistics:
    """Compare the sensors that vary by the similarity of a method of the paper."""
    varying = recording.select(recording.varying())
    return compare([varying], find_method(method).similarity, bins=bins, with_noise=False)


def published_similarity(recording: Recording, method: str, bins: int = DEFAULT_BINS) -> Reals:
    """Compute the similarity of all sensors by a method of the paper, (N, N); constant ones: 0."""
    varying, found = recording.varying(), compared(recording, method, bins).similarity
    similarity = np.eye(recording.n_sensors, dtype=found.dtype)
    similarity[np.ix_(varying, varying)] = found
    return similarity


def published_metric(recording: Recording, method: str) -> Reals:
    """Compute the metric of the sensors that vary by a method of the paper. Returns (n, n)."""
    return find_method(method).metric(dissimilarities(compared(recording, method), method))


def spectrum(metric: ArrayLike) -> NDArray[np.float64]:
    """Compute the variances of classical scaling. metric (N, N) -> (N,)."""
    squares = np.asarray(metric, dtype=np.float64) ** 2
    rows = squares.mean(axis=0)
    inner = -(squares - np.add.outer(rows, rows) + rows.mean()) / 2
    return np.linalg.eigvalsh(inner)[::-1]


def n_dimensions(variances: ArrayLike) -> int:
    """Choose the number of dimensions by the largest drop in variance.

    Pierce & Kuipers (1997), "Map learning with uninterpreted sensors and effectors", Artificial
    Intelligence 92: 169-227, doi:10.1016/S0004-3702(96)00051-3.
    """
    return int(np.argmax(-np.diff(np.asarray(variances, dtype=np.float64)))) + 1


_WHISKER = 1.5  # interquartile ranges, as in the paper's Figure 3
SMACOF = SmacofOptions(solver="majorization")
"""The paper's algorithm; the default is faster."""


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
    options: MethodOptions | None = None,
    similarity: Reals | None = None,
) -> ScoredMap:
    """Reconstruct a map and score it against the true positions of the recording.

    Positions are scaled by majorization, as in the paper. Maps in 2D are compared with the first
    two coordinates of the true positions. The similarity of all pairs is computed if not given.
    """
    published = replace(options or MethodOptions(), smacof=SMACOF)
    if similarity is None:
        sensor_map = reconstruct(recording, method, dimensions, options=published)
    else:
        constant = [recording.names[i] for i in np.flatnonzero(~recording.varying())]
        sensor_map = reconstruct_from(
            similarity=similarity,
            method=method,
            dimensions=dimensions,
            options=published,
            names=recording.names,
            drop=constant,
        )
    truth, units = true_positions(recording, dimensions), recording.units
    return ScoredMap(
        sensor_map,
        score(sensor_map, truth, exclude=exclude, units=units, permutations=permutations),
    )


def draw_run(
    recording: Recording,
    dimensions: Iterable[int] = (3,),
    methods: Iterable[str] = METHODS,
    labels: Mapping[int, str] | None = None,
) -> tuple[list[Panel], list[ScoredMap]]:
    """Draw the true positions, and beside them the maps by all methods, in each dimension.

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
            scored = map_and_score(recording, method, k, exclude=left_out)
            title = f"{METHOD_LOOKS[method].label}, r = {scored.score.mantel.r:.3f}"
            panels.append(map_panel(title, *scored, truth, labels=labels))
            found.append(scored)
    return panels, found


SCORE_COLUMNS = {
    "run": "body and scenario, or number of the run of the patch",
    "seed": "seed of the run",
    "method": "method",
    "dimensions": "dimensions of the map",
    "bins": "bins per sensor for entropies",
    "mantel_r": "Mantel r of the map with the true positions",
    "null_whisker_low": "null distribution of Mantel r (random relabelling): lower whisker, 1.5 "
    "interquartile ranges",
    "null_quartile_1": "null distribution: first quartile",
    "null_median": "null distribution: median",
    "null_quartile_3": "null distribution: third quartile",
    "null_whisker_high": "null distribution: upper whisker",
    "null_min": "null distribution: minimum",
    "null_max": "null distribution: maximum",
    "null_outliers": "null distribution: all values beyond the whiskers, separated by spaces",
    "permutations": "random relabellings; without any, the null distribution is nan",
    "rms_in_spacings": "RMS error after alignment, in distances between neighbouring sensors",
    "neighbours_kept": "share of the six true nearest neighbours that are nearest on the map",
    "straightness": "straight lines of sensors on the map: distance between the ends divided by "
    "the length of the path through the middle, mean over the lines; 1 is straight",
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
    run: str,
    recording: Recording,
    seed: int,
    dimensions: Iterable[int],
    settings: Settings,
    *,
    exclude: Iterable[str] = (),
    more_bins: Iterable[int] = (),
) -> Iterator[Row]:
    """Score every method on a recording; yield rows of `SCORE_COLUMNS`.

    Methods that bin readings are also scored with the numbers of bins in `more_bins`, without a
    null distribution.
    """
    excluded, more = list(exclude), tuple(more_bins)
    is_cylinder = recording.metadata.get("body") == "cylinder"
    compared: dict[tuple[str, int], Reals] = {}
    for k in dimensions:
        for method in METHODS:
            for bins in (DEFAULT_BINS, *(() if method == "r-anisomap" else more)):
                key = find_method(method).similarity, bins
                if key not in compared:
                    compared[key] = published_similarity(recording, method, bins)
                scored = map_and_score(
                    recording,
                    method,
                    k,
                    permutations=settings.permutations if bins == DEFAULT_BINS else 0,
                    exclude=excluded,
                    options=MethodOptions(entropy_bins=bins),
                    similarity=compared[key],
                )
                result, found = scored.score, scored.sensor_map
                mapped = found.positions[result.sensors]
                shape: Row = (math.nan,) * 4
                if is_cylinder and k == 3:
                    shape = cylinder_shape(mapped, result.truth)
                yield (
                    *(run, seed, method, k, bins, result.mantel.r),
                    *_null_cells(result.mantel),
                    *(result.rms_in_spacings, result.neighbours_kept),
                    *(straightness(mapped, result.truth), *shape),
                    *(found.stress, found.n_iterations),
                )


def stopped(rows: Iterable[Mapping[str, Any]]) -> str:
    """Count the scalings of score rows that stopped before they converged, by method."""
    counts = Counter(r["method"] for r in rows if r["iterations"] >= SMACOF.max_iterations)
    return ", ".join(f"{method} {count}" for method, count in counts.items()) or "none"


_BOX = {
    "whislo": "whisker_low",
    "q1": "quartile_1",
    "med": "median",
    "q3": "quartile_3",
    "whishi": "whisker_high",
}


def null_box(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the box plot of a null distribution from a row of `SCORE_COLUMNS`."""
    outliers = [float(value) for value in str(row["null_outliers"]).split()]
    return {key: row[f"null_{name}"] for key, name in _BOX.items()} | {"fliers": outliers}


def _null_cells(mantel: Mantel) -> Row:
    null = mantel.null
    if not null.size:
        return (*[math.nan] * 7, "", 0)
    first, median, third = np.quantile(null, (0.25, 0.5, 0.75)).tolist()
    reach = _WHISKER * (third - first)
    is_inside = (null >= first - reach) & (null <= third + reach)
    low, high = float(null[is_inside].min()), float(null[is_inside].max())
    outliers = " ".join(f"{value:.4f}" for value in np.sort(null[~is_inside]))
    extremes = (float(null.min()), float(null.max()))
    return (low, first, median, third, high, *extremes, outliers, null.size)
