"""How far correlations can be believed: how noisy they are, and whether they come again."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.precision import Reals, float_type

_LAG_SHARE = 4  # of the frames: autocorrelations of longer lags rest on too few
_LONGEST_LAG = 4096  # frames; a contact that lasts longer is no fleeting one
_SHORTEST_WINDOW = 10  # frames
_FADED = 0.1  # autocorrelation
_WINDOWS = 2.0  # the window is so many times the lag at which the autocorrelation has faded
_SENSORS_AT_ONCE = 64
_ENOUGH = 4000  # sensors, to tell what pairs are like


def sampling_variance(readings: ArrayLike) -> Reals:
    """Estimate the variance that a correlation of two unrelated sensors has by chance.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings, T >= 2.

    Returns
    -------
    ndarray of shape (N, N)
        At least 1 / T, which it would be if frames were independent. Symmetric.

    Raises
    ------
    InputError
        If there are fewer than 2 frames.

    Notes
    -----
    Bartlett (1946), Journal of the Royal Statistical Society, Supplement 8: 27-41:
    ``var(r_ij) = sum_l (1 - |l| / (L + 1)) rho_i(l) rho_j(l) / T`` over lags ``|l| <= L``, with
    the autocorrelations rho. The window L follows the recording: twice the lag at which the median
    autocorrelation has faded, so that it does not depend on the frame rate.
    """
    values = np.asarray(readings)
    n_frames = len(values)
    if n_frames < 2:
        raise InputError("one frame has no correlations; give 2 or more")
    autocorrelation = _autocorrelation(values, min(_LONGEST_LAG, max(1, n_frames // _LAG_SHARE)))
    faded = np.flatnonzero(np.median(autocorrelation, axis=1) < _FADED)
    first = int(faded[0]) if faded.size else len(autocorrelation)
    window = min(len(autocorrelation) - 1, max(_SHORTEST_WINDOW, math.ceil(_WINDOWS * first)))
    taper = 2 * (1 - np.arange(window + 1) / (window + 1))
    taper[0] = 1.0  # every other lag stands for itself and its negative
    kept = autocorrelation[: window + 1]
    tapered = np.sqrt(taper / n_frames)[:, None] * kept
    tapered = tapered.astype(float_type(values.shape[1]), copy=False)
    variance = tapered.T @ tapered  # a matrix by itself: symmetric to the last bit
    return np.maximum(variance, 1 / n_frames, out=variance)


def typical_variance(variance: ArrayLike) -> float:
    """Give the median of a variance over pairs of sensors, the diagonal aside.

    Of more than 4,000 sensors, it is that over the pairs of so many, evenly chosen.
    """
    values = np.asarray(variance)
    step = -(-len(values) // _ENOUGH)
    values = values[::step, ::step]
    pairs = values[np.triu_indices(len(values), 1)]
    return float(np.median(pairs if pairs.size else values))


def _autocorrelation(readings: NDArray[np.generic], longest: int) -> NDArray[np.float64]:
    """Autocorrelation at lags 0 to `longest`, shape (longest + 1, N); 0 of what never varies."""
    n_frames, n_sensors = readings.shape
    size = 1 << math.ceil(math.log2(n_frames + longest + 1))
    result = np.zeros((longest + 1, n_sensors))
    for start in range(0, n_sensors, _SENSORS_AT_ONCE):
        part = np.asarray(readings[:, start : start + _SENSORS_AT_ONCE], dtype=np.float64)
        part = part / np.maximum(np.abs(part).max(axis=0), np.finfo(np.float64).tiny)
        spectrum = np.fft.rfft(part - part.mean(axis=0), n=size, axis=0)
        products = np.fft.irfft(np.abs(spectrum) ** 2, n=size, axis=0)[: longest + 1]
        varies = np.ptp(part, axis=0) > 0
        result[:, start : start + part.shape[1]] = np.divide(
            products, products[0], out=np.zeros_like(products), where=varies
        )
    return result
