"""Similarities of sensors of unlike response, and of near and far pairs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import pdist, squareform
from scipy.stats import spearmanr

from anisomap.errors import InputError
from anisomap.numerics.graph.dissimilarity import regularised_reciprocal
from anisomap.numerics.similarity.correlation import pearson
from anisomap.numerics.similarity.information import mutual_information
from anisomap.paper.cases import METHODS, true_positions
from anisomap.paper.experiment import Row
from anisomap.paper.map_scores import map_and_score, similarity_of
from anisomap.recording import Recording

MEDIAN = 0.5
"""Quantile of the contact readings at which the claim is tested: the centre of the response."""

CLAIMED_NOISE = 0.1
"""Noise of each sensor in the test of the claim."""

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
    "area": "area under the ROC curve: chance that the linear sensor of the same quantity is more "
    "similar than another one",
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
    """Identify sensors of equal quantities, and map a skin with both kinds of sensors."""
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
            own = np.diagonal(across)[:, None]
            beaten = (across < own).sum() + ((across == own).sum() - n_sensors) / 2
            area = float(beaten / (n_sensors * (n_sensors - 1)))
            r = map_and_score(mixed, method, 3, mu=mu).score.mantel.r
            yield (run, seed, quantile, noise, method, identified, area, r)


_FEW = 8  # the share of the frames is 1 / 8
_N_LINE = 5  # other sensors on a line of the cylinder
_SAME_LINE = 1e-6  # in metres

PAIR_COLUMNS = {
    "run": "body and scenario, or the patch",
    "seed": "seed of the run",
    "method": "method, whose similarity and dissimilarity are taken",
    "few_frames": "Mantel r of the map from the first eighth of the frames",
    "unrelated": "information distance over the sum of entropies, mean over the half of the pairs "
    "that are farthest apart",
    "axial": "cylinder: share of the five most similar sensors that lie on the same line along the "
    "axis",
    "shorter": "rank correlation of dissimilarity and true distance among pairs of dissimilarities "
    "below the median minus that among the others, 0 of equal ones",
}


def pair_rows(
    run: str, recording: Recording, seed: int, dimensions: int, mu: float
) -> Iterator[Row]:
    """Compare similarities with distances of pairs; yield rows of `PAIR_COLUMNS`."""
    varying = recording.select(recording.varying())
    truth = true_positions(varying, dimensions)
    distances = pdist(truth)
    few = replace(varying, readings=varying.readings[: varying.n_frames // _FEW])
    for method in METHODS[:2]:
        similarity = np.asarray(similarity_of(varying, method), dtype=np.float64)
        unlike = squareform(regularised_reciprocal(similarity, mu), checks=False)
        is_short = unlike < np.median(unlike)
        near, far = (
            # Dissimilarities of all pairs with r below 0 are equal, and give no correlation.
            spearmanr(unlike[half], distances[half]).statistic if np.ptp(unlike[half]) else 0.0
            for half in (is_short, ~is_short)
        )
        unrelated, axial = np.nan, np.nan
        if method == "i-anisomap":
            entropies = np.diagonal(similarity)
            sums = squareform(np.add.outer(entropies, entropies), checks=False)
            shares = 1 - 2 * squareform(similarity, checks=False) / sums
            unrelated = float(shares[distances > np.median(distances)].mean())
        if recording.metadata.get("body") == "cylinder":
            line = squareform(pdist(truth[:, :2])) < _SAME_LINE
            others = similarity - 2 * np.abs(similarity).max() * np.eye(len(similarity))
            best = np.argsort(-others, axis=1, kind="stable")[:, :_N_LINE]
            axial = float(np.take_along_axis(line, best, axis=1).mean())
        try:
            r = map_and_score(few, method, dimensions, mu=mu).score.mantel.r
        except InputError:  # too few contacts for a map
            r = np.nan
        yield (run, seed, method, r, unrelated, axial, float(near - far))
