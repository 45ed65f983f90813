"""Similarity of sensors by the heights of their contacts, and how well a map explains it.

Correlations of readings are high where sensors are touched in the same frames. A contact that is
long in one direction touches distant sensors at once, and their correlations do not resolve that
direction. The heights of matching contacts resolve it: they differ as much as the ground, or any
other object that touches the skin, differs over the distance of the sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import isotonic_regression
from scipy.spatial.distance import pdist

from anisomap.numerics.columns import mean_ranks, ranks_from_counts
from anisomap.numerics.graph.metric import minimax_paths
from anisomap.numerics.precision import Floats
from anisomap.numerics.reliability.split_half import split_blocks

Peaks = tuple[NDArray[np.intp], Floats]

MIN_PEAKS = 8
"""Minimum number of matched peaks from which a length is estimated; chosen by hand."""

_CONTACT_THRESHOLD = 0.1  # of a sensor's range; separates contacts from tremor. Chosen by hand
_RANGE_QUANTILE = 0.995  # top of the range; excludes outliers. Chosen by hand
_MIN_DIFFERENCE = 0.05  # of 1 - rho; keeps lengths above 0. Chosen by hand


def contacts_of(raised: ArrayLike) -> tuple[NDArray[np.intp], Floats, NDArray[np.intp]]:
    """Find the peak of each contact of one sensor, and its number of frames. raised (T,)."""
    values = np.asarray(raised, dtype=np.float64)
    level = _CONTACT_THRESHOLD * max(float(np.quantile(values, _RANGE_QUANTILE)), 0.0)
    touched = np.flatnonzero(values > level)
    begins = np.flatnonzero(np.diff(touched, prepend=-2) > 1)
    durations = np.diff(begins, append=touched.size)
    heights = np.maximum.reduceat(values[touched], begins) if begins.size else np.empty(0)
    contact = np.repeat(np.arange(begins.size), durations)
    highest = np.flatnonzero(values[touched] == heights[contact])
    first = np.searchsorted(contact[highest], np.arange(begins.size))
    return touched[highest[first]], heights, np.asarray(durations)


_WINDOW = 0.75  # of the median duration of contacts, to each side of a peak; chosen by hand
_MIN_HEIGHTS = 4  # distinct heights per sensor; readings with fewer levels have no order of heights
_MIN_VARIANCE = 1e-9  # of relative ranks, whose variance is 1/12 without ties; rounding error
_RIDGE = 1.0  # of the partial correlations, as for correlations of readings
_MIN_TOUCHED = 0.5  # share of a sensor's contacts that another shares, to be its possible neighbour
_MAX_SHARING = 48  # sensors given which a pair is correlated; a surface has fewer around a sensor
_TINY = 1e-12  # standard deviation of ranks that are all equal
_MIN_PAIRS = 50  # of which the explained share is computed; chosen by hand
_INDIRECT = 0.1  # share of S in the strength of links, as in `direct_dissimilarity`
_MIN_STRENGTH = 1e-3  # of links; keeps lengths finite
_ROUNDING = 1e-9  # relative
# Of a link to the longest step of the best path between its sensors: with 1.1, maps lack links;
# with 1.3, some have links across the body.
_MAX_STEP_RATIO = 1.2


@dataclass(frozen=True, eq=False)
class HeightSimilarity:
    """Similarity of sensors by the heights of their contacts, (N, N) each.

    similarity: Correlation of the ranks of the heights of matching contacts, in [-1, 1].
    partial: Partial correlation given the sensors that share the contacts: high for neighbours.
    n_contacts: Number of contacts of either sensor.
    """

    similarity: Floats
    partial: Floats
    n_contacts: Floats


@dataclass(frozen=True)
class Explained:
    """How far the distances on a map explain the similarity of heights.

    reliability: Correlation of the similarities in the halves of the recording.
    share: Share of their covariance that one decreasing function of the distances explains.
    """

    reliability: float
    share: float


@dataclass(frozen=True, eq=False)
class ContactHeights:
    """Heights of the contacts of all sensors.

    contacts: Frames and heights of the peaks of the contacts of each sensor.
    usable: Whether most sensors have contacts of different heights.
    ranks: Relative rank, in (0, 1], of the highest reading of each sensor around each frame.
    """

    contacts: tuple[Peaks, ...]
    usable: bool
    ranks: NDArray[np.float32]

    @classmethod
    def of(cls, depths: ArrayLike) -> ContactHeights:
        """Find the contacts of all sensors. depths (T, N)."""
        by_sensor = np.ascontiguousarray(np.asarray(depths, dtype=np.float64).T)
        peaks, heights, durations = zip(*map(contacts_of, by_sensor), strict=True)
        graded = np.mean([np.unique(one).size >= _MIN_HEIGHTS for one in heights])
        lasting = np.concatenate(durations)
        half = max(1, round(_WINDOW * float(np.median(lasting)))) if lasting.size else 1
        # The highest reading around a frame is the height of the contact that matches a peak there;
        # it is at rest, a tie, where the sensor is not touched.
        ranks = np.empty(by_sensor.shape, np.float32)
        for row, depth in zip(ranks, by_sensor, strict=True):
            row[:] = _ranks_of_runs(_highest_around(depth, half)) / len(depth)
        usable = bool(graded > _MIN_TOUCHED)
        return cls(tuple(zip(peaks, heights, strict=True)), usable, ranks.T)

    @cached_property
    def halves(self) -> list[HeightSimilarity]:
        """Similarity in the halves of the recording (`split_blocks`), without partial ones."""
        inside = np.zeros((2, len(self.ranks)), dtype=bool)
        for half, frames in zip(inside, split_blocks(len(self.ranks)), strict=True):
            half[frames] = True
        parts = [tuple((at[half[at]], h[half[at]]) for at, h in self.contacts) for half in inside]
        return [replace(self, contacts=part).compare(partial=False) for part in parts]

    def compare(self, *, partial: bool = True) -> HeightSimilarity:
        """Compare the heights of the contacts of all pairs of sensors.

        The contacts of a pair are those of either sensor; the other's height is that of its highest
        reading around the peak. Ranks are taken over the recording.
        """
        n = self.ranks.shape[1]
        sums, squares, products = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
        partials, counts = np.zeros((n, n)), np.zeros(n)
        lowest = self.ranks.min(axis=0) if partial else np.zeros(n)
        for i, (at, _) in enumerate(self.contacts):
            ranks = self.ranks[at].astype(np.float64)
            counts[i] = len(at)
            sums[i], products[i] = np.stack([np.ones(len(at)), ranks[:, i]]) @ ranks
            squares[i] = np.einsum("kj,kj->j", ranks, ranks)
            if partial:
                partials[i] = self._partial(i, ranks, lowest)
        # Row i of each sum is over the contacts of sensor i.
        pooled = np.maximum(counts[:, None] + counts, 1.0)
        mean = (np.diag(sums)[:, None] + sums.T) / pooled
        variance = (np.diag(squares)[:, None] + squares.T) / pooled - mean**2
        covariance = (products + products.T) / pooled - mean * mean.T
        varying = (variance > _MIN_VARIANCE) & (variance.T > _MIN_VARIANCE)
        scale = np.sqrt(np.where(varying, variance * variance.T, 1.0))
        similarity = np.where(varying, covariance / scale, 0.0)
        np.fill_diagonal(similarity, 1.0)
        return HeightSimilarity(similarity, (partials + partials.T) / 2, pooled)

    @staticmethod
    def _partial(sensor: int, ranks: Floats, lowest: Floats) -> Floats:
        """Return the partial correlations of a sensor with those that share its contacts."""
        found = np.zeros(ranks.shape[1])
        if len(ranks) < MIN_PEAKS:
            return found
        sharing = np.mean(ranks > lowest, axis=0) > _MIN_TOUCHED
        sharing[sensor] = False
        chosen = np.flatnonzero(sharing)
        centred = ranks[:, chosen] - ranks[:, chosen].mean(axis=0)
        own = ranks[:, sensor] - ranks[:, sensor].mean()
        spread = np.maximum(centred.std(axis=0), _TINY)
        if len(chosen) > _MAX_SHARING:
            nearest = np.argsort(-(own @ centred) / spread, kind="stable")[:_MAX_SHARING]
            chosen, centred, spread = chosen[nearest], centred[:, nearest], spread[nearest]
        standardised = np.column_stack([own / max(own.std(), _TINY), centred / spread])
        covariance = standardised.T @ standardised / len(ranks) + _RIDGE * np.eye(len(chosen) + 1)
        precision = np.linalg.inv(covariance)
        scale = np.sqrt(np.diag(precision))
        found[chosen] = -precision[0, 1:] / (scale[1:] * scale[0])
        return found


def explained_share(
    halves: Sequence[HeightSimilarity], positions: ArrayLike, sharing: ArrayLike
) -> Explained:
    """Measure how far distances on a map, (N, k), explain the similarity of heights; may be NaN.

    With the similarities A and B of the halves and the decreasing functions a and b of distance
    that fit each best (isotonic regression), the share is ``1 - cov(A - a, B - b) / cov(A, B)``.
    """
    upper = np.triu_indices(len(np.asarray(positions)), 1)
    enough = [half.n_contacts[upper] >= 2 * MIN_PEAKS for half in halves]
    used = enough[0] & enough[1] & np.asarray(sharing, dtype=bool)[upper]
    if np.count_nonzero(used) < _MIN_PAIRS:
        return Explained(np.nan, np.nan)
    order = np.argsort(pdist(np.asarray(positions))[used], kind="stable")
    first, second = (half.similarity[upper][used][order] for half in halves)
    if np.ptp(first) == 0 or np.ptp(second) == 0:
        return Explained(np.nan, np.nan)
    reliability = float(np.corrcoef(first, second)[0, 1])
    if reliability <= 0:
        return Explained(reliability, np.nan)
    residuals = [x - isotonic_regression(x, increasing=False).x for x in (first, second)]
    unexplained = float(np.cov(*residuals)[0, 1] / np.cov(first, second)[0, 1])
    return Explained(reliability, 1 - unexplained)


def peak_lengths(heights: ContactHeights, links: NDArray[np.bool_]) -> Floats:
    """Estimate the lengths of links. links (N, N) -> (N, N), NaN elsewhere and for few peaks.

    ``(1 - rho_ij)^(1/2)`` with Spearman's rho of the heights of those peaks of i and j that are
    mutually nearest in time: the root of a variogram (Matheron 1963, Economic Geology 58:
    1246-1266) of the ground, which is taken to be isotropic. Beyond the correlation length of the
    ground, rho is 0 and distances are indistinguishable.
    """
    lengths = np.full(links.shape, np.nan)
    for i, j in np.argwhere(np.triu(links, 1)):
        lengths[i, j] = lengths[j, i] = _peak_difference(heights.contacts[i], heights.contacts[j])
    return lengths


def _peak_difference(first: Peaks, second: Peaks) -> float:
    (frames, heights), (other_frames, other_heights) = first, second
    if min(len(frames), len(other_frames)) < MIN_PEAKS:
        return np.nan
    match = _nearest(frames, other_frames)
    mutual = _nearest(other_frames, frames)[match] == np.arange(len(frames))
    own, others = heights[mutual], other_heights[match[mutual]]
    if len(own) < MIN_PEAKS or np.ptp(own) == 0 or np.ptp(others) == 0:
        return np.nan
    rho = np.corrcoef(mean_ranks(own), mean_ranks(others))[0, 1]
    return float(np.sqrt(max(1 - rho, _MIN_DIFFERENCE)))


def _nearest(frames: NDArray[np.intp], among: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the index in `among` of the frame nearest to each of `frames`."""
    return np.asarray(np.searchsorted((among[1:] + among[:-1]) / 2, frames))


