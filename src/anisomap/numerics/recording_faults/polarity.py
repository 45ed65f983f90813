"""Inverted sensors: contact lowers their readings, while it raises those of the others."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.recording_faults.excerpt import MAX_FRAMES, standardised

_MIN_SKEWNESS = 0.5  # magnitude of the skewness of sensors that are touched now and then; by hand
_MIN_SHARE = 0.8  # of the sensors that must be skewed so; chosen by hand
_MIN_AGREEMENT = 0.9  # share of the strongest correlations whose sign must be explained; by hand
_N_PARTNERS = 4
_MIN_CORRELATION = 0.2  # magnitude of correlations whose sign counts; chosen by hand


def find_inverted(readings: NDArray[Any]) -> NDArray[np.intp]:
    """Find sensors on which contact has the opposite sign.

    Parameters
    ----------
    readings : ndarray of shape (T, N)
        Finite.

    Returns
    -------
    ndarray of int
        Indices of the sensors: the smaller part, or, of equal parts, those that contact lowers.

    Notes
    -----
    Sensors are at rest most of the time, so contact skews readings to its own side. Sensors of
    both signs are a finding only if correlations agree: the signs of the strongest correlations must
    be negative between the two parts, and positive within them. Readings that are not skewed,
    such as those of sensors that are always in contact, are not judged.
    """
    step = max(1, len(readings) // (4 * MAX_FRAMES))
    values = standardised(readings[::step])
    varying = values.any(axis=0)
    if np.count_nonzero(varying) < 3:
        return np.empty(0, dtype=np.intp)
    skewness = np.einsum("ti,ti,ti->i", values, values, values) / len(values)
    clear = np.abs(skewness) >= _MIN_SKEWNESS
    if np.mean(clear[varying]) < _MIN_SHARE:
        return np.empty(0, dtype=np.intp)
    negative = np.flatnonzero(clear & (skewness < 0))
    positive = np.flatnonzero(clear & (skewness > 0))
    suspects = negative if negative.size <= positive.size else positive
    if not suspects.size:
        return suspects
    others = np.flatnonzero(clear)
    correlation = values[:, suspects].T @ values[:, others] / len(values)
    correlation[suspects[:, None] == others] = 0
    count = min(_N_PARTNERS, others.size - 1)
    strongest = np.argpartition(-np.abs(correlation), count - 1, axis=1)[:, :count]
    r = np.take_along_axis(correlation, strongest, axis=1)
    same = np.isin(others, suspects)[strongest]
    counted = np.abs(r) >= _MIN_CORRELATION
    explained = counted & ((r > 0) == same)
    # A touched sensor can correlate negatively with distant ones, but less than with neighbours.
    confirmed = explained.sum(axis=1) >= _MIN_AGREEMENT * np.maximum(1, counted.sum(axis=1))
    confirmed &= explained[:, :1].any(axis=1) | (explained.sum(axis=1) > 0)
    return np.asarray(suspects[confirmed])
