"""The runs of the paper: six simulated, five on the patch; their maps, and how good those are."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.drawing.figures.charts import METHOD_LOOKS, NullBox
from anisomap.evaluation import Mantel, Score, score
from anisomap.methods import MethodOptions
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.paper.experiment import Row, Settings
from anisomap.paper.measures import axial_scale, spread_of_radii
from anisomap.reconstruction import reconstruct
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap
from anisomap.simulation import dead, saturating, simulate

METHODS = tuple(METHOD_LOOKS)
"""The paper's methods, in the one order that all figures and tables have."""

_WHISKER = 1.5  # times the distance between the quartiles, as in the paper's Figure 3


@dataclass(frozen=True)
class Case:
    """A body, and what happens to it.

    Attributes
    ----------
    name : str
    body, scenario : str
        Names in `anisomap.simulation.BODIES` and `SCENARIOS`.
    label : str
        For figures.
    """

    name: str
    body: str
    scenario: str
    label: str

    def record(self, settings: Settings, seed: int, **parameters: Any) -> Recording:
        """Simulate it; `parameters` may hold ``n_frames``."""
        if not parameters:
            return _simulated(self.body, self.scenario, seed, settings.n_frames)
        chosen = {"n_frames": settings.n_frames, **parameters}
        return simulate(self.body, self.scenario, seed=seed, **chosen)


@lru_cache(maxsize=64)  # many experiments look at the same runs
def _simulated(body: str, scenario: str, seed: int, n_frames: int) -> Recording:
    return simulate(body, scenario, seed=seed, n_frames=n_frames)


BOMBARDED = (
    Case("sphere-bombardment", "sphere", "bombardment", "sphere,\nbombardment"),
    Case("cylinder-bombardment", "cylinder", "bombardment", "cylinder,\nbombardment"),
    Case("y-shape-bombardment", "y-shape", "bombardment", "Y-shape,\nbombardment"),
    Case("plane-bombardment", "plane", "bombardment", "plane,\nbombardment"),
)
ROLLED = (
    Case("sphere-locomotion", "sphere", "locomotion", "sphere,\nlocomotion"),
    Case("cylinder-locomotion", "cylinder", "locomotion", "cylinder,\nlocomotion"),
)
CASES = (*BOMBARDED, *ROLLED)

PATCH_FRAMES = (1120, 1054, 1487, 2128, 2105)
"""Frames of the paper's five runs on the patch."""

SILENT = tuple(f"t5p{pad}" for pad in range(12) if pad not in (6, 10))
"""The triangle that never answers."""

FAILING = "t3p0"
"""The patch's sensor 30, counted from 0, as the paper's."""

FIRST_FAILED_RUN = 4


def patch_run(settings: Settings, number: int, **failure: float) -> Recording:
    """Rub the twin of the hardware patch.

    Parameters
    ----------
    settings : Settings
    number : int
        1 to 5. Run and seed decide how it is rubbed; a triangle is silent in all runs, and from
        run 4 on one sensor saturates now and then.
    **failure
        Parameters of `anisomap.simulation.saturating`.

    Returns
    -------
    Recording
        Of the 60 sensors of six triangles; positions in mm.
    """
    frames = PATCH_FRAMES[number - 1]
    seed = settings.seed + number - 1
    n_frames = frames // 8 if settings.quick else frames
    recording = dead(_simulated("hexagon", "rubbing", seed, n_frames), SILENT)
    if number >= FIRST_FAILED_RUN:
        recording = saturating(recording, [FAILING], rng=seed, **failure)
    return replace(
        recording,
        positions=1e3 * truth_of(recording),
        units="mm",
        source=f"simulated patch, run {number}, seed {seed}",
    )


@dataclass(frozen=True, eq=False)
class Scored:
    """A map and its score."""

    sensor_map: SensorMap
    score: Score


def make_map(
    recording: Recording,
    method: str,
    dimensions: int,
    *,
    permutations: int = 0,
    exclude: Iterable[str] = (),
    options: MethodOptions | None = None,
) -> Scored:
    """Make a map and score it against the true positions that the recording knows.

    In two dimensions the truth is flat, too: the first two coordinates of a flat skin.
    """
    found = reconstruct(
        recording,
        method,
        dimensions,
        options=options,
    )
    result = score(
        found,
        truth_of(recording, dimensions),
        exclude=exclude,
        units=recording.units,
        permutations=permutations,
    )
    return Scored(found, result)


