"""Maps of resampled recordings, warm-started from the map of the recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from anisomap.methods import MethodOptions, find_method
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.contacts.contact_agreement import resampled_contact_agreement
from anisomap.numerics.contacts.contact_fit import resample_contacts
from anisomap.numerics.covariogram.covariogram_fit import Covariogram, fit_covariogram
from anisomap.numerics.covariogram.minimisation import SharedCurvature
from anisomap.numerics.graph.dissimilarity import direct_dissimilarity
from anisomap.numerics.precision import Reals
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.reliability.block_bootstrap import balanced_weights, block_edges
from anisomap.numerics.reliability.sampling_noise import thinning, typical_variance
from anisomap.numerics.similarity.resampled import resampled_correlation
from anisomap.stages.consensus import combine_with_paths
from anisomap.stages.pairs import PairStatistics
from anisomap.stages.refinement import ContactAverage

N_RESAMPLES = 8
"""Number of resamples: together they take about as much time as the map.

With 12, ellipses hold equally many positions, since covariances are pooled over sensors.
"""

STEP = 0.5
"""Share of the weights that is resampled.

A block that occurs n times in a resample has the weight 1 + STEP (n - 1), and differences between
maps are divided by STEP. A full resample has twice the noise of the recording, and shortest paths
are biased by noise: with 1, the differences of simulated skins of 1,000 frames, seeds 201 to 212,
were 1.2 times as large.
"""

CONTACT_INFLATION = 1.3
"""Ratio of the errors of maps that are averaged with a fit of contacts to their differences.

Resamples keep which readings are contacts, and the profile, so they differ too little. With 1.3,
97 % of the positions are inside their ellipses of 95 % on a bombarded sphere and a rubbed torus of
1,000 frames, seeds 201 to 203; with 1, 76 to 92 % were on four simulated skins, seeds 501 to 504.
"""

MAX_SENSORS = 3000
"""Maximum number of sensors: resamples of two matrices of all their pairs take 650 MB."""

# Iterations of the fit of the recording itself, if it starts from that of its map. Its similarity
# and its metric differ from those of the map by little; with 300, spreads differed by less than 6 %
# on four real skins, and by 12 % on a retina.
_MAX_CONTINUED = 40
_MAX_ITERATIONS = 5  # of each fit; with 300, spreads differed by less than 5 % (seeds 201 to 203)


def resampled_maps(
    pairs: PairStatistics,
    positions: NDArray[np.float64],
    method: str,
    contacts_from: Callable[[NDArray[np.float64]], ContactAverage | None],
    *,
    fitted: Covariogram | None = None,
    curvature: SharedCurvature | None = None,
    options: MethodOptions | None = None,
    rng: np.random.Generator,
    progress: Callable[[float], None] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Map resamples of blocks of a recording.

    Parameters
    ----------
    pairs : PairStatistics
        Of one component, with its readings, T >= 80. The similarity is blended, or the agreement of
        contacts.
    positions : ndarray of shape (n, k)
        Its map, from which the fits start.
    method : str
        Name of a method that refines positions.
    contacts_from : callable
        Takes a map of the recording that is not averaged with a fit of contacts, and returns that
        average; None if the map itself is not such an average.
    fitted : Covariogram, optional
        The covariogram fit of the map, from which fits then start instead.
    curvature : SharedCurvature, optional
        Of fits near the map of the recording; computed if it is not known.
    options : MethodOptions, optional
    rng : numpy.random.Generator
    progress : callable, optional
        Called with the completed share, from 0 to 1.

    Returns
    -------
    reference : ndarray of shape (n, k)
        Map of the recording by the same fit.
    maps : ndarray of shape (R, n, k)
        Maps of the resamples, which differ by `STEP` times as much as independent recordings.
    """
    options = replace(options or MethodOptions(), split_unrelated=False)
    recipe = find_method(method)
    curvature = curvature or SharedCurvature()
    readings = np.asarray(pairs.readings)
    edges = block_edges(readings)
    drawn = balanced_weights(len(edges) - 1, N_RESAMPLES, rng)
    weights = np.vstack([np.ones(len(edges) - 1), 1 + STEP * (drawn - 1)])
    with limited_blas(len(positions)):
        resamples, noise = _similarities(pairs, edges, weights), pairs.noise
        variance = typical_variance(noise)
        made: list[NDArray[np.float64]] = []
        start, exponent, by_paths = positions, 1.0, True
        iterations, shared = options.covariogram.max_iterations, None
        if fitted is not None:
            start, exponent = np.asarray(fitted.positions), fitted.exponent
            iterations = min(iterations, _MAX_CONTINUED)
        for i, resample in enumerate(resamples):
            compared = PairStatistics.from_similarity(
                resample, noise=noise, statistic=pairs.statistic
            )
            if i == 0:
                dissimilarity = recipe.dissimilarity(compared, options)
                linked = np.isfinite(dissimilarity)
            else:
                # Links that are significant in the recording are not tested again.
                dissimilarity = direct_dissimilarity(resample, noise)
                dissimilarity[~linked] = np.inf
            metric = recipe.metric(dissimilarity)
            fit = fit_covariogram(
                resample,
                _scaled(start, metric),
                metric,
                noise=variance,
                exponent=exponent,
                options=replace(options.covariogram, max_iterations=iterations),
                shared=shared,
            )
            found = np.asarray(fit.positions, dtype=np.float64)
            if by_paths:
                consensus = combine_with_paths(compared, found)
                by_paths = consensus.path_weight > 0
                found = np.asarray(consensus.positions, dtype=np.float64)
            if i == 0:
                start, exponent = np.asarray(fit.positions), fit.exponent
                # All resamples are near the recording, so that one curvature serves them all.
                iterations, shared = _MAX_ITERATIONS, curvature
            made.append(found)
            if progress is not None:
                progress(len(made) / len(weights))
        contacts = None if by_paths else contacts_from(made[0])
        if contacts is not None:
            frames = np.repeat(weights, np.diff(edges), axis=1)
            refined = _with_contacts(contacts, made, frames)
            # Contacts are not part of maps whose lengths came from elsewhere.
            if _misfit(refined[0], positions) < _misfit(made[0], positions):
                made = refined
    return made[0], np.array(made[1:])


