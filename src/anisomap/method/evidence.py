"""The evidence of a recording: the similarity of all pairs of sensors, and its sampling variance.

All comparisons of pairs are made by `Evidence`. It represents a whole recording, a resample, parts
with different sensors, or one component of the sensors.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations_with_replacement, product
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.names import match_names
from anisomap.numerics.columns import centred_rows, ranked
from anisomap.numerics.covariogram.covariogram_fit import unexplained_share
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.graph.neighbour_graphs import all_products
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.sampling_noise import (
    Blend,
    Groups,
    balanced_weights,
    blended_correlation,
    block_edges,
    group_sensors,
    sampling_variance,
    thinning,
    typical_variance,
    without_slow_changes,
)
from anisomap.numerics.signals import MAX_PAIRED, Signals, unit_rows
from anisomap.numerics.similarity.contact_agreement import Contacts, contact_agreement
from anisomap.numerics.similarity.correlation import (
    co_activation,
    pearson,
    spearman,
    without_common_signal,
)
from anisomap.numerics.similarity.information import mutual_information
from anisomap.numerics.similarity.rest import estimate_rest, ranks_of_depths
from anisomap.recording import Recording

logger = logging.getLogger(__name__)

_MIN_FRAMES = 3  # a correlation requires two differences between frames
_ALIKE = 1e-5  # rounding error of readings in [-1, 1], in float32

Scores: TypeAlias = Blend | Contacts
"""Scores of frames. Their sums over weighted blocks give the similarity of a resample."""


@dataclass(frozen=True)
class Similarity:
    """A pairwise statistic.

    compute: ``compute(readings, bins)`` returns the similarity of all pairs, shape (n, n).
    score: ``score(readings, signals, centred)`` returns the scores that it follows from; the
        signals of the readings may be None. Without scores, its variance is that of correlations of
        what `correlated` makes of the readings, by default themselves.
    centred: Whether the signal that all sensors share is subtracted first.
    """

    summary: str
    compute: Callable[[ArrayLike, int], Reals]
    score: Callable[[NDArray[Any], Signals | None, bool], Scores] | None = None
    correlated: Callable[[NDArray[Any]], NDArray[Any]] = np.asarray
    centred: bool = False


SIMILARITIES: Mapping[str, Similarity] = MappingProxyType(
    {
        "pearson": Similarity("linear correlation", lambda x, _: pearson(x)),
        "spearman": Similarity("rank correlation", lambda x, _: spearman(x), correlated=ranked),
        "co-activation": Similarity(
            "correlation of binary contact (phi)",
            lambda x, _: co_activation(x),
            correlated=lambda x: estimate_rest(x).active(x),
        ),
        "mutual-information": Similarity(
            "mutual information of binned readings", mutual_information
        ),
        "blended-correlation": Similarity(
            "linear correlation where it is reliable, else rank correlation",
            lambda x, _: blended_correlation(x),
            Blend.of,
            centred=True,
        ),
        "contact-agreement": Similarity(
            "agreement over distinct contacts (kappa), for readings that are on or off",
            lambda x, _: contact_agreement(x),
            lambda x, *_: Contacts.of(x),
        ),
    }
)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Similarity of all pairs of n sensors, and its sampling variance.

    similarity, variance (n, n): Symmetric; the sampling variance of each similarity.
    known (n, n): Pairs that were recorded together.
    statistic: Name of the similarity that was computed from readings; empty if it was precomputed.
    readings (T, n): In temporal order; None for a precomputed similarity, and if some pairs are
        unknown.
    scores: Scores of frames, from which resamples are computed.
    common_share: Share of the mean over sensors that was subtracted as a signal of all sensors.
    related: Whether the sensors are known to be related, such as the sensors of one component.
    """

    similarity: Reals
    variance: Reals
    known: NDArray[np.bool_]
    statistic: str = ""
    readings: NDArray[np.generic] | None = None
    scores: Scores | None = None
    common_share: float = 0.0
    related: bool = False

    @classmethod
    def of(
        cls, recording: Recording, statistic: str, *, bins: int, with_variance: bool
    ) -> Evidence:
        """Compare all pairs of sensors, each over the parts of the recording that contain both."""
        log_stage(f"comparing all pairs of sensors ({statistic})", recording.n_sensors)
        if len(recording.parts) > 1:
            return _of_parts(recording, statistic, bins)
        how, (recording,) = SIMILARITIES[statistic], recording.parts
        few = recording.n_sensors <= MAX_PAIRED
        if with_variance or how.centred:
            step = thinning(recording.readings)
            signals = recording.signals if few and step == 1 else None
            return _compared(recording.readings[::step], statistic, bins, signals)
        if few and statistic == "pearson":  # the health of sensors needs it, too
            found = recording.signals.pearson[0]
        else:
            found = how.compute(recording.readings, bins)
        return cls.from_similarity(found, variance=np.nan, statistic=statistic)

    @classmethod
    def from_similarity(
        cls,
        similarity: ArrayLike,
        *,
        variance: ArrayLike,
        known: NDArray[np.bool_] | None = None,
        statistic: str = "",
    ) -> Evidence:
        """Check and complete a similarity (n, n).

        variance (n, n) or a number. known (n, n): All by default; the similarity of other pairs is
        ignored.
        """
        if known is not None and not known.all():
            known = known | np.eye(len(known), dtype=bool)
            similarity = np.where(known, similarity, 0)
        checked = as_symmetric(similarity, "similarity")
        noise = np.asarray(variance)
        noise = as_symmetric(noise, "noise") if noise.ndim else noise
        # Constant matrices are broadcast, which takes no memory.
        return cls(
            checked,
            np.broadcast_to(noise, checked.shape),
            np.broadcast_to(np.array(True), checked.shape) if known is None else known,
            statistic,
        )

    def select(self, sensors: NDArray[np.bool_]) -> Evidence:
        """Return the evidence of some sensors, given as a mask of shape (n,)."""
        if sensors.all():
            return self
        inside = np.ix_(sensors, sensors)
        return replace(
            self,
            similarity=self.similarity[inside],
            variance=self.variance[inside],
            known=self.known[inside],
            readings=None if self.readings is None else self.readings[:, sensors],
            scores=None if self.scores is None else self.scores.select(sensors),
        )

    def resamples(self, count: int, step: float, rng: np.random.Generator) -> Iterator[Evidence]:
        """Yield the evidence of weighted blocks of frames; requires scores.

        A block that occurs n times in a resample has the weight ``1 + step (n - 1)``.
        """
        weights = 1 + step * (balanced_weights(len(self.edges) - 1, count, rng) - 1)
        for similarity in self.scores.resampled(self.edges, weights) if self.scores else ():
            yield Evidence(
                similarity, self.variance, self.known, self.statistic, related=self.related
            )

    @cached_property
    def edges(self) -> NDArray[np.intp]:
        """Edges of blocks that are longer than the autocorrelation of the readings, (B + 1,)."""
        return block_edges(np.asarray(self.readings))

    @cached_property
    def noise(self) -> float:
        """Typical sampling variance of a similarity."""
        return typical_variance(self.variance)

    @cached_property
    def groups(self) -> Groups:
        """Groups of related sensors, by significant correlations."""
        if self.related:
            return Groups(*np.zeros((2, len(self.similarity)), dtype=np.intp))
        return group_sensors(self.similarity, self.variance)

    @cached_property
    def correlation(self) -> Reals | None:
        """Blended correlation of the readings, shape (n, n); None without readings."""
        if self.statistic == "blended-correlation":
            return self.similarity
        return None if self.readings is None else blended_correlation(self.readings)

    @cached_property
    def rank_changes(self) -> Reals | None:
        """Correlation of changes of ranks between frames, shape (n, n); None without readings."""
        if self.readings is None or len(self.readings) < _MIN_FRAMES:
            return None
        return all_products(unit_rows(np.diff(self.ranks, axis=0)))

    @cached_property
    def rank_correlation(self) -> Reals:
        """Correlation of the ranks, shape (n, n); requires readings."""
        return self.scores.rho if isinstance(self.scores, Blend) else pearson(self.ranks)

    @cached_property
    def ranks(self) -> Reals:
        """Ranks of the depths of each sensor beyond rest, (T, n); requires readings."""
        if isinstance(self.scores, Blend):
            return self.scores.ranks
        return ranks_of_depths(np.asarray(self.readings))

    def unexplained(self, positions: Reals) -> float:
        """Return the share of the variance of S that distances of (n, k) leave unexplained."""
        return unexplained_share(self.similarity, positions, self.noise, known=self.known)


