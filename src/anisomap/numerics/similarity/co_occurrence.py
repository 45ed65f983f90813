"""How often pairs of sensors have each pair of codes at once: exact counts, and their logarithms.

Every code of a sensor but one, its reference, is a series that is on in some frames and off in
others. Only pairs of series are counted, (b - 1)^2 a pair of sensors; what the reference does
follows from the marginals. With the most frequent code for a reference, a skin's series are
mostly off.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.special import xlogy
from threadpoolctl import threadpool_info

from anisomap.numerics.compiled.co_occurrence import (
    Entries,
    Tallies,
    compiled,
    dense_panel,
    fold_panel,
    list_entries,
    pack_bits,
    sparse_panel,
    tally_codes,
)
from anisomap.numerics.precision import mirror

MIN_COMPILED_SENSORS = 300
"""From so many sensors on, compiled loops pay; fewer are left to numpy."""

CHUNK_FRAMES = 8192
"""Frames that are multiplied at a time: float32 holds every count of so few exactly."""

Counts: TypeAlias = NDArray[np.unsignedinteger[Any]]

Codes: TypeAlias = NDArray[np.integer[Any]] | NDArray[np.bool_]
"""Small numbers from 0, frames x sensors."""

_Panel: TypeAlias = Callable[[int, int, NDArray[np.uint32]], None]

_PANEL_SERIES = 96
_INCREMENT = 12  # words of bits that are counted in the time of one step from entry to entry
_WORD = 64


@dataclass(frozen=True, eq=False)
class Layout:
    """Which series the codes of N sensors make.

    Attributes
    ----------
    reference : ndarray of int, shape (N,)
        The code of each sensor that is no series.
    position : ndarray of int, shape (N, b)
        The series that each code of each sensor is; -1 for references and codes that never occur.
    first : ndarray of int, shape (N + 1,)
        Where the series of each sensor begin; the last is their number, M.
    """

    reference: NDArray[np.intp]
    position: NDArray[np.int64]
    first: NDArray[np.int64]

    @classmethod
    def of(cls, counts: NDArray[np.integer[Any]]) -> Layout:
        """Lay series out by how often every sensor has every code, shape (N, b)."""
        reference = counts.argmax(axis=1)
        series = counts > 0
        np.put_along_axis(series, reference[:, None], False, axis=1)
        position = np.where(series, np.cumsum(series).reshape(series.shape) - 1, -1)
        first = np.concatenate([[0], np.cumsum(series.sum(axis=1))])
        return cls(reference, position, first.astype(np.int64))

    @classmethod
    def of_switches(cls, n_sensors: int) -> Layout:
        """Lay out sensors that are on or off: a series each, whatever they do."""
        numbers = np.arange(n_sensors + 1)
        position = np.column_stack([np.full(n_sensors, -1), numbers[:-1]])
        return cls(np.zeros(n_sensors, dtype=np.intp), position, numbers)

    @property
    def n_series(self) -> int:
        """How many series there are, M."""
        return int(self.first[-1])


def code_counts(codes: Codes, n_codes: int) -> NDArray[np.int64]:
    """Count how often every sensor has every code, shape (N, b), of codes of shape (T, N)."""
    if codes.shape[1] < MIN_COMPILED_SENSORS:
        found = [np.count_nonzero(codes == code, axis=0) for code in range(n_codes)]
        return np.column_stack(found).astype(np.int64)
    counts = np.zeros((codes.shape[1], n_codes), dtype=np.int64)
    compiled(tally_codes)(_plain(codes), counts)
    return counts


def co_occurrences(codes: Codes, layout: Layout) -> NDArray[np.uint32]:
    """Count in how many frames both of two series are on.

    Parameters
    ----------
    codes : ndarray of int, shape (T, N)
        Small numbers from 0.
    layout : Layout

    Returns
    -------
    ndarray of uint32, shape (M, M)
        Symmetric; how often a series itself is on stands on the diagonal.
    """
    n_series = layout.n_series
    counts = np.zeros((n_series, n_series), dtype=np.uint32)
    if codes.shape[1] < MIN_COMPILED_SENSORS:
        for start in range(0, len(codes), CHUNK_FRAMES):
            on = _indicators(codes[start : start + CHUNK_FRAMES], layout)
            counts += (on.T @ on).astype(np.uint32)
        return counts
    first = layout.first

    def keep(start: int, stop: int, panel: NDArray[np.uint32]) -> None:
        counts[first[start] : first[stop]] = panel

    _in_panels(codes, layout, keep)
    mirror(counts, upper=True)
    return counts


def joint_logarithms(codes: Codes, n_codes: int) -> NDArray[np.float64]:
    """Sum n log n over the joint counts of every pair of sensors, without keeping the counts.

    Parameters
    ----------
    codes : ndarray of int, shape (T, N)
        Numbers from 0 to b - 1.
    n_codes : int
        b.

    Returns
    -------
    ndarray of shape (N, N)
        Symmetric to the last bit. On the diagonal, the sum over the sensor's own codes.
    """
    n_frames, n_sensors = codes.shape
    counts = code_counts(codes, n_codes)
    layout = Layout.of(counts)
    marginals = _marginals(counts, layout)
    known = Tallies(layout.first, marginals, _n_log_n(np.arange(n_frames + 1)))
    joint = np.zeros((n_sensors, n_sensors))
    fold = compiled(fold_panel)

    def take_in(start: int, stop: int, panel: NDArray[np.uint32]) -> None:
        fold(panel, known, start, stop, joint)

    _in_panels(codes, layout, take_in)
    np.fill_diagonal(joint, own_logarithms(marginals, layout.first, n_frames))
    mirror(joint, upper=True)
    return joint


def joint_logarithms_of_counts(
    counts: Counts, first: NDArray[np.int64], n_frames: int
) -> NDArray[np.float64]:
    """Sum n log n over the joint counts of every pair of sensors.

    Parameters
    ----------
    counts : ndarray of int, shape (M, M)
        See `co_occurrences`.
    first : ndarray of int, shape (N + 1,)
        See `Layout`.
    n_frames : int
        T.

    Returns
    -------
    ndarray of shape (N, N)
        As from `joint_logarithms`.
    """
    marginals = np.diag(counts).astype(np.int64)
    own = own_logarithms(marginals, first, n_frames)
    joint: NDArray[np.float64] = np.add.outer(own, own) - float(xlogy(n_frames, n_frames))
    moving = np.flatnonzero(np.diff(first))
    begins = first[moving]
    for sensor in moving:
        # Rows of one sensor at a time: the logarithms of all cells would be a matrix of their own.
        both = counts[first[sensor] : first[sensor + 1]].astype(np.int64)
        mine = marginals[first[sensor] : first[sensor + 1]]
        alone = mine[:, None] - np.add.reduceat(both, begins, axis=1)
        other = marginals - both.sum(axis=0)
        neither = n_frames - mine.sum() - np.add.reduceat(other, begins)
        cells = np.add.reduceat(_n_log_n(both).sum(axis=0) + _n_log_n(other), begins)
        joint[sensor, moving] = cells + _n_log_n(alone).sum(axis=0) + _n_log_n(neither)
        joint[sensor, sensor] = own[sensor]
    mirror(joint, upper=True)
    return joint


def own_logarithms(
    marginals: NDArray[np.int64], first: NDArray[np.int64], n_frames: int
) -> NDArray[np.float64]:
    """Sum n log n over the codes of each sensor, shape (N,), its reference among them."""
    sums = np.concatenate([[0], np.cumsum(marginals)])
    resting = n_frames - (sums[first[1:]] - sums[first[:-1]])
    logs = np.zeros(len(first) - 1)
    np.add.at(logs, np.repeat(np.arange(logs.size), np.diff(first)), _n_log_n(marginals))
    return np.asarray(logs + _n_log_n(resting))


def _n_log_n(counts: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
    return np.asarray(xlogy(counts, counts), dtype=np.float64)


def _indicators(codes: Codes, layout: Layout) -> NDArray[np.float32]:
    """Tell with 0 and 1 which series are on, shape (t, M)."""
    on = np.empty((len(codes), layout.n_series), dtype=np.float32)
    for code, position in enumerate(layout.position.T):
        there = position >= 0
        on[:, position[there]] = codes[:, there] == code
    return on


def _marginals(counts: NDArray[np.int64], layout: Layout) -> NDArray[np.int64]:
    """Pick from how often sensors have codes, shape (N, b), how often series are on."""
    return np.asarray(counts[layout.position >= 0])


def _in_panels(
    codes: Codes,
    layout: Layout,
    take: Callable[[int, int, NDArray[np.uint32]], None],
) -> None:
    """Count series against all that follow, some sensors at a time, and hand the counts on.

    `take` is called with the sensors' range and their panel, by several threads at once.
    """
    first, n_series = layout.first, layout.n_series
    count = _panel_counter(codes, layout)
    cuts = [0]
    for sensor in range(1, len(first)):
        if first[sensor] - first[cuts[-1]] >= _PANEL_SERIES or sensor == len(first) - 1:
            cuts.append(sensor)

    def work(start: int, stop: int) -> None:
        panel = np.zeros((int(first[stop] - first[start]), n_series), dtype=np.uint32)
        count(int(first[start]), int(first[stop]), panel)
        take(start, stop, panel)

    with ThreadPoolExecutor(_n_threads()) as pool:
        # Going through the results lets an error of a thread out.
        for _ in pool.map(work, cuts[:-1], cuts[1:]):
            pass


def _n_threads() -> int:
    """Use as many threads as linear algebra may: one knob for both, which workers turn to 1."""
    return max((int(found["num_threads"]) for found in threadpool_info()), default=1)


def _panel_counter(codes: Codes, layout: Layout) -> _Panel:
    """Choose how to count by what it costs: bits of all frames, or entries of those that are on."""
    resting = layout.reference.astype(codes.dtype)
    together = np.count_nonzero(codes != resting, axis=1).astype(np.float64)
    words = -(-len(codes) // _WORD)
    if _INCREMENT * (together**2).sum() < float(layout.n_series) ** 2 * words:
        return partial(compiled(sparse_panel), _entries(codes, layout))
    return partial(compiled(dense_panel), _bits(codes, layout))


def _bits(codes: Codes, layout: Layout) -> NDArray[np.uint64]:
    """Pack what is on into a bit a frame, shape (M, words)."""
    bits = np.zeros((layout.n_series + 1, -(-len(codes) // _WORD)), dtype=np.uint64)
    compiled(pack_bits)(_plain(codes), layout.position, bits)
    return bits[:-1]


def _plain(codes: Codes) -> Codes:
    return codes.view(np.uint8) if codes.dtype == np.bool_ else codes


def _entries(codes: Codes, layout: Layout) -> Entries:
    """List what is on frame by frame, and where each series stands in the list."""
    marginals = _marginals(code_counts(codes, layout.position.shape[1]), layout)
    starts = np.concatenate([[0], np.cumsum(marginals)])
    size = int(starts[-1])
    on = Entries(
        np.empty(size, dtype=np.uint32),
        np.empty(size, dtype=np.int64),
        np.empty(size, dtype=np.int64),
        starts,
    )
    compiled(list_entries)(_plain(codes), layout.reference, layout.position, on)
    return on
