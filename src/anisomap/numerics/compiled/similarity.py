"""Compiled loops of similarities: rest, bins, products of readings, and co-occurrences.

M binary series belong to N sensors; see `anisomap.numerics.similarity.co_occurrence.Layout`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.compiled.parallel import loop
from anisomap.numerics.compiled.stress import Ints, Reals


@loop()
def add_bin(
    costs: Ints,
    ends: Ints,
    least: Ints,
    bounds: tuple[int, int, int, int],
    found: tuple[Ints, Ints],
) -> None:
    """Find the best division of beginnings of m values into one more bin, as numpy in `binning`.

    costs (T + 1,): Of a bin of each size. ends, least (m + 1,): Cumulative counts of the values,
    and the least cost without the bin. bounds: First and last number of values without the bin, and
    with it. found (m + 1,): The least cost with the bin and the value at which it begins, filled.
    """
    lowest, highest, first, last = bounds
    result, cut = found
    stride = 1
    while 2 * stride <= last - first + 1:
        stride *= 2
    while stride > 0:
        for end in range(first + stride - 1, last + 1, 2 * stride):
            low = lowest if end - stride < first else cut[end - stride]
            high = min(highest if end + stride > last else cut[end + stride], end - 1)
            best, at = least[low] + costs[ends[end] - ends[low]], low
            for begin in range(low + 1, high + 1):
                cost = least[begin] + costs[ends[end] - ends[begin]]
                if cost < best:
                    best, at = cost, begin
            result[end], cut[end] = best, at
        stride //= 2


@loop()
def add_products(panel: Reals, first: int, sensors: Ints, values: Reals, begins: Ints) -> None:
    """Add products of values in the same frame to ``panel[i - first, j]`` for all j >= i.

    Values of frame f, by increasing sensor, are those from ``begins[f]`` to ``begins[f + 1]``. Four
    rows are filled at a time, which changes some elements with j < i, too.
    """
    last = first + len(panel)
    for frame in range(len(begins) - 1):
        entry, end = begins[frame], begins[frame + 1]
        beyond = end
        while entry < beyond:  # bisection for the first sensor of the panel
            middle = (entry + beyond) // 2
            if sensors[middle] < first:
                entry = middle + 1
            else:
                beyond = middle
        while entry + 3 < end and sensors[entry + 3] < last:
            row, value = panel[sensors[entry] - first], values[entry]
            row1, value1 = panel[sensors[entry + 1] - first], values[entry + 1]
            row2, value2 = panel[sensors[entry + 2] - first], values[entry + 2]
            row3, value3 = panel[sensors[entry + 3] - first], values[entry + 3]
            for other in range(entry, end):
                sensor, factor = sensors[other], values[other]
                row[sensor] += value * factor
                row1[sensor] += value1 * factor
                row2[sensor] += value2 * factor
                row3[sensor] += value3 * factor
            entry += 4
        while entry < end and sensors[entry] < last:
            row, value = panel[sensors[entry] - first], values[entry]
            for other in range(entry, end):
                row[sensors[other]] += value * values[other]
            entry += 1


Words = NDArray[np.uint64]
Counts = NDArray[np.uint32]

WORDS = 256
"""Words of a series counted at a time: a panel of 96 series then fits into a second-level cache."""

# Constants of the population count of 64 bits (Warren 2012, Hacker's Delight, section 5-1), which
# LLVM recognises and vectorises.
_ONES, _TWOS = np.uint64(1), np.uint64(2)
_FOURS, _TOP = np.uint64(4), np.uint64(56)
_PAIRS = np.uint64(0x5555555555555555)
_QUADS = np.uint64(0x3333333333333333)
_OCTETS = np.uint64(0x0F0F0F0F0F0F0F0F)
_BYTES = np.uint64(0x0101010101010101)


@loop()
def tally_codes(codes: NDArray[Any], counts: Ints) -> None:
    """Add the number of frames in which each sensor has each code to `counts`. codes (T, N)."""
    for frame in range(codes.shape[0]):
        for sensor in range(codes.shape[1]):
            counts[sensor, codes[frame, sensor]] += 1


@loop()
def pack_bits(codes: NDArray[Any], position: Ints, bits: Words) -> None:
    """Set one bit per frame in which a series is on.

    codes (T, N), position (N, b), bits (M + 1, words), initially zero. Codes without a series have
    position -1, the last row, which avoids a branch.
    """
    for frame in range(codes.shape[0]):
        word, bit = frame // 64, _ONES << np.uint64(frame % 64)
        for sensor in range(codes.shape[1]):
            bits[position[sensor, codes[frame, sensor]], word] |= bit


@loop()
def pack_switches(codes: NDArray[Any], bits: Words) -> None:
    """Set the bits, (N, words), of codes, (T, N), that are 0 or 1: `pack_bits`, but vectorised."""
    n_frames, n_sensors = codes.shape
    words = np.empty(n_sensors, np.uint64)
    for begin in range(0, n_frames, 64):
        words[:] = 0
        for frame in range(begin, min(begin + 64, n_frames)):
            row, place = codes[frame], np.uint64(frame - begin)
            for sensor in range(n_sensors):
                words[sensor] |= np.uint64(row[sensor]) << place
        for sensor in range(n_sensors):
            bits[sensor, begin // 64] = words[sensor]


@loop()
def count_ones(x: np.uint64) -> np.uint64:
    """Return the number of bits that are set."""
    x -= (x >> _ONES) & _PAIRS
    x = (x & _QUADS) + ((x >> _TWOS) & _QUADS)
    x = (x + (x >> _FOURS)) & _OCTETS
    return (x * _BYTES) >> _TOP


@loop()
def count_bits(bits: Words, start: int, stop: int, counts: Counts) -> None:
    """Count frames in which two series are on, from their bits, (M, words).

    counts (stop - start, M): Filled for series from `start` to `stop` and all not before them.

    One series is compared with four at a time, so that a vector of it is loaded once for four
    counts. Rows of `bits` should begin at multiples of 64 bytes.
    """
    n_series, n_words = bits.shape
    last = n_series - 1
    for begin in range(0, n_words, WORDS):
        end = min(n_words, begin + WORDS)
        for q in range(start, n_series, 4):
            right, right1 = bits[q, begin:end], bits[min(q + 1, last), begin:end]
            right2, right3 = bits[min(q + 2, last), begin:end], bits[min(q + 3, last), begin:end]
            for p in range(start, min(stop, q + 4)):
                left = bits[p, begin:end]
                both = both1 = both2 = both3 = np.uint64(0)
                for k in range(left.size):
                    both += count_ones(left[k] & right[k])
                    both1 += count_ones(left[k] & right1[k])
                    both2 += count_ones(left[k] & right2[k])
                    both3 += count_ones(left[k] & right3[k])
                row = counts[p - start]
                row[q] += np.uint32(both)
                if q + 1 < n_series:
                    row[q + 1] += np.uint32(both1)
                if q + 2 < n_series:
                    row[q + 2] += np.uint32(both2)
                if q + 3 < n_series:
                    row[q + 3] += np.uint32(both3)


@loop()
def count_entries(
    entries: tuple[Counts, Ints, Ints, Ints], start: int, stop: int, counts: Counts
) -> None:
    """Count frames in which two series are on, as `count_bits`, from `co_occurrence._entries`."""
    series, ends, places, starts = entries
    for p in range(start, stop):
        row = counts[p - start]
        for k in range(starts[p], starts[p + 1]):
            entry = places[k]
            for other in range(entry, ends[entry]):
                row[series[other]] += np.uint32(1)


@loop()
def sum_logarithms(
    counts: Counts,
    tallies: tuple[Ints, Ints, NDArray[np.float64]],
    start: int,
    stop: int,
    joint: NDArray[np.float64],
) -> None:
    """Sum n log n over the contingency tables of sensors from `start` to `stop` and later ones.

    counts: Of all series of these sensors with all M series. tallies: The first series of each
    sensor, (N + 1,); the frames in which each series is on, (M,); and n log n, (T + 1,). Cells of
    the reference codes follow from these. The upper triangle of `joint`, (N, N), is filled.
    """
    first, marginals, logs = tallies
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
