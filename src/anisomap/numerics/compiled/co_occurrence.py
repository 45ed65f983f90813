"""Compiled inner loops that count how often pairs of series are on together.

Plain numba is enough here: LLVM recognises the arithmetic in `dense_panel` as a population count
and vectorises it. Loops are compiled when they are first asked for, and kept on disk. They let go
of the interpreter's lock, so that threads can share the panels.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

WORDS = 256
"""Words of a series that are counted at a time: a panel of them stays in a core's own cache."""

_ONES, _TWOS = np.uint64(1), np.uint64(2)
_FOURS, _TOP = np.uint64(4), np.uint64(56)
_PAIRS = np.uint64(0x5555555555555555)
_QUADS = np.uint64(0x3333333333333333)
_OCTETS = np.uint64(0x0F0F0F0F0F0F0F0F)
_BYTES = np.uint64(0x0101010101010101)


class Entries(NamedTuple):
    """What is on in a recording, as lists of E entries.

    Attributes
    ----------
    series : ndarray of uint32, shape (E,)
        What is on, frame after frame, in increasing order in each.
    ends : ndarray of int64, shape (E,)
        Where in `series` the frame of each entry ends.
    entries : ndarray of int64, shape (E,)
        Where in `series` each series stands, series after series.
    starts : ndarray of int64, shape (M + 1,)
        Where in `entries` each series begins.
    """

    series: NDArray[np.uint32]
    ends: NDArray[np.int64]
    entries: NDArray[np.int64]
    starts: NDArray[np.int64]


class Tallies(NamedTuple):
    """What is known of single series.

    Attributes
    ----------
    first : ndarray of int64, shape (N + 1,)
        Where the series of each sensor begin. Frames in which none of them is on are its rest.
    marginals : ndarray of int64, shape (M,)
        Frames in which each is on.
    logs : ndarray of shape (T + 1,)
        n log n.
    """

    first: NDArray[np.int64]
    marginals: NDArray[np.int64]
    logs: NDArray[np.float64]


@cache
def compiled(loop: Callable[..., None]) -> Callable[..., None]:
    """Compile one of the loops of this module.

    Parameters
    ----------
    loop : callable
        `tally_codes`, `pack_bits`, `dense_panel`, `list_entries`, `sparse_panel` or `fold_panel`.

    Returns
    -------
    callable
        The same, fast.
    """
    compiler: Any = import_module("anisomap.numerics.compiled.jit")
    fast: Callable[..., None] = compiler.loop()(loop)
    return fast


def tally_codes(codes: NDArray[Any], counts: NDArray[np.int64]) -> None:
    """Count how often every sensor has every code.

    Parameters
    ----------
    codes : ndarray of int, shape (T, N)
        What every sensor read.
    counts : ndarray of int64, shape (N, b)
        Zeros; filled.
    """
    for frame in range(codes.shape[0]):
        for sensor in range(codes.shape[1]):
            counts[sensor, codes[frame, sensor]] += 1


def pack_bits(codes: NDArray[Any], position: NDArray[np.int64], bits: NDArray[np.uint64]) -> None:
    """Pack what is on into a bit a frame.

    Parameters
    ----------
    codes : ndarray of int, shape (T, N)
        What every sensor read.
    position : ndarray of int64, shape (N, b)
        See `anisomap.numerics.similarity.co_occurrence.Layout`.
    bits : ndarray of uint64, shape (M + 1, words)
        Zeros; filled. What is no series goes to the last row, which saves asking.
    """
    for frame in range(codes.shape[0]):
        word, bit = frame // 64, _ONES << np.uint64(frame % 64)
        for sensor in range(codes.shape[1]):
            bits[position[sensor, codes[frame, sensor]], word] |= bit


def dense_panel(
    bits: NDArray[np.uint64], start: int, stop: int, counts: NDArray[np.uint32]
) -> None:
    """Count in how many frames both of two series are on, by their bits.

    Parameters
    ----------
    bits : ndarray of uint64, shape (M, words)
        A bit a frame of each series.
    start, stop : int
        The series of the panel.
    counts : ndarray of uint32, shape (stop - start, M)
        Zeros; filled where the column is not less than the row's series.
    """
    n_series, n_words = bits.shape
    for begin in range(0, n_words, WORDS):
        end = min(n_words, begin + WORDS)
        for q in range(start, n_series):
            right = bits[q, begin:end]
            for p in range(start, min(stop, q + 1)):
                left = bits[p, begin:end]
                total = np.uint64(0)
                for k in range(left.size):
                    x = left[k] & right[k]
                    x -= (x >> _ONES) & _PAIRS
                    x = (x & _QUADS) + ((x >> _TWOS) & _QUADS)
                    x = (x + (x >> _FOURS)) & _OCTETS
                    total += (x * _BYTES) >> _TOP
                counts[p - start, q] += np.uint32(total)


def sparse_panel(on: Entries, start: int, stop: int, counts: NDArray[np.uint32]) -> None:
    """Count the same frame by frame, of what is on only.

    Parameters
    ----------
    on : Entries
    start, stop, counts
        As for `dense_panel`.
    """
    for p in range(start, stop):
        row = counts[p - start]
        for k in range(on.starts[p], on.starts[p + 1]):
            entry = on.entries[k]
            for other in range(entry, on.ends[entry]):
                row[on.series[other]] += np.uint32(1)


def list_entries(
    codes: NDArray[Any], reference: NDArray[np.intp], position: NDArray[np.int64], on: Entries
) -> None:
    """List what is on, frame by frame.

    Parameters
    ----------
    codes : ndarray of int, shape (T, N)
        What every sensor read.
    reference, position
        See `anisomap.numerics.similarity.co_occurrence.Layout`.
    on : Entries
        With `starts` known; the rest is filled.
    """
    free, entry = on.starts.copy(), 0
    for frame in range(codes.shape[0]):
        begin = entry
        for sensor in range(codes.shape[1]):
            code = codes[frame, sensor]
            if code != reference[sensor]:
                p = position[sensor, code]
                on.series[entry] = p
                on.entries[free[p]] = entry
                free[p] += 1
                entry += 1
        on.ends[begin:entry] = entry


def fold_panel(
    counts: NDArray[np.uint32], known: Tallies, start: int, stop: int, joint: NDArray[np.float64]
) -> None:
    """Sum n log n over all cells of the table of two sensors, from the cells that were counted.

    Parameters
    ----------
    counts : ndarray of uint32, shape (first[stop] - first[start], M)
        A panel, of whole sensors.
    known : Tallies
    start, stop : int
        The sensors of the panel.
    joint : ndarray of shape (N, N)
        Filled for its sensors as rows, and greater ones as columns.
    """
    first, marginals, logs = known.first, known.marginals, known.logs
    n_frames, above = len(logs) - 1, first[start]
    for i in range(start, stop):
        for j in range(i + 1, len(first) - 1):
            neither, total = n_frames, 0.0
            for q in range(first[j], first[j + 1]):
                alone = marginals[q]
                for p in range(first[i], first[i + 1]):
                    alone -= counts[p - above, q]
                total += logs[alone]
                neither -= alone
            for p in range(first[i], first[i + 1]):
                alone = marginals[p]
                for q in range(first[j], first[j + 1]):
                    both = counts[p - above, q]
                    total += logs[both]
                    alone -= both
                total += logs[alone]
                neither -= marginals[p]
            joint[i, j] = total + logs[neither]
