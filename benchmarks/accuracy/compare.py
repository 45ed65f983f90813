"""Several methods on one recording with known positions, scored on the same sensors."""

from __future__ import annotations

import csv
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import StringIO

import numpy as np
from numpy.typing import NDArray

from anisomap import AnisomapWarning, Recording, SensorMap, reconstruct, score
from anisomap.base import DEFAULT_METHOD
from anisomap.errors import InputError
from anisomap.evaluation.mantel_r import MIN_SENSORS_COMPARED
from anisomap.method.named import METHODS, PAPER_METHODS
from benchmarks.accuracy.rivals import RIVALS, map_by_rival

COMPARED = (DEFAULT_METHOD, *PAPER_METHODS, *RIVALS)
"""The default method, the paper's methods, and the stock methods."""

MIN_TOUCHES = 5
"""Frames in which a sensor must differ from rest to be compared.

Fewer say almost nothing about its place, and a few such sensors ruin the map of all others; the
value is that of the published comparisons on Nao's skin.
"""

_FACTS = ("recording", "sensors x frames", "map", "scored")
_LEGEND = (
    "Each cell holds Mantel r and, in brackets, the RMS error in spacings of neighbouring sensors. "
    "All methods of a row are scored on the same sensors. Bold marks the best method of anisomap "
    "and the best stock method."
)
_FLAT = 0.02  # relative singular value of positions below which a direction is not spanned
_MIN_SHARE = 0.5  # two maps that both place more than half of the sensors share some of them


@dataclass(frozen=True, eq=False)
class MethodScore:
    """Score of one method.

    Attributes
    ----------
    method : str
        Its name.
    mantel_r, rms_in_spacings : float
        Mantel r, and RMS error in median spacings, over the sensors of the `Comparison`; NaN
        without a score.
    sensor_map : SensorMap or None
        None if the method made no map.
    n_placed : int
        Sensors in the largest component of its map.
    reason : str
        Why there is no score; empty if there is one.
    """

    method: str
    mantel_r: float = math.nan
    rms_in_spacings: float = math.nan
    sensor_map: SensorMap | None = None
    n_placed: int = 0
    reason: str = ""

    @property
    def is_stock(self) -> bool:
        """Whether it is a stock method, not one of anisomap."""
        return self.method not in METHODS


@dataclass(frozen=True, eq=False)
class Comparison:
    """Scores of several methods on one recording.

    Attributes
    ----------
    name : str
        Of the recording.
    n_sensors, n_frames, dimensions : int
        Sensors and frames of the recording; coordinates of the maps.
    sensors : ndarray of int
        Indices of the sensors that were scored, the same for all methods.
    scores : tuple of MethodScore
        In the order of the methods.
    """

    name: str
    n_sensors: int
    n_frames: int
    dimensions: int
    sensors: NDArray[np.intp]
    scores: tuple[MethodScore, ...]

    def best(self, *, stock: bool) -> MethodScore | None:
        """Return the stock method, or the method of anisomap, with the largest Mantel r, if any."""
        scored = [s for s in self.scores if s.is_stock is stock and not math.isnan(s.mantel_r)]
        return max(scored, key=lambda s: s.mantel_r, default=None)

    @property
    def judged(self) -> MethodScore | None:
        """The first method of anisomap: the default method, unless others were chosen."""
        return next((s for s in self.scores if not s.is_stock), None)

    @property
    def margin(self) -> float:
        """Mantel r of `judged` minus that of the best stock method; negative is a loss.

        NaN without a stock method or a method of anisomap; one without a score counts as 0.
        """
        own, stock = self.judged, self.best(stock=True)
        return float(np.nan_to_num(own.mantel_r)) - stock.mantel_r if own and stock else math.nan


