"""Sensors of unlike response: linear ones and radial basis functions of the same quantity."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.similarity.correlation import pearson
from anisomap.numerics.similarity.information import mutual_information
from anisomap.paper.experiment import Row
from anisomap.paper.map_scores import map_and_score
from anisomap.recording import Recording

MEDIAN = 0.5
"""Quantile of the contact readings at which the claim is tested: the middle of the response."""

CLAIMED_NOISE = 0.1
"""Noise of each sensor with which the claim is tested."""

_TRIALS = ((0.25, 0.0), (MEDIAN, 0.0), (1.0, 0.0), (MEDIAN, CLAIMED_NOISE))  # quantile, noise
_WIDTH = 0.5  # standard deviation of the basis function, relative to the optimum: 14 % at rest
_SIMILARITIES = {"r-anisomap": pearson, "i-anisomap": mutual_information}

RESPONSE_COLUMNS = {
    "run": "body and scenario",
    "seed": "seed of the run",
    "optimum": "optimum of the radial-basis sensors, as a quantile of the readings of the sensor "
    "in contact",
    "noise": "standard deviation of the noise of each sensor, relative to its response to a median "
    "contact",
    "method": "method; r-ANISOMAP uses linear correlation, I-ANISOMAP mutual information",
    "identified": "share of radial-basis sensors whose most similar linear sensor measures the "
    "same quantity",
    "mantel_r": "Mantel r of the 3D map of a skin with half of its sensors of each kind",
}


def radial_basis(readings: ArrayLike, quantile: float) -> NDArray[np.float64]:
    """Replace linear readings by Gaussian radial basis functions of the same quantity.

    readings (T, N) -> (T, N).
    """
    values = np.asarray(readings, dtype=np.float64)
    optimum = _in_contact(values, quantile, untouched=1.0)
    return np.exp(-(((values / optimum - 1) / _WIDTH) ** 2) / 2)


def _in_contact(
    readings: NDArray[np.float64], quantile: float, *, untouched: float
) -> NDArray[np.float64]:
    """Return a quantile of the readings of each sensor in contact, (T, N) -> (N,)."""
    found = np.full(readings.shape[1], untouched)
    touched = (readings > 0).any(axis=0)
    inside = np.where(readings > 0, readings, np.nan)[:, touched]
    found[touched] = np.nanquantile(inside, quantile, axis=0)
    return found


def response_rows(run: str, recording: Recording, seed: int, mu: float) -> Iterator[Row]:
    """Identify equal quantities, and map a skin with both kinds of sensors."""
    rng, n_sensors = np.random.default_rng(seed), recording.n_sensors
    chosen = rng.permutation(n_sensors) < n_sensors // 2
    for quantile, noise in _TRIALS:
        linear = np.asarray(recording.readings, dtype=np.float64)
        unlike = radial_basis(linear, quantile)
        medians = _in_contact(linear, 0.5, untouched=0.0)
        linear = linear + noise * medians * rng.standard_normal(linear.shape)
        unlike = unlike + noise * rng.standard_normal(unlike.shape)
        mixed = replace(recording, readings=np.where(chosen, unlike, linear))
        both = np.hstack([linear, unlike])
        for method, similarity in _SIMILARITIES.items():
            across = similarity(both)[n_sensors:, :n_sensors]
            identified = float(np.mean(across.argmax(axis=1) == np.arange(n_sensors)))
            r = map_and_score(mixed, method, 3, mu=mu).score.mantel.r
            yield (run, seed, quantile, noise, method, identified, r)
