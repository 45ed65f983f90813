"""Which of many sensors differ from the others, at a stated rate of false alarms."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

FALSE_ALARMS = 0.05
"""Expected number of healthy sensors of a recording that are outlying, and at most one in 1,000."""

_LEAST_SPREAD = 0.4  # of the logarithms of levels: sensors of one skin differ by a factor of 1.5
_MIN_SENSORS = 8  # from which a distribution is fitted
_NORMAL_MAD = 0.6745  # median absolute deviation of a normal distribution


def outlying(levels: NDArray[np.float64], variance: ArrayLike = 0.0) -> NDArray[np.bool_]:
    """Return whether each of n positive levels is too high among the others, (n,).

    variance: Sampling variance of the logarithm of each level.

    Logarithms of the levels of healthy sensors are normal, with the median and the median absolute
    deviation of all.
    """
    if len(levels) < _MIN_SENSORS:
        return np.zeros(len(levels), dtype=bool)
    logarithm = np.log(levels)
    beyond = logarithm - np.median(logarithm)
    spread = max(float(np.median(np.abs(beyond))) / _NORMAL_MAD, _LEAST_SPREAD)
    deviation = np.sqrt(spread**2 + np.asarray(variance))
    return np.asarray(ndtr(-beyond / deviation) < min(1e-3, FALSE_ALARMS / len(levels)))
