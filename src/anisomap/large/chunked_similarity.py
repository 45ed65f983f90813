"""How each similarity is taken chunk by chunk, of more frames than memory holds.

Frames are gone through twice where it takes all of them to know what a reading means: first for
the values that occur, then for the statistic. Whoever can go through them only once keeps the
joint counts of values instead (`anisomap.numerics.similarity.joint_values`).
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

_COUNTS = 3 * 4  # bytes of a pair: a total, a part, and both together, in uint32
_MUCH = 1 << 28  # bytes of counts, beyond which it may be better to keep the codes

Take: TypeAlias = Callable[[NDArray[Any]], Any]
"""Makes an accumulator of a chunk of finite readings, shape (t, N)."""


@dataclass(frozen=True)
class Chunked:
    """A similarity in parts.

    Attributes
    ----------
    prepare : callable
        Given the values that occur and the number of bins, tells what to make of a chunk.
    finish : callable
        Turns what was made, merged over all chunks, into the (N, N) similarity.
    of_values : callable, optional
        Turns `JointValues` and the number of bins into the same. None where no pass over the
        values is needed: `prepare` then takes None for them.
    """

    prepare: Callable[[ValueCounts | None, int], Take]
    finish: Callable[[Any], Matrix]
    of_values: Callable[[JointValues, int], Matrix] | None = None

    @property
    def needs_values(self) -> bool:
        """Whether frames must be gone through for their values first."""
        return self.of_values is not None


def _settled(values: ValueCounts | None) -> ValueCounts:
    if values is None:
        raise TypeError("the values that occur must be counted first")
    return values


def _take_ranks(ranks: Recoding, chunk: NDArray[Any]) -> Moments:
    return Moments.of(ranks(chunk))


def _take_activity(rest: Rest, chunk: NDArray[Any]) -> CoOccurrences:
    return CoOccurrences.of(rest.active(chunk), Layout.of_switches(chunk.shape[1]))


def _take_codes(recoding: Recoding, layout: Layout, chunk: NDArray[Any]) -> CoOccurrences:
    return CoOccurrences.of(recoding(chunk), layout)


def _keep_codes(recoding: Recoding, chunk: NDArray[Any]) -> StoredCodes:
    return StoredCodes.of(recoding(chunk))


def _rest(values: ValueCounts) -> Rest:
    return rest_from_counts(zip(values.values, values.counts, strict=True))


def _codes(values: ValueCounts, bins: int) -> tuple[list[NDArray[np.intp]], Layout]:
    """Give the bin of every value, and how their series are laid out."""
    codes = [maximum_entropy_bins(counts, bins) for counts in values.counts]
    full = [
        np.bincount(code, weights=counts, minlength=bins)
        for code, counts in zip(codes, values.counts, strict=True)
    ]
    return codes, Layout.of(np.array(full).astype(np.int64))


def _prepare_codes(values: ValueCounts | None, bins: int) -> Take:
    known = _settled(values)
    layout = _codes(known, bins)[1]
    kept, counted = known.n_frames * known.n_sensors, _COUNTS * layout.n_series**2
    check_memory(
        min(kept, counted),
        f"counting all pairs of {bins} bins of {known.n_sensors} sensors",
        "use fewer bins, or linear correlation (r-anisomap)",
    )
    if kept <= counted and counted > _MUCH:
        return partial(_keep_codes, known.bins(bins))
    return partial(_take_codes, known.bins(bins), layout)


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
            lambda values, _: partial(_take_ranks, _settled(values).ranks()),
            Moments.correlation,
            _spearman_of_values,
        ),
        "co-activation": Chunked(
            lambda values, _: partial(_take_activity, _rest(_settled(values))),
            lambda found: phi_from_counts(found.counts, found.n_frames),
            _phi_of_values,
        ),
        "mutual-information": Chunked(_prepare_codes, _information, _information_of_values),
        # Recordings that come in chunks are long, and in those r is as good as reliable.
        "blended-correlation": Chunked(lambda *_: Moments.of, Moments.correlation),
    }
)
"""By the name of the similarity."""
