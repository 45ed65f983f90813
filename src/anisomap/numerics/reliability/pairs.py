"""Sensors that pair off, as those do whose places are always touched together."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

_MIN_SENSORS = 8
_MIN_GAP, _MIN_MUTUAL = 0.25, 0.7
_GREATEST = 0.999  # correlations above it are not told apart


def sensors_pair_off(similarity: ArrayLike) -> bool:
    """Return whether most sensors resemble one other, and it them, far more than the next one.

    similarity (N, N): Correlations.

    The limits are a median difference of .25 in Fisher's z, and 70 % of sensors whose most similar
    sensor has them as its own. Sensors of a skin have several neighbours at nearly equal distances.
    If a body touches itself at mirrored places, each sensor has a twin besides, which the readings
    place beside it: of 19 such recordings, 8 exceed both limits, and none of 128 others with good
    maps. Where no sensor is at the mirrored place, nothing shows.
    """
    found = np.array(similarity, dtype=np.float64)
    if len(found) < _MIN_SENSORS:
        return False
    np.fill_diagonal(found, -1)
    nearest = found.argmax(axis=1)
    mutual = float(np.mean(nearest[nearest] == np.arange(len(found))))
    second, first = np.sort(found, axis=1)[:, -2:].T
    gap = np.diff(np.arctanh(np.clip([second, first], -_GREATEST, _GREATEST)), axis=0)
    return mutual > _MIN_MUTUAL and float(np.median(gap)) > _MIN_GAP
