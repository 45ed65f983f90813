"""Sampling variance of correlations of autocorrelated readings, and significant correlations.

Split-half reliability of correlations, and linear and rank correlation blended by reliability.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import solve_banded
from scipy.spatial.distance import squareform
from scipy.special import ndtr

from anisomap.errors import InputError
from anisomap.numerics.columns import centred_rows
from anisomap.numerics.neighbours import labels_by_size, linked_labels, tree_edges
from anisomap.numerics.precision import Floats, Reals, float_type, row_blocks
from anisomap.numerics.signals import Signals
from anisomap.numerics.similarity.correlation import (
    N_BLOCKS,
    correlation_and_reliability,
    resampled_correlation,
)
from anisomap.numerics.similarity.rest import ranks_of_depths

_MAX_LAG_SHARE = 4  # maximum lag T / 4: longer lags average too few products
_MAX_LAG = 4096  # frames; longer than a contact
_FIRST_LAGS = (20, 256)  # lags examined first, which usually suffice
_FEW_LAGS = 20  # for fewer lags, sums of products take less time than transforms
_MIN_WINDOW = 10  # frames
_FADED = 0.1  # autocorrelation below which readings count as uncorrelated
_WINDOW_FACTOR = 2  # window / lag at which the autocorrelation has faded
_MIN_THINNED = 2048  # frames of thinned readings: with more, maps change by less than their errors
_MAX_VARIANCE = 1.1  # of a correlation of thinned frames, relative to that of all
_SENSORS_AT_ONCE = 16  # sensors transformed at a time, which stay in the cache
_SAMPLED_SENSORS = 64  # whose autocorrelations give the window
_MAX_SENSORS = 4000  # sampled sensors; their 8 million pairs determine the median


def sampling_variance(readings: ArrayLike) -> Reals:
    """Estimate the sampling variance of the correlation of every pair of unrelated sensors.

    readings (T, N) -> (N, N), symmetric, and at least 1 / T, the variance for independent frames.

    Bartlett (1946), Journal of the Royal Statistical Society, Supplement 8: 27-41:
    ``var(r_ij) = sum_l (1 - |l| / (L + 1)) rho_i(l) rho_j(l) / T`` over lags ``|l| <= L``, with
    the autocorrelations rho. The window L is twice the lag at which the median autocorrelation
    falls below 0.1, so that the result does not depend on the frame rate. More than 64 sensors
    are sampled evenly for that lag.
    """
    values = np.asarray(readings)
    n_frames, n_sensors = values.shape
    if n_frames < 2:
        raise InputError(f"a sampling variance needs at least 2 frames, got {n_frames}")
    lag, sampled, known = _fading(values)
    window = min(n_frames - 1, max(_MIN_WINDOW, _WINDOW_FACTOR * lag))
    others = np.ones(n_sensors, dtype=bool)
    found = np.empty((window + 1, n_sensors), float_type(n_sensors))
    if window < len(known):
        found[:, sampled], others[sampled] = known[: window + 1], False
    found[:, others] = _autocorrelation(values, window, np.flatnonzero(others))
    taper = 2 * (1 - np.arange(window + 1) / (window + 1))
    taper[0] = 1.0  # all other lags are doubled, for their negatives
    found *= np.sqrt(taper / n_frames)[:, None]
    variance = found.T @ found  # the product of a matrix with itself is exactly symmetric
    return np.asarray(np.maximum(variance, 1 / n_frames, out=variance))


def typical_variance(variance: ArrayLike) -> float:
    """Return the median of a variance over pairs of sensors. variance (N, N)."""
    values = np.asarray(variance)
    step = -(-len(values) // _MAX_SENSORS)
    values = values[::step, ::step]
    pairs = squareform(values, checks=False)  # of a symmetric matrix
    return float(np.median(pairs if pairs.size else values))


def correlation_time(readings: ArrayLike) -> int:
    """Return the lag at which the median autocorrelation falls below 0.1. readings (T, N)."""
    return _fading(np.asarray(readings))[0]


def thinning(readings: ArrayLike) -> int:
    """Return the largest step between frames that hardly increases the variance of correlations.

    The variance of correlations of every s-th frame is proportional to ``s sum_l rho(s l)^2``, with
    the autocorrelations rho at all lags l, for two sensors with equal autocorrelations. The step is
    1 if changes are slow: sensors then share the same few events, and differ by noise.
    """
    values = np.asarray(readings)
    if len(values) < 2 * _MIN_THINNED:
        return 1
    lag, _, found = _fading(values)
    if N_BLOCKS * lag >= len(values):
        return 1
    squares = np.square(found[: _WINDOW_FACTOR * lag + 1]).mean(axis=1)
    squares[1:] *= 2  # for the negative lags
    of_all = _MAX_VARIANCE * float(squares.sum())
    steps = range(min(lag, len(values) // _MIN_THINNED), 1, -1)
    return next((step for step in steps if step * float(squares[::step].sum()) <= of_all), 1)


def _fading(readings: NDArray[np.generic]) -> tuple[int, NDArray[np.intp], NDArray[np.float32]]:
    """Find the lag at which the median autocorrelation of sampled sensors fades.

    readings (T, N) -> lag, the sampled sensors (n,), their autocorrelations (L, n).
    """
    n_frames, n_sensors = readings.shape
    sampled = np.linspace(0, n_sensors - 1, min(n_sensors, _SAMPLED_SENSORS)).astype(np.intp)
    max_lag = min(_MAX_LAG, max(1, n_frames // _MAX_LAG_SHARE))
    # Nearly all recordings fade much earlier than the longest lag.
    for lags in sorted({min(lags, max_lag) for lags in (*_FIRST_LAGS, max_lag)}):
        found = _autocorrelation(readings, lags, sampled)
        faded = np.flatnonzero(np.median(found, axis=1) < _FADED)
        if faded.size and _WINDOW_FACTOR * int(faded[0]) <= lags:
            break
    return (int(faded[0]) if faded.size else len(found)), sampled, found


def _autocorrelation(
    readings: NDArray[np.generic], max_lag: int, sensors: NDArray[np.intp]
) -> NDArray[np.float32]:
    """Autocorrelate at lags 0 to `max_lag`, shape (max_lag + 1, n); 0 for constant sensors."""
    size = next_fast_len(len(readings) + max_lag, real=True)
    result = np.zeros((max_lag + 1, len(sensors)), dtype=np.float32)
    for begin in range(0, len(sensors), _SENSORS_AT_ONCE):
        part = centred_rows(readings[:, sensors[begin : begin + _SENSORS_AT_ONCE]])
        varies = part.any(axis=1)
        if max_lag <= _FEW_LAGS:
            pairs = ((part[:, lag:], part[:, : part.shape[1] - lag]) for lag in range(max_lag + 1))
            products = np.stack([np.einsum("nt,nt->n", *pair) for pair in pairs], axis=1)
        else:
            # Transforms of float32 take a third of the time; errors stay below 1e-5.
            spectrum = rfft(part, n=size)
            power = spectrum.real**2 + spectrum.imag**2
            products = irfft(power, n=size)[:, : max_lag + 1]
        products[varies] /= products[varies, :1]
        products[~varies] = 0.0
        result[:, begin : begin + len(part)] = products.T
    return result


MAX_BLOCKS = 100
"""Maximum number of blocks: with more, variances are hardly more precise and take more time."""

MIN_BLOCKS = 8
"""Minimum number of blocks: resamples of fewer blocks hardly differ; chosen by hand."""

BLOCK_FACTOR = 4
"""Length of a block, relative to the lag at which autocorrelations fade; see `block_edges`."""


def block_length(readings: ArrayLike) -> int:
    """Return the frames per block: several times the autocorrelation of readings (T, N)."""
    return BLOCK_FACTOR * max(1, correlation_time(readings))


def block_edges(readings: ArrayLike) -> NDArray[np.intp]:
    """Split readings (T, N) into blocks that are longer than their autocorrelation.

    Kuensch (1989), doi:10.1214/aos/1176347265: for estimates of variances, blocks must be long
    relative to the autocorrelation and short relative to the recording.
    """
    values = np.asarray(readings)
    count = len(values) // block_length(values)
    count = min(max(count, MIN_BLOCKS), MAX_BLOCKS, len(values))
    return np.linspace(0, len(values), count + 1).astype(np.intp)


def balanced_weights(n_blocks: int, n_resamples: int, rng: np.random.Generator) -> Floats:
    """Draw how often each block occurs in each resample, (R, B).

    The balanced bootstrap of Davison, Hinkley & Schechtman (1986), doi:10.1093/biomet/73.3.555:
    every block is drawn equally often over all resamples.
    """
    drawn = rng.permutation(np.tile(np.arange(n_blocks), n_resamples)).reshape(-1, n_blocks)
    return np.array([np.bincount(row, minlength=n_blocks) for row in drawn], dtype=np.float64)


_MIN_BRIDGE = 1.2
"""Minimum strength of a link between groups, relative to the strongest unrelated link.