def compare_methods(
    recording: Recording,
    methods: Sequence[str] = COMPARED,
    dimensions: int | None = None,
    *,
    name: str = "",
    min_touches: int = MIN_TOUCHES,
    seed: int = 0,
) -> Comparison:
    """Map a recording by several methods, and score all maps on the same sensors.

    Parameters
    ----------
    recording : Recording
        Complete readings, with true positions.
    methods : sequence of str
        Keys of `anisomap.METHODS` and `RIVALS`. A stock method whose library is not installed has
        no score, but a reason.
    dimensions : int, optional
        Number of coordinates; by default as many as the true positions span.
    name : str
        Name of the recording; its source by default.
    min_touches : int
        Sensors that differ from their median reading in fewer frames are left out of all maps.
    seed : int
        Seed of stock methods that are random.

    Returns
    -------
    Comparison
        The sensors scored are those in the largest component of every map. A map whose largest
        component holds at most half of the sensors has no score, so that the failure of one method
        does not decide on which sensors the others are scored.

    Raises
    ------
    InputError
        If the recording has no true positions, or fewer than 4 sensors were touched.
    """
    truth = recording.positions
    if truth is None:
        raise InputError("a comparison of methods requires true positions in the recording")
    kept = np.flatnonzero(touched(recording, min_touches))
    if len(kept) < MIN_SENSORS_COMPARED:
        raise InputError(
            f"a comparison requires at least 4 sensors that differ from rest in {min_touches} "
            f"frames, got {len(kept)}"
        )
    dimensions = dimensions or spanned_dimensions(truth)
    chosen = recording.select(kept)
    made = [_made(chosen, method, dimensions, seed) for method in methods]
    common = np.asarray(np.isfinite(truth[kept]).all(axis=1))
    for one in made:
        if one.sensor_map is not None and not one.reason:
            common &= one.sensor_map.component == 0
    scores = tuple(_scored(one, truth[kept], common) for one in made)
    shape = recording.n_sensors, recording.n_frames
    return Comparison(name or recording.source, *shape, dimensions, kept[common], scores)


def touched(recording: Recording, min_touches: int) -> NDArray[np.bool_]:
    """Select sensors that differ from their median reading in at least `min_touches` frames."""
    readings = recording.readings
    beyond = np.count_nonzero(readings != np.median(readings, axis=0), axis=0)
    return np.asarray(beyond >= min_touches)


def spanned_dimensions(positions: NDArray[np.float64]) -> int:
    """Count the dimensions that positions span: 2 for a flat skin with coordinates in space."""
    known = positions[np.isfinite(positions).all(axis=1)]
    extents = np.linalg.svd(known - known.mean(axis=0), compute_uv=False)
    return max(1, int(np.count_nonzero(extents > _FLAT * extents[0])))


def _made(recording: Recording, name: str, dimensions: int, seed: int) -> MethodScore:
    """Make the map of one method; there is no score yet, but a reason if there will be none."""
    try:
        if name in METHODS:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", AnisomapWarning)  # the notes remain on the map
                sensor_map = reconstruct(recording, name, dimensions)
        else:
            sensor_map = map_by_rival(recording, name, dimensions, seed=seed)
    except (ImportError, InputError) as error:
        return MethodScore(name, reason=str(error))
    n_placed, n_sensors = int(np.count_nonzero(sensor_map.component == 0)), recording.n_sensors
    reason = f"its largest component holds {n_placed} of {n_sensors} sensors"
    if n_placed > _MIN_SHARE * n_sensors:
        reason = ""
    return MethodScore(name, sensor_map=sensor_map, n_placed=n_placed, reason=reason)


def _scored(
    made: MethodScore, truth: NDArray[np.float64], common: NDArray[np.bool_]
) -> MethodScore:
    """Score a map on the sensors that all maps place. truth (N, k), common (N,)."""
    if made.sensor_map is None or made.reason:
        return made
    try:
        found = score(SensorMap(made.sensor_map.positions[common]), truth[common], permutations=0)
    except InputError as error:
        return replace(made, reason=str(error))
    return replace(made, mantel_r=found.mantel.r, rms_in_spacings=found.rms_in_spacings)


