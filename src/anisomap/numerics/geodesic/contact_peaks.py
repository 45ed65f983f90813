"""Link lengths estimated from the heights of contact peaks."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.columns import columns, mean_ranks
from anisomap.numerics.similarity.rest import estimate_rest

MIN_PEAKS = 8
"""Minimum number of matched peaks from which a length is estimated; chosen by hand."""

_CONTACT_THRESHOLD = 0.1  # of a sensor's range; separates contacts from tremor. Chosen by hand
_RANGE_QUANTILE = 0.995  # top of the range; excludes outliers. Chosen by hand
_MIN_DIFFERENCE = 0.05  # of 1 - rho; keeps lengths above 0. Chosen by hand


def contact_peaks(raised: ArrayLike) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Find the peak of each contact of one sensor.

    Parameters
    ----------
    raised : array_like of shape (T,)
        Reading relative to rest, positive under contact, in any unit.

    Returns
    -------
    frames : ndarray of int, shape (n,)
        Frame of each peak, increasing. A contact is a run of frames in which the reading exceeds
        rest by more than a tenth of its range.
    heights : ndarray of shape (n,)
        Readings at the peaks.
    """
    frames, heights, _ = contacts_of(raised)
    return frames, heights


def contacts_of(
    raised: ArrayLike,
) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.intp]]:
    """Find the peak of each contact of one sensor, and its number of frames.

    Parameters
    ----------
    raised : array_like of shape (T,)
        See `contact_peaks`.

    Returns
    -------
    frames, heights
        See `contact_peaks`.
    durations : ndarray of int, shape (n,)
    """
    values = np.asarray(raised, dtype=np.float64)
    touched, begins = _contacts(values)
    durations = np.diff(begins, append=touched.size)
    heights = np.maximum.reduceat(values[touched], begins) if begins.size else np.empty(0)
    contact = np.repeat(np.arange(begins.size), durations)
    highest = np.flatnonzero(values[touched] == heights[contact])
    first = np.searchsorted(contact[highest], np.arange(begins.size))
    return touched[highest[first]], heights, np.asarray(durations)


def _contacts(values: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the frames of all contacts, and the index of the first frame of each among them."""
    level = _CONTACT_THRESHOLD * _top(values)
    touched = np.flatnonzero(values > level)
    return touched, np.flatnonzero(np.diff(touched, prepend=-2) > 1)


def _top(values: NDArray[np.float64]) -> float:
    """Return the top of the range of values: their `_RANGE_QUANTILE`, but at least 0."""
    positive = values[values > 0]
    place = _RANGE_QUANTILE * (values.size - 1) - (values.size - positive.size)
    if place < 0:  # next to the values that are not positive
        return max(float(np.quantile(values, _RANGE_QUANTILE)), 0.0)
    below = int(place)
    above = min(below + 1, positive.size - 1)
    low, high = np.partition(positive, (below, above))[[below, above]]
    return float(low + (place - below) * (high - low))


def peak_lengths(readings: ArrayLike, adjacency: ArrayLike) -> NDArray[np.float64]:
    """Estimate the lengths of links from the differences between contact peaks.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings in temporal order.
    adjacency : array_like of bool, shape (N, N)
        Neighbours; symmetric.

    Returns
    -------
    ndarray of shape (N, N)
        Symmetric, above 0 between neighbours, in arbitrary units; NaN for other pairs, and where
        fewer than `MIN_PEAKS` peaks match or all matched peaks are equally high.

    Raises
    ------
    InputError
        If shapes disagree.

    Notes
    -----
    ``(1 - rho_ij)^(1/2)`` with Spearman's rho of the heights of those peaks of i and j that are
    mutually nearest in time: the root of a variogram (Matheron 1963, Economic Geology 58:
    1246-1266) of the ground. On a rolling body, i and j touch the ground in one frame (along the
    axis) or some frames apart (around it), and the heights of their peaks differ as much as the
    ground over that distance. Lengths in both directions are therefore comparable if the ground,
    or any other object that touches the skin, is isotropic. Beyond the correlation length of the
    ground, rho is 0 and distances are indistinguishable.
    """
    values = np.asarray(readings, dtype=np.float64)
    mask = np.asarray(adjacency, dtype=bool)
    if values.ndim != 2 or mask.shape != (values.shape[1],) * 2:
        raise InputError(
            f"the adjacency matrix of shape {mask.shape} does not fit readings of shape "
            f"{values.shape}"
        )
    rest = estimate_rest(values)
    peaks = [
        contact_peaks(side * (column - value))
        for column, value, side in zip(columns(values), rest.value, rest.side, strict=True)
    ]
    lengths = np.full(mask.shape, np.nan)
    for i, j in np.argwhere(np.triu(mask, 1)):
        lengths[i, j] = lengths[j, i] = _peak_difference(*peaks[i], *peaks[j])
    return lengths


def _peak_difference(
    frames: NDArray[np.intp],
    heights: NDArray[np.float64],
    other_frames: NDArray[np.intp],
    other_heights: NDArray[np.float64],
) -> float:
    if min(len(frames), len(other_frames)) < MIN_PEAKS:
        return np.nan
    match = _nearest(frames, other_frames)
    mutual = _nearest(other_frames, frames)[match] == np.arange(len(frames))
    first, second = heights[mutual], other_heights[match[mutual]]
    if len(first) < MIN_PEAKS or np.ptp(first) == 0 or np.ptp(second) == 0:
        return np.nan
    rho = np.corrcoef(mean_ranks(first), mean_ranks(second))[0, 1]
    return float(np.sqrt(max(1 - rho, _MIN_DIFFERENCE)))


def _nearest(frames: NDArray[np.intp], among: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the index in `among` of the frame nearest to each of `frames`."""
    return np.asarray(np.searchsorted((among[1:] + among[:-1]) / 2, frames))
