"""Covariance of the position of every sensor, from maps of resampled recordings.

Maps of resampled recordings, warm-started from the map of the recording.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from anisomap.diagnosis.accuracy import pooled, rms_in_spacings
from anisomap.evaluation.scoring import median_spacing
from anisomap.evidence import PairStatistics
from anisomap.methods import find_method
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.contacts.contact_agreement import resampled_contact_agreement
from anisomap.numerics.contacts.contact_fit import ContactFit, resample_contacts
from anisomap.numerics.covariogram.covariogram_fit import Covariogram, fit_covariogram
from anisomap.numerics.covariogram.minimisation import SharedCurvature
from anisomap.numerics.graph.dissimilarity import direct_dissimilarity
from anisomap.numerics.precision import Reals
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.reliability.sampling_noise import (
    balanced_weights,
    block_edges,
    typical_variance,
)
from anisomap.numerics.similarity.correlation import resampled_correlation
from anisomap.options import MethodOptions
from anisomap.refinements.chain import RefinedMap
from anisomap.refinements.paths import by_paths

_ALIGNMENTS = 4  # rounds of alignment to the mean of all maps; more change nothing visible
_N_POOLED = 8  # nearest sensors over which covariances are pooled; 20 hold equally many positions


def covariances(
    maps: NDArray[np.float64], positions: NDArray[np.float64], step: float = 1.0
) -> NDArray[np.float64]:
    """Estimate the covariance of every position from maps of resampled recordings.

    maps (R, n, k), positions (n, k) -> (n, k, k).

    The covariance of R maps is uncertain itself. Returned is the mean of three:
    that of the sensor, the mean of those of its 8 nearest sensors, and the sphere as large as the
    latter. Differences from the mean of the maps count, not from the given map: resamples have more
    noise than the recording, which shifts all of them alike.
    """
    aligned = aligned_to_mean(maps)
    mean = aligned.mean(axis=0)
    fit = fit_similarity(mean, positions)
    deviations = (fit.scale / step) * (aligned - mean) @ fit.rotation.T
    own = np.einsum("rni,rnj->nij", deviations, deviations) / (len(maps) - 1)
    around = pooled(own, positions, _N_POOLED)
    dimensions = positions.shape[1]
    sphere = np.trace(around, axis1=1, axis2=2)[:, None, None] / dimensions * np.eye(dimensions)
    return np.asarray((own + around + sphere) / 3)


def aligned_to_mean(maps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Align maps of the same sensors with their mean, such that uncertain sensors count less.

    maps (R, n, k) -> (R, n, k).

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

    found (n, k, k), positions (n, k).
    """
    spacing = median_spacing(positions)
    mean = float(np.trace(found, axis1=1, axis2=2).mean())
    return math.sqrt(mean) / spacing if spacing > 0 else math.inf


def departure_in_spacings(reference: NDArray[np.float64], positions: NDArray[np.float64]) -> float:
    """Return the RMS difference of two maps after the best similarity, in spacings of the second.

    reference, positions (n, k).
    """
    moved = fit_similarity(reference, positions).apply(reference)
    return rms_in_spacings(moved - positions, positions)


N_RESAMPLES, FEWEST_RESAMPLES = 8, 3
"""Number of resamples of up to 250 sensors, and of 670 and more.

With 12, ellipses hold equally many positions, since covariances are pooled over sensors; the more
sensors, the better the RMS over all of them is known.
"""

_RESAMPLED_SENSORS = 2000  # over all resamples

STEP = 0.5
"""Share of the weights that is resampled.

A block that occurs n times in a resample has the weight 1 + STEP (n - 1), and differences between
maps are divided by STEP. A full resample has twice the noise of the recording, and shortest paths
are biased by noise.
"""

CONTACT_INFLATION = 1.3
"""Ratio of the errors of maps that are averaged with a fit of contacts to their differences.

Resamples keep which readings are contacts, and the profile, so they differ too little.
"""

MAX_SENSORS = 5000
"""Maximum number of sensors: resamples of two matrices of all their pairs take 800 MB."""

_MAX_CONTINUED = 40  # iterations of the fit of the recording itself, from that of its map
_MAX_ITERATIONS = 5  # of each other fit; more change the spread of the maps by a few percent