def _with_contacts(
    contacts: ContactAverage, made: list[NDArray[np.float64]], weights: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Average maps with a fit of contacts to frames of given weights, shape (R, T)."""
    whole = np.asarray(contacts.given, dtype=np.float64)
    given = np.array([fit_similarity(one, whole).apply(one) for one in made])
    moved = resample_contacts(contacts.fit, given, weights)
    refined = (1 - contacts.share) * given + contacts.share * moved
    return list(refined[0] + CONTACT_INFLATION * (refined - refined[0]))


def _misfit(moved: NDArray[np.float64], positions: NDArray[np.float64]) -> float:
    return float(np.square(fit_similarity(moved, positions).apply(moved) - positions).sum())


def _similarities(
    pairs: PairStatistics, edges: NDArray[np.intp], weights: NDArray[np.float64]
) -> Reals:
    """Compute a similarity of weighted blocks of frames, shape (R, n, n)."""
    readings, found = np.asarray(pairs.readings), pairs.blended
    if found is None:
        # Shortest paths in float32 take half the time.
        return resampled_contact_agreement(readings, edges, weights).astype(np.float32)
    step = thinning(readings)
    edges = -(-edges // step)
    blended = resampled_correlation(readings[::step], edges, weights)
    rho = resampled_correlation(found.ranks[::step], edges, weights)
    blended *= found.weight
    rho *= 1 - found.weight
    blended += rho
    return blended


def _scaled(positions: NDArray[np.float64], metric: Reals) -> NDArray[np.float64]:
    """Scale positions to the unit of a metric, by least squares."""
    distances = pdist(positions)
    lengths = metric[np.triu_indices(len(metric), 1)]
    return positions * float(distances @ lengths / (distances @ distances))