def to_markdown(comparisons: Sequence[Comparison]) -> str:
    """Format comparisons of the same methods as a Markdown table, followed by its losses."""
    methods = [s.method for s in comparisons[0].scores]
    lines = [[*_FACTS, *methods], ["---"] * (len(_FACTS) + len(methods))]
    for comparison in comparisons:
        best = [comparison.best(stock=stock) for stock in (False, True)]
        cells = [comparison.name, *_facts(comparison)]
        for s in comparison.scores:
            cell = (
                f"{_number(s.mantel_r, '.3f')} ({s.rms_in_spacings:.2f})" if not s.reason else "-"
            )
            cells.append(f"**{cell}**" if s in best else cell)
        lines.append(cells)
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    stock = "; ".join(f"{m}: {RIVALS[m].summary}" for m in methods if m in RIVALS)
    said = [*sentences(comparisons), *([f"Stock methods: {stock}."] if stock else [])]
    return "\n\n".join([table, _LEGEND, *said]) + "\n"


def _facts(comparison: Comparison) -> tuple[str, str, str]:
    """Describe a row of a table: its values below `_FACTS`, after the name."""
    size = f"{comparison.n_sensors} x {comparison.n_frames}"
    return size, f"{comparison.dimensions}D", str(len(comparison.sensors))


def columns(methods: Sequence[str]) -> list[str]:
    """Return the columns of `to_csv`."""
    errors = [f"{method}: error" for method in methods]
    stock = ("best stock", "best stock r", "best stock: error")
    return [*_FACTS, *methods, *errors, *stock, "margin"]


def to_csv(comparisons: Sequence[Comparison]) -> str:
    """Format comparisons of the same methods as CSV, one line per recording.

    The columns are named after the methods (Mantel r), after the methods with ``: error`` (RMS
    error in spacings), and ``best stock``, ``best stock r``, ``best stock: error`` and ``margin``:
    Mantel r of the first method of anisomap minus that of the best stock method.
    """
    text = StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(columns([s.method for s in comparisons[0].scores]))
    for comparison in comparisons:
        stock = comparison.best(stock=True)
        table.writerow(
            [
                comparison.name,
                *_facts(comparison),
                *(_number(s.mantel_r) for s in comparison.scores),
                *(_number(s.rms_in_spacings) for s in comparison.scores),
                *(
                    (stock.method, _number(stock.mantel_r), _number(stock.rms_in_spacings))
                    if stock
                    else "---"
                ),
                _number(comparison.margin, "+.3f"),
            ]
        )
    return text.getvalue()


def sentences(comparisons: Sequence[Comparison]) -> list[str]:
    """Say on which recordings a stock method is better, and which methods have no score and why."""
    said = []
    losses, judged = [], 0
    reasons: dict[tuple[str, str], list[str]] = {}
    own = ""
    for comparison in comparisons:
        title = f"{comparison.name} in {comparison.dimensions}D"
        if not math.isnan(comparison.margin):
            judged += 1
            first, stock = comparison.judged, comparison.best(stock=True)
            r = math.nan if first is None else first.mantel_r
            own = own or (first.method if first else "")
            if round(comparison.margin, 3) < 0 and stock:
                reached = "no map" if math.isnan(r) else f"{r:.3f}"
                against = f"{stock.mantel_r:.3f} of {stock.method}"
                losses.append(f"{title} ({reached} against {against})")
        for s in comparison.scores:
            if s.reason:
                reasons.setdefault((s.method, s.reason), []).append(title)
    if judged:
        named = f": {', '.join(losses)}" if losses else ""
        count = f"{len(losses)} of {judged} maps"
        said.append(f"A stock method is better than {own} on {count}{named}.")
    for (method, reason), names in reasons.items():
        everywhere = "" if len(names) == len(comparisons) else f" on {', '.join(names)}"
        said.append(f"No score of {method}{everywhere}: {reason}.")
    return said


def _number(value: float, form: str = ".4f") -> str:
    return "-" if math.isnan(value) else f"{value:{form}}"