def resampled_maps(
    pairs: PairStatistics,
    positions: NDArray[np.float64],
    method: str,
    refined: RefinedMap | None = None,
    *,
    options: MethodOptions | None = None,
    rng: np.random.Generator,
    progress: Callable[[float], None] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Map resamples of blocks of a recording of T >= 80 frames, starting from its map.

    positions (n, k) -> reference (n, k), maps (R, n, k).

    The reference is a map of the recording by the same fit; the maps differ by `STEP` times as much
    as maps of independent recordings. `refined` tells how the positions were computed, if known.
    """
    options = replace(options or MethodOptions(), split_unrelated=False)
    recipe = find_method(method)
    edges = block_edges(np.asarray(pairs.readings))
    few = max(FEWEST_RESAMPLES, _RESAMPLED_SENSORS // len(positions))
    drawn = balanced_weights(len(edges) - 1, min(N_RESAMPLES, few), rng)
    weights = np.vstack([np.ones(len(edges) - 1), 1 + STEP * (drawn - 1)])
    start, exponent = positions, 1.0
    iterations = options.covariogram.max_iterations
    if refined is not None and isinstance(fit := _fit(refined, "covariogram"), Covariogram):
        start, exponent = np.asarray(fit.positions), fit.exponent
        iterations = min(iterations, _MAX_CONTINUED)
    curvature: SharedCurvature | None = None
    linked: NDArray[np.bool_] | None = None
    averaged = refined is None or bool(refined.weights.get("paths"))
    variance = typical_variance(pairs.noise)
    made: list[NDArray[np.float64]] = []
    with limited_blas(len(positions)):
        for resample in _similarities(pairs, edges, weights):
            compared = PairStatistics.from_similarity(
                resample, noise=pairs.noise, statistic=pairs.statistic
            )
            if linked is None:
                dissimilarity = recipe.dissimilarity(compared, options)
                linked = np.isfinite(dissimilarity)
            else:
                # Links that are significant in the recording are not tested again.
                dissimilarity = direct_dissimilarity(resample, pairs.noise)
                dissimilarity[~linked] = np.inf
            metric = recipe.metric(dissimilarity)
            found = fit_covariogram(
                resample,
                _scaled(start, metric),
                metric,
                noise=variance,
                exponent=exponent,
                options=replace(options.covariogram, max_iterations=iterations),
                shared=curvature,
            )
            mapped = RefinedMap(found.positions, 1.0)
            if averaged and (proposal := by_paths(compared, metric, found.positions, options)):
                mapped = mapped.combined("paths", proposal)
            made.append(np.asarray(mapped.positions, dtype=np.float64))
            if curvature is None:
                # All resamples are near the recording, so that one curvature serves them all.
                start, exponent = np.asarray(found.positions), found.exponent
                iterations, curvature = _MAX_ITERATIONS, SharedCurvature()
            if progress is not None:
                progress(len(made) / len(weights))
        if refined is not None and refined.weights.get("contacts"):
            made = _with_contacts(refined, made, np.repeat(weights, np.diff(edges), axis=1))
    return made[0], np.array(made[1:])


def _fit(refined: RefinedMap, step: str) -> object:
    return refined.proposals[step].fit if step in refined.proposals else None


def _with_contacts(
    refined: RefinedMap, made: list[NDArray[np.float64]], weights: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Average maps with a fit of contacts to frames of given weights, shape (R, T)."""
    fit = _fit(refined, "contacts")
    if not isinstance(fit, ContactFit):
        return made
    whole = np.asarray(refined.given["contacts"], dtype=np.float64)
    share = refined.weights["contacts"]
    given = np.array([fit_similarity(one, whole).apply(one) for one in made])
    averaged = (1 - share) * given + share * resample_contacts(fit, given, weights)
    return list(averaged[0] + CONTACT_INFLATION * (averaged - averaged[0]))


def _similarities(
    pairs: PairStatistics, edges: NDArray[np.intp], weights: NDArray[np.float64]
) -> Reals:
    """Compute a similarity of weighted blocks of frames, shape (R, n, n)."""
    readings, found = np.asarray(pairs.readings), pairs.blended
    if found is None:
        # Shortest paths in float32 take half the time.
        return resampled_contact_agreement(readings, edges, weights).astype(np.float32)
    blended = resampled_correlation(readings, edges, weights)
    rho = resampled_correlation(found.ranks, edges, weights)
    blended *= found.weight
    rho *= 1 - found.weight
    blended += rho
    return blended


def _scaled(positions: NDArray[np.float64], metric: Reals) -> NDArray[np.float64]:
    """Scale positions to the unit of a metric, by least squares."""
    distances = pdist(positions)
    lengths = metric[np.triu_indices(len(metric), 1)]
    return positions * float(distances @ lengths / (distances @ distances))
