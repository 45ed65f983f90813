"""Sampling variance of correlations of autocorrelated readings."""

from __future__ import annotations

import math

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
_SENSORS_AT_ONCE = 64  # sensors transformed at a time; bounds the memory
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
    """
    values = np.asarray(readings)
    n_frames = len(values)
    if n_frames < 2:
        raise InputError(f"a sampling variance needs at least 2 frames, got {n_frames}")
    sampled, some, lag = _fading(values)
    window = min(len(some) - 1, max(_MIN_WINDOW, math.ceil(_WINDOW_FACTOR * lag)))
    tapered = np.empty((window + 1, values.shape[1]), float_type(values.shape[1]))
    tapered[:, sampled] = some[: window + 1]
    others = np.setdiff1d(np.arange(values.shape[1]), sampled)
    for begin in range(0, len(others), _SENSORS_AT_ONCE):
        part = others[begin : begin + _SENSORS_AT_ONCE]
        tapered[:, part] = _autocorrelation(values[:, part], window)
    taper = 2 * (1 - np.arange(window + 1) / (window + 1))
    taper[0] = 1.0  # all other lags are doubled, for their negatives
    tapered *= np.sqrt(taper / n_frames)[:, None]
    variance = tapered.T @ tapered  # the product of a matrix with itself is exactly symmetric
    return np.asarray(np.maximum(variance, 1 / n_frames, out=variance))


def typical_variance(variance: ArrayLike) -> float:
    """Return the median of a variance over pairs of sensors.

    Parameters
    ----------
    variance : array_like of shape (N, N)
        The diagonal is ignored. For more than 4,000 sensors, a regular sample is used.

    Returns
    -------
    float
    """
    values = np.asarray(variance)
    step = -(-len(values) // _MAX_SENSORS)
    values = values[::step, ::step]
    pairs = values[np.triu_indices(len(values), 1)]
    return float(np.median(pairs if pairs.size else values))


def correlation_time(readings: ArrayLike) -> int:
    """Return the lag in frames at which the median autocorrelation of sensors falls below 0.1.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings. More than 128 sensors are sampled evenly.

    Returns
    -------
    int
        At most a quarter of the frames, and 4,096; plus 1 if it does not fall.
    """
    return _fading(np.asarray(readings))[2]


def _fading(
    readings: NDArray[np.generic],
) -> tuple[NDArray[np.intp], NDArray[np.float32], int]:
    """Return sampled sensors, their autocorrelations, and the lag at which the median fades."""
    n_frames, n_sensors = readings.shape
    max_lag = min(_MAX_LAG, max(1, n_frames // _MAX_LAG_SHARE))
    sampled = np.linspace(0, n_sensors - 1, min(n_sensors, _SAMPLED_SENSORS)).astype(np.intp)
    # Nearly all recordings fade much earlier than the longest lag.
    for lags in sorted({min(_FIRST_LAGS, max_lag), max_lag}):
        some = _autocorrelation(readings[:, sampled], lags)
        faded = np.flatnonzero(np.median(some, axis=1) < _FADED)
        if faded.size and math.ceil(_WINDOW_FACTOR * int(faded[0])) <= lags:
            break
    return sampled, some, int(faded[0]) if faded.size else len(some)


def _autocorrelation(readings: NDArray[np.generic], max_lag: int) -> NDArray[np.float32]:
    """Autocorrelate at lags 0 to `max_lag`, shape (max_lag + 1, N); 0 for constant sensors."""
    n_frames, n_sensors = readings.shape
    size = next_fast_len(n_frames + max_lag, real=True)
    result = np.zeros((max_lag + 1, n_sensors), dtype=np.float32)
    for start in range(0, n_sensors, _SENSORS_AT_ONCE):
        # Rows of contiguous numbers are transformed several times faster than columns.
        part = np.array(
            readings[:, start : start + _SENSORS_AT_ONCE].T, dtype=np.float64, order="C", copy=True
        )
        varies = np.ptp(part, axis=1) > 0
        part /= np.maximum(np.abs(part).max(axis=1), np.finfo(np.float64).tiny)[:, None]
        part -= part.mean(axis=1)[:, None]
        part /= np.where(varies, np.abs(part).max(axis=1), 1)[:, None]
        # Transforms of float32 take a third of the time; errors stay below 1e-5.
        spectrum = rfft(part.astype(np.float32), n=size)
        power = spectrum.real**2 + spectrum.imag**2
        products = irfft(power, n=size)[:, : max_lag + 1]
        products[varies] /= products[varies, :1]
        products[~varies] = 0.0
        result[:, start : start + len(part)] = products.T
    return result
