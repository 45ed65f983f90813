"""Joint counts of the codes of every pair of sensors, and the sums of n log n over them.

Every code of a sensor except its most frequent one, the reference, is a binary series: on in the
frames with this code. Only pairs of series are counted, (b - 1)^2 per pair of sensors; counts of
references follow from the marginals. On tactile data, where most readings are at rest, most
series are mostly off.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.special import xlogy

from anisomap.numerics.compiled.parallel import load_loops, parallel_map
from anisomap.numerics.precision import Floats, mirror

MIN_COMPILED_SENSORS = 300
"""Minimum number of sensors for compiled loops; below, loading numba takes longer than it saves."""

CHUNK_FRAMES = 8192
"""Frames multiplied at a time; float32 holds counts of up to 2^24 frames exactly."""

Counts: TypeAlias = NDArray[np.unsignedinteger[Any]]

Codes: TypeAlias = NDArray[np.integer[Any]] | NDArray[np.bool_]
"""Small non-negative integers, shape (T, N)."""

Counting: TypeAlias = Literal["auto", "products", "bits", "entries"]
"""Ways to count, with equal results.

- ``"products"``: matrix products of indicators, in numpy
- ``"bits"``: compiled, population counts of one bit per frame and series
- ``"entries"``: compiled, over the series that are on in each frame; for sparse series
- ``"auto"``: products below `MIN_COMPILED_SENSORS` sensors, else the cheaper of the other two
"""

_CountPanel: TypeAlias = Callable[[int, int, NDArray[np.uint32]], None]

_PANEL_SERIES = 96  # rows of counts per task, which fit into a second-level cache
_ENTRY_COST = 12  # time to count one pair of entries, in words of 64 bits; measured
_WORD = 64
_LINE_WORDS = 8  # words in a cache line of 64 bytes, the size in x86 and most ARM processors
_SAMPLE_FRAMES = 1000  # frames from which the cheaper way to count is estimated


@dataclass(frozen=True, eq=False)
class Layout:
    """Numbering of the series of N sensors.

    reference: Code of each sensor without a series.
    position: Series of each code of each sensor; -1 if there is none.
    first: First series of each sensor; the last entry is the number of series, M.
    """

    reference: NDArray[np.intp]
    position: NDArray[np.int64]
    first: NDArray[np.int64]

    @classmethod
    def of(cls, counts: NDArray[np.integer[Any]]) -> Layout:
        """Assign numbers to series, given the counts of the codes of each sensor, shape (N, b)."""
        reference = counts.argmax(axis=1)
        series = counts > 0
        np.put_along_axis(series, reference[:, None], False, axis=1)
        position = np.where(series, np.cumsum(series).reshape(series.shape) - 1, -1)
        first = np.concatenate([[0], np.cumsum(series.sum(axis=1))])
        return cls(reference, position, first.astype(np.int64))

    @classmethod
    def of_switches(cls, n_sensors: int) -> Layout:
        """Assign numbers to the series of binary sensors: code 1 of sensor i is series i."""
        numbers = np.arange(n_sensors + 1)
        position = np.column_stack([np.full(n_sensors, -1), numbers[:-1]])
        return cls(np.zeros(n_sensors, dtype=np.intp), position, numbers)

    @property
    def is_of_switches(self) -> bool:
        """Whether series i is code 1 of sensor i, as in `of_switches`."""
        return self.position.shape[1] == 2 and bool(
            np.array_equal(self.position[:, 1], np.arange(len(self.position)))
        )

    @property
    def n_series(self) -> int:
        """Number of series, M."""
        return int(self.first[-1])


def code_counts(codes: Codes, n_codes: int) -> NDArray[np.int64]:
    """Count the frames in which each sensor has each code, shape (N, b)."""
    if codes.shape[1] < MIN_COMPILED_SENSORS:
        found = [np.count_nonzero(codes == code, axis=0) for code in range(n_codes)]
        return np.column_stack(found).astype(np.int64)
    counts = np.zeros((codes.shape[1], n_codes), dtype=np.int64)
    load_loops("similarity").tally_codes(_as_integers(codes), counts)
    return counts


def co_occurrences(codes: Codes, layout: Layout, counting: Counting = "auto") -> Counts:
    """Count the frames in which both of two series are on."""
    n_series = layout.n_series
    counts = np.zeros((n_series, n_series), dtype=np.uint32)
    if counting == "products" or (counting == "auto" and codes.shape[1] < MIN_COMPILED_SENSORS):
        for start in range(0, len(codes), CHUNK_FRAMES):
            on = _indicators(codes[start : start + CHUNK_FRAMES], layout)
            counts += (on.T @ on).astype(np.uint32)
        return counts
    first = layout.first

    def keep(start: int, stop: int, panel: NDArray[np.uint32]) -> None:
        counts[first[start] : first[stop]] = panel

    _for_each_panel(codes, layout, counting, keep)
    mirror(counts)
    return counts


def joint_logarithms(codes: Codes, n_codes: int, counting: Counting = "auto") -> Floats:
    """Sum n log n over the joint counts of every pair of sensors, without storing the counts.

    Returns (N, N).
    """
    n_frames, n_sensors = codes.shape
    counts = code_counts(codes, n_codes)
    layout = Layout.of(counts)
    marginals = counts[layout.position >= 0]
    tallies = layout.first, marginals, _n_log_n(np.arange(n_frames + 1))
    joint = np.zeros((n_sensors, n_sensors))
    sum_logarithms = load_loops("similarity").sum_logarithms

    def add(start: int, stop: int, panel: NDArray[np.uint32]) -> None:
        sum_logarithms(panel, tallies, start, stop, joint)

    _for_each_panel(codes, layout, counting, add)
    np.fill_diagonal(joint, _marginal_logarithms(marginals, layout.first, n_frames))
    mirror(joint)
    return joint


def joint_logarithms_of_counts(counts: Counts, first: NDArray[np.int64], n_frames: int) -> Floats:
    """Sum n log n over the joint counts of every pair of sensors, given the counts.

    Returns (N, N).
    """
    marginals = np.diag(counts).astype(np.int64)
    own = _marginal_logarithms(marginals, first, n_frames)
    joint: Floats = np.add.outer(own, own) - float(xlogy(n_frames, n_frames))
    varying = np.flatnonzero(np.diff(first))
    begins = first[varying]
    for sensor in varying:
        # One sensor at a time: the logarithms of all M^2 cells would need another (M, M) matrix.
        both = counts[first[sensor] : first[sensor + 1]].astype(np.int64)
        mine = marginals[first[sensor] : first[sensor + 1]]
        alone = mine[:, None] - np.add.reduceat(both, begins, axis=1)
        other = marginals - both.sum(axis=0)
        neither = n_frames - mine.sum() - np.add.reduceat(other, begins)
        cells = np.add.reduceat(_n_log_n(both).sum(axis=0) + _n_log_n(other), begins)
        joint[sensor, varying] = cells + _n_log_n(alone).sum(axis=0) + _n_log_n(neither)
        joint[sensor, sensor] = own[sensor]
    mirror(joint)
    return joint


def _marginal_logarithms(
    marginals: NDArray[np.int64], first: NDArray[np.int64], n_frames: int
) -> Floats:
    """Sum n log n over the counts of all codes of each sensor, the reference included, (N,)."""
    sums = np.concatenate([[0], np.cumsum(marginals)])
    reference = n_frames - (sums[first[1:]] - sums[first[:-1]])
    logs = np.zeros(len(first) - 1)
    np.add.at(logs, np.repeat(np.arange(logs.size), np.diff(first)), _n_log_n(marginals))
    return np.asarray(logs + _n_log_n(reference))


def _n_log_n(counts: NDArray[np.integer[Any]]) -> Floats:
    return np.asarray(xlogy(counts, counts), dtype=np.float64)


def _indicators(codes: Codes, layout: Layout) -> NDArray[np.float32]:
    """Return 1 where a series is on, else 0, shape (t, M)."""
    on = np.empty((len(codes), layout.n_series), dtype=np.float32)
    for code, position in enumerate(layout.position.T):
        exists = position >= 0
        on[:, position[exists]] = codes[:, exists] == code
    return on


def _for_each_panel(
    codes: Codes,
    layout: Layout,
    counting: Counting,
    use: Callable[[int, int, NDArray[np.uint32]], None],
) -> None:
    """Count panels of series with all later series, and call `use` with each panel.

    Its arguments are the first and the last sensor (exclusive) and the counts; threads may call it.
    """
    first, n_series = layout.first, layout.n_series
    count = _panel_counter(codes, layout, counting)
    cuts = [0]
    for sensor in range(1, len(first)):
        if first[sensor] - first[cuts[-1]] >= _PANEL_SERIES or sensor == len(first) - 1:
            cuts.append(sensor)

    def work(sensors: tuple[int, int]) -> None:
        start, stop = sensors
        panel = np.zeros((int(first[stop] - first[start]), n_series), dtype=np.uint32)
        count(int(first[start]), int(first[stop]), panel)
        use(start, stop, panel)

    with parallel_map(n_series) as map_threads:
        map_threads(work, pairwise(cuts))


def _panel_counter(codes: Codes, layout: Layout, counting: Counting) -> _CountPanel:
    if counting == "auto":
        some = codes[np.linspace(0, len(codes) - 1, min(len(codes), _SAMPLE_FRAMES)).astype(int)]
        on = np.count_nonzero(some != layout.reference.astype(codes.dtype), axis=1)
        pairs = len(codes) * float((on.astype(np.float64) ** 2).mean()) if len(codes) else 0.0
        words = -(-len(codes) // _WORD)
        sparse = _ENTRY_COST * pairs < float(layout.n_series) ** 2 * words
        counting = "entries" if sparse else "bits"
    loops = load_loops("similarity")
    if counting == "entries":
        return partial(loops.count_entries, _entries(codes, layout))
    return partial(loops.count_bits, _bits(codes, layout))


def _bits(codes: Codes, layout: Layout) -> NDArray[np.uint64]:
    bits = _aligned_zeros(layout.n_series + 1, -(-len(codes) // _WORD))
    if codes.dtype == np.bool_ and layout.is_of_switches:
        load_loops("similarity").pack_switches(_as_integers(codes), bits[:-1])
        return bits[:-1]
    load_loops("similarity").pack_bits(_as_integers(codes), layout.position, bits)
    return bits[:-1]


def _aligned_zeros(n_rows: int, n_words: int) -> NDArray[np.uint64]:
    """Return words of 64 bits, shape (n_rows, n_words or more); each row begins a cache line."""
    stride = -(-n_words // _LINE_WORDS) * _LINE_WORDS
    words = np.zeros(n_rows * stride + _LINE_WORDS - 1, dtype=np.uint64)
    skipped = -(words.ctypes.data // words.itemsize) % _LINE_WORDS
    return words[skipped : skipped + n_rows * stride].reshape(n_rows, stride)


def _as_integers(codes: Codes) -> Codes:
    return codes.view(np.uint8) if codes.dtype == np.bool_ else codes


def _entries(codes: Codes, layout: Layout) -> tuple[NDArray[Any], ...]:
    """List the E series that are on, frame by frame.

    Returns the series, by frame and increasing series, (E,); the index at which the frame of each
    ends, (E,); the indices of the entries of each series, (E,); and the first of these, (M + 1,).
    """
    n_frames, n_sensors = codes.shape
    on = codes != layout.reference.astype(codes.dtype)
    counts = np.count_nonzero(on, axis=1)
    begins = np.concatenate([[0], np.cumsum(counts)])
    found = np.flatnonzero(on)  # faster than a search in two dimensions
    sensors = found - np.repeat(np.arange(n_frames) * n_sensors, counts)
    series = layout.position[sensors, codes[on].astype(np.intp)]
    shape = (n_frames, layout.n_series)
    by_series: Any = csr_array((np.arange(len(series)), series, begins), shape=shape).tocsc()
    places, starts = by_series.data, by_series.indptr.astype(np.int64)
    return series.astype(np.uint32), np.repeat(begins[1:], counts), places, starts
