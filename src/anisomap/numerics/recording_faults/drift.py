"""Drift: the reading at rest changes slowly, as in electronics that warm up."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import percentile_filter, uniform_filter1d
from scipy.special import ndtr

from anisomap.numerics.recording_faults.common_mode import never_at_rest
from anisomap.numerics.recording_faults.excerpt import deviation_from_median

N_BLOCKS = 20
"""Blocks of frames whose levels at rest are compared; chosen by hand."""

FALSE_DISCOVERIES = 0.01
"""Expected share of the sensors that are found by chance."""

_MIN_BLOCK, _MAX_BLOCK = 20, 250  # frames of a block, and those that are used
_LEVEL = 25.0  # percentile that lies at rest even if a sensor is touched in most frames of a block
_MIN_SIZE = 0.1  # standard deviations of the readings; less changes no correlation; by hand
_WINDOW = 8  # times the time that readings stay alike, over which the level at rest is taken
_MIN_WINDOW = 41  # frames
_MAX_CORRELATED = 0.2  # autocorrelation at which readings count as unlike


@dataclass(frozen=True, eq=False)
class Drift:
    """Drifting sensors.

    Attributes
    ----------
    sensors : ndarray of int, shape (n,)
    sizes : ndarray of shape (n,)
        Range of the level at rest, in standard deviations of the readings without it.
    """

    sensors: NDArray[np.intp]
    sizes: NDArray[np.float64]


def find_drift(readings: NDArray[Any], side: NDArray[np.floating] | None = None) -> Drift | None:
    """Find sensors whose level at rest drifts.

    Parameters
    ----------
    readings : ndarray of shape (T, N)
        Finite.
    side : ndarray of shape (N,), optional
        1 where contact raises readings, -1 where it lowers them; by default by the skewness.

    Returns
    -------
    Drift or None

    Notes
    -----
    The level at rest of a block is the quartile of its readings opposite to contact. Levels of
    independent blocks have a ratio of von Neumann, the mean square of successive differences over
    the variance, of 2 with a variance of 4 (n - 2) / (n^2 - 1), and less if they drift: von Neumann
    (1941), Annals of Mathematical Statistics 12: 367-395, doi:10.1214/aoms/1177731677. Sensors that
    one value occurs often in have no drift.
    """
    n_frames = len(readings)
    chosen = never_at_rest(readings)
    if n_frames < N_BLOCKS * _MIN_BLOCK or not chosen.size:
        return None
    signs = contact_side(readings[:, chosen]) if side is None else np.asarray(side)[chosen]
    size = n_frames // N_BLOCKS
    step = -(-size // _MAX_BLOCK)
    ratios, sizes = np.full(chosen.size, 2.0), np.zeros(chosen.size)
    for k, (i, sign) in enumerate(zip(chosen.tolist(), signs.tolist(), strict=True)):
        column = readings[: size * N_BLOCKS, i].astype(np.float64)
        values = sign * column.reshape(N_BLOCKS, size)[:, ::step]
        levels = np.percentile(values, _LEVEL, axis=1)
        left = math.sqrt(float(np.mean((values - levels[:, None]).var(axis=1))))
        if levels.std() >= _MIN_SIZE * left:
            ratios[k] = float(np.mean(np.diff(levels) ** 2)) / float(levels.var())
            sizes[k] = float(np.ptp(levels)) / max(left, 1e-300)
    deviations = (ratios - 2) / math.sqrt(4 * (N_BLOCKS - 2) / (N_BLOCKS**2 - 1))
    drifting = _least(ndtr(deviations))
    return Drift(chosen[drifting], sizes[drifting]) if drifting.any() else None


def remove_drift(readings: NDArray[Any], drift: Drift) -> NDArray[Any]:
    """Subtract the level at rest of drifting sensors from their readings.

    Parameters
    ----------
    readings : ndarray of shape (T, N)
        Finite.
    drift : Drift
        From `find_drift`.

    Returns
    -------
    ndarray of shape (T, N)
        The drifting sensors are at rest at their median level before.
    """
    mended = np.array(readings)
    signs = contact_side(readings[:, drift.sensors])
    for i, sign in zip(drift.sensors.tolist(), signs.tolist(), strict=True):
        values = sign * readings[:, i].astype(np.float64)
        level = level_at_rest(values)
        mended[:, i] = sign * (values - level + np.median(level))
    return mended


def level_at_rest(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the level at rest of a sensor over time, shape (T,); contact raises its readings.

    The level is a running quartile, then a running mean of the readings near it.
    """
    window = _window(values)
    level = percentile_filter(values, _LEVEL, size=window, mode="nearest")
    for _ in range(3):
        left = values - level
        noise = 3 * float(np.median(np.abs(np.minimum(left, 0))[left <= 0])) / 0.6745
        near = (
            np.abs(left) <= max(noise, float(deviation_from_median(left[:, None])[0]) * 0.1)
        ).astype(float)
        weight = uniform_filter1d(near, window // 4 | 1, mode="nearest")
        mean = uniform_filter1d(near * values, window // 4 | 1, mode="nearest")
        level = np.where(weight > 0.05, mean / np.maximum(weight, 1e-12), level)
    return np.asarray(level)


def contact_side(readings: NDArray[Any]) -> NDArray[np.float64]:
    """Return the sign of the skewness of fast changes from the median: 1 or -1, shape (N,)."""
    values = readings[:: -(-len(readings) // 4096)].astype(np.float32)
    window = max(3, len(values) // N_BLOCKS) | 1
    values = values - uniform_filter1d(values, window, axis=0, mode="nearest")
    return np.where((values**3).sum(axis=0) < 0, -1.0, 1.0)


def _window(values: NDArray[np.float64]) -> int:
    """Choose a window that is long compared to a contact and short compared to the recording."""
    longest = max(_MIN_WINDOW, len(values) // 10)
    slow = values - uniform_filter1d(values, longest, mode="nearest")
    spectrum = np.abs(np.fft.rfft(slow, 2 * len(slow))) ** 2
    correlation = np.fft.irfft(spectrum)[: len(slow)]
    unlike = np.flatnonzero(correlation < _MAX_CORRELATED * correlation[0])
    time = int(unlike[0]) if unlike.size else longest
    return int(np.clip(_WINDOW * time, _MIN_WINDOW, longest)) | 1


def _least(probabilities: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Select probabilities so that a share of `FALSE_DISCOVERIES` of them are by chance.

    Benjamini & Hochberg (1995), Journal of the Royal Statistical Society B 57: 289-300,
    doi:10.1111/j.2517-6161.1995.tb02031.x.
    """
    ordered = np.sort(probabilities)
    limits = FALSE_DISCOVERIES * np.arange(1, ordered.size + 1) / ordered.size
    below = np.flatnonzero(ordered <= limits)
    return np.asarray(probabilities <= (limits[below[-1]] if below.size else -1.0))
