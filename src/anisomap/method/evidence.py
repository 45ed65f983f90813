"""The evidence of a recording: the similarity of all pairs of sensors, and its sampling variance.

`Evidence` is the one place where pairs are compared. The whole recording, its resamples, several
runs and a component of the sensors are evidence alike.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations_with_replacement, product
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.columns import centred_rows, ranked
from anisomap.numerics.covariogram.covariogram_fit import unexplained_share
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.precision import Floats, Reals
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
)
from anisomap.numerics.signals import Signals
from anisomap.numerics.similarity.contact_agreement import Contacts, contact_agreement
from anisomap.numerics.similarity.correlation import (
    co_activation,
    pearson,
    spearman,
    without_common_signal,
)
from anisomap.numerics.similarity.information import mutual_information
from anisomap.numerics.similarity.rest import Rest, estimate_rest, ranks_of_depths
from anisomap.recording import Recording, sensors_differ

logger = logging.getLogger(__name__)

_MIN_FRAMES = 3  # two differences between frames, the fewest that correlate
_ALIKE = 1e-5  # difference of readings in [-1, 1] by rounding, in float32

Scores: TypeAlias = Blend | Contacts
"""Scores of frames, whose sums over weighted blocks give the similarity of a resample."""

Compared: TypeAlias = tuple[Reals, Reals, Scores | None]
"""Similarity and sampling variance, (n, n) each, and the scores that they follow from."""


@dataclass(frozen=True)
class Similarity:
    """A pairwise statistic.

    compute: ``compute(readings, bins)`` returns the similarity of all pairs, shape (n, n).
    compare: ``compare(readings, rest, centred)`` returns it with its variance and its scores; rest
        may be None. By default, the variance is that of correlations of the readings.
    of_signals: ``of_signals(signals)`` returns what `compute` would, if other analyses need it.
    centred: Whether the signal that all sensors share is subtracted first.
    """

    summary: str
    compute: Callable[[ArrayLike, int], Reals]
    compare: Callable[[NDArray[Any], Rest | None, bool], Compared] | None = None
    of_signals: Callable[[Signals], Reals] | None = None
    centred: bool = False

    def with_variance(
        self, readings: NDArray[Any], bins: int, rest: Rest | None = None, *, centred: bool = False
    ) -> Compared:
        """Compute the similarity, its sampling variance for unrelated sensors, and its scores."""
        if self.compare is not None:
            return self.compare(readings, rest, centred)
        return self.compute(readings, bins), sampling_variance(readings), None


def _blended(readings: NDArray[Any], rest: Rest | None, centred: bool) -> Compared:
    blend = Blend.of(readings, rest, centred=centred)
    return blend.similarity, blend.variance, blend


def _agreement(readings: NDArray[Any], *_: object) -> Compared:
    contacts = Contacts.of(readings)
    return contacts.agreement(), sampling_variance(contacts.active), contacts


SIMILARITIES: Mapping[str, Similarity] = MappingProxyType(
    {
        "pearson": Similarity(
            "linear correlation",
            lambda x, _: pearson(x),
            of_signals=lambda signals: signals.pearson,
        ),
        "spearman": Similarity(
            "rank correlation",
            lambda x, _: spearman(x),
            lambda x, *_: (spearman(x), sampling_variance(ranked(x)), None),
        ),
        "co-activation": Similarity(
            "correlation of binary contact (phi)",
            lambda x, _: co_activation(x),
            lambda x, *_: (
                co_activation(x),
                sampling_variance(estimate_rest(x).active(x)),
                None,
            ),
        ),
        "mutual-information": Similarity(
            "mutual information of binned readings", mutual_information
        ),
        "blended-correlation": Similarity(
            "linear correlation where it is reliable, else rank correlation",
            lambda x, _: blended_correlation(x),
            _blended,
            centred=True,
        ),
        "contact-agreement": Similarity(
            "agreement over distinct contacts (kappa), for readings that are on or off",
            lambda x, _: contact_agreement(x),
            _agreement,
        ),
    }
)


@dataclass(frozen=True, eq=False)
class Evidence:
    """What readings show of n sensors: the similarity of all pairs, and its sampling variance.

    Attributes
    ----------
    similarity : ndarray of shape (n, n)
        Symmetric.
    variance : ndarray of shape (n, n)
        Sampling variance of each similarity.
    known : ndarray of bool, shape (n, n)
        Pairs that were recorded together.
    statistic : str
        Name of the similarity that was computed from readings; empty if it was precomputed.
    readings : ndarray of shape (T, n), optional
        Readings in temporal order; None for a precomputed similarity, and if some pairs are
        unknown.
    scores : Blend or Contacts, optional
        What resamples are computed from.
    common_share : float
        Share of the mean over sensors that is a signal of all of them, which was subtracted.
    related : bool
        Whether the sensors are known to be related, as those of one component are.
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
        cls, runs: Sequence[Recording], statistic: str, *, bins: int, with_variance: bool
    ) -> Evidence:
        """Compare all pairs of the sensors of runs; each pair over the runs that contain both."""
        logger.info("comparing all pairs of sensors (%s)", statistic)
        if len(runs) > 1 and sensors_differ(runs):
            return _of_different_sensors(runs, statistic, bins)
        how, readings = SIMILARITIES[statistic], _joined(runs, runs[0].names)
        if not with_variance:
            if how.of_signals is not None and len(runs) == 1:
                found = how.of_signals(runs[0].signals)
            else:
                found = how.compute(_centred(how, readings)[0], bins)
            return cls.from_similarity(found, variance=np.nan, statistic=statistic)
        step = thinning(readings)
        readings, share = _centred(how, readings[::step])
        rest = runs[0].signals.rest if len(runs) == 1 and step == 1 and share == 0 else None
        readings = np.asfortranarray(readings)  # most statistics go sensor by sensor
        found, variance, scores = how.with_variance(readings, bins, rest, centred=share > 0)
        checked = cls.from_similarity(found, variance=variance, statistic=statistic)
        return replace(checked, readings=readings, scores=scores, common_share=share)

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
        edges = block_edges(np.asarray(self.readings))
        weights = 1 + step * (balanced_weights(len(edges) - 1, count, rng) - 1)
        for similarity in self.scores.resampled(edges, weights) if self.scores else ():
            yield Evidence(
                similarity, self.variance, self.known, self.statistic, related=self.related
            )

    @property
    def weights(self) -> Floats | None:
        """Weights of distances in scaling: 0 for unknown pairs; None if all pairs are known."""
        return None if self.known.all() else self.known.astype(np.float64)

    @cached_property
    def noise(self) -> float:
        """Typical sampling variance of a similarity."""
        return typical_variance(self.variance)

    @cached_property
    def groups(self) -> Groups:
        """Groups of sensors that significant correlations show to be related, or unrelated."""
        if self.related:
            return Groups(*np.zeros((2, len(self.similarity)), dtype=np.intp))
        return group_sensors(self.similarity, self.variance)

    @cached_property
    def correlation(self) -> Reals | None:
        """Blended correlation of the readings, shape (n, n); None without them."""
        if self.statistic == "blended-correlation":
            return self.similarity
        return None if self.readings is None else blended_correlation(self.readings)

    @cached_property
    def rank_changes(self) -> Reals | None:
        """Correlation of the changes of ranks between frames, shape (n, n); None without them."""
        if self.readings is None or len(self.readings) < _MIN_FRAMES:
            return None
        return pearson(np.diff(self.ranks, axis=0))

    @cached_property
    def ranks(self) -> Reals:
        """Ranks of the depths of each sensor beyond rest, (T, n); requires readings."""
        if isinstance(self.scores, Blend):
            return self.scores.ranks
        return ranks_of_depths(np.asarray(self.readings))

    def unexplained(self, positions: Reals) -> float:
        """Return the share of the variance of S that distances on a map, (n, k), do not explain."""
        return unexplained_share(self.similarity, positions, self.noise, known=self.known)


