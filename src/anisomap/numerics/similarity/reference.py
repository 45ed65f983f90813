"""Correlations without the signal that all sensors share."""

from __future__ import annotations

import numpy as np

from anisomap.numerics.precision import Reals, mirror

_MIN_SENSORS = 8  # of fewer, the mean is mostly each sensor's own reading; chosen by hand
_APART = 0.25  # share of the pairs that are taken for distant
_TINY = 1e-9  # variance that is rounding error


def common_share(correlation: Reals) -> float:
    """Return how much of the mean over sensors is a signal that all share, in [0, 1].

    correlation (N, N).

    The mean over N standardised sensors has the variance ``mean(r)``, over all pairs. If all share
    a signal of variance c, and other signals are local, distant pairs have the correlation c. The
    lower quartile of r estimates it, since contacts as wide as half of the skin leave a quarter of
    the pairs apart; the share is ``c / mean(r)``.
    """
    n_sensors = len(correlation)
    if n_sensors < _MIN_SENSORS:
        return 0.0
    mean = float(correlation.mean(dtype=np.float64))
    apart = float(np.quantile(correlation[np.triu_indices(n_sensors, 1)], _APART))
    return min(1.0, apart / mean) if apart > 0 else 0.0


def without_common_signal(correlation: Reals) -> Reals:
    """Return the correlations of sensors less the signal that all share, shape (N, N).

    Potentials are differences to a reference, and loads on soft ground rise together: all sensors
    share a signal, and correlations depend on places only beyond it. The mean over sensors
    estimates the signal, and is subtracted with the weight g of `common_share`: ``H r H``,
    normalised, with ``H = I - g 11' / N``. With g = 1, it is the average reference of
    electroencephalography: Offner (1950), Electroencephalography and Clinical Neurophysiology 2:
    213-214; Bertrand, Perrin & Pernier (1985), ibid. 62: 462-464. Where contacts are local, most
    pairs are uncorrelated, and g is 0.
    """
    share = common_share(correlation)
    if share == 0:
        return correlation
    with_mean = correlation.mean(axis=1, dtype=np.float64)
    left = correlation - share * (with_mean[:, None] + with_mean) + share**2 * with_mean.mean()
    deviations = np.sqrt(np.maximum(np.diag(left), _TINY))
    left /= deviations[:, None] * deviations
    np.clip(left, -1, 1, out=left)
    np.fill_diagonal(left, 1.0)
    mirror(left, upper=True)
    return np.asarray(left, correlation.dtype)
