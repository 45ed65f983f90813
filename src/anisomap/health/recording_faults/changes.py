"""Changes within a recording: from some frame on, sensors resemble other sensors than before."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from anisomap.health.recording_faults.found import Found
from anisomap.numerics.signals import count_contacts, some_sensors
from anisomap.numerics.similarity.rest import ranks_of_depths
from anisomap.recording import Recording

_N_BLOCKS = 16  # of a recording, an even number; it may change after every second one
_MAX_FRAMES = 16_384  # of which ranks are correlated
_MIN_CONTACTS = 3  # of a sensor in each quarter that is compared, for a correlation
_MIN_SENSORS = 8  # that have these contacts
_N_PARTNERS = 4  # most similar sensors: the neighbours on a square lattice
_MIN_KEPT = 2 / 3  # of their similarity: two of four neighbours are left if edges are joined
_MAX_REACH = 2.0  # ratio of the numbers of similar sensors: folding a skin doubles it at most
_N_PERMUTATIONS = 99  # that a change exceeds: 1 % of recordings without one are accused


def find_change(recording: Recording) -> Iterator[Found]:
    """Find sensors that resemble other sensors from some frame on.

    Wires were exchanged, or the body took another posture. A recording is divided in two parts, and
    each part in two quarters of every second block. A sensor changed if the sensors that it
    resembles most in one part keep less of their similarity in the other part than in the other
    quarter of the same part: that tells noise from a change. What they lose, summed over sensors at
    the division where it is most, must exceed that of 99 random orders of the blocks. Recordings
    are not judged if sensors resemble many more others in one part: contacts were larger.
    """
    n_frames = recording.n_frames
    if n_frames < 50 * _N_BLOCKS:
        return
    chosen = some_sensors(recording.n_sensors)
    step = -(-n_frames // _MAX_FRAMES)
    ranks = ranks_of_depths(recording.readings[::step][:, chosen], single=True)
    # A column of ones turns products into sums and counts as well.
    values = np.column_stack([ranks - ranks.mean(axis=0), np.ones(len(ranks), ranks.dtype)])
    moments = np.array([block.T @ block for block in np.array_split(values, _N_BLOCKS)])
    parts = np.array_split(recording.signals.touched, _N_BLOCKS)
    contacts = np.array([count_contacts(part[:, chosen]) for part in parts])
    lost, reach = zip(*_divisions(moments, contacts), strict=True)
    division = int(np.argmax([one.sum() for one in lost]))
    changed, size = np.flatnonzero(lost[division]), lost[division].sum()
    if changed.size < 2 or reach[division] > _MAX_REACH:
        return
    rng = np.random.default_rng(0)
    for _ in range(_N_PERMUTATIONS):
        order = rng.permutation(_N_BLOCKS)
        if max(one.sum() for one, _ in _divisions(moments[order], contacts[order])) >= size:
            return
    frame = 2 * (division + 1) * n_frames // _N_BLOCKS
    yield Found(
        chosen[changed],
        changed.size / chosen.size,
        f"{changed.size} sensors resemble other sensors from about frame {frame} of {n_frames} on",
    )


def _divisions(
    moments: NDArray[np.floating], contacts: NDArray[np.intp]
) -> Iterator[tuple[NDArray[np.float64], float]]:
    """Yield what each sensor loses at each division, and the ratio of similar sensors."""
    products, counts = (
        np.cumsum([one[::2], one[1::2]], axis=1, dtype=np.float64) for one in (moments, contacts)
    )
    for k in range(_N_BLOCKS // 2 - 1):
        quarters = np.concatenate([products[:, k], products[:, -1] - products[:, k]])
        least = np.concatenate([counts[:, k], counts[:, -1] - counts[:, k]]).min(axis=0)
        judged = np.flatnonzero(least >= _MIN_CONTACTS)
        lost = np.zeros(least.size)
        if judged.size < _MIN_SENSORS:
            yield lost, 1.0
            continue
        r = [_correlation(one, judged) for one in quarters]
        within = np.minimum(_kept(r[0], r[1]), _kept(r[2], r[3]))
        across = np.mean([_kept(r[a], r[b]) for a in (0, 1) for b in (2, 3)], axis=0)
        lost[judged] = np.maximum(_MIN_KEPT * within - across, 0)
        similar = [np.median((np.maximum(r[i] + r[i + 1], 0) ** 2).sum(axis=1)) for i in (0, 2)]
        yield lost, float(max(similar) / max(min(similar), 1e-12))


def _correlation(moments: NDArray[np.float64], judged: NDArray[np.intp]) -> NDArray[np.float64]:
    """Correlate sensors with others, given sums of products; -1 with themselves."""
    sums, count = moments[-1, judged], moments[-1, -1]
    covariance = moments[np.ix_(judged, judged)] - np.outer(sums, sums) / count
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-9 * count))
    correlation = np.clip(covariance / np.outer(deviation, deviation), -1, 1)
    np.fill_diagonal(correlation, -1)
    return np.asarray(correlation)


def _kept(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the share of their similarity that the most similar sensors of each keep, at least.

    first, second (n, n) -> (n,).
    """
    kept = []
    for one, other in ((first, second), (second, first)):
        partners = np.argpartition(-one, _N_PARTNERS, axis=1)[:, :_N_PARTNERS]
        most, left = (np.take_along_axis(r, partners, axis=1).sum(axis=1) for r in (one, other))
        kept.append(np.where(most > 0, left / np.maximum(most, 1e-12), 0))
    return np.asarray(np.clip(np.min(kept, axis=0), 0, 1))