def check_unlike(*runs: Any, rows_of: Callable[[Any], NDArray[Any]] = centred_rows) -> None:
    """Check that sensors differ by more than offset, gain and sign: else all maps are alike.

    runs: Readings, each (T, n), or other matrices that have a column for each sensor.
    rows_of: Takes some columns, and returns what is alike in such sensors, up to its size.
    """
    for run, count in product(runs, (2, None)):  # nearly always, two sensors differ
        rows = rows_of(run[:, :count])
        rows = rows / np.maximum(np.abs(rows).max(axis=1), np.finfo(rows.dtype).tiny)[:, None]
        signs = np.sign(rows @ rows[0])[:, None]
        if (np.abs(signs * rows - rows[0]) > _ALIKE).any():
            return
    raise InputError(
        "all sensors read the same, but for offset and gain, so their readings do not show where "
        "they are; touch one place after another"
    )


def _centred(how: Similarity, readings: NDArray[Any]) -> tuple[NDArray[Any], float]:
    """Return the readings that are compared, (T, n), and the share of what was subtracted."""
    return without_common_signal(readings) if how.centred else (readings, 0.0)


def _of_different_sensors(runs: Sequence[Recording], statistic: str, bins: int) -> Evidence:
    """Compare each pair of sensors over the runs that contain both."""
    how = SIMILARITIES[statistic]
    names = tuple(dict.fromkeys(name for run in runs for name in run.names))
    column = {name: i for i, name in enumerate(names)}
    present = np.zeros((len(runs), len(names)), dtype=bool)
    for row, run in zip(present, runs, strict=True):
        row[[column[name] for name in run.names]] = True
    similarity, variance = np.eye(len(names)), np.ones((len(names), len(names)))
    known = np.eye(len(names), dtype=bool)
    patterns, pattern = np.unique(present, axis=1, return_inverse=True)
    compared: dict[bytes, tuple[NDArray[np.intp], Reals, Reals]] = {}
    for a, b in combinations_with_replacement(range(patterns.shape[1]), 2):
        shared = patterns[:, a] & patterns[:, b]
        if not shared.any():
            continue
        if (key := shared.tobytes()) not in compared:
            sensors = np.flatnonzero(present[shared].all(axis=0))
            chosen = [run for run, has_both in zip(runs, shared, strict=True) if has_both]
            readings = _joined(chosen, tuple(names[i] for i in sensors))
            values, share = _centred(how, readings)
            found = how.with_variance(values, bins, centred=share > 0)
            compared[key] = sensors, found[0], found[1]
        sensors, *statistics = compared[key]
        one, other = (np.flatnonzero(pattern[sensors] == which) for which in (a, b))
        for rows, columns in ((one, other), (other, one)):
            target, source = np.ix_(sensors[rows], sensors[columns]), np.ix_(rows, columns)
            similarity[target], variance[target] = (values[source] for values in statistics)
            known[target] = True
    return Evidence.from_similarity(similarity, variance=variance, known=known, statistic=statistic)


def _joined(runs: Sequence[Recording], names: tuple[str, ...]) -> NDArray[np.floating]:
    """Concatenate the readings of runs, sensors in the order of the names."""
    ordered = [
        run.readings
        if run.names == names
        else run.readings[:, [run.names.index(name) for name in names]]
        for run in runs
    ]
    return ordered[0] if len(ordered) == 1 else np.concatenate(ordered)
