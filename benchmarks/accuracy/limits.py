"""What real recordings allow the default method to reach.

One table shows, beside the default map of each recording,

- the map if the method starts from the true positions: where it is no better, a better start does
  not help, and only another model could do better;
- Mantel r between the true distances and the decreasing function of the similarity that predicts
  them best (isotonic regression): how far the similarity itself is a function of distance;
- Mantel r of the maps of both halves of the recording with each other, and of each with the truth.

The other shows what maps of electrodes are worth by the length of the recording, whose first
eighth, quarter, half and whole are mapped: beside r-ANISOMAP and the best stock method, and with
the verdict, which is made without the positions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist
from sklearn.isotonic import IsotonicRegression

import anisomap
from anisomap.base import DEFAULT_METHOD
from anisomap.evaluation import mantel
from anisomap.method.configuration import best_scale
from anisomap.method.evidence import Evidence
from anisomap.method.named import METHODS, MethodOptions
from anisomap.method.refinement import refine
from anisomap.recording import Recording
from benchmarks.accuracy.compare import MIN_TOUCHES, compare_methods, spanned_dimensions, touched
from benchmarks.accuracy.rivals import RIVALS
from benchmarks.harness import files_in, keyed_table, markdown_table, measured, options, publish
from benchmarks.skins.corrections import read_corrected

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
    """Measure all recordings and write the tables."""
    chosen = options(__doc__, "quality", workers=True).parse_args(arguments)
    files = files_in(chosen.recordings)
    limits = measured(limits_of, files, chosen.workers)
    publish(chosen.output, "limits", limits, limits_table(limits))
    electrodes = [path for path in files if path.stem.startswith(ELECTRODES)]
    rows = measured(electrodes_of, electrodes, chosen.workers)
    publish(chosen.output, "neural", rows, electrodes_table(rows))


def limits_of(path: Path) -> list[Limits]:
    """Measure one recording with known positions."""
    recording = read_corrected(path)
    truth = np.asarray(recording.positions)
    k = spanned_dimensions(truth)
    active = np.flatnonzero(touched(recording, MIN_TOUCHES))
    made = anisomap.reconstruct(recording.select(active), dimensions=k)
    largest = made.component == 0
    part, places = recording.select(active[largest]), truth[active[largest]]
    similarity, from_truth = _map_from(part, places)
    default = _r(made.positions[largest], places)
    started = math.nan if from_truth is None else _r(from_truth, places)
    function = _isotonic(similarity, places)
    size = len(places), recording.n_frames, k
    return [Limits(path.stem, *size, default, started, function, *_halves(part, places, k))]


def _map_from(part: Recording, places: Array) -> tuple[Array, Array | None]:
    """Return the similarity, and the default map if its refinement starts from given places.

    There is no such map if the links of the part alone do not connect all its sensors.
    """
    recipe, options = METHODS[DEFAULT_METHOD], MethodOptions()
    evidence = Evidence.of(
        part, recipe.similarity_of(part), bins=options.entropy_bins, with_variance=True
    )
    metric = np.asarray(recipe.lengths_of(evidence, options))
    similarity: Array = np.asarray(evidence.similarity)
    if not np.isfinite(metric).all():
        return similarity, None
    start = places * best_scale(places, metric)[0]
    refined = refine(evidence, metric, start, options.covariogram)
    found: Array = start if refined is None else np.asarray(refined.positions)
    return similarity, found


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


def limits_table(results: Sequence[Limits]) -> str:
    """Format the results as a table."""
    rows = []
    for found in results:
        name, sensors, frames, k, *values = astuple(found)
        cells = (f"{value:.3f}" if math.isfinite(value) else "-" for value in values)
        rows.append((name, f"{sensors} x {frames}", f"{k}D", *cells))
    return "\n".join(markdown_table(HEADER, rows)) + "\n"


ELECTRODES = ("eeg", "retina")
SHARES = tuple(Fraction(1, part) for part in (8, 4, 2, 1))


@dataclass(frozen=True)
class Electrodes:
    """Scores of the maps of the beginning of a recording.

    r, error, kept: Mantel r, RMS error in spacings and share of neighbours kept, by default.
    level, expected: The verdict, and the error in spacings that it expects.
    """

    recording: str
    frames: int
    dimensions: int
    scored: int
    r: float
    error: float
    kept: float
    level: str
    expected: float
    paper: float
    stock: str
    stock_r: float


def electrodes_of(path: Path) -> list[Electrodes]:
    """Map the beginnings of a recording."""
    whole = anisomap.read(path)
    rows = []
    for share in SHARES:
        n_frames = int(whole.n_frames * share)
        part = anisomap.Recording(
            whole.readings[:n_frames], positions=whole.positions, rate_hz=whole.rate_hz
        )
        compared = compare_methods(part, (DEFAULT_METHOD, "r-anisomap", *RIVALS))
        own, paper, *_ = compared.scores
        stock = compared.best(stock=True)
        if own.sensor_map is None or stock is None:
            print(f"skipped {n_frames} frames of {path.stem}: {own.reason}")
            continue
        mapped = part.select([part.names.index(name) for name in own.sensor_map.names])
        verdict = anisomap.diagnose(own.sensor_map, mapped, rng=0).verdict
        kept = anisomap.score(own.sensor_map, mapped, permutations=0).neighbours_kept
        rows.append(
            Electrodes(path.stem, n_frames, compared.dimensions, len(compared.sensors),
                       own.mantel_r, own.rms_in_spacings, kept, verdict.level,
                       verdict.expected_error, paper.mantel_r, stock.method, stock.mantel_r)
        )  # fmt: skip
    return rows


def electrodes_table(rows: Sequence[Electrodes]) -> str:
    """Format the rows as a table."""
    cells = (
        {
            "recording": row.recording,
            "frames": f"{row.frames:,}",
            "map": f"{row.dimensions}D",
            "scored": row.scored,
            "default": f"{row.r:.3f}",
            "error": f"{row.error:.2f}",
            "neighbours kept": f"{row.kept:.0%}",
            "verdict": row.level,
            "expected error": f"{row.expected:.2f}",
            "r-anisomap": f"{row.paper:.3f}",
            "best stock method": f"{row.stock_r:.3f} ({row.stock})",
        }
        for row in rows
    )
    return "\n".join(keyed_table(cells)) + "\n"


if __name__ == "__main__":
    main()
