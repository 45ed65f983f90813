"""Similarities of readings, their uncertainty, and tests against chance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.precision import Reals
from anisomap.numerics.signals import count_contacts, unit_rows
from anisomap.numerics.similarity.rest import ranks_of_depths

N_SHIFTS = 19
"""Number of circular shifts: an unrelated sensor exceeds all of them with probability 1/20."""

MIN_FRAMES = 40
"""Minimum number of frames."""

N_PARTS = 10
"""Number of parts of a recording, each left out once for the uncertainty of similarities."""

_ROUNDS = 3  # minimum blocks per part, so that contacts of all parts cover the whole skin
_LONG = 5.0  # length of a block in mean contacts: adjacent blocks should not share contacts
_MIN_SHIFT = 0.05  # of the recording: shorter shifts leave contacts correlated; chosen by hand
_MAX_SHIFTED = 5000  # approximate number of frames for the null distribution
_N_BEST = 3  # most similar sensors in the test of a sensor; chosen by hand


@dataclass(frozen=True, eq=False)
class ReadingStatistics:
    """Similarities of n sensors, their uncertainty, and sensors with significant similarities.

    similarity (n, n): Correlation of the ranks of the depths beyond rest.
    parts (g, n, n): Similarities without each of g parts of the frames (jackknife).
    tested (n,): Sensors whose similarity to the 3 most similar sensors exceeds that after every
        circular shift of the sensor against all others.
    """

    similarity: Reals
    parts: Reals
    tested: NDArray[np.bool_]

    def select(self, sensors: NDArray[np.intp]) -> ReadingStatistics:
        """Return the statistics of some sensors, given as indices, in that order."""
        if np.array_equal(sensors, np.arange(len(self.tested))):
            return self
        inside = np.ix_(sensors, sensors)
        parts = np.stack([part[inside] for part in self.parts])
        return ReadingStatistics(self.similarity[inside], parts, self.tested[sensors])


def reading_statistics(
    readings: ArrayLike, rng: np.random.Generator, *, n_shifts: int = N_SHIFTS
) -> ReadingStatistics:
    """Compute the similarities of all pairs of sensors, and their uncertainty.

    Parameters
    ----------
    readings : array_like of shape (T, n)
        Finite readings.
    rng : numpy.random.Generator
        Draws the shifts.
    n_shifts : int
        At least 1.

    Returns
    -------
    ReadingStatistics

    Raises
    ------
    InputError
        If there are fewer than 40 frames.
    """
    values = np.asarray(readings)
    n_frames = len(values)
    if n_frames < MIN_FRAMES:
        raise InputError(f"a check needs at least {MIN_FRAMES} frames, got {n_frames}")
    ranks = ranks_of_depths(values)
    rows = unit_rows(ranks)
    part = _part_of_frames(ranks)
    products = np.stack([rows[:, part == g] @ rows[:, part == g].T for g in range(N_PARTS)])
    whole = products.sum(axis=0)
    parts = [_without(whole - one, rows[:, part == g], n_frames) for g, one in enumerate(products)]
    similarity = _symmetric(whole)
    least = max(1, int(_MIN_SHIFT * n_frames))
    lags = rng.integers(least, n_frames - least, size=n_shifts, endpoint=True)
    # Contacts last for many frames, so a sample of frames suffices for chance.
    every = max(1, n_frames // _MAX_SHIFTED)
    thinned = unit_rows(ranks[::every]).T
    strength = _strength(similarity)
    # Each sensor is shifted circularly against all others.
    shifted = (np.roll(thinned, -(int(lag) // every), axis=0) for lag in lags)
    chance = [_strength(thinned.T @ one) for one in shifted]
    tested = (strength > np.max(chance, axis=0)) & (strength > 0)
    return ReadingStatistics(similarity, np.stack(parts), tested)


def _part_of_frames(ranks: NDArray[np.float64]) -> NDArray[np.intp]:
    """Assign blocks of frames that are longer than contacts to the parts in turn, shape (T,)."""
    n_frames = len(ranks)
    active = ranks > ranks.min(axis=0)
    n_contacts = max(1, int(count_contacts(active).sum()))
    length = round(_LONG * np.count_nonzero(active) / n_contacts)
    length = int(np.clip(length, 1, max(1, n_frames // (_ROUNDS * N_PARTS))))
    return np.arange(n_frames) // length % N_PARTS


def _without(
    product: NDArray[np.float32], left_out: NDArray[np.float32], n_frames: int
) -> NDArray[np.float32]:
    """Return correlations from products of centred rows, without the frames of a part.

    left_out (n, t): Rows of these frames, of n_frames.
    """
    sums = left_out.sum(axis=1)
    centred = product - np.outer(sums, sums) / (n_frames - left_out.shape[1])
    norms = np.sqrt(np.maximum(np.diag(centred), 0))
    inverse = np.divide(1, norms, out=np.zeros_like(norms), where=norms > 1e-3)
    return _symmetric(centred * np.outer(inverse, inverse))


def _symmetric(product: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.clip((product + product.T) / 2, -1, 1)


def _strength(similarity: Reals) -> NDArray[np.float32]:
    """Return the mean similarity of each sensor to its most similar others."""
    others = np.array(similarity)
    np.fill_diagonal(others, -1)
    n_best = min(_N_BEST, len(others) - 1)
    best = np.partition(others, len(others) - n_best, axis=1)[:, len(others) - n_best :]
    return np.asarray(best.mean(axis=1))
