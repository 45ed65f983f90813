"""What recordings allow the default method to reach (part of ``make quality``).

The table shows, beside the default map of each real recording,

- the map if the method starts from the true positions: where it is no better, a better start does
  not help, and only another model could do better;
- Mantel r between the true distances and the decreasing function of the similarity that predicts
  them best (isotonic regression): how far the similarity itself is a function of distance;
- Mantel r of the maps of both halves of the recording with each other, and of each with the truth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist, squareform
from sklearn.isotonic import IsotonicRegression

import anisomap
from anisomap.base.defaults import DEFAULT_METHOD, MIN_TOUCHES
from anisomap.comparison import spanned_dimensions, touched
from anisomap.evaluation import mantel
from anisomap.evidence import compare
from anisomap.mapping import Configuration, dissimilarities, refine_components
from anisomap.methods import METHODS
from anisomap.options import MethodOptions
from anisomap.recording import Recording
from benchmarks.harness import files_in, markdown_table, options, stream

FRAMES_FOR_HALVES = 1000
"""Shorter recordings are not halved: their halves hold too few contacts for a map."""

HEADER = (
    "recording", "sensors x frames", "map", "default", "started from the truth",
    "function of the similarity", "first half", "second half", "between halves",
)  # fmt: skip

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Limits:
    """Mantel r, with the truth unless stated otherwise; NaN where it was not measured."""

    recording: str
    n_sensors: int
    n_frames: int
    dimensions: int
    default: float
    started_from_truth: float
    function_of_similarity: float
    first_half: float
    second_half: float
    between_halves: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure all recordings and write the table."""
    chosen = options(__doc__, "quality").parse_args(arguments)
    found = (limits_of(anisomap.read(path), path.stem) for path in files_in(chosen.recordings))
    results = stream(chosen.output / "limits.csv", found)
    (chosen.output / "limits-table.md").write_text(markdown(results), encoding="utf-8")


def limits_of(recording: Recording, name: str) -> Limits:
    """Measure one recording with known positions."""
    truth = np.asarray(recording.positions)
    k = spanned_dimensions(truth)
    active = np.flatnonzero(touched(recording, MIN_TOUCHES))
    made = anisomap.reconstruct(recording.select(active), dimensions=k)
    largest = made.component == 0
    part, places = recording.select(active[largest]), truth[active[largest]]
    similarity, from_truth = _map_from(part, places)
    first, second, between = _halves(part, places, k)
    return Limits(
        name,
        len(places),
        recording.n_frames,
        k,
        default=_r(made.positions[largest], places),
        started_from_truth=_r(from_truth, places),
        function_of_similarity=_isotonic(similarity, places),
        first_half=first,
        second_half=second,
        between_halves=between,
    )


def _map_from(part: Recording, places: Array) -> tuple[Array, Array]:
    """Return the similarity, and the default map if its refinement starts from given places."""
    recipe, options = METHODS[DEFAULT_METHOD], MethodOptions(split_unrelated=False)
    pairs = compare(
        [part], recipe.similarity_of([part]), bins=options.entropy_bins, with_noise=True
    )
    metric = np.asarray(recipe.metric(dissimilarities(pairs, DEFAULT_METHOD, options)))
    start = Configuration(
        positions=places * (squareform(metric, checks=False).mean() / pdist(places).mean()),
        component=np.zeros(len(places), dtype=np.intp),
        stress=math.nan,
        converged=True,
        n_iterations=0,
    )
    refined = refine_components(recipe.refinements, pairs, metric, start, options)
    return np.asarray(pairs.similarity), np.asarray(refined.positions)


def _isotonic(similarity: Array, places: Array) -> float:
    """Return how well the best decreasing function of the similarity predicts distances."""
    upper = np.triu_indices(len(places), 1)
    distances = pdist(places)
    predicted = IsotonicRegression(increasing=False).fit_transform(similarity[upper], distances)
    return float(np.corrcoef(predicted, distances)[0, 1])


def _halves(part: Recording, places: Array, k: int) -> tuple[float, float, float]:
    """Return Mantel r of the maps of both halves with the truth and with each other."""
    if part.n_frames < FRAMES_FOR_HALVES:
        return math.nan, math.nan, math.nan
    middle = part.n_frames // 2
    first, second = (
        anisomap.reconstruct(half, dimensions=k)
        for half in (part.readings[:middle], part.readings[middle:])
    )
    both = (first.component == 0) & (second.component == 0)
    a, b, truth = first.positions[both], second.positions[both], places[both]
    return _r(a, truth), _r(b, truth), _r(a, b)


def _r(first: Array, second: Array) -> float:
    return mantel(first, second, permutations=0).r


def markdown(results: Sequence[Limits]) -> str:
    """Format the results as a table."""
    rows = []
    for found in results:
        name, sensors, frames, k, *values = astuple(found)
        cells = (f"{value:.3f}" if math.isfinite(value) else "-" for value in values)
        rows.append((name, f"{sensors} x {frames}", f"{k}D", *cells))
    return "\n".join(markdown_table(HEADER, rows)) + "\n"


if __name__ == "__main__":
    main()
