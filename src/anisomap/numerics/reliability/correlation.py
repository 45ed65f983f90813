"""How far correlations can be believed: how noisy they are, and whether they come again."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import rankdata

from anisomap.errors import InputError
from anisomap.numerics.precision import Reals, held_as
from anisomap.numerics.similarity.activity import estimate_rest
from anisomap.numerics.similarity.statistics import pearson

N_BLOCKS = 20
"""Stretches of time that a recording is cut into, to compare one half of them with the other."""

_LAG_SHARE = 4  # of the frames: autocorrelations of longer lags rest on too few
_LONGEST_LAG = 4096  # frames; a contact that lasts longer is no fleeting one
_SHORTEST_WINDOW = 10  # frames
_FADED = 0.1  # autocorrelation
_WINDOWS = 2.0  # the window is so many times the lag at which the autocorrelation has faded
_RELIANCE = 5.0
_CAUTION = 10.0
_SENSORS_AT_ONCE = 64
_FEWEST_FRAMES = 4
_FEWEST_SENSORS = 3
_ENOUGH = 4000  # sensors, to tell what pairs are like


def even_and_odd(n_frames: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Share the frames out into two halves of alternating stretches of time.

    Parameters
    ----------
    n_frames : int
        T >= 2.

    Returns
    -------
    even, odd : ndarray of int
        Frames of the blocks 0, 2, ... and 1, 3, ... of `N_BLOCKS` (fewer if T is smaller). The
        halves are nearly independent, where alternating frames would be nearly the same.
    """
    if n_frames < 2:
        raise InputError(f"{n_frames} frames have no halves; give 2 or more")
    blocks = np.array_split(np.arange(n_frames), min(N_BLOCKS, n_frames))
    return np.concatenate(blocks[::2]), np.concatenate(blocks[1::2])


def reliability(readings: ArrayLike) -> float:
    """Tell how well the correlations of one half of a recording predict those of the other.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings, T >= 4, N >= 3.

    Returns
    -------
    float
        Correlation over pairs of sensors of Pearson's r in the two halves of `even_and_odd`; in
        [-1, 1]. Of more than 4,000 sensors, evenly chosen ones are compared. 0 where all pairs are
        alike in a half, and where there are fewer than 4 frames or 3 sensors.
    """
    values = np.asarray(readings)
    if len(values) < _FEWEST_FRAMES or values.shape[1] < _FEWEST_SENSORS:
        return 0.0
    values = values[:, :: -(-values.shape[1] // _ENOUGH)]
    pairs = np.triu_indices(values.shape[1], 1)
    first, second = (pearson(values[half])[pairs] for half in even_and_odd(len(values)))
    if np.ptp(first) == 0 or np.ptp(second) == 0:
        return 0.0
    return float(np.corrcoef(first, second)[0, 1])


def blended_correlation(readings: ArrayLike) -> Reals:
    """Correlate readings where these can be relied on, and their ranks where they cannot.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.

    Returns
    -------
    ndarray of shape (N, N)
        ``w r + (1 - w) rho`` of Pearson's r and Spearman's rho: in [-1, 1], symmetric to the last
        bit, ones on the diagonal. Unchanged by a change of any sensor's unit or zero.

    Notes
    -----
    Pearson's r of a skin is ruled by few deep contacts: noisy in short recordings, but free of
    what ranks do to distances. Ranks are of depths beyond rest
    (`anisomap.numerics.similarity.activity.estimate_rest`), since those of a noisy rest are noise.
    With the
    reliabilities p of r and q of rho, ``1 - w = (1 - p^5) min(1, q / p)^10``: ranks are asked
    where r does not come again, unless they do so still less. The powers were chosen on simulated
    skins; 3 to 10 in place of 5 are about as good.
    """
    values = np.asarray(readings)
    ranks = rankdata(estimate_rest(values).depth(values), axis=0)
    of_values, of_ranks = max(reliability(values), 0.0), max(reliability(ranks), 0.0)
    steadier = 1.0 if of_ranks >= of_values else of_ranks / of_values
    weight = 1 - (1 - of_values**_RELIANCE) * steadier**_CAUTION
    blended, of_ranks_alone = pearson(values), pearson(ranks)
    blended *= weight
    of_ranks_alone *= 1 - weight
    blended += of_ranks_alone
    np.fill_diagonal(blended, 1.0)
    return blended


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
    tapered = tapered.astype(held_as(values.shape[1]), copy=False)
    variance = tapered.T @ tapered  # a matrix by itself: symmetric to the last bit
    return np.maximum(variance, 1 / n_frames, out=variance)


def typical_noise(variance: ArrayLike) -> float:
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
