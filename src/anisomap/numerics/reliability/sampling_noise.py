"""Sampling variance of correlations of autocorrelated readings, and blocks that resample them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import irfft, next_fast_len, rfft

from anisomap.errors import InputError
from anisomap.numerics.columns import centred_rows
from anisomap.numerics.precision import Reals, float_type

_MAX_LAG_SHARE = 4  # maximum lag T / 4: longer lags average too few products
_MAX_LAG = 4096  # frames; longer than a contact
_FIRST_LAGS = 256  # lags examined first, which saves most of the maximum lags
_MIN_WINDOW = 10  # frames
_FADED = 0.1  # autocorrelation below which readings count as uncorrelated
_WINDOW_FACTOR = 2  # window / lag at which the autocorrelation has faded
_MIN_THINNED = 2048  # frames left in thinned readings: more change no map by its ellipses
_MAX_VARIANCE = 1.1  # of a correlation of thinned frames, relative to that of all
_SENSORS_AT_ONCE = 16  # sensors transformed at a time, which stay in the cache
_SAMPLED_SENSORS = 64  # whose autocorrelations give the window
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
    pairs = values[np.triu_indices(len(values), 1)]
    return float(np.median(pairs if pairs.size else values))


def correlation_time(readings: ArrayLike) -> int:
    """Return the lag in frames at which the median autocorrelation of sensors falls below 0.1.

    readings (T, N).
    """
    return _fading(np.asarray(readings))[0]


def thinning(readings: ArrayLike) -> int:
    """Return the largest step between frames whose correlations vary hardly more than those of all.

    readings (T, N).

    The variance of correlations of every s-th frame is proportional to ``s sum_l rho(s l)^2``, with
    the autocorrelations rho at all lags l, for two sensors with the same ones. At least 2,048
    frames are left.
    """
    values = np.asarray(readings)
    if len(values) < 2 * _MIN_THINNED:
        return 1
    lag, _, found = _fading(values)
    squares = np.square(found[: _WINDOW_FACTOR * lag + 1]).mean(axis=1)
    squares[1:] *= 2  # for the negative lags
    of_all = _MAX_VARIANCE * float(squares.sum())
    steps = range(min(lag, len(values) // _MIN_THINNED), 1, -1)
    return next((step for step in steps if step * float(squares[::step].sum()) <= of_all), 1)


def _fading(
    readings: NDArray[np.generic],
) -> tuple[int, NDArray[np.intp], NDArray[np.float32]]:
    """Find the lag at which the median autocorrelation of sampled sensors fades.

    readings (T, N) -> lag, the sampled sensors (n,), their autocorrelations (L, n).
    """
    n_frames, n_sensors = readings.shape
    sampled = np.linspace(0, n_sensors - 1, min(n_sensors, _SAMPLED_SENSORS)).astype(np.intp)
    max_lag = min(_MAX_LAG, max(1, n_frames // _MAX_LAG_SHARE))
    # Nearly all recordings fade much earlier than the longest lag.
    for lags in sorted({min(_FIRST_LAGS, max_lag), max_lag}):
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
        # Transforms of float32 take a third of the time; errors stay below 1e-5.
        spectrum = rfft(part, n=size)
        power = spectrum.real**2 + spectrum.imag**2
        products = irfft(power, n=size)[:, : max_lag + 1]
        products[varies] /= products[varies, :1]
        products[~varies] = 0.0
        result[:, begin : begin + len(part)] = products.T
    return result


MAX_BLOCKS = 100
"""Maximum number of blocks: more estimate a variance hardly better and take more time."""

MIN_BLOCKS = 8
"""Minimum number of blocks: fewer have hardly different resamples; chosen by hand."""

BLOCK_FACTOR = 4
"""Length of a block, relative to the lag at which autocorrelations fade; see `block_edges`."""


def block_edges(readings: ArrayLike) -> NDArray[np.intp]:
    """Split a recording into blocks that are long against the autocorrelation of its readings.

    readings (T, N).

    Kuensch (1989), doi:10.1214/aos/1176347265: resampling blocks of frames estimates variances if
    blocks are long against the autocorrelation and few against the recording. Blocks of 2 to 8
    times that lag gave about equal variances on simulated skins, seeds 201 to 212.
    """
    values = np.asarray(readings)
    length = BLOCK_FACTOR * max(1, correlation_time(values))
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
