"""Errors of positions by chance, estimated from maps of resamples or halves of the recording.

Maps of resampled blocks of frames start from the given map and take a few iterations. If the given
map does not follow from its covariogram fit, halves of the recording are mapped from the beginning.
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation.mantel_r import MIN_SENSORS_COMPARED
from anisomap.evaluation.scoring import align, median_spacing
from anisomap.method.evidence import PairStatistics, compare
from anisomap.method.named import Method, find_method
from anisomap.method.options import MethodOptions
from anisomap.method.pipeline import Stages, configure_pairs
from anisomap.method.reconstruction import reconstruct_with_stages
from anisomap.numerics.contacts.contact_agreement import resampled_contact_agreement
from anisomap.numerics.covariogram.covariogram_fit import Covariogram
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.reliability.sampling_noise import balanced_weights, block_edges
from anisomap.numerics.reliability.split_half import N_BLOCKS, split_blocks
from anisomap.numerics.similarity.correlation import resampled_correlation
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap
from anisomap.verdict.accuracy import pooled

logger = logging.getLogger(__name__)

MIN_SENSORS = 12
"""Minimum number of sensors: maps of fewer agree too often by chance."""

MIN_FRAMES = 4 * N_BLOCKS
"""Minimum number of frames."""

MAX_SENSORS = 5000
"""Maximum number of sensors: resamples of two matrices of all their pairs take 800 MB."""

STEP = 0.5
"""Share of the weights that is resampled.

A block that occurs n times in a resample has the weight 1 + STEP (n - 1), and differences between
maps are divided by STEP. A full resample has twice the noise of the recording, and shortest paths
are biased by noise.
"""

_N_RESAMPLES = 3  # enough, since covariances are pooled over sensors
_MAX_ITERATIONS = 5  # of the covariogram fit of a resample, which starts from that of the map
_ITERATIONS_OF_HALF = 30  # of the fit of a half; with the default, errors differed by 1 %
_ALIGNMENTS = 4  # rounds of alignment to the mean of all maps; more change nothing visible
_N_POOLED = 8  # nearest sensors over which covariances are pooled; 20 hold equally many positions
_SAME = 1e-6  # spacings; rounding errors of a map that was scaled or turned are far below

Frames = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class MapPart:
    """A component of a map.

    positions (n, k)
    fit: The covariogram fit; None if the map does not follow from it.
    share: Variance of the positions by chance, relative to that before contacts refined them.
    """

    positions: NDArray[np.float64]
    pairs: PairStatistics
    fit: Covariogram | None = None
    share: float = 1.0


def part_of(
    sensor_map: SensorMap, label: int, run: Recording, options: MethodOptions, stages: Stages | None
) -> MapPart:
    """Return a component of a map of one recording; without stages, compare its sensors again."""
    members = sensor_map.component == label
    positions, components = sensor_map.positions[members], sensor_map.component[sensor_map.placed]
    if stages is None or not np.array_equal(stages.configuration.component, components):
        part = run.select(members)
        return MapPart(
            positions,
            compare([part], sensor_map.similarity, bins=options.entropy_bins, with_noise=True),
        )
    made, inside = stages.configuration, components == label
    pairs, refined = stages.pairs.select(inside), made.refinements[label]
    # Maps with lengths from heights or from declared spacing are not those of the covariogram.
    follows = refined is not None and "covariogram" in refined.proposals and not refined.elongated
    if refined is None or not follows or _departure(made.positions[inside], positions) > _SAME:
        return MapPart(positions, pairs)
    # A mean weighted by precision leaves this share of the variance. A map that is replaced, with
    # the weight 1, is no such mean.
    weight = refined.weights.get("contacts", 0.0)
    share = 1 - weight if weight < 1 else 1.0
    return MapPart(positions, pairs, refined.proposals["covariogram"].fit, share)


def made_again(sensor_map: SensorMap, run: Recording, options: MethodOptions) -> Stages | None:
    """Return the stages of the map that the method makes of a recording; None if there is none."""
    unplaced = [sensor_map.names[i] for i in np.flatnonzero(~sensor_map.placed)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)  # the notes of the map have them
        try:
            return reconstruct_with_stages(
                run, sensor_map.method, sensor_map.dimensions, options=options, drop=unplaced
            )[1]
        except InputError:
            return None


def deviations_by_chance(
    part: MapPart,
    method: str,
    options: MethodOptions,
    rng: np.random.Generator,
    progress: Callable[[float], None],
) -> NDArray[np.float64]:
    """Return deviations of positions of the size of their errors by chance, (R, n, k)."""
    recipe, options = find_method(method), replace(options, split_unrelated=False)
    if part.fit is None:
        logger.info("mapping halves of the recording to estimate the repeatability")
        few = _with_iterations(options, _ITERATIONS_OF_HALF)
        n_frames = len(np.asarray(part.pairs.readings))
        return deviations_of_halves(
            n_frames, part.positions, lambda frames: _map_half(part, frames, recipe, few)
        )
    few = _with_iterations(options, _MAX_ITERATIONS)
    start = np.asarray(part.fit.positions, dtype=np.float64)
    made = []
    for resample in _resamples(part.pairs, _N_RESAMPLES, rng):
        near = replace(resample, near=part.fit)
        found = configure_pairs(near, recipe, start.shape[1], few, start=start)
        made.append(found.positions)
        progress(len(made) / _N_RESAMPLES)
    return math.sqrt(part.share) / STEP * deviations_from_mean(np.array(made), part.positions)


def _with_iterations(options: MethodOptions, most: int) -> MethodOptions:
    fit = options.covariogram
    return replace(options, covariogram=replace(fit, max_iterations=min(fit.max_iterations, most)))


def _resamples(
    pairs: PairStatistics, count: int, rng: np.random.Generator
) -> Iterator[PairStatistics]:
    """Yield the statistics of weighted blocks of T >= 80 frames."""
    readings, blended = np.asarray(pairs.readings), pairs.blended
    edges = block_edges(readings)
    weights = 1 + STEP * (balanced_weights(len(edges) - 1, count, rng) - 1)
    similarities: NDArray[np.floating]
    if blended is None:
        similarities = resampled_contact_agreement(readings, edges, weights)
    else:
        similarities = resampled_correlation(readings, edges, weights)
        similarities *= blended.weight
        rho = resampled_correlation(blended.ranks, edges, weights)
        rho *= 1 - blended.weight
        similarities += rho
    for similarity in similarities:
        yield PairStatistics.from_similarity(
            similarity, noise=pairs.noise, statistic=pairs.statistic
        )


def _map_half(
    part: MapPart, frames: Frames, recipe: Method, options: MethodOptions
) -> NDArray[np.float64]:
    """Map some frames from the beginning; NaN for sensors that are constant in them."""
    half = part.pairs.of_frames(frames)
    varying = np.ptp(np.asarray(half.readings), axis=0) > 0
    k = part.positions.shape[1]
    if np.count_nonzero(varying) < max(options.min_sensors, k):
        raise InputError("too few sensors vary in a half of the recording")
    positions = np.full(part.positions.shape, np.nan)
    positions[varying] = configure_pairs(half.select(varying), recipe, k, options).positions
    return positions


def deviations_of_halves(
    n_frames: int,
    positions: NDArray[np.float64],
    place: Callable[[Frames], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Subtract a map from maps of halves of the recording, (2, n, k); 0 where these are NaN.

    positions (n, k).

    If a map of all frames has errors of variance v, those of a half have 2 v. Both share frames:
    their difference has a variance of v, which is that of the map.
    """
    found = np.zeros((2, *positions.shape))
    for deviations, frames in zip(found, split_blocks(n_frames), strict=True):
        made = place(frames)
        placed = np.isfinite(made).all(axis=1)
        if np.count_nonzero(placed) < MIN_SENSORS_COMPARED:
            raise InputError("too few sensors are placed by a half of the recording")
        given = positions[placed]
        deviations[placed] = align(made[placed], given).aligned - given
    return found


