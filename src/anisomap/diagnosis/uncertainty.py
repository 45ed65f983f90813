"""Covariance of the position of every sensor, from maps of resampled recordings."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.evaluation.neighbourhood import median_spacing
from anisomap.numerics.procrustes import fit_similarity

INFLATION = 1.5
"""Ratio of the covariances to the mean squared differences of maps of resamples.

Covariances of few resamples are uncertain, as in Student's distribution. Tuned such that 95 % of
the positions are inside their ellipses: 12 recordings of 1,000 frames of each of five simulated
skins, seeds 201 to 212.
"""

_ALIGNMENTS = 4  # rounds of alignment to the mean of all maps; more change nothing visible
_N_POOLED = 8  # nearest sensors over which covariances are pooled; 20 hold equally many positions


def covariances(
    maps: NDArray[np.float64], positions: NDArray[np.float64], step: float = 1.0
) -> NDArray[np.float64]:
    """Estimate the covariance of every position from maps of resampled recordings.

    Parameters
    ----------
    maps : ndarray of shape (R, n, k)
        R >= 2 maps in any frames and units.
    positions : ndarray of shape (n, k)
        The map whose covariances are wanted.
    step : float
        Ratio of the differences between the maps to those between independent recordings.

    Returns
    -------
    ndarray of shape (n, k, k)
        In the frame and the squared unit of `positions`.

    Notes
    -----
    The covariance of R maps is uncertain itself. Returned is `INFLATION` times the mean of three:
    that of the sensor, the mean of those of its 8 nearest sensors, and the sphere as large as the
    latter. Differences from the mean of the maps count, not from the given map: resamples have more
    noise than the recording, which shifts all of them alike.
    """
    aligned = aligned_to_mean(maps)
    mean = aligned.mean(axis=0)
    fit = fit_similarity(mean, positions)
    deviations = (fit.scale / step) * (aligned - mean) @ fit.rotation.T
    own = np.einsum("rni,rnj->nij", deviations, deviations) / (len(maps) - 1)
    nearest = KDTree(positions).query(positions, k=min(_N_POOLED, len(positions)))[1]
    pooled = own[np.asarray(nearest)].mean(axis=1)
    dimensions = positions.shape[1]
    sphere = np.trace(pooled, axis1=1, axis2=2)[:, None, None] / dimensions * np.eye(dimensions)
    return np.asarray(INFLATION * (own + pooled + sphere) / 3)


def aligned_to_mean(maps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Align maps of the same sensors with their mean, such that uncertain sensors count less.

    Parameters
    ----------
    maps : ndarray of shape (R, n, k)

    Returns
    -------
    ndarray of shape (R, n, k)
        About in the frame and the unit of the first map.

    Notes
    -----
    Generalised Procrustes analysis (Gower 1975, doi:10.1007/BF02291478), in which a sensor of
    variance v has the weight ``1 / (v + median v)``, so that sensors whose positions are hardly
    known do not turn the maps.
    """
    mean, weights = maps[0], np.ones(maps.shape[1])
    aligned = maps
    for _ in range(_ALIGNMENTS):
        aligned = np.array([fit_similarity(one, mean, weights).apply(one) for one in maps])
        mean = aligned.mean(axis=0)
        variance = np.square(aligned - mean).sum(axis=2).mean(axis=0)
        typical = float(np.median(variance))
        if typical == 0:
            break
        weights = 1 / (variance + typical)
    return aligned


def error_in_spacings(found: NDArray[np.float64], positions: NDArray[np.float64]) -> float:
    """Return the RMS error that goes with `covariances`, in spacings of the map.

    Parameters
    ----------
    found : ndarray of shape (n, k, k)
        From `covariances`.
    positions : ndarray of shape (n, k)

    Returns
    -------
    float
        Infinite if most sensors coincide with another one.
    """
    spacing = median_spacing(positions)
    mean = float(np.trace(found, axis1=1, axis2=2).mean()) / INFLATION
    return math.sqrt(mean) / spacing if spacing > 0 else math.inf


def departure_in_spacings(reference: NDArray[np.float64], positions: NDArray[np.float64]) -> float:
    """Return the RMS difference of two maps after the best similarity, in spacings of the second.

    Parameters
    ----------
    reference, positions : ndarray of shape (n, k)

    Returns
    -------
    float
        Infinite if most sensors coincide with another one.
    """
    spacing = median_spacing(positions)
    moved = fit_similarity(reference, positions).apply(reference) - positions
    rms = math.sqrt(float(np.square(moved).sum(axis=1).mean()))
    return rms / spacing if spacing > 0 else math.inf
