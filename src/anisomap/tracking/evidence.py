"""What recordings tell of all pairs of sensors, added up, and sensors that it shows elsewhere."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from hashlib import blake2b

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri

from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.base.immutable import Immutable
from anisomap.errors import InputError
from anisomap.evaluation.scoring import median_spacing
from anisomap.evidence import PairStatistics
from anisomap.methods import check_even_spacing, find_method
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.contacts.contact_agreement import (
    MIN_CONTACTS,
    distinct_contacts,
    is_on_off,
    shows_single_contacts,
)
from anisomap.numerics.precision import check_pair_memory
from anisomap.numerics.reliability.split_half import profile_agreement
from anisomap.options import MethodOptions
from anisomap.reconstruction import reconstruct_from
from anisomap.recording import Recording, as_runs, match_names, sensor_mask
from anisomap.sensor_map import SensorMap
from anisomap.tracking.pair_sums import PairSums

_MIN_VARYING = 2  # sensors; fewer form no pair
_DIGEST_BYTES = 16  # of a recording; equal digests of different recordings are out of the question


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


MIN_COMPARED = 8
"""Minimum number of sensors on the map and in the recording; fewer give no typical difference."""

FAR = 3.0
"""Smallest distance of a move that is looked for, in spacings; nearer profiles are alike."""

# From median absolute deviations to standard deviations of a normal distribution.
_TO_SIGMA = 1 / float(ndtri(0.75))


@dataclass(frozen=True, eq=False)
class Moves(Immutable):
    """Sensors that moved.

    Attributes
    ----------
    names : tuple of str
        The compared sensors.
    p_values : ndarray of shape (n,)
        Probability that chance alone makes any sensor fit a far place so much better (Bonferroni);
        1 for sensors that fit their own place better than any far one.
    like : tuple of str
        The far sensor of the map that each fits best.
    moved : tuple of str
        Sensors with a p value below the level.
    """

    names: tuple[str, ...]
    p_values: NDArray[np.float64]
    like: tuple[str, ...]
    moved: tuple[str, ...]


def find_moves(
    sensor_map: SensorMap, evidence: Evidence, fresh: Evidence, level: float
) -> Moves | None:
    """Find sensors of which the similarity to all others is that of a far sensor before.

    For each sensor, the agreement of its new profile with its own old one is compared with the
    best agreement with the profile of a far sensor. A sensor moved if the far one fits better, by
    more than chance explains: differences of sensors that did not move are taken as normal, with
    the median and the median absolute deviation of all.
    """
    compared = set(evidence.names) & set(fresh.names)
    placed = np.flatnonzero(sensor_map.placed)
    placed = placed[[sensor_map.names[i] in compared for i in placed]]
    if len(placed) < MIN_COMPARED:
        return None
    names = tuple(sensor_map.names[i] for i in placed)
    key = common_similarity(evidence, fresh)
    old_similarity, old_known = similarity_of(evidence, key, names)
    new_similarity, new_known = similarity_of(fresh, key, names)
    agreement = profile_agreement(new_similarity, old_similarity, new_known, old_known)
    places, component = sensor_map.positions[placed], sensor_map.component[placed]
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    far = (apart > FAR * spacing_of(sensor_map)) | (component[:, None] != component)
    if not far.any():
        return None
    elsewhere = np.where(far, agreement, -np.inf)
    gain = elsewhere.max(axis=1) - np.diag(agreement)
    finite = gain[np.isfinite(gain)]
    middle = float(np.median(finite))
    sigma = _TO_SIGMA * float(np.median(np.abs(finite - middle)))
    z = (gain - middle) / max(sigma, np.finfo(float).tiny)
    p_values = np.where(gain > 0, np.minimum(1.0, len(names) * ndtr(-z)), 1.0)
    return Moves(
        names=names,
        p_values=p_values,
        like=tuple(names[j] for j in elsewhere.argmax(axis=1)),
        moved=tuple(name for name, p in zip(names, p_values, strict=True) if p < level),
    )


def spacing_of(sensor_map: SensorMap) -> float:
    """Return the median distance between neighbours on the largest component, 0 of one sensor."""
    places = sensor_map.positions[sensor_map.component == 0]
    return median_spacing(places) if len(places) > 1 else 0.0


def common_similarity(first: Evidence, second: Evidence) -> str:
    """Return the most specific similarity of which both have sums."""
    return next(key for key in reversed(tuple(first.sums)) if key in second.sums)


def similarity_of(
    evidence: Evidence, key: str, names: Sequence[str]
) -> tuple[NDArray[np.floating], NDArray[np.bool_]]:
    """Return the similarity of n sensors, and which pairs of them are known, (n, n) each."""
    rows = match_names(names, evidence.names)
    inside = np.ix_(rows, rows)
    pairs = evidence.sums[key].statistics(key)
    return pairs.similarity[inside], pairs.known[inside]