_MIN_TOLD = 1000  # sensors of a map whose stages are logged, since it takes long


def log_stage(stage: str, n_sensors: int, seconds: float | None = None) -> None:
    """Log a stage of a map of many sensors, and an estimate of the remaining time."""
    if n_sensors >= _MIN_TOLD:
        left = "" if seconds is None else f", about {max(1, math.ceil(seconds))} s left"
        logger.info("%s%s", stage, left)


def check_unlike(*runs: Any, rows_of: Callable[[Any], NDArray[Any]] = centred_rows) -> None:
    """Check that sensors differ by more than offset, gain and sign; no map is possible otherwise.

    runs: Readings, each (T, n), or other matrices with a column for each sensor.
    rows_of: Returns a row for each column; rows of equal sensors are equal up to scale.
    """
    for run, count in product(runs, (2, None)):  # the first two sensors nearly always differ
        rows = rows_of(run[:, :count])
        rows = rows / np.maximum(np.abs(rows).max(axis=1), np.finfo(rows.dtype).tiny)[:, None]
        signs = np.sign(rows @ rows[0])[:, None]
        if (np.abs(signs * rows - rows[0]) > _ALIKE).any():
            return
    raise InputError(
        "all sensors have the same readings, apart from offset and gain, so the readings do not "
        "show where the sensors are; touch one place after another"
    )


