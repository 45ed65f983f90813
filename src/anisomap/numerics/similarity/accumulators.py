"""Statistics that can be taken in chunks of frames and merged: what one chunk adds to each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.precision import Reals, float_type, row_blocks
from anisomap.numerics.similarity.co_occurrence import Codes, Counts, Layout, co_occurrences
from anisomap.numerics.similarity.sparse_products import products_of_few

CHUNK_FRAMES = 8192
"""Frames that are converted to float64 at a time: enough for fast products, little memory."""

MIN_FLOAT32_SENSORS = 512
"""From so many sensors on, products of float32 save more than they cost."""

_SINGLE_RANGE = 1e15


@dataclass(frozen=True, eq=False)
class Moments:
    """First and second moments of N sensors over some frames.

    Attributes
    ----------
    n_frames : int
        How many frames they are of, T.
    mean : ndarray of shape (N,)
        Mean reading of each sensor.
    comoment : ndarray of shape (N, N)
        Sums over frames of the products of deviations from the means: T times the covariance.
        Symmetric to the last bit; a sensor that never varied has exact zeros.
    """

    n_frames: int
    mean: NDArray[np.float64]
    comoment: NDArray[np.float64]

    @classmethod
    def of(cls, readings: ArrayLike, *, single: bool = False) -> Moments:
        """Take the moments of an array.

        Parameters
        ----------
        readings : array_like of shape (T, N)
            Finite readings, T >= 1.
        single : bool
            Multiply in float32, twice as fast. Means, deviations and sums over chunks stay
            float64, so that correlations are right to 1e-5.

        Returns
        -------
        Moments
        """
        chunks = _chunks(np.asarray(readings))
        total = cls._of_chunk(next(chunks), single)
        for chunk in chunks:
            total = total.merged(cls._of_chunk(chunk, single))
        return total

    @classmethod
    def _of_chunk(cls, chunk: NDArray[np.generic], single: bool) -> Moments:
        few = products_of_few(chunk) if chunk.shape[1] >= MIN_FLOAT32_SENSORS else None
        if few is not None:
            return cls(len(chunk), *few)
        if single and (found := _in_float32(chunk)) is not None:
            mean, small = found
            return cls(len(chunk), mean, (small.T @ small).astype(np.float64))
        # Deviations from the first frame first: a constant sensor then has no rounding error.
        deviations = np.asarray(chunk, dtype=np.float64) - chunk[0]
        mean = deviations.mean(axis=0)
        deviations -= mean
        return cls(len(chunk), chunk[0] + mean, deviations.T @ deviations)

    def merged(self, other: Moments) -> Moments:
        """Join the moments of two disjoint sets of frames of the same sensors.

        Parameters
        ----------
        other : Moments
            Of the same N sensors.

        Returns
        -------
        Moments
            Of all frames; the order of merging matters only to rounding.

        Notes
        -----
        Chan, Golub & LeVeque (1983), The American Statistician 37: 242-247.
        """
        n_frames = self.n_frames + other.n_frames
        step = other.mean - self.mean
        weight = self.n_frames * other.n_frames / n_frames
        comoment = np.empty_like(self.comoment)
        for rows in row_blocks(len(comoment)):
            np.outer(step[rows], step, out=comoment[rows])
            comoment[rows] *= weight
            comoment[rows] += self.comoment[rows]
            comoment[rows] += other.comoment[rows]
        return Moments(n_frames, self.mean + step * (other.n_frames / n_frames), comoment)

    def varying(self) -> NDArray[np.bool_]:
        """Tell which sensors ever varied, shape (N,)."""
        return np.asarray(np.diag(self.comoment) > 0)

    def correlation(self) -> Reals:
        """Give Pearson's r of every pair of sensors.

        Returns
        -------
        ndarray of shape (N, N)
            Symmetric to the last bit, in [-1, 1], ones on the diagonal. A sensor that never
            varied is correlated with nothing: 0.
        """
        return correlation_of_comoments(self.comoment)


@dataclass(frozen=True, eq=False)
class CoOccurrences:
    """How often pairs of series are on together: exact counts.

    Attributes
    ----------
    n_frames : int
        How many frames they are of, T.
    first : ndarray of int, shape (N + 1,)
        Index of the first series of each sensor.
    counts : ndarray of uint32 or uint64, shape (M, M)
        Symmetric; how often a series itself is on stands on the diagonal.
    """

    n_frames: int
    first: NDArray[np.int64]
    counts: Counts

    @classmethod
    def of(cls, codes: Codes, layout: Layout) -> CoOccurrences:
        """Count in an array of codes of shape (T, N), T >= 1."""
        return cls(len(codes), layout.first, co_occurrences(codes, layout))

    def merged(self, other: CoOccurrences) -> CoOccurrences:
        """Join the counts of two disjoint sets of frames, of the same series.

        Parameters
        ----------
        other : CoOccurrences
            Of the same M series.

        Returns
        -------
        CoOccurrences
            Of all frames; the order of merging does not matter at all.
        """
        n_frames = self.n_frames + other.n_frames
        dtype = np.uint32 if n_frames <= np.iinfo(np.uint32).max else np.uint64
        return CoOccurrences(n_frames, self.first, np.add(self.counts, other.counts, dtype=dtype))


@dataclass(frozen=True, eq=False)
class StoredCodes:
    """Codes of all frames as they are: of many sensors less than counts of all their pairs.

    Attributes
    ----------
    n_frames : int
        How many frames they are of, T.
    parts : tuple of ndarray of int, shapes (t, N)
        Small numbers from 0, in the order of the frames.
    """

    n_frames: int
    parts: tuple[NDArray[np.integer[Any]], ...]

    @classmethod
    def of(cls, codes: NDArray[np.integer[Any]]) -> StoredCodes:
        """Keep codes of shape (T, N)."""
        return cls(len(codes), (codes.astype(np.min_scalar_type(codes.max(initial=0))),))

    def merged(self, other: StoredCodes) -> StoredCodes:
        """Put the codes of later frames of the same sensors behind these."""
        return StoredCodes(self.n_frames + other.n_frames, self.parts + other.parts)

    def whole(self) -> NDArray[np.integer[Any]]:
        """Give all codes as one array, shape (T, N)."""
        return np.concatenate(self.parts)


def correlation_of_comoments(comoment: NDArray[np.float64]) -> Reals:
    """Divide co-moments by the spreads of both sensors; see `Moments.correlation`."""
    spread = np.sqrt(np.diag(comoment))
    scale = np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > 0)
    correlation = np.empty(comoment.shape, float_type(len(comoment)))
    for rows in row_blocks(len(comoment)):
        # First the product of scales: the same two roundings for (i, j) and (j, i).
        products = np.outer(scale[rows], scale)
        products *= comoment[rows]
        np.clip(products, -1, 1, out=correlation[rows], casting="same_kind")
    np.fill_diagonal(correlation, 1.0)
    return correlation


def _in_float32(
    chunk: NDArray[Any],
) -> tuple[NDArray[np.float64], NDArray[np.float32]] | None:
    """Give float64 means, and deviations from them as float32 unless their squares leave it."""
    lowest, highest = (np.asarray(f(chunk, axis=0), np.float64) for f in (np.min, np.max))
    reach = highest - lowest
    if (reach > _SINGLE_RANGE).any() or ((reach < 1 / _SINGLE_RANGE) & (reach > 0)).any():
        return None
    mean = np.where(reach > 0, chunk.mean(axis=0, dtype=np.float64), lowest)
    deviations = np.empty(chunk.shape, dtype=np.float32)
    # The difference is taken in float64: only what is left is small enough for float32.
    np.subtract(chunk, mean, out=deviations, dtype=np.float64, casting="same_kind")
    return mean, deviations


def _chunks(readings: NDArray[np.generic]) -> Iterator[NDArray[np.generic]]:
    for start in range(0, len(readings), CHUNK_FRAMES):
        yield readings[start : start + CHUNK_FRAMES]
