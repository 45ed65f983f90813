"""Similarities computed chunk by chunk, for recordings larger than memory.

Statistics that depend on the distribution of all readings take two passes over the frames: one to
count distinct values, one to compute the statistic. Streams, which permit one pass, use joint
counts of values instead (`anisomap.numerics.similarity.joint_values`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.memory import check_memory
from anisomap.numerics.precision import Reals
from anisomap.numerics.similarity.accumulators import (
    CoOccurrences,
    Moments,
    StoredCodes,
    correlation_of_comoments,
)
from anisomap.numerics.similarity.binning import maximum_entropy_bins
from anisomap.numerics.similarity.co_occurrence import Layout, joint_logarithms_of_counts
from anisomap.numerics.similarity.correlation import phi_from_counts
from anisomap.numerics.similarity.information import (
    information_from_codes,
    information_from_logarithms,
)
from anisomap.numerics.similarity.joint_values import JointValues
from anisomap.numerics.similarity.rest import Rest, rest_from_counts
from anisomap.numerics.similarity.value_counts import Recoding, ValueCounts

Matrix: TypeAlias = Reals

_BYTES_PER_COUNT = 3 * 4  # uint32: the total, the next result, and their sum
_MAX_COUNT_BYTES = 1 << 28  # of counts; above, codes are stored if smaller. Chosen by hand

Mapper: TypeAlias = Callable[[NDArray[Any]], Any]
"""Makes an accumulator of a chunk of finite readings, shape (t, N)."""


@dataclass(frozen=True)
class Chunked:
    """A similarity as a map-reduce.

    prepare: ``prepare(values, bins)`` returns the mapper, given the counts of distinct values (None
        unless `needs_values`) and the number of bins.
    finish: Converts the accumulator of all chunks to the (N, N) similarity.
    of_values: ``of_values(joint_values, bins)`` computes the same similarity from `JointValues`.
        None if the similarity does not depend on the counts of values.
    """

    prepare: Callable[[ValueCounts | None, int], Mapper]
    finish: Callable[[Any], Matrix]
    of_values: Callable[[JointValues, int], Matrix] | None = None

    @property
    def needs_values(self) -> bool:
        """Whether a first pass must count distinct values."""
        return self.of_values is not None


def _required(values: ValueCounts | None) -> ValueCounts:
    if values is None:
        raise TypeError("this similarity requires counts of distinct values")
    return values


def _map_ranks(ranks: Recoding, chunk: NDArray[Any]) -> Moments:
    return Moments.of(ranks(chunk))


def _map_activity(rest: Rest, chunk: NDArray[Any]) -> CoOccurrences:
    return CoOccurrences.of(rest.active(chunk), Layout.of_switches(chunk.shape[1]))


def _count_codes(recoding: Recoding, layout: Layout, chunk: NDArray[Any]) -> CoOccurrences:
    return CoOccurrences.of(recoding(chunk), layout)


def _store_codes(recoding: Recoding, chunk: NDArray[Any]) -> StoredCodes:
    return StoredCodes.of(recoding(chunk))


def _rest(values: ValueCounts) -> Rest:
    return rest_from_counts(zip(values.values, values.counts, strict=True))


def _codes(values: ValueCounts, bins: int) -> tuple[list[NDArray[np.intp]], Layout]:
    """Return the bin of every value, and the layout of their series."""
    codes = [maximum_entropy_bins(counts, bins) for counts in values.counts]
    full = [
        np.bincount(code, weights=counts, minlength=bins)
        for code, counts in zip(codes, values.counts, strict=True)
    ]
    return codes, Layout.of(np.array(full).astype(np.int64))


def _prepare_codes(values: ValueCounts | None, bins: int) -> Mapper:
    known = _required(values)
    layout = _codes(known, bins)[1]
    stored, counted = known.n_frames * known.n_sensors, _BYTES_PER_COUNT * layout.n_series**2
    check_memory(
        min(stored, counted),
        f"counting all pairs of {bins} bins of {known.n_sensors} sensors",
        "use fewer bins, or a method based on Pearson's r",
    )
    if stored <= counted and counted > _MAX_COUNT_BYTES:
        return partial(_store_codes, known.bins(bins))
    return partial(_count_codes, known.bins(bins), layout)


def _information(found: CoOccurrences | StoredCodes) -> Matrix:
    if isinstance(found, StoredCodes):
        return information_from_codes(found.whole())
    joint = joint_logarithms_of_counts(found.counts, found.first, found.n_frames)
    return information_from_logarithms(joint, found.n_frames)


def _spearman_of_values(found: JointValues, _: int) -> Matrix:
    ranks = [np.cumsum(counts) - (counts - 1) / 2 for counts in found.single.counts]
    return correlation_of_comoments(found.comoments(ranks))


def _phi_of_values(found: JointValues, _: int) -> Matrix:
    single = found.single
    rest = _rest(single)
    active = [
        (rest.side[i] * (values - rest.value[i]) - rest.threshold[i] > 0).astype(np.intp)
        for i, values in enumerate(single.values)
    ]
    switched = found.of_series(active, Layout.of_switches(single.n_sensors))
    return phi_from_counts(switched.counts, single.n_frames)


def _information_of_values(found: JointValues, bins: int) -> Matrix:
    return _information(found.of_series(*_codes(found.single, bins)))


CHUNKED: Mapping[str, Chunked] = MappingProxyType(
    {
        "pearson": Chunked(lambda *_: Moments.of, Moments.correlation),
        "spearman": Chunked(
            lambda values, _: partial(_map_ranks, _required(values).ranks()),
            Moments.correlation,
            _spearman_of_values,
        ),
        "co-activation": Chunked(
            lambda values, _: partial(_map_activity, _rest(_required(values))),
            lambda found: phi_from_counts(found.counts, found.n_frames),
            _phi_of_values,
        ),
        "mutual-information": Chunked(_prepare_codes, _information, _information_of_values),
        # Blending weights r by its reliability, which is nearly 1 in long recordings.
        "blended-correlation": Chunked(lambda *_: Moments.of, Moments.correlation),
    }
)
"""Chunked computation of each similarity, by its name."""


def computed_similarity(name: str) -> str:
    """Return the name of the similarity that is computed from chunks in place of the named one."""
    return "pearson" if name == "blended-correlation" else name
