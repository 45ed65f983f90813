"""Similarity of all pairs of sensors over all frames of a Dask array, summed block by block.

The blocks are summed where Dask runs: in threads, in processes or on a cluster. Bins, ranks and
rest values depend on the distribution of all readings. They require two passes over the blocks: the
first counts distinct values, the second compares the sensors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from anisomap.errors import InputError, import_extra
from anisomap.numerics.columns import ranks_from_counts
from anisomap.numerics.precision import Floats, Reals, check_memory, check_pair_memory
from anisomap.numerics.similarity.binning import Recoding, ValueCounts, maximum_entropy_bins
from anisomap.numerics.similarity.correlation import PairSums
from anisomap.numerics.similarity.information import information_from_logarithms, joint_logarithms
from anisomap.numerics.similarity.rest import rest_from_counts
from anisomap.recording import MAX_READING

Sum: TypeAlias = PairSums | ValueCounts
Summand: TypeAlias = Callable[[NDArray[Any]], Any]
"""Sums a block of finite readings, shape (t, N)."""

_BYTES_PER_COUNT = 3 * 8  # float64: the total, the next result, and their sum
_SUMS_AT_ONCE = 4  # merged by one task, which holds them in memory


@dataclass(frozen=True, eq=False)
class SummedSimilarity:
    """Similarity (N, N) over all frames, mask of the sensors that vary, (N,), and number of frames.

    notes: Differences from the similarity of an array in memory.
    """

    similarity: Reals
    varying: NDArray[np.bool_]
    n_frames: int
    notes: tuple[str, ...] = ()


def sum_blocks(readings: Any, similarity: str, bins: int) -> SummedSimilarity:
    """Compute a similarity, a key of `SUMMED`, of a Dask array of finite readings (T, N)."""
    if similarity not in SUMMED:
        raise InputError(
            f"{similarity} needs all readings in memory: choose another method, such as r-anisomap,"
            " or sample frames that fit in memory, as by readings[::10].compute()"
        )
    blocks = _frames_of(readings)
    check_pair_memory(readings.shape[1], refined=False)
    prepare, finish = SUMMED[similarity]
    values: ValueCounts | None = None
    summand: Summand = PairSums.of
    notes: tuple[str, ...] = ()
    if prepare is not None:
        values = _total(blocks, ValueCounts.of)
        summand = prepare(values, bins)
        if not values.exact:
            notes = (
                f"{(values.n_rounded_bits > 0).sum()} of {values.n_sensors} sensors have more than "
                f"{values.max_values} distinct values, which were rounded for bins, ranks and rest",
            )
    total = _total(blocks, summand)
    varying = np.diag(total.products) > 0 if values is None else values.varying()
    return SummedSimilarity(finish(total, len(varying)), varying, total.n_frames, notes)


def _frames_of(readings: Any) -> list[Any]:
    """Return the blocks of frames as delayed arrays; each block contains all sensors."""
    array = import_extra("dask.array", "a Dask array", "cluster")
    if not isinstance(readings, array.Array):
        raise InputError(
            f"Dask objects must be arrays, got a {type(readings).__name__}; use "
            "frame.to_dask_array(), or array.data of xarray"
        )
    if readings.ndim != 2 or readings.dtype.kind not in "biuf" or not readings.shape[1] > 0:
        raise InputError(f"a Dask array must hold (T, N) real numbers, got {readings!r}")
    return list(readings.rechunk({1: -1}).to_delayed().ravel())


def _total(blocks: Sequence[Any], summand: Summand) -> Any:
    """Sum all blocks in a tree, which limits the number of sums in memory."""
    dask = import_extra("dask", "a Dask array", "cluster")
    sums = [dask.delayed(_sum_of)(block, summand) for block in blocks]
    while len(sums) > 1:
        parts = range(0, len(sums), _SUMS_AT_ONCE)
        sums = [dask.delayed(_merged)(sums[i : i + _SUMS_AT_ONCE]) for i in parts]
    with threadpool_limits(1):  # the tasks run in parallel already
        (total,) = dask.compute(*sums)
    if total is None:
        raise InputError("the Dask array has no frames")
    return total


def _sum_of(block: NDArray[Any], summand: Summand) -> Sum | None:
    if not len(block):
        return None
    faulty = np.flatnonzero(~(np.abs(block.astype(np.float64)) <= MAX_READING).all(axis=0))
    if faulty.size:
        raise InputError(f"sensor {faulty[0]} reads NaN or above {MAX_READING:g}; fill it first")
    found: Sum = summand(block)
    return found


def _merged(sums: Sequence[Any]) -> Any:
    total = None
    for one in sums:
        total = one if total is None else total if one is None else total.merged(one)
    return total


def _recoded(values: ValueCounts, outcomes: Sequence[NDArray[Any]], summand: Summand) -> Summand:
    """Sum recoded readings, given the code of each distinct value."""
    recode = Recoding.of(values.values, outcomes, outcomes[0].dtype.type)
    return partial(_of_recoded, recode, summand)


def _of_recoded(recode: Recoding, summand: Summand, block: NDArray[Any]) -> Any:
    return summand(recode(block))


def _ranks(values: ValueCounts, _: int) -> Summand:
    """Sum over the mean ranks of readings, from 1 to T."""
    return _recoded(values, [ranks_from_counts(counts) for counts in values.counts], PairSums.of)


def _activity(values: ValueCounts, _: int) -> Summand:
    """Sum over indicators: 0 at rest, 1 beyond rest."""
    rest = rest_from_counts(zip(values.values, values.counts, strict=True))
    active = [
        (rest.side[i] * (levels - rest.value[i]) > rest.threshold[i]).astype(np.float64)
        for i, levels in enumerate(values.values)
    ]
    return _recoded(values, active, PairSums.of)


def _bins(values: ValueCounts, bins: int) -> Summand:
    """Sum over indicators of bins: 1 for the bin of a reading, 0 for other bins."""
    codes = [maximum_entropy_bins(counts, bins).astype(np.uint16) for counts in values.counts]
    check_memory(
        _BYTES_PER_COUNT * (bins * values.n_sensors) ** 2,
        f"counting all pairs of {bins} bins of {values.n_sensors} sensors",
        "use fewer bins, or a method based on Pearson's r",
    )
    return _recoded(values, codes, partial(_of_bins, bins))


def _of_bins(bins: int, codes: NDArray[Any]) -> PairSums:
    return PairSums.of(np.concatenate([codes == code for code in range(bins)], axis=1) * 1.0)


def _information(found: PairSums, n_sensors: int) -> Reals:
    counts = np.rint(found.products + found.n_frames * np.outer(found.mean, found.mean))
    tables = counts.reshape(len(counts) // n_sensors, n_sensors, -1, n_sensors)

    def count(first: int, second: int) -> Floats:
        return np.asarray(tables[first, :, second])

    return information_from_logarithms(joint_logarithms(count, len(tables)), found.n_frames)


def _correlation(found: PairSums, _: int) -> Reals:
    return found.correlation()


SUMMED: Mapping[
    str, tuple[Callable[[ValueCounts, int], Summand] | None, Callable[[PairSums, int], Reals]]
] = MappingProxyType(
    {
        "pearson": (None, _correlation),
        "spearman": (_ranks, _correlation),
        "co-activation": (_activity, _correlation),
        "mutual-information": (_bins, _information),
    }
)
"""The two functions of each similarity. ``prepare(values, bins)`` returns the summand, given the
distinct values of all frames and their counts; it is None if the readings themselves are summed.
``finish(total, n_sensors)`` returns the similarity (N, N)."""
