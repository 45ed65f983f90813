"""The first stage: similarity of all pairs of sensors, and its sampling variance."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.base.defaults import DEFAULT_BINS
from anisomap.errors import InputError
from anisomap.numerics.columns import ranked
from anisomap.numerics.contacts.contact_agreement import contact_agreement, distinct_contacts
from anisomap.numerics.covariogram.covariogram_fit import Covariogram, unexplained_share
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.precision import Floats, Reals
from anisomap.numerics.reliability.sampling_noise import (
    sampling_variance,
    thinning,
    typical_variance,
)
from anisomap.numerics.reliability.split_half import Blend, blend, blended_correlation
from anisomap.numerics.signals import Signals
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
_ROUNDING = 1e-6  # by which a computed correlation may exceed 1


@dataclass(frozen=True)
class Similarity:
    """A pairwise statistic.

    compute: ``compute(readings, bins)`` returns the similarity, shape (n, n).
    scores: ``scores(readings)`` returns the values, shape (T, n), whose linear correlation the
        similarity is; its sampling variance is theirs. The readings by default.
    blend: ``blend(readings, rest)`` returns the similarity, its sampling variance and what it was
        blended from, if it is not the correlation of any scores; rest may be None.
    shared: ``shared(signals)`` returns what `compute` would, if other analyses need it, too.
    """

    summary: str
    compute: Callable[[ArrayLike, int], Reals]
    scores: Callable[[NDArray[np.generic]], ArrayLike] | None = None
    blend: Callable[[ArrayLike, Rest | None], Blend] | None = None
    refer: Callable[[NDArray[Any]], tuple[NDArray[Any], float]] | None = None
    shared: Callable[[Signals], Reals] | None = None

    def with_variance(self, readings: NDArray[np.generic], bins: int) -> tuple[Reals, Reals]:
        """Compute the similarity, and its sampling variance for unrelated sensors, (n, n) each."""
        if self.blend is not None:
            found = self.blend(readings, None)
            return found.similarity, found.variance
        scores = readings if self.scores is None else self.scores(readings)
        return self.compute(readings, bins), sampling_variance(scores)

    def referred(self, readings: NDArray[Any]) -> tuple[NDArray[Any], float]:
        """Return the readings that are compared, (T, n), and the share of what was subtracted."""
        return (readings, 0.0) if self.refer is None else self.refer(readings)


SIMILARITIES: Mapping[str, Similarity] = MappingProxyType(
    {
        "pearson": Similarity(
            "linear correlation", lambda x, _: pearson(x), shared=lambda signals: signals.pearson
        ),
        "spearman": Similarity("rank correlation", lambda x, _: spearman(x), ranked),
        "co-activation": Similarity(
            "correlation of binary contact (phi)",
            lambda x, _: co_activation(x),
            lambda x: estimate_rest(x).active(x),
        ),
        "mutual-information": Similarity(
            "mutual information of binned readings", mutual_information
        ),
        "blended-correlation": Similarity(
            "linear correlation where it is reliable, else rank correlation",
            lambda x, _: blended_correlation(x),
            blend=blend,
            refer=without_common_signal,
        ),
        "contact-agreement": Similarity(
            "agreement over distinct contacts (kappa), for readings that are on or off",
            lambda x, _: contact_agreement(x),
            distinct_contacts,
        ),
    }
)


@dataclass(frozen=True, eq=False)
class PairStatistics:
    """Similarity of all pairs of n sensors, and its sampling variance.

    Attributes
    ----------
    similarity : ndarray of shape (n, n)
        Symmetric.
    noise : ndarray of shape (n, n)
        Sampling variance of each similarity.
    known : ndarray of bool, shape (n, n)
        Pairs that were recorded together.
    readings : ndarray of shape (T, n), optional
        Readings in temporal order; None for a precomputed similarity, and if some pairs are
        unknown.
    statistic : str
        Name of the similarity that was computed from readings; empty if it was precomputed.
    blended : Blend, optional
        What a blended correlation was computed from, of all sensors that were compared.
    common_share : float
        Share of the mean over sensors that is a signal of all of them, which was subtracted.
    near : Covariogram, optional
        A fit to nearly the same similarity, from which that to this one starts.
    """

    similarity: Reals
    noise: Reals
    known: NDArray[np.bool_]
    readings: NDArray[np.generic] | None = None
    statistic: str = ""
    blended: Blend | None = None
    common_share: float = 0.0
    near: Covariogram | None = None

    @classmethod
    def from_similarity(
        cls,
        similarity: ArrayLike,
        *,
        noise: ArrayLike,
        known: NDArray[np.bool_] | None = None,
        readings: NDArray[np.generic] | None = None,
        statistic: str = "",
    ) -> PairStatistics:
        """Check and complete a similarity (n, n).

        noise (n, n) or a number: Its sampling variance. known (n, n): All by default; the
        similarity of other pairs is ignored. statistic: Its name, if it was computed from readings.
        """
        if known is not None and not known.all():
            known = known | np.eye(len(known), dtype=bool)
            similarity = np.where(known, similarity, 0)
            readings = None
        checked = as_symmetric(similarity, "similarity")
        noise = np.asarray(noise)
        noise = as_symmetric(noise, "noise") if noise.ndim else noise
        # Constant matrices are broadcast, which takes no memory.
        return cls(
            checked,
            np.broadcast_to(noise, checked.shape),
            np.broadcast_to(np.array(True), checked.shape) if known is None else known,
            readings,
            statistic,
        )

    @cached_property
    def rank_changes(self) -> Reals | None:
        """Correlation of the changes of ranks between frames, shape (n, n); None without them."""
        if self.readings is None or len(self.readings) < _MIN_FRAMES:
            return None
        return pearson(np.diff(self.ranks, axis=0))

    @cached_property
    def correlation(self) -> Reals | None:
        """Blended correlation of the readings, shape (n, n); None without them."""
        if self.statistic == "blended-correlation":
            return self.similarity
        return None if self.readings is None else blended_correlation(self.readings)

    @cached_property
    def rest(self) -> Rest:
        """Rest of each sensor; requires readings."""
        return (
            estimate_rest(np.asarray(self.readings)) if self.blended is None else self.blended.rest
        )

    @cached_property
    def ranks(self) -> Reals:
        """Ranks of the depths of each sensor beyond rest, (T, n); requires readings."""
        if self.blended is not None:
            return self.blended.ranks
        return ranks_of_depths(np.asarray(self.readings), self.rest)

    def unexplained(self, positions: Reals) -> float:
        """Return the share of the variance of S that distances on a map, (n, k), do not explain."""
        noise = typical_variance(self.noise)
        return unexplained_share(self.similarity, positions, noise, known=self.known)

    def of_frames(self, frames: NDArray[np.intp]) -> PairStatistics:
        """Compare the sensors in some frames, which increase; requires readings."""
        readings = np.asarray(self.readings)[frames]
        found = _examined(readings, self.statistic, DEFAULT_BINS)
        return replace(found, common_share=self.common_share)

    @property
    def weights(self) -> Floats | None:
        """Weights of distances in scaling: 0 for unknown pairs; None if all pairs are known."""
        return None if self.known.all() else self.known.astype(np.float64)

    def select(self, sensors: NDArray[np.bool_]) -> PairStatistics:
        """Return the statistics of some sensors, given as a mask of shape (n,)."""
        if sensors.all():
            return self
        inside = np.ix_(sensors, sensors)
        readings = None if self.readings is None else self.readings[:, sensors]
        return replace(
            self,
            similarity=self.similarity[inside],
            noise=self.noise[inside],
            known=self.known[inside],
            readings=readings,
            blended=None if self.blended is None else self.blended.select(sensors),
            near=None,
        )

    def check_correlations(self) -> None:
        """Check that the similarity is a correlation, at most 1 in magnitude."""
        largest = np.abs(self.similarity).max(initial=0)
        if largest > 1 + _ROUNDING:
            raise InputError(
                f"this method requires correlations in [-1, 1], got a similarity of magnitude "
                f"{largest:g}; r-anisomap accepts any similarity"
            )


def compare(
    runs: Sequence[Recording], similarity: str, *, bins: int, with_noise: bool
) -> PairStatistics:
    """Compute the similarity S of all pairs of sensors."""
    logger.info("comparing all pairs of sensors (%s)", similarity)
    statistic = SIMILARITIES[similarity]
    if not sensors_differ(runs):
        readings = _joined(runs, runs[0].names)
        if not with_noise:
            if statistic.shared is not None and len(runs) == 1:
                found = statistic.shared(runs[0].signals)
            else:
                found = statistic.compute(statistic.referred(readings)[0], bins)
            return PairStatistics.from_similarity(found, noise=np.nan, statistic=similarity)
        step = thinning(readings)
        readings, share = statistic.referred(readings[::step])
        rest = runs[0].signals.rest if len(runs) == 1 and step == 1 and share == 0 else None
        return replace(_examined(readings, similarity, bins, rest), common_share=share)
    names = tuple(dict.fromkeys(name for run in runs for name in run.names))
    shared = _shared_runs(runs, names)
    values, noise = np.eye(len(names)), np.ones(shared.shape)
    for runs_of_pair, chosen, sensors in _groups(runs, shared):
        readings, _ = statistic.referred(_joined(chosen, tuple(names[i] for i in sensors)))
        inside = np.ix_(sensors, sensors)
        in_group = shared[inside] == runs_of_pair
        if with_noise:
            found, variance = statistic.with_variance(readings, bins)
            noise[inside] = np.where(in_group, variance, noise[inside])
        else:
            found = statistic.compute(readings, bins)
        values[inside] = np.where(in_group, found, values[inside])
    return PairStatistics.from_similarity(
        values, noise=noise, known=shared > 0, statistic=similarity
    )


def _examined(
    readings: NDArray[Any], similarity: str, bins: int, rest: Rest | None = None
) -> PairStatistics:
    """Compare readings, (T, n), which stay at hand for refinements; their rest may be known."""
    statistic = SIMILARITIES[similarity]
    readings = np.asfortranarray(readings)  # most statistics go sensor by sensor
    blended = None if statistic.blend is None else statistic.blend(readings, rest)
    if blended is None:
        found, variance = statistic.with_variance(readings, bins)
    else:
        found, variance = blended.similarity, blended.variance
    pairs = PairStatistics.from_similarity(
        found, noise=variance, readings=readings, statistic=similarity
    )
    return replace(pairs, blended=blended)


def _joined(runs: Sequence[Recording], names: tuple[str, ...]) -> NDArray[np.floating]:
    """Concatenate the readings of runs, sensors in the order of the names."""
    ordered = [
        run.readings
        if run.names == names
        else run.readings[:, [run.names.index(name) for name in names]]
        for run in runs
    ]
    return ordered[0] if len(ordered) == 1 else np.concatenate(ordered)


def _shared_runs(runs: Sequence[Recording], names: tuple[str, ...]) -> NDArray[np.int64]:
    """Encode the runs that contain both sensors of each pair: one bit per run, shape (N, N)."""
    present = np.zeros(len(names), dtype=np.int64)
    column = {name: i for i, name in enumerate(names)}
    for bit, run in enumerate(runs):
        present[[column[name] for name in run.names]] |= 1 << bit
    return present[:, None] & present


def _groups(
    runs: Sequence[Recording], shared: NDArray[np.int64]
) -> Iterator[tuple[int, list[Recording], NDArray[np.intp]]]:
    """Yield each set of runs that some pair shares: its code, the runs, and its sensors."""
    for code in np.unique(shared[shared > 0]).tolist():
        chosen = [run for bit, run in enumerate(runs) if code >> bit & 1]
        sensors = np.flatnonzero((np.diag(shared) & code) == code)
        yield code, chosen, sensors
