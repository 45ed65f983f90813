"""Sums over frames from which the similarity of pairs follows; they add up over recordings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.base.immutable import Immutable
from anisomap.errors import InputError
from anisomap.evidence import SIMILARITIES, PairStatistics, Similarity
from anisomap.numerics.contacts.contact_agreement import (
    agreement_of_sums,
    distinct_contacts,
    weighted_contacts,
)
from anisomap.numerics.precision import Reals
from anisomap.numerics.similarity.rest import ranks_of_depths

_MIN_CONTACTS = 2  # for a sampling variance


@dataclass(frozen=True, eq=False)
class PairSums(Immutable):
    """Sums over the frames of one or several recordings, for all pairs of n sensors.

    Attributes
    ----------
    products : ndarray of shape (n, n)
        Sums of products, symmetric; see `_POOLINGS`.
    squares : ndarray of shape (n, n)
        Sums of squares of the sensor of the row, over recordings that contain the sensor of the
        column as well.
    weights : ndarray of shape (n, n)
        Weights of the frames or contacts that were recorded with both sensors; symmetric.
    precision : ndarray of shape (n, n)
        Reciprocal of the sampling variance: the effective number of independent frames. 0 for pairs
        that were not recorded together; symmetric.

    Notes
    -----
    Means are those of each recording, so that a shift of the zero between two recordings relates
    no sensors.
    """

    products: NDArray[np.float64]
    squares: NDArray[np.float64]
    weights: NDArray[np.float64]
    precision: NDArray[np.float64]

    @classmethod
    def of(cls, readings: NDArray[np.generic], similarity: str, *, bins: int) -> PairSums:
        """Sum over the complete readings of one recording, shape (T, n), of varying sensors."""
        chosen, shape = _similarity(similarity), (readings.shape[1],) * 2
        if similarity == _OF_CONTACTS and len(distinct_contacts(readings)) < _MIN_CONTACTS:
            return cls(*(np.zeros(shape) for _ in fields(cls)))
        readings, _ = chosen.referred(readings)
        found, variance = chosen.with_variance(readings, bins)
        pool, _ = _POOLINGS.get(similarity, _OF_CORRELATION)
        products, squares, weight = pool(readings, found)
        return cls(
            products,
            np.array(np.broadcast_to(squares[:, None], shape)),
            np.full(shape, weight),
            1.0 / np.asarray(variance, dtype=np.float64),
        )

    @property
    def known(self) -> NDArray[np.bool_]:
        """Mask of the pairs that were recorded together, shape (n, n)."""
        return np.asarray(self.precision > 0)

    def merged(self, other: PairSums) -> PairSums:
        """Add the sums of other frames of the same sensors, in any order."""
        return PairSums(*map(np.add, vars(self).values(), vars(other).values()))

    def spread(self, rows: NDArray[np.intp], n_sensors: int) -> PairSums:
        """Return the sums of `n_sensors` sensors, of which these are the given rows."""
        found = np.zeros((len(fields(self)), n_sensors, n_sensors))
        for matrix, sums in zip(found, vars(self).values(), strict=True):
            matrix[np.ix_(rows, rows)] = sums
        return PairSums(*found)

    def without(self, sensors: NDArray[np.intp]) -> PairSums:
        """Return sums in which no pair of the given sensors is known."""
        kept = ~np.isin(np.arange(len(self.products)), sensors)
        return PairSums(
            *(np.where(kept[:, None] & kept, sums, 0.0) for sums in vars(self).values())
        )

    def statistics(self, similarity: str) -> PairStatistics:
        """Return the similarity of all pairs, by the key given to `of`, and its variance."""
        _similarity(similarity)
        known = self.known
        _, finish = _POOLINGS.get(similarity, _OF_CORRELATION)
        values = np.where(known | np.eye(len(known), dtype=bool), finish(self), 0.0)
        noise = np.divide(1.0, self.precision, out=np.ones_like(values), where=known)
        return PairStatistics.from_similarity(
            values, noise=noise, known=known, statistic=similarity
        )


_Sums: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64], float]
"""Sums of products, shape (n, n), and of squares, shape (n,), and the weight of a recording."""


def _correlation_sums(readings: NDArray[np.generic], similarity: Reals) -> _Sums:
    """Weight a correlation by how much its sensors vary, in ranks, which have no unit."""
    n_frames = len(readings)
    ranks = ranks_of_depths(readings) / n_frames
    squares = n_frames * np.asarray(ranks.var(axis=0))
    spread = np.sqrt(squares)
    # Multiplying the spreads first rounds (i, j) and (j, i) alike.
    products = np.outer(spread, spread) * similarity
    return np.asarray(products), np.asarray(squares), float(n_frames)


def _finished_correlation(sums: PairSums) -> Reals:
    size = np.sqrt(sums.squares) * np.sqrt(sums.squares.T)
    correlation = np.divide(sums.products, size, out=np.zeros_like(size), where=size > 0)
    np.clip(correlation, -1, 1, out=correlation)
    np.fill_diagonal(correlation, 1.0)
    return np.asarray(correlation)


def _contact_sums(readings: NDArray[np.generic], _: Reals) -> _Sums:
    together, total = weighted_contacts(readings)
    return together, np.asarray(np.diag(together)), total


def _mean_sums(readings: NDArray[np.generic], similarity: Reals) -> _Sums:
    n_frames = float(len(readings))
    return np.asarray(n_frames * similarity), np.full(len(similarity), n_frames), n_frames


def _finished_mean(sums: PairSums) -> Reals:
    found = np.zeros_like(sums.products)
    return np.asarray(np.divide(sums.products, sums.weights, out=found, where=sums.weights > 0))


_OF_CONTACTS = "contact-agreement"
_Pooling: TypeAlias = tuple[
    Callable[[NDArray[np.generic], Reals], _Sums], Callable[[PairSums], Reals]
]
_OF_CORRELATION: _Pooling = (_correlation_sums, _finished_correlation)
_POOLINGS: Mapping[str, _Pooling] = MappingProxyType(
    {
        _OF_CONTACTS: (
            _contact_sums,
            lambda sums: agreement_of_sums(sums.products, sums.squares, sums.weights),
        ),
        "mutual-information": (_mean_sums, _finished_mean),
    }
)
"""How readings and their similarity are summed, and the similarity of sums, if no correlation.

Correlations are pooled as covariances within recordings are; a sensor that hardly varies in one of
them has little weight there. Agreements have exact sums, over the distinct contacts of each
recording. Mutual information is averaged over frames.
"""


def _similarity(key: str) -> Similarity:
    if key not in SIMILARITIES:
        raise InputError(f"there is no similarity {key!r}")
    return SIMILARITIES[key]
