"""Similarities computed chunk by chunk, for recordings larger than memory.

Statistics that depend on the distribution of all readings take two passes over the frames: one to
count distinct values, one to compute the statistic.
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
from anisomap.numerics.columns import ranks_from_counts
from anisomap.numerics.precision import Reals
from anisomap.numerics.similarity.binning import Recoding, ValueCounts, maximum_entropy_bins
from anisomap.numerics.similarity.co_occurrence import Layout, joint_logarithms_of_counts
from anisomap.numerics.similarity.correlation import (
    CoOccurrences,
    Moments,
    StoredCodes,
    phi_from_counts,
)
from anisomap.numerics.similarity.information import (
    information_from_codes,
    information_from_logarithms,
)
from anisomap.numerics.similarity.rest import rest_from_counts

_BYTES_PER_COUNT = 3 * 4  # uint32: the total, the next result, and their sum
_MAX_COUNT_BYTES = 1 << 28  # of counts; above, codes are stored if smaller. Chosen by hand

Mapper: TypeAlias = Callable[[NDArray[Any]], Any]
"""Makes an accumulator of a chunk of finite readings, shape (t, N)."""

Outcomes: TypeAlias = tuple[list[NDArray[Any]], Layout | None]
"""What each distinct value of each sensor counts as: codes with a layout, or scores without."""


@dataclass(frozen=True)
class Chunked:
    """A similarity as a map-reduce.

    finish: Converts the accumulator of all chunks to the (N, N) similarity.
    recode: ``recode(values, bins)`` returns what the distinct values of all frames count as; None
        if the readings are used as they are.
    can_store: Whether `finish` accepts `StoredCodes`, which take less memory in few frames.
    """

    finish: Callable[[Any], Reals]
    recode: Callable[[ValueCounts, int], Outcomes] | None = None
    can_store: bool = False

    @property
    def needs_values(self) -> bool:
        """Whether a first pass must count distinct values."""
        return self.recode is not None

    def prepare(self, values: ValueCounts | None, bins: int) -> Mapper:
        """Return the mapper, given the counts of distinct values if they are needed."""
        if self.recode is None or values is None:
            return Moments.of
        outcomes, layout = self.recode(values, bins)
        recoding = Recoding.of(values.values, outcomes, outcomes[0].dtype.type)
        if layout is None:
            return _Recoded(recoding, Moments.of)
        if self.can_store:
            stored, counted = values.n_frames * values.n_sensors, layout.n_series**2
            counted *= _BYTES_PER_COUNT
            check_memory(
                min(stored, counted),
                f"counting all pairs of {bins} bins of {values.n_sensors} sensors",
                "use fewer bins, or a method based on Pearson's r",
            )
            if stored <= counted and counted > _MAX_COUNT_BYTES:
                return _Recoded(recoding, StoredCodes.of)
        return _Recoded(recoding, partial(CoOccurrences.of, layout=layout))


@dataclass(frozen=True)
class _Recoded:
    """Recodes a chunk, then makes an accumulator of it."""

    recode: Recoding
    make: Mapper

    def __call__(self, chunk: NDArray[Any]) -> Any:
        return self.make(self.recode(chunk))


def _ranks(values: ValueCounts, _: int) -> Outcomes:
    """Return the mean rank of every value, from 1 to T."""
    return [ranks_from_counts(counts) for counts in values.counts], None


def _activity(values: ValueCounts, _: int) -> Outcomes:
    """Return which values exceed rest."""
    rest = rest_from_counts(zip(values.values, values.counts, strict=True))
    active = [
        rest.side[i] * (levels - rest.value[i]) - rest.threshold[i] > 0
        for i, levels in enumerate(values.values)
    ]
    return active, Layout.of_switches(values.n_sensors)


def _bins(values: ValueCounts, bins: int) -> Outcomes:
    """Return the maximum-entropy bin of every value."""
    codes = [maximum_entropy_bins(counts, bins).astype(np.uint16) for counts in values.counts]
    full = [
        np.bincount(code, weights=counts, minlength=bins)
        for code, counts in zip(codes, values.counts, strict=True)
    ]
    return codes, Layout.of(np.array(full).astype(np.int64))


def _phi(found: CoOccurrences) -> Reals:
    return phi_from_counts(found.counts, found.n_frames)


def _information(found: CoOccurrences | StoredCodes) -> Reals:
    if isinstance(found, StoredCodes):
        return information_from_codes(found.whole())
    joint = joint_logarithms_of_counts(found.counts, found.first, found.n_frames)
    return information_from_logarithms(joint, found.n_frames)


CHUNKED: Mapping[str, Chunked] = MappingProxyType(
    {
        "pearson": Chunked(Moments.correlation),
        "spearman": Chunked(Moments.correlation, _ranks),
        "co-activation": Chunked(_phi, _activity),
        "mutual-information": Chunked(_information, _bins, can_store=True),
        # Blending weights r by its reliability, which is nearly 1 in long recordings.
        "blended-correlation": Chunked(Moments.correlation),
    }
)
"""Chunked computation of each similarity, by its name."""


def computed_similarity(name: str) -> str:
    """Return the name of the similarity that is computed from chunks in place of the named one."""
    return "pearson" if name == "blended-correlation" else name