def _compared(
    readings: NDArray[Any], statistic: str, bins: int, signals: Signals | None = None
) -> Evidence:
    """Compare all pairs of sensors. readings (T, n). signals: Their signals, if known."""
    how = SIMILARITIES[statistic]
    slow = without_slow_changes(readings) if how.centred else readings
    values, share = without_common_signal(slow) if how.centred else (readings, 0.0)
    unchanged = values is readings
    values = np.asfortranarray(values)  # most statistics process one sensor at a time
    scores = None
    if how.score is None:
        found, variance = how.compute(values, bins), sampling_variance(how.correlated(values))
    else:
        scores = how.score(values, signals if unchanged else None, share > 0)
        found = scores.similarity
        if isinstance(scores, Blend):
            variance = scores.variance
        else:
            variance = sampling_variance(scores.active)
    checked = Evidence.from_similarity(found, variance=variance, statistic=statistic)
    return replace(checked, readings=values, scores=scores, common_share=share)


def _of_parts(recording: Recording, statistic: str, bins: int) -> Evidence:
    """Compare each pair of sensors over the parts that contain both."""
    names, parts = recording.names, recording.parts
    place = np.stack([match_names(names, part.names) for part in parts])
    present = place >= 0
    similarity, variance = np.eye(len(names)), np.ones((len(names), len(names)))
    known = np.eye(len(names), dtype=bool)
    patterns, pattern = np.unique(present, axis=1, return_inverse=True)
    compared: dict[bytes, tuple[NDArray[np.intp], Evidence]] = {}
    for a, b in combinations_with_replacement(range(patterns.shape[1]), 2):
        shared = patterns[:, a] & patterns[:, b]
        if not shared.any():
            continue
        if (key := shared.tobytes()) not in compared:
            sensors = np.flatnonzero(present[shared].all(axis=0))
            both = [i for i in range(len(parts)) if shared[i]]
            readings = np.concatenate([parts[i].readings[:, place[i][sensors]] for i in both])
            compared[key] = sensors, _compared(readings, statistic, bins)
        sensors, shown = compared[key]
        one, other = (np.flatnonzero(pattern[sensors] == which) for which in (a, b))
        for rows, columns in ((one, other), (other, one)):
            target, source = np.ix_(sensors[rows], sensors[columns]), np.ix_(rows, columns)
            similarity[target] = shown.similarity[source]
            variance[target] = shown.variance[source]
            known[target] = True
    return Evidence.from_similarity(similarity, variance=variance, known=known, statistic=statistic)
