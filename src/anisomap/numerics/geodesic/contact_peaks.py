"""How far apart neighbours are, told from the heights of the contacts that pass over them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import rankdata

from anisomap.errors import InputError
from anisomap.numerics.similarity.rest import estimate_rest

FEWEST_PASSES = 8
"""Passes that two sensors must have in common for their heights to tell anything."""

_CONTACT = 0.1  # of a sensor's range; less is no contact but a tremor
_RANGE = 0.995  # quantile that counts as the top of the range: the deepest readings are outliers
_LEAST_DIFFERENCE = 0.05  # of 1 - rho: heights are never so alike that sensors coincide


def contact_peaks(raised: ArrayLike) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Find when the contacts of one sensor were at their highest, and how high.

    Parameters
    ----------
    raised : array_like of shape (T,)
        How far beyond rest the sensor is, in any unit.

    Returns
    -------
    frames : ndarray of int, shape (n,)
        Rising. A contact is a run of frames in which the sensor is beyond rest by more than a
        tenth of its range.
    heights : ndarray of shape (n,)
    """
    values = np.asarray(raised, dtype=np.float64)
    level = _CONTACT * max(float(np.quantile(values, _RANGE)), 0.0)
    touched = np.concatenate([[False], values > level, [False]])
    turns = np.flatnonzero(touched[1:] != touched[:-1])
    runs = zip(turns[::2].tolist(), turns[1::2].tolist(), strict=True)
    frames = np.array([first + values[first:end].argmax() for first, end in runs], dtype=np.intp)
    return frames, values[frames]


def pass_lengths(readings: ArrayLike, joined: ArrayLike) -> NDArray[np.float64]:
    """Give the distance of neighbours as the difference between the contacts that pass over both.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings in the order of time.
    joined : array_like of bool, shape (N, N)
        Who is whose neighbour; symmetric.

    Returns
    -------
    ndarray of shape (N, N)
        Symmetric, above 0 between neighbours, in a unit of its own; NaN where fewer than
        `FEWEST_PASSES` can be compared, or all are equally high, and between all others.

    Raises
    ------
    InputError
        If shapes disagree.

    Notes
    -----
    ``(1 - rho_ij)^(1/2)`` with Spearman's rho of the heights of those contacts of i and j that are
    each other's nearest in time: the root of a variogram (Matheron 1963, Economic Geology 58:
    1246-1266) of the ground. A body that rolls meets the same ground at i and at j in one frame
    (along its axis) or some frames apart (around it). Either way heights differ as the ground does
    over that distance; so lengths in both directions are comparable if the ground, or whatever
    touches the skin, is equally rough in both. Beyond the ground's correlation length rho is 0 and
    all distances look alike.
    """
    values = np.asarray(readings, dtype=np.float64)
    mask = np.asarray(joined, dtype=bool)
    if values.ndim != 2 or mask.shape != (values.shape[1],) * 2:
        raise InputError(f"neighbours {mask.shape} do not fit readings of shape {values.shape}")
    rest = estimate_rest(values)
    peaks = [contact_peaks(column) for column in (rest.side * (values - rest.value)).T]
    lengths = np.full(mask.shape, np.nan)
    for i, j in np.argwhere(np.triu(mask, 1)):
        lengths[i, j] = lengths[j, i] = _difference(*peaks[i], *peaks[j])
    return lengths


def _difference(
    frames: NDArray[np.intp],
    heights: NDArray[np.float64],
    other_frames: NDArray[np.intp],
    other_heights: NDArray[np.float64],
) -> float:
    if min(len(frames), len(other_frames)) < FEWEST_PASSES:
        return np.nan
    match = _nearest(frames, other_frames)
    mutual = _nearest(other_frames, frames)[match] == np.arange(len(frames))
    first, second = heights[mutual], other_heights[match[mutual]]
    if len(first) < FEWEST_PASSES or np.ptp(first) == 0 or np.ptp(second) == 0:
        return np.nan
    rho = np.corrcoef(rankdata(first), rankdata(second))[0, 1]
    return float(np.sqrt(max(1 - rho, _LEAST_DIFFERENCE)))


def _nearest(frames: NDArray[np.intp], among: NDArray[np.intp]) -> NDArray[np.intp]:
    return np.asarray(np.searchsorted((among[1:] + among[:-1]) / 2, frames))