def height_links(similarity: HeightSimilarity) -> NDArray[np.bool_]:
    """Link neighbours by the heights of their contacts, (N, N), connected.

    Sensors are linked if ``M_ij <= 1.2 m_ij`` with ``M = (S (Q + S / 10))^(-1/4)``, the similarity
    S of heights, their partial correlations Q, and m from `minimax_paths`.
    """
    positive = np.clip(similarity.similarity, _MIN_STRENGTH, 1.0)
    mixed = np.clip(similarity.partial + _INDIRECT * similarity.similarity, _MIN_STRENGTH, 1.0)
    lengths = (positive * mixed) ** -0.25
    np.fill_diagonal(lengths, 0.0)
    links = lengths <= _MAX_STEP_RATIO * minimax_paths(lengths) * (1 + _ROUNDING)
    np.fill_diagonal(links, val=False)
    return np.asarray(links | links.T)


def _highest_around(depths: Floats, half: int) -> Floats:
    """Return the maximum over `half` frames to each side of every frame."""
    width = 2 * half + 1
    highest = np.pad(depths, half)
    size = 1
    while 2 * size <= width:  # maxima over twice as many frames
        highest = np.maximum(highest[:-size], highest[size:])
        size *= 2
    if size < width:
        highest = np.maximum(highest[: size - width], highest[width - size :])
    return highest


def _ranks_of_runs(values: Floats) -> Floats:
    """Rank values as `mean_ranks`, faster where most are equal to those before. values (T,)."""
    begins = np.flatnonzero(np.diff(values, prepend=np.nan))
    lengths = np.diff(begins, append=len(values))
    _, codes = np.unique(values[begins], return_inverse=True)
    counts = np.bincount(codes, lengths)
    return np.repeat(ranks_from_counts(counts)[codes], lengths)
