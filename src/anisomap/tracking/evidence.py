"""What recordings tell of all pairs of sensors: sums over frames, which add up over recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce
from hashlib import blake2b
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.base.immutable import Immutable
from anisomap.errors import InputError
from anisomap.method.evidence import SIMILARITIES, PairStatistics
from anisomap.method.named import check_even_spacing, find_method
from anisomap.method.options import MethodOptions
from anisomap.method.reconstruction import reconstruct_from
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.contacts.contact_agreement import (
    MIN_CONTACTS,
    agreement_of_sums,
    distinct_contacts,
    is_on_off,
    shows_single_contacts,
    weighted_contacts,
)
from anisomap.numerics.precision import Reals, check_pair_memory
from anisomap.numerics.similarity.rest import ranks_of_depths
from anisomap.recording import Recording, as_runs, match_names, sensor_mask
from anisomap.sensor_map import SensorMap

_MIN_CONTACTS = 2  # for a sampling variance
_MIN_VARYING = 2  # sensors; fewer form no pair
_DIGEST_BYTES = 16  # of a recording; equal digests of different recordings are out of the question


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
        if similarity not in SIMILARITIES:
            raise InputError(f"there is no similarity {similarity!r}")
        chosen, shape = SIMILARITIES[similarity], (readings.shape[1],) * 2
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


@dataclass(frozen=True, eq=False)
class Evidence(Immutable):
    """Sums over all frames of one or several recordings, from which a map can be made.

    Attributes
    ----------
    names : tuple of str
        The n sensors that varied in a recording.
    sums : mapping of str to PairSums
        Sums of each similarity that the method may use, for all pairs of the n sensors.
    method : str
        A key of `anisomap.METHODS`.
    dimensions : int
        Number of coordinates of the map.
    options : MethodOptions
    n_frames : int
        Number of frames of all recordings.
    recordings : tuple of str
        A digest of the readings of each recording, in increasing order: none counts twice.
    single_contacts : bool
        Whether any recording shows one contact at a time, in readings that are on or off.
    """

    names: tuple[str, ...]
    sums: Mapping[str, PairSums]
    method: str
    dimensions: int
    options: MethodOptions
    n_frames: int
    recordings: tuple[str, ...]
    single_contacts: bool = False

    def merged(self, other: Evidence) -> Evidence:
        """Add the evidence of other recordings of the same skin.

        The order affects rounding and the order of the sensors only.

        Raises
        ------
        InputError
            If both contain the same recording, or they were gathered for different methods.
        """
        if self.method != other.method or set(self.sums).isdisjoint(other.sums):
            raise InputError(
                f"evidence for the method {self.method} cannot be added to evidence for the method "
                f"{other.method}"
            )
        if set(self.recordings) & set(other.recordings):
            raise InputError("the recording is part of the evidence already; give another one")
        names = tuple(dict.fromkeys((*self.names, *other.names)))
        check_pair_memory(len(names), refined=True)
        mine, others = (match_names(one.names, names) for one in (self, other))
        return replace(
            self,
            names=names,
            sums={
                key: self.sums[key]
                .spread(mine, len(names))
                .merged(other.sums[key].spread(others, len(names)))
                for key in self.sums
                if key in other.sums
            },
            n_frames=self.n_frames + other.n_frames,
            recordings=tuple(sorted((*self.recordings, *other.recordings))),
            single_contacts=self.single_contacts or other.single_contacts,
        )

    def without(self, names: Iterable[str]) -> Evidence:
        """Forget all pairs of some sensors, which keep their names."""
        gone = set(names)
        rows = np.flatnonzero([name in gone for name in self.names])
        return replace(self, sums={key: sums.without(rows) for key, sums in self.sums.items()})

    @property
    def similarity(self) -> str:
        """Key of the similarity that the method uses for these recordings."""
        recipe = find_method(self.method)
        contact = recipe.contact_similarity
        if contact in self.sums and self.single_contacts:
            return str(contact)
        return recipe.similarity

    def statistics(self) -> PairStatistics:
        """Return the similarity of all pairs, and its sampling variance."""
        return self.sums[self.similarity].statistics(self.similarity)


def gather_evidence(
    recording: Recording | ArrayLike | Sequence[Recording],
    method: str = DEFAULT_METHOD,
    dimensions: int = 3,
    *,
    options: MethodOptions | None = None,
    drop: Iterable[str | int] = (),
) -> Evidence:
    """Collect the pairwise statistics of a recording.

    Parameters
    ----------
    recording : Recording, array_like of shape (T, N), or sequence of Recording
        Complete readings. Those of a sequence are pooled; each pair is compared over the recordings
        that contain both of its sensors.
    method, dimensions, options, drop
        As for `anisomap.reconstruct`, for the maps that will be made of it.

    Returns
    -------
    Evidence
        Of the sensors that vary and are not dropped.

    Raises
    ------
    InputError
        If a reading is missing, fewer than 2 sensors vary, even spacing is declared, or recordings
        repeat.
    """
    chosen = options or MethodOptions()
    check_even_spacing(method, chosen, readings=False)
    runs = as_runs(recording)
    if isinstance(recording, Sequence):  # apart, also those of the same sensors
        runs = tuple(run for run in recording if isinstance(run, Recording)) or runs
    left_out = tuple(drop)
    return reduce(
        Evidence.merged, (_evidence_of(run, left_out, method, dimensions, chosen) for run in runs)
    )


def map_evidence(evidence: Evidence) -> SensorMap:
    """Reconstruct the positions of sensors from evidence.

    Parameters
    ----------
    evidence : Evidence

    Returns
    -------
    SensorMap
        As `anisomap.reconstruct_from` makes it of the similarity. Sensors of which no pair is known
        have no position.

    Raises
    ------
    InputError
        As for `anisomap.reconstruct_from`.
    """
    pairs = evidence.statistics()
    known = pairs.known & ~np.eye(len(evidence.names), dtype=bool)
    alone = np.flatnonzero(~known.any(axis=1))
    return reconstruct_from(
        similarity=pairs.similarity,
        noise=pairs.noise,
        weights=pairs.weights,
        method=evidence.method,
        dimensions=evidence.dimensions,
        options=evidence.options,
        names=evidence.names,
        drop=alone.tolist(),
        statistic=pairs.statistic,
    )


def _evidence_of(
    run: Recording,
    left_out: Sequence[str | int],
    method: str,
    dimensions: int,
    options: MethodOptions,
) -> Evidence:
    """Gather the evidence of one recording; names that it lacks may be left out."""
    recipe = find_method(method)
    here = [one for one in left_out if not isinstance(one, str) or one in run.names]
    mapped = run.varying() & ~sensor_mask(run.names, here)
    n_sensors = int(np.count_nonzero(mapped))
    if n_sensors < _MIN_VARYING:
        raise InputError(
            f"{run.source or 'the recording'} holds no evidence of distances: only {n_sensors} of "
            f"its {run.n_sensors} sensors vary"
        )
    check_pair_memory(n_sensors, refined=bool(recipe.refinements))
    run = run.select(mapped).complete()
    readings = run.readings
    similarities = [recipe.similarity]
    single = False
    if recipe.contact_similarity is not None and is_on_off(readings):
        single = shows_single_contacts(readings)
        # Too few contacts do not tell whether they come one at a time; other recordings may.
        if single or len(distinct_contacts(readings)) < MIN_CONTACTS:
            similarities.append(recipe.contact_similarity)
    with limited_blas(run.n_sensors):
        sums = {key: PairSums.of(readings, key, bins=options.entropy_bins) for key in similarities}
    digest = blake2b(digest_size=_DIGEST_BYTES)
    digest.update("\n".join(run.names).encode("utf-8", "backslashreplace"))
    digest.update(np.ascontiguousarray(readings, dtype=np.float64).data)
    return Evidence(
        names=run.names,
        sums=sums,
        method=method,
        dimensions=dimensions,
        options=options,
        n_frames=run.n_frames,
        recordings=(digest.hexdigest(),),
        single_contacts=single,
    )
