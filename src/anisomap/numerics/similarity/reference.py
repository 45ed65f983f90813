"""Readings relative to the mean of all sensors, where they have no rest to refer to."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.similarity.correlation import scale_extremes
from anisomap.numerics.similarity.rest import estimate_rest

_MIN_SENSORS = 8  # of fewer, the mean is mostly each sensor's own reading; chosen by hand
_MAX_FRAMES = 4000  # evenly spaced, in which rest is searched; bounds the time
_MAX_SAMPLED = 128  # evenly spaced sensors in which rest is searched; bounds the time
_MIN_WITHOUT_REST = 0.5  # share of the sensors: most of them

_TINY = 1e-12  # variance that is rounding error

_MAX_UNEVENNESS = 0.012
"""Increase of the variance of log amplitudes up to which the mean is subtracted.

It was at most .008 with noise or hum that all sensors of a skin share (``make trust``, seeds 6, 8
and 28), and at least .015 in most random fields about as wide as the array (seeds 1 to 4).
"""

_COMMON_SLOPE = -0.25
"""Slope of log amplitudes over the log of what remains, below which the mean is subtracted.

It is -1 if a shared signal alone makes amplitudes unequal, and 0 if they are equal. It was at most
-.33 in simulated EEGs with unequal amplitudes (seeds 1 to 20), and at least -.18 in these fields.
"""


def refer_to_mean(readings: NDArray[Any]) -> NDArray[Any]:
    """Subtract the mean of all sensors from readings without rest.

    Parameters
    ----------
    readings : ndarray of shape (T, N)
        Finite.

    Returns
    -------
    ndarray of shape (T, N)
        The readings themselves if most sensors have a rest value, if there are fewer than 8
        sensors, or if the mean is part of a field that is wider than the array. Otherwise each
        sensor's deviations from its mean, less the mean deviation of all sensors, where
        deviations are in units of each sensor's standard deviation.

    Notes
    -----
    Contacts start from rest, so that readings beyond rest are those of contacts alone. Readings
    without rest, such as potentials, are differences to a reference: another electrode, a supply
    or a hum. The reference is a signal that all sensors share; near a reference electrode, little
    is left but noise, and far from it, all sensors are alike. Correlations then depend on the
    place of the reference. The mean of all sensors is a reference without a place: Offner (1950),
    Electroencephalography and Clinical Neurophysiology 2: 213-214; Bertrand, Perrin & Pernier
    (1985), ibid. 62: 462-464.

    If the field is stationary, sensors have equal amplitudes in the right reference. A signal that
    all share makes them unequal; then the largest lose most with the mean. Of a field about as wide
    as the array, the mean takes more from the middle than from the edges: amplitudes become less
    equal, and the mean is not subtracted. Amplitudes are compared in the unit of the readings,
    which sensors should share.
    """
    n_sensors = readings.shape[1]
    if n_sensors < _MIN_SENSORS or not _lack_rest(readings):
        return readings
    values = scale_extremes(readings).astype(np.float64)
    values -= values.mean(axis=0)
    amplitude = values.std(axis=0)
    varies = amplitude > 0
    values /= np.where(varies, amplitude, 1.0)
    values -= values.mean(axis=1)[:, None]
    left = values.std(axis=0)
    if np.count_nonzero(varies) < _MIN_SENSORS or not (left > 0).all():
        return readings
    before, remaining = np.log(amplitude[varies]), np.log(left[varies])
    increase = float((before + remaining).var() - before.var())
    slope = (increase / max(float(remaining.var()), _TINY) - 1) / 2
    if increase > _MAX_UNEVENNESS and slope > _COMMON_SLOPE:
        return readings
    return np.asarray(values * np.where(varies, amplitude, 0.0))


def _lack_rest(readings: NDArray[Any]) -> bool:
    """Whether most sensors have no rest value."""
    n_frames, n_sensors = readings.shape
    some = readings[:: -(-n_frames // _MAX_FRAMES), :: -(-n_sensors // _MAX_SAMPLED)]
    known = estimate_rest(some).known
    return bool(np.count_nonzero(~known) > _MIN_WITHOUT_REST * known.size)