def deviations_from_mean(
    maps: NDArray[np.float64], positions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return deviations of maps from their mean, in the frame and scale of given positions.

    maps (R, n, k), positions (n, k) -> (R, n, k). The mean square is an unbiased variance.

    The deviations are from the mean of the maps, not from the given map: resamples have more noise
    than the recording, which shifts all of their maps alike.
    """
    aligned = aligned_to_mean(maps)
    mean = aligned.mean(axis=0)
    fit = fit_similarity(mean, positions)
    unbiased = math.sqrt(len(maps) / (len(maps) - 1))
    return np.asarray(unbiased * fit.scale * (aligned - mean) @ fit.rotation.T)


def aligned_to_mean(maps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Align maps of the same sensors with their mean; uncertain sensors count less.

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


def covariances(
    deviations: NDArray[np.float64], positions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Estimate the covariance of every position from deviations by chance.

    deviations (R, n, k), positions (n, k) -> (n, k, k).

    The covariance of few maps is itself uncertain. The result is therefore the mean of three
    covariances: that of the sensor, the mean of those of its 8 nearest sensors, and the isotropic
    covariance with the trace of that mean.
    """
    own = np.einsum("rni,rnj->nij", deviations, deviations) / len(deviations)
    around = pooled(own, positions, _N_POOLED)
    dimensions = positions.shape[1]
    sphere = np.trace(around, axis1=1, axis2=2)[:, None, None] / dimensions * np.eye(dimensions)
    return np.asarray((own + around + sphere) / 3)


def error_in_spacings(found: NDArray[np.float64], positions: NDArray[np.float64]) -> float:
    """Return the RMS error that belongs to `covariances`, in spacings of the map.

    found (n, k, k), positions (n, k).
    """
    spacing = median_spacing(positions)
    mean = float(np.trace(found, axis1=1, axis2=2).mean())
    return math.sqrt(mean) / spacing if spacing > 0 else math.inf


def _departure(made: NDArray[np.float64], positions: NDArray[np.float64]) -> float:
    """Return the RMS difference of two aligned maps, (n, k) each, in spacings."""
    spacing = median_spacing(positions)
    return align(made, positions).rms / spacing if spacing > 0 else math.inf
