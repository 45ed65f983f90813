"""Sampling variance of correlations of autocorrelated readings.

Block bootstrap: blocks of consecutive frames, and weights that resample them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import irfft, next_fast_len, rfft

from anisomap.errors import InputError
from anisomap.numerics.precision import Reals, float_type

_MAX_LAG_SHARE = 4  # maximum lag T / 4: longer lags average too few products
_MAX_LAG = 4096  # frames; chosen by hand, longer than a contact
_FIRST_LAGS = 256  # lags examined first; chosen by hand, to save most of the maximum lags
_MIN_WINDOW = 10  # frames; chosen by hand
_FADED = 0.1  # autocorrelation below which readings count as uncorrelated; chosen by hand
_WINDOW_FACTOR = 2.0  # window / lag at which the autocorrelation has faded; chosen by hand
_MIN_THINNED = 2048  # frames left in thinned readings; chosen by hand
_LAGS_PER_FADING = 8  # lags up to the one at which the autocorrelation has faded; see `_fading`
_EXAMINED_SENSORS = 32  # in which it is examined whether readings may be thinned; by hand
_FRAMES_PER_FADING = 12  # maximum thinning of resamples; of noise-free readings, it costs 1 %
_MAX_VARIANCE = 1.1  # of a correlation of thinned frames, relative to that of all; by hand
_SENSORS_AT_ONCE = 16  # sensors transformed at a time, which stay in the cache
_FLOAT32_RANGE = 1e15  # of readings that are centred in float32
_SAMPLED_SENSORS = 128  # whose median autocorrelation gives the window; by hand
_MAX_SENSORS = 4000  # sampled sensors; their 8 million pairs determine the median


def sampling_variance(readings: ArrayLike) -> Reals:
    """Estimate the sampling variance of the correlation of every pair of unrelated sensors.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings, T >= 2.

    Returns
    -------
    ndarray of shape (N, N)
        At least 1 / T, the variance for independent frames. Symmetric.

    Raises
    ------
    InputError
        If there are fewer than 2 frames.

    Notes
    -----
    Bartlett (1946), Journal of the Royal Statistical Society, Supplement 8: 27-41:
    ``var(r_ij) = sum_l (1 - |l| / (L + 1)) rho_i(l) rho_j(l) / T`` over lags ``|l| <= L``, with
    the autocorrelations rho. The window L is twice the lag at which the median autocorrelation
    falls below 0.1, so that the result does not depend on the frame rate. More than 128 sensors
    are sampled evenly for that lag.

    Of recordings of 4,096 frames and more, frames are thinned while that lag is 8 frames at least,
    and autocorrelations are interpolated linearly between lag 1, beyond which the noise of readings
    does not last, and the lags that are left. Frames are not thinned where autocorrelations depart
    from the interpolated ones by more than 0.1, as those of a hum do.
    """
    values = np.asarray(readings)
    n_frames = len(values)
    if n_frames < 2:
        raise InputError(f"a sampling variance needs at least 2 frames, got {n_frames}")
    sampled, some, lag, step = _fading(values)
    window = min(len(some) - 1, max(_MIN_WINDOW, math.ceil(_WINDOW_FACTOR * lag / step)))
    found = np.empty((window + 1, values.shape[1]), float_type(values.shape[1]))
    found[:, sampled] = some[: window + 1]
    others = np.setdiff1d(np.arange(values.shape[1]), sampled)
    found[:, others] = _autocorrelation(values[::step], window, others)
    if step > 1:
        found = _interpolated(np.insert(found, 1, _lag_one(values, step), axis=0), step)
    taper = 2 * (1 - np.arange(len(found)) / len(found))
    taper[0] = 1.0  # all other lags are doubled, for their negatives
    found *= np.sqrt(taper / n_frames)[:, None]
    variance = found.T @ found  # the product of a matrix with itself is exactly symmetric
    return np.asarray(np.maximum(variance, 1 / n_frames, out=variance))


def typical_variance(variance: ArrayLike) -> float:
    """Return the median of a variance over pairs of sensors. variance (N, N)."""
    values = np.asarray(variance)
    step = -(-len(values) // _MAX_SENSORS)
    values = values[::step, ::step]
    pairs = values[np.triu_indices(len(values), 1)]
    return float(np.median(pairs if pairs.size else values))


def correlation_time(readings: ArrayLike) -> int:
    """Return the lag in frames at which the median autocorrelation of sensors falls below 0.1.

    readings (T, N).
    """
    return _fading(np.asarray(readings))[2]


def thinning(readings: ArrayLike) -> int:
    """Return the largest step between frames whose correlations vary hardly more than those of all.

    readings (T, N).

    The variance of correlations of every s-th frame is proportional to ``s sum_l rho(s l)^2``, with
    the autocorrelations rho at all lags l, for two sensors with the same ones.
    """
    values = np.asarray(readings)
    sampled, _, lag, _ = _fading(values)
    largest = lag // _FRAMES_PER_FADING
    if largest <= 1:
        return 1
    lags = min(math.ceil(_WINDOW_FACTOR * lag), len(values) - 1)
    squares = np.square(_autocorrelation(values, lags, _some(sampled))).mean(axis=1)
    squares[1:] *= 2  # for the negative lags
    steps = range(largest, 1, -1)
    of_all = _MAX_VARIANCE * float(squares.sum())
    return next((step for step in steps if step * float(squares[::step].sum()) <= of_all), 1)


def _some(sensors: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return some of the sensors, evenly chosen."""
    return sensors[:: -(-len(sensors) // _EXAMINED_SENSORS)]


def _largest_step(readings: NDArray[np.generic], sampled: NDArray[np.intp]) -> int:
    """Return the largest step at which autocorrelations between the lags left are interpolated."""
    n_frames = len(readings)
    step = 1 << max(0, (n_frames // _MIN_THINNED).bit_length() - 1)
    if step == 1:
        return 1
    exact = _autocorrelation(readings, min(_FIRST_LAGS, n_frames // _MAX_LAG_SHARE), _some(sampled))
    while step > 1:
        between = _interpolated(np.insert(exact[::step], 1, exact[1], axis=0), step)
        if np.abs(between - exact[: len(between)]).max() <= _FADED:
            break
        step //= 2
    return step


def _fading(
    readings: NDArray[np.generic],
) -> tuple[NDArray[np.intp], NDArray[np.float32], int, int]:
    """Find the lag at which the median autocorrelation of sampled sensors fades."""
    n_frames, n_sensors = readings.shape
    sampled = np.linspace(0, n_sensors - 1, min(n_sensors, _SAMPLED_SENSORS)).astype(np.intp)
    step = _largest_step(readings, sampled)
    while True:
        thinned = readings[::step]
        max_lag = min(_MAX_LAG, max(1, n_frames // _MAX_LAG_SHARE)) // step
        # Nearly all recordings fade much earlier than the longest lag.
        for lags in sorted({min(_FIRST_LAGS, max_lag), max_lag}):
            some = _autocorrelation(thinned, lags, sampled)
            median = np.median(some, axis=1)
            faded = np.flatnonzero(median < _FADED)
            if faded.size and math.ceil(_WINDOW_FACTOR * int(faded[0])) <= lags:
                break
        first = int(faded[0]) if faded.size else len(some)
        if step == 1 or first >= _LAGS_PER_FADING:
            break
        step //= 2
    if faded.size and first:
        before, after = float(median[first - 1]), float(median[first])
        return sampled, some, math.ceil((first - (_FADED - after) / (before - after)) * step), step
    return sampled, some, first * step, step


def _autocorrelation(
    readings: NDArray[np.generic], max_lag: int, sensors: NDArray[np.intp]
) -> NDArray[np.float32]:
    """Autocorrelate at lags 0 to `max_lag`, shape (max_lag + 1, n); 0 for constant sensors."""
    size = next_fast_len(len(readings) + max_lag, real=True)
    result = np.zeros((max_lag + 1, len(sensors)), dtype=np.float32)
    for begin in range(0, len(sensors), _SENSORS_AT_ONCE):
        part, varies = _centred(readings, sensors[begin : begin + _SENSORS_AT_ONCE])
        # Transforms of float32 take a third of the time; errors stay below 1e-5.
        spectrum = rfft(part, n=size)
        power = spectrum.real**2 + spectrum.imag**2
        products = irfft(power, n=size)[:, : max_lag + 1]
        products[varies] /= products[varies, :1]
        products[~varies] = 0.0
        result[:, begin : begin + len(part)] = products.T
    return result


def _lag_one(readings: NDArray[np.generic], step: int) -> NDArray[np.float32]:
    """Autocorrelate at lag 1 in every `step`-th frame, shape (N,); 0 for constant sensors."""
    found = np.zeros(readings.shape[1], dtype=np.float32)
    for begin in range(0, len(found), _SENSORS_AT_ONCE):
        sensors = np.arange(begin, min(begin + _SENSORS_AT_ONCE, len(found)))
        first, second = (
            _centred(readings[frames], sensors)[0]
            for frames in (slice(0, -1, step), slice(1, None, step))
        )
        products, one, other = (
            np.einsum("nt,nt->n", *pair)
            for pair in ((first, second), (first, first), (second, second))
        )
        size = np.sqrt(one * other)
        np.divide(products, size, out=found[sensors[0] : sensors[-1] + 1], where=size > 0)
    return found


def _interpolated(found: Reals, step: int) -> Reals:
    """Interpolate autocorrelations of lags 0, 1 and multiples of a step at all lags."""
    lags = np.insert(np.arange(0, (len(found) - 1) * step, step), 1, 1)
    every = np.arange(lags[-1] + 1)
    after = np.maximum(np.searchsorted(lags, every), 1)
    share = ((every - lags[after - 1]) / (lags[after] - lags[after - 1])).astype(found.dtype)
    between = share[:, None] * (found[after] - found[after - 1])
    between += found[after - 1]
    return np.asarray(between)


def _centred(
    readings: NDArray[np.generic], sensors: NDArray[np.intp]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return centred readings of sensors in [-1, 1], shape (n, T), and which of them vary."""
    # Rows of contiguous numbers are transformed several times faster than columns.
    part: NDArray[Any] = np.ascontiguousarray(readings.T[sensors])
    single = part.dtype == np.float32 and np.abs(part).max(initial=0) < _FLOAT32_RANGE
    if not single:
        part = part.astype(np.float64)
        part /= np.maximum(np.abs(part).max(axis=1), np.finfo(np.float64).tiny)[:, None]
    varies = np.ptp(part, axis=1) > 0
    part -= part.mean(axis=1)[:, None]
    part /= np.where(varies, np.abs(part).max(axis=1), 1)[:, None]
    return part.astype(np.float32, copy=False), varies


MAX_BLOCKS = 100
"""Maximum number of blocks: more estimate a variance hardly better and take more time."""

MIN_BLOCKS = 8
"""Minimum number of blocks: fewer have hardly different resamples; chosen by hand."""

_BLOCK_FACTOR = 4  # block length / lag at which autocorrelations fade; see `block_edges`
_MAX_SENSORS_BLOCK_BOOTSTRAP = (
    64  # regularly sampled sensors whose autocorrelations give the length of blocks
)


def block_edges(readings: ArrayLike) -> NDArray[np.intp]:
    """Split a recording into blocks that are long against the autocorrelation of its readings.

    readings (T, N).

    Kuensch (1989), doi:10.1214/aos/1176347265: resampling blocks of frames estimates variances if
    blocks are long against the autocorrelation and few against the recording. Blocks of 2 to 8
    times that lag gave about equal variances on simulated skins, seeds 201 to 212.
    """
    values = np.asarray(readings)
    length = _BLOCK_FACTOR * max(1, _time(values))
    count = min(max(len(values) // length, MIN_BLOCKS), MAX_BLOCKS, len(values))
    return np.linspace(0, len(values), count + 1).astype(np.intp)


def balanced_weights(
    n_blocks: int, n_resamples: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Draw how often each block occurs in each resample.

    Returns (R, B).

    The balanced bootstrap of Davison, Hinkley & Schechtman (1986), doi:10.1093/biomet/73.3.555:
    every block is drawn equally often over all resamples, so that their mean is unbiased.
    """
    drawn = rng.permutation(np.tile(np.arange(n_blocks), n_resamples)).reshape(-1, n_blocks)
    return np.array([np.bincount(row, minlength=n_blocks) for row in drawn], dtype=np.float64)


def _time(readings: NDArray[Any]) -> int:
    step = -(-readings.shape[1] // _MAX_SENSORS_BLOCK_BOOTSTRAP)
    return correlation_time(readings[:, ::step])
