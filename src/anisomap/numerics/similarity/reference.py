"""Readings without the signal that all sensors share."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.precision import Reals
from anisomap.numerics.similarity.correlation import pearson, scale_extremes

_MIN_SENSORS = 8  # of fewer, the mean is mostly each sensor's own reading; chosen by hand
_APART = 0.25  # share of the pairs that are taken for distant
_MAX_FRAMES, _MAX_SAMPLED = 4000, 250  # evenly spaced, that show the common signal


def common_share(correlation: Reals) -> float:
    """Return how much of the variance of the mean over sensors is a common signal, in [0, 1].

    correlation (N, N).

    The mean over N standardised sensors has the variance ``mean(r)``, over all pairs. If all share
    a signal of variance c, and other signals are local, distant pairs have the correlation c. The
    lower quartile of r estimates it, since contacts as wide as half of the skin leave a quarter of
    the pairs apart; the share is ``c / mean(r)``.
    """
    if len(correlation) < _MIN_SENSORS:
        return 0.0
    mean = float(correlation.mean(dtype=np.float64))
    apart = float(np.quantile(correlation[np.triu_indices(len(correlation), 1)], _APART))
    return min(1.0, apart / mean) if apart > 0 else 0.0


def without_common_signal(readings: NDArray[Any]) -> tuple[NDArray[Any], float]:
    """Return readings less the signal that all sensors share, shape (T, N), and its share.

    Potentials are differences to a reference, and loads on soft ground rise together: all sensors
    share a signal, and correlations depend on places only beyond it. The mean over sensors
    estimates the signal, and is subtracted with the weight ``sqrt(s)``, the share of its amplitude,
    with s from `common_share`. With a weight of 1, it is the average reference of
    electroencephalography: Offner (1950), Electroencephalography and Clinical Neurophysiology 2:
    213-214; Bertrand, Perrin & Pernier (1985), ibid. 62: 462-464. From a sensor that contains less
    of the mean than others do, such as one at the edge of a sole, only what it contains is
    subtracted, by linear regression: otherwise all such sensors would share its negative. Where
    contacts are local, most pairs are uncorrelated, the share is 0, and the readings themselves are
    returned.
    """
    n_frames, n_sensors = readings.shape
    some = readings[:: -(-n_frames // _MAX_FRAMES), :: -(-n_sensors // _MAX_SAMPLED)]
    varying = some[:, (some != some[0]).any(axis=0)]
    share = common_share(pearson(varying)) if varying.shape[1] >= _MIN_SENSORS else 0.0
    if share == 0:
        return readings, 0.0
    values = scale_extremes(readings).astype(np.float64)
    values -= values.mean(axis=0)
    amplitude = values.std(axis=0)
    varies = amplitude > 0
    mean = (values[:, varies] / amplitude[varies]).mean(axis=1)
    size = max(float(mean @ mean), np.finfo(float).tiny)
    own = np.clip(mean @ values / np.where(varies, amplitude, 1) / size, 0, 1)
    values -= math.sqrt(share) * mean[:, None] * (own * amplitude)
    return values, share