def truth_of(recording: Recording, dimensions: int = 3) -> NDArray[np.float64]:
    """Give true positions, shape (N, k); `dimensions` at the most."""
    if recording.positions is None:
        raise ValueError(f"{recording.source} knows no positions")
    return recording.positions[:, :dimensions]


SCORE_COLUMNS = {
    "run": "which run: body and scenario, or number of the run on the patch",
    "seed": "seed of the run",
    "method": "method",
    "dimensions": "of the space that was mapped into",
    "bins": "bins a sensor for entropies",
    "mantel_r": "Mantel r of the map with the true positions",
    "null_whisker_low": "Mantel r after relabelling at random: lower whisker, 1.5 IQR",
    "null_quartile_1": "the same, first quartile",
    "null_median": "the same, median",
    "null_quartile_3": "the same, third quartile",
    "null_whisker_high": "the same, upper whisker",
    "null_least": "the same, least",
    "null_most": "the same, greatest",
    "permutations": "random relabellings; the null is nan if there were none",
    "rms_in_spacings": "RMS error after alignment, in distances between neighbouring sensors",
    "neighbours_kept": "share of the six true nearest neighbours that are nearest on the map",
    "spread_of_radii": "standard deviation over mean of the distances from the map's centroid",
    "true_spread_of_radii": "the same of the true positions",
    "axial_scale": "of a cylinder in 3D: scale along the axis over scale away from it, of the map "
    "laid onto the truth; below 1 it is compressed along the axis",
    "local_axial_scale": "of a cylinder in 3D: distance between neighbours along the axis over "
    "that of neighbours around it, against the truth; below 1, those along it are too close",
    "stress": "Stress-1 of the scaling",
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
    """Score every method on a recording, a row of `SCORE_COLUMNS` each.

    With `more_bins`, methods that bin readings are scored with those, too, without a null.
    """
    left_out = list(exclude)
    for k in dimensions:
        for method in METHODS:
            binned = () if method == "r-anisomap" else tuple(more_bins)
            for bins in (DEFAULT_BINS, *binned):
                scored = make_map(
                    recording,
                    method,
                    k,
                    permutations=settings.permutations if bins == DEFAULT_BINS else 0,
                    exclude=left_out,
                    options=MethodOptions(bins=bins),
                )
                yield (
                    run,
                    seed,
                    method,
                    k,
                    bins,
                    *_score_cells(scored, recording.metadata.get("body")),
                )


def null_box(row: dict[str, Any]) -> NullBox:
    """Give the box plot of a null from a row of `SCORE_COLUMNS`."""
    low, high = row["null_whisker_low"], row["null_whisker_high"]
    beyond = (row["null_least"], row["null_most"])
    return NullBox(
        low,
        row["null_quartile_1"],
        row["null_median"],
        row["null_quartile_3"],
        high,
        tuple(value for value in beyond if not low <= value <= high),
    )


def _score_cells(scored: Scored, body: object) -> Row:
    result = scored.score
    return (
        result.mantel.r,
        *_null_cells(result.mantel),
        result.rms_in_spacings,
        result.neighbours_kept,
        spread_of_radii(scored.sensor_map.positions[result.sensors]),
        spread_of_radii(result.truth),
        *_axial_cells(scored, body),
        scored.sensor_map.stress,
    )


def _axial_cells(scored: Scored, body: object) -> Row:
    if body != "cylinder" or scored.sensor_map.dimensions != 3:
        return (math.nan, math.nan)
    sensors = scored.score.sensors
    scale = axial_scale(scored.sensor_map.positions[sensors], scored.score.truth)
    return (scale.whole, scale.local)


def _null_cells(mantel: Mantel) -> Row:
    null = mantel.null
    if not null.size:
        return (*[math.nan] * 7, 0)
    first, middle, third = np.quantile(null, (0.25, 0.5, 0.75)).tolist()
    reach = _WHISKER * (third - first)
    inside = null[(null >= first - reach) & (null <= third + reach)]
    low, high = float(inside.min()), float(inside.max())
    return (low, first, middle, third, high, float(null.min()), float(null.max()), null.size)