On skins of 500 frames and more, the weakest necessary link was at least 1.22 times as strong. The
strongest link between skins touched independently was mostly .8 to 1.2 times as strong.
"""

_MISSED = 2.33  # standard deviations; a link that is stronger by them is missed in 1 % of cases
_WEAK_LINKS = 0.05  # share of the links of a group that may be weaker than expected

_MIN_FILTERED_SENSORS = 500  # above which insignificant links of a component are removed; by hand
_MIN_LINK = 1.5  # strength of a significant link, relative to the strongest unrelated one; by hand
_GREATEST_R = 1 - 1e-6  # greater correlations are replaced by it; float32 resolves 6e-8
_MIN_COVERED = 0.95  # share of the sensors that significant links connect; chosen by hand
_N_STRONGEST = 5  # 4 to 6 result in similar maps of strips and spheres; with 8, strips are bridged
_MIN_SHARED = 0.1  # share of common neighbours; it is 1/3 for near sensors in a plane; by hand


def remove_insignificant_links(
    dissimilarity: Reals, similarity: Reals, variance: Reals, component: NDArray[np.intp]
) -> Reals:
    """Make dissimilarities infinite between components and along insignificant links.

    dissimilarity (N, N), similarity (N, N), variance (N, N), component (N,) -> (N, N).
    """
    if component.any():
        dissimilarity[np.not_equal.outer(component, component)] = np.inf
    for label in np.flatnonzero(np.bincount(component) > _MIN_FILTERED_SENSORS):
        inside = ... if not component.any() else np.ix_(component == label, component == label)
        kept = significant_links(similarity[inside], variance[inside])
        np.fill_diagonal(kept, val=True)
        dissimilarity[inside] = np.where(kept, dissimilarity[inside], np.inf)
    return dissimilarity


@dataclass(frozen=True, eq=False)
class Groups:
    """Groups of N sensors; arrays of labels of shape (N,), 0 is the largest.

    linked: Sensors that statistically significant links connect.
    related: Unions of such groups that are not shown to be unrelated.
    """

    linked: NDArray[np.intp]
    related: NDArray[np.intp]

    @property
    def hidden(self) -> NDArray[np.intp]:
        """Sensors whose links to most others of their `related` group are hidden by noise."""
        found = np.zeros(len(self.linked), dtype=bool)
        for label in range(self.related.max(initial=-1) + 1):
            inside = np.flatnonzero(self.related == label)
            main = np.bincount(self.linked[inside]).argmax()
            found[inside] = self.linked[inside] != main
        return np.flatnonzero(found)


def group_sensors(similarity: Reals, variance: ArrayLike) -> Groups:
    """Group sensors by statistically significant links, and by the absence of expected links.

    similarity (N, N), variance (N, N).

    Groups grow along the strongest links, as in single linkage. The strength of a link is
    ``artanh r`` (Fisher 1921, Metron 1: 3-32) in standard deviations of unrelated sensors. The
    strongest of m independent links between unrelated sensors is about ``sqrt(2 log m)``. A group
    of n sensors has m = n (N - n) links to other sensors. Links of 1.2 times this are significant.

    Two groups without a significant link between them are unrelated if a link of the 5 % quantile
    of strengths within either group would have been found with a probability of 99 %. They are
    related if noise could hide it. Quantiles are at most that of the largest group, whose weak
    links are known best; single sensors take this quantile, too.
    """
    links = standardised_correlation(similarity, variance, by_z=True)
    n_sensors = len(links)
    if n_sensors < 2:
        return Groups(*np.zeros((2, n_sensors), dtype=np.intp))
    group, sizes = np.arange(n_sensors), np.ones(n_sensors, dtype=np.intp)
    held: list[list[float]] = [[] for _ in range(n_sensors)]
    for i, j in _strongest_first(links):
        one, other = group[i], group[j]
        if links[i, j] >= _least_bridge(int(min(sizes[one], sizes[other])), n_sensors):
            group[group == other] = one
            sizes[one] += sizes[other]
            held[one] += [*held[other], float(links[i, j])]
    linked = labels_by_size(group)
    if not linked.any():
        return Groups(linked, linked)
    first = np.unique(linked, return_index=True)[1]
    sizes = sizes[group[first]]
    weakest = [np.quantile(held[g], _WEAK_LINKS) if held[g] else 0.0 for g in group[first]]
    strength = np.minimum(np.where(sizes > 1, weakest, np.inf), weakest[0])
    least = np.array([_least_bridge(size, n_sensors) for size in sizes.tolist()])
    shown = np.minimum.outer(strength, strength) >= np.minimum.outer(least, least) + _MISSED
    joined = linked_labels(~shown)
    return Groups(linked, labels_by_size(joined[linked]))


def _least_bridge(size: int, n_sensors: int) -> float:
    """Return the strength from which links between a group and the others are significant."""
    return _MIN_BRIDGE * math.sqrt(2 * math.log(max(2, size * (n_sensors - size))))


def significant_links(similarity: Reals, variance: ArrayLike) -> NDArray[np.bool_]:
    """Select the links that show that two sensors of a large skin are close.

    A link is significant if it is 1.5 times as strong as the strongest of P unrelated pairs,
    ``sqrt(2 log P)`` standard deviations, and if its sensors share neighbours. The 5 strongest
    links of each sensor and links of the maximum spanning tree between components are kept. All
    links are kept if significant links connect too few sensors: contacts are then too small, or the
    recording is too short, to distinguish links.
    """
    links = standardised_correlation(similarity, variance)
    n_sensors = len(links)
    n_pairs = max(2, n_sensors * (n_sensors - 1) // 2)
    np.fill_diagonal(links, -np.inf)
    kept = links >= _MIN_LINK * math.sqrt(2 * math.log(n_pairs))
    counted = kept.astype(np.float32)
    degree = counted.sum(axis=1)
    kept &= counted @ counted >= _MIN_SHARED * np.minimum(degree[:, None], degree)
    component = linked_labels(kept)
    if np.bincount(component).max() < _MIN_COVERED * n_sensors:
        return ~np.eye(n_sensors, dtype=bool)
    strongest = np.argpartition(links, -_N_STRONGEST, axis=1)[:, -_N_STRONGEST:]
    np.put_along_axis(kept, strongest, values=True, axis=1)
    kept |= kept.T
    component = linked_labels(kept)
    for i, j in _strongest_first(links) if component.any() else ():
        if component[i] != component[j]:
            component[component == component[j]] = component[i]
            kept[i, j] = kept[j, i] = True
    return np.asarray(kept)


def standardised_correlation(
    similarity: Reals, variance: ArrayLike, *, by_z: bool = False
) -> Reals:
    """Divide correlations, or their Fisher's z, by their standard deviations, shape (N, N).

    Each variance is at least the median: estimates for sensors with few contacts are too small.
    """
    links, noise = similarity.copy(order="C"), np.asarray(variance)
    least = typical_variance(noise)
    for rows in row_blocks(len(links)):
        part = links[rows]
        if by_z:
            np.arctanh(np.clip(part, -_GREATEST_R, _GREATEST_R, out=part), out=part)
        part /= np.sqrt(np.maximum(noise[rows], least))
    return links


def _strongest_first(links: Reals) -> list[tuple[int, int]]:
    """List the edges of the maximum spanning tree of links by decreasing strength."""
    edges = ((links[new, joined], joined, new) for new, joined in tree_edges(links))
    return [(i, j) for _, i, j in sorted(edges, reverse=True)]


FALSE_ALARMS = 0.05
"""Expected number of healthy sensors of a recording that are outlying; at most one in 1,000 is."""

_LEAST_P = 1e-3
_LEAST_SPREAD = 0.4  # of the logarithms of levels: sensors of one skin differ by a factor of 1.5
_MIN_COMPARED = 8  # minimum number of levels for a fit of their distribution
_NORMAL_MAD = 0.6745  # median absolute deviation of a normal distribution


def outlying(levels: Floats, variance: ArrayLike = 0.0) -> NDArray[np.bool_]:
    """Return whether each of n positive levels is too high compared to all others, (n,).

    variance: Sampling variance of the logarithm of each level. Logarithms are taken to be normal.
    """
    if len(levels) < _MIN_COMPARED:
        return np.zeros(len(levels), dtype=bool)
    logarithm = np.log(levels)
    beyond = logarithm - np.median(logarithm)
    spread = max(float(np.median(np.abs(beyond))) / _NORMAL_MAD, _LEAST_SPREAD)
    deviation = np.sqrt(spread**2 + np.asarray(variance))
    return np.asarray(ndtr(-beyond / deviation) < min(_LEAST_P, FALSE_ALARMS / len(levels)))


_MIN_REPEATED = 0.5  # correlation of the correlations of two halves; chosen by hand
_GAIN = 0.25  # minimum gain of innovations, above chance in short recordings; chosen by hand


def without_slow_changes(readings: NDArray[Any]) -> NDArray[Any]:
    """Return the innovations of readings, (T, N), if they repeat better; otherwise the readings.

    Slow drifts of levels are few events, so their correlations differ between the halves of a
    recording. Innovations are the unpredicted parts of a random walk with white noise (Muth 1960,
    doi:10.1080/01621459.1960.10482064): ``y_t = x_t - x_(t-1) + theta y_(t-1)``, where the
    autocorrelation of differences at lag 1 is ``-theta/(1 + theta^2)``.
    """
    step = -(-readings.shape[1] // _SAMPLED_SENSORS)
    repeated = correlation_and_reliability(readings[:, ::step], 2)[1]
    if repeated >= _MIN_REPEATED or N_BLOCKS * correlation_time(readings) < len(readings):
        return readings
    changes = np.diff(readings - readings[0].astype(np.float64), axis=0)
    found = _autocorrelation(changes, 1, np.arange(changes.shape[1]))
    lag_1 = float(np.clip(np.median(found[1]), -0.5, 0))
    theta = math.tan(math.asin(-2 * lag_1) / 2)
    bands = np.outer([1, -theta], np.ones(len(readings)))
    left = solve_banded((1, 0), bands, np.pad(changes, ((1, 0), (0, 0))))
    gained = correlation_and_reliability(left[:, ::step], 2)[1] - repeated
    return left if gained >= _GAIN else readings


_LEAST_SHARE = 0.1  # .01 to .25 result in similar maps
# Tuned on simulated skins, seeds 101-105; 3 to 10 result in similar maps.
_POWER_OF_RELIABILITY = 5.0
_POWER_OF_RATIO = 10.0


def blended_correlation(readings: ArrayLike) -> Reals:
    """Combine Pearson's r and Spearman's rho by their split-half reliability.

    readings (T, N) -> ``w r + (1 - w) rho``, (N, N): in [-1, 1], exactly symmetric, ones on the
    diagonal. Invariant under changes of the unit and the zero of a sensor.

    A few deep contacts dominate Pearson's r of tactile readings, so r is noisy in short recordings.
    Ranks are less noisy but distort distances. Ranks are of depths beyond rest
    (`anisomap.numerics.similarity.rest.estimate_rest`), since ranks of readings at rest are noise.
    With the reliabilities p of r and q of rho, ``1 - w = (1 - p^5) min(1, q / p)^10``: the weight
    of rho is large if r is unreliable, unless rho is even less reliable. In recordings of fewer
    than 20 correlation times, what fades between two frames is noise. The result is then divided by
    ``sqrt(s_i s_j)`` (Spearman 1904, The American Journal of Psychology 15: 72-101), with the share
    s of a sensor's variance that is no noise: its autocorrelation, extrapolated to lag 0.
    """
    return Blend.of(readings).similarity


@dataclass(frozen=True, eq=False)
class Blend:
    """A blended correlation, and the correlations and readings from which it was computed.

    similarity (N, N): See `blended_correlation`.
    weight: Weight of Pearson's r, in [0, 1].
    rho (N, N): Spearman's. readings, ranks (T, N): Ranks are of depths beyond rest.
    gain (N, N): Inverse of the attenuation by noise.
    """

    similarity: Reals
    rho: Reals
    weight: float
    readings: NDArray[Any]
    ranks: Reals
    gain: Reals

    @classmethod
    def of(
        cls, readings: ArrayLike, signals: Signals | None = None, centred: bool = False
    ) -> Blend:
        """Blend the correlations of readings, (T, N), whose signals may be known.

        centred: Whether a common signal was subtracted, after which sensors do not rest alike.
        """
        values = np.asarray(readings)
        signals = Signals(values) if signals is None else signals
        ranks = ranks_of_depths(values, signals.rest, single=True, alike=not centred)
        (r, p), (rho, q) = signals.pearson, correlation_and_reliability(ranks)
        p, q = max(p, 0.0), max(q, 0.0)
        ratio = 1.0 if q >= p else q / p
        weight = 1 - (1 - p**_POWER_OF_RELIABILITY) * ratio**_POWER_OF_RATIO
        gain = np.ones_like(r)
        if N_BLOCKS * correlation_time(values) >= len(values):
            _, first, second = _autocorrelation(values, 2, np.arange(len(r)))
            share = np.clip(2 * first - second, _LEAST_SHARE, 1)
            gain /= np.sqrt(np.outer(share, share))
        blended = np.clip((weight * r + (1 - weight) * rho) * gain, -1, 1)
        np.fill_diagonal(blended, 1.0)
        return cls(blended, rho, weight, values, ranks, gain)

    @cached_property
    def variance(self) -> Reals:
        """Sampling variance for unrelated sensors, (N, N).

        It is ``(w sd(r) + (1 - w) sd(rho))^2``: the errors of r and rho are nearly proportional.
        """
        deviation = self.weight * np.sqrt(sampling_variance(self.readings))
        deviation += (1 - self.weight) * np.sqrt(sampling_variance(self.ranks))
        deviation *= self.gain
        return np.asarray(np.square(deviation, out=deviation))

    def select(self, sensors: NDArray[np.bool_]) -> Blend:
        """Return the blend of some of the sensors, given as a mask of shape (N,)."""
        inside = np.ix_(sensors, sensors)
        return replace(
            self,
            similarity=self.similarity[inside],
            rho=self.rho[inside],
            readings=self.readings[:, sensors],
            ranks=self.ranks[:, sensors],
            gain=self.gain[inside],
        )

    def resampled(self, edges: NDArray[np.intp], weights: Floats) -> NDArray[np.floating]:
        """Return the correlations over weighted blocks of frames. weights (R, B) -> (R, N, N)."""
        found = resampled_correlation(self.readings, edges, weights)
        found *= self.weight
        rho = resampled_correlation(self.ranks, edges, weights)
        rho *= 1 - self.weight
        found += rho
        found *= self.gain
        return np.clip(found, -1, 1, out=found)
