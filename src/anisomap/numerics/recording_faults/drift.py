"""Drift: the reading at rest changes slowly, as in electronics that warm up."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

N_BLOCKS = 20
"""Blocks of frames whose levels at rest are compared; chosen by hand."""

FALSE_DISCOVERIES = 0.01
"""Expected share of the sensors that are found by chance."""

_MIN_BLOCK, _MAX_BLOCK = 20, 250  # frames of a block, and those that are used
_LEVEL = 25.0  # percentile that lies at rest even if a sensor is touched in most frames of a block
_MIN_SIZE = 0.1  # standard deviations of the readings; less changes no correlation; by hand
_MIN_REST = 0.3  # share of the frames at rest, for the level to be known; chosen by hand
_NOISE = 3.0  # standard deviations of the readings at rest
_N_ROUNDS, _MIN_NEAR = 3, 0.05  # of the running line, and its share of readings at rest
_MIN_SPREAD = 0.005  # variance of their times, in windows, for a slope; 1/12 in a full window
_MIN_WIDTH = 0.03  # of the same, so that a line fits a curve; chosen by hand
_MAX_WIDTH = 0.5  # of the noise at rest, in standard deviations of the readings; by hand
_WINDOW = 8  # times the time that readings stay alike, over which the level at rest is taken
_MIN_WINDOW = 41  # frames
_MAX_CORRELATED = 0.2  # autocorrelation at which readings count as unlike


@dataclass(frozen=True, eq=False)
class Drift:
    """Drifting sensors.

    sizes (n,): Range of the level at rest, in standard deviations of the readings without it.
    """

    sensors: NDArray[np.intp]
    sizes: NDArray[np.float64]


def find_drift(
    readings: NDArray[Any], chosen: NDArray[np.intp], side: NDArray[np.floating] | None = None
) -> Drift | None:
    """Find sensors whose level at rest drifts.

    readings (T, N), side (N,).

    The level at rest of a block is the quartile of its readings opposite to contact. Levels of
    independent blocks have a ratio of von Neumann, the mean square of successive differences over
    the variance, of 2 with a variance of 4 (n - 2) / (n^2 - 1), and less if they drift: von Neumann
    (1941), Annals of Mathematical Statistics 12: 367-395, doi:10.1214/aoms/1177731677. Sensors that
    one value occurs often in have no drift.
    """
    n_frames = len(readings)
    if n_frames < N_BLOCKS * _MIN_BLOCK or not chosen.size:
        return None
    signs = contact_side(readings[:, chosen]) if side is None else np.asarray(side)[chosen]
    size = n_frames // N_BLOCKS
    step = -(-size // _MAX_BLOCK)
    ratios, sizes = np.full(chosen.size, 2.0), np.zeros(chosen.size)
    for k, (i, sign) in enumerate(zip(chosen.tolist(), signs.tolist(), strict=True)):
        column = readings[: size * N_BLOCKS, i].astype(np.float64)
        values = np.sort(sign * column.reshape(N_BLOCKS, size)[:, ::step], axis=1)
        levels = values[:, round(_LEVEL / 100 * (values.shape[1] - 1))]
        left = math.sqrt(float(np.mean((values - levels[:, None]).var(axis=1))))
        if levels.std() >= _MIN_SIZE * left:
            ratios[k] = float(np.mean(np.diff(levels) ** 2)) / float(levels.var())
            sizes[k] = float(np.ptp(levels)) / max(left, 1e-300)
    deviations = (ratios - 2) / math.sqrt(4 * (N_BLOCKS - 2) / (N_BLOCKS**2 - 1))
    drifting = _least(ndtr(deviations))
    return Drift(chosen[drifting], sizes[drifting]) if drifting.any() else None


def remove_drift(readings: NDArray[Any], drift: Drift) -> NDArray[Any]:
    """Subtract the level at rest of drifting sensors from their readings.

    readings (T, N) -> (T, N).
    """
    mended = np.array(readings)
    signs = contact_side(readings[:, drift.sensors])
    for i, sign in zip(drift.sensors.tolist(), signs.tolist(), strict=True):
        values = sign * readings[:, i].astype(np.float64)
        level, noise = level_at_rest(values)
        left = values - level
        at_rest = np.abs(left) <= noise
        if np.mean(at_rest) >= _MIN_REST and np.median(noise) <= _MAX_WIDTH * left.std():
            mended[:, i] = sign * (np.where(at_rest, 0, left) + np.median(level))
    return mended


def level_at_rest(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the level at rest of a sensor and the width of its noise over time, shape (T,).

    Contact raises readings. The level is a running quartile, then a running line through the
    readings near it.
    """
    from scipy.ndimage import percentile_filter  # noqa: PLC0415, slow to import

    window = _window(values)
    level = percentile_filter(values, _LEVEL, size=window, mode="nearest")
    for _ in range(_N_ROUNDS):
        left = values - level
        level = _local_line(values, np.abs(left) <= _width_at_rest(left), window // 4 | 1, level)
    return level, _width_at_rest(values - level)


def _width_at_rest(left: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the width of the noise at rest over time, from the side that contact does not reach.

    It differs between blocks, since a level follows a fast drift less closely than a slow one.
    """
    blocks = np.array_split(left, N_BLOCKS)
    medians = [
        float(np.median(np.abs(block[block <= 0]))) if (block <= 0).any() else 0.0
        for block in blocks
    ]
    widths = np.maximum(_NOISE * np.array(medians) / 0.6745, _MIN_WIDTH * left.std())
    return np.repeat(widths, [block.size for block in blocks])


def _local_line(
    values: NDArray[np.float64], used: NDArray[np.bool_], window: int, instead: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Fit a line to the used values in a window about each frame, and return it at the frame.

    A mean would be biased at the ends of a recording, for all sensors alike.
    """
    times = (np.arange(values.size) - values.size / 2) / window
    weight = used.astype(np.float64)

    def mean(products: NDArray[np.float64]) -> NDArray[np.float64]:
        return _running_mean(products, window, "constant")

    total = mean(weight)
    safe = np.maximum(total, 1e-12)
    middle, level = mean(weight * times) / safe, mean(weight * values) / safe
    spread = mean(weight * times**2) / safe - middle**2
    slope = mean(weight * times * values) / safe - middle * level
    slope = np.where(spread > _MIN_SPREAD, slope / np.maximum(spread, _MIN_SPREAD), 0)
    share = total / mean(np.ones_like(weight))
    return np.where(share > _MIN_NEAR, level + slope * (times - middle), instead)


def contact_side(readings: NDArray[Any]) -> NDArray[np.float64]:
    """Return the sign of the skewness of fast changes from the median: 1 or -1, shape (N,)."""
    values = readings[:: -(-len(readings) // 4096)].astype(np.float32)
    window = max(3, len(values) // N_BLOCKS) | 1
    values = values - _running_mean(values, window)
    return np.where(np.einsum("ti,ti,ti->i", values, values, values) < 0, -1.0, 1.0)


def _running_mean(
    values: NDArray[Any], window: int, mode: Literal["nearest", "constant"] = "nearest"
) -> NDArray[Any]:
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415, slow to import

    return np.asarray(uniform_filter1d(values, window, axis=0, mode=mode))


def _window(values: NDArray[np.float64]) -> int:
    """Choose a window that is long compared to a contact and short compared to the recording."""
    longest = max(_MIN_WINDOW, len(values) // 10)
    slow = values - _running_mean(values, longest)
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
