"""Errors of positions by chance, estimated from maps of resamples of the recording.

Blocks of frames are resampled. The map of each resample starts from the map of all frames and takes
a few iterations. Covariances of positions also include systematic errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.evaluation.scoring import median_spacing
from anisomap.method.configuration import best_scale
from anisomap.method.evidence import Evidence
from anisomap.method.named import Method, MethodOptions
from anisomap.method.pipeline import Stages
from anisomap.method.refinement import Refinement
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.similarity.correlation import N_BLOCKS

MIN_SENSORS = 12
"""Minimum number of sensors: maps of fewer sensors agree too often by chance."""

MIN_FRAMES = 4 * N_BLOCKS
"""Minimum number of frames."""

MAX_SENSORS = 5000
"""Maximum number of sensors: resamples of two matrices of all pairs take 800 MB."""

STEP = 0.5
"""Share of the weights that is resampled: see `Evidence.resamples`.

Differences between maps are divided by this share. It is below 1, since a full resample has twice
the noise of the recording, and noise biases shortest paths.
"""

_N_RESAMPLES = 3  # sufficient, since covariances are pooled over sensors
_MAX_ITERATIONS = 5  # of the covariogram fit of a resample, which starts from the fit of the map
_ALIGNMENTS = 4  # rounds of alignment to the mean of all maps; more change nothing visible
_N_POOLED = 8  # nearest sensors for pooled covariances; with 20, ellipses contain equally many


@dataclass(frozen=True, eq=False)
class Part:
    """A component of n sensors of a map, with its stages.

    scaled (n, k): Positions from the metric alone.
    """

    evidence: Evidence
    refined: Refinement
    scaled: NDArray[np.float64]

    @classmethod
    def of(cls, stages: Stages, label: int) -> Part | None:
        """Return a component of the map of some stages; None if it was not refined."""
        made = stages.configuration
        refined = made.refinements[label] if label < len(made.refinements) else None
        if refined is None or made.scaled is None:
            return None
        inside = made.component == label
        related = replace(stages.evidence.select(inside), related=True)
        return cls(related, refined, made.scaled[inside])


def deviations_by_chance(
    part: Part,
    positions: NDArray[np.float64],
    recipe: Method,
    options: MethodOptions,
    *,
    rng: np.random.Generator,
    progress: Callable[[float], None],
) -> NDArray[np.float64]:
    """Return deviations of positions (n, k) that represent errors by chance, (R, n, k)."""
    fit = part.refined.fit
    most = min(options.covariogram.max_iterations, _MAX_ITERATIONS)
    few = replace(options.covariogram, max_iterations=most)
    start = np.asarray(fit.positions, dtype=np.float64)
    made = []
    for resample in part.evidence.resamples(_N_RESAMPLES, STEP, rng):
        # The metric, a prior of the fit, has errors by chance as well.
        metric = recipe.lengths_of(resample, options)
        lengths = metric / (best_scale(start, metric)[0] or 1.0)
        found = recipe.refine(resample, lengths, start, few, fit) if recipe.refine else None
        made.append(start if found is None else found.positions)
        progress(len(made) / _N_RESAMPLES)
    return deviations_from_mean(np.array(made), positions) / STEP


def deviations_from_mean(
    maps: NDArray[np.float64], positions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return deviations of maps from their mean, in the frame and scale of given positions.

    maps (R, n, k), positions (n, k) -> (R, n, k). The mean square is an unbiased variance.

    Deviations are from the mean of the maps, not from the given map: resamples have more noise than
    the recording, which shifts all of their maps equally.
    """
    aligned = aligned_to_mean(maps)
    mean = aligned.mean(axis=0)
    fit = fit_similarity(mean, positions)
    unbiased = math.sqrt(len(maps) / (len(maps) - 1))
    return np.asarray(unbiased * fit.scale * (aligned - mean) @ fit.rotation.T)


def aligned_to_mean(maps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Align maps of the same sensors with their mean; uncertain sensors have less weight.

    maps (R, n, k) -> (R, n, k).

    Generalised Procrustes analysis (Gower 1975, doi:10.1007/BF02291478), in which a sensor of
    variance v has the weight ``1 / (v + median v)``, so that sensors with uncertain positions do
    not rotate the maps.
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

    A covariance estimated from few maps is uncertain. The result is therefore the mean of three
    covariances: the covariance of the sensor, the mean over its 8 nearest sensors, and the
    isotropic covariance with the trace of this mean.
    """
    own = np.einsum("rni,rnj->nij", deviations, deviations) / len(deviations)
    around = pooled(own, positions, _N_POOLED)
    dimensions = positions.shape[1]
    sphere = np.trace(around, axis1=1, axis2=2)[:, None, None] / dimensions * np.eye(dimensions)
    return np.asarray((own + around + sphere) / 3)


def error_in_spacings(found: NDArray[np.float64], positions: NDArray[np.float64]) -> float:
    """Return the RMS error according to `covariances`, in spacings of the map.

    found (n, k, k), positions (n, k).
    """
    spacing = median_spacing(positions)
    mean = float(np.trace(found, axis1=1, axis2=2).mean())
    return math.sqrt(mean) / spacing if spacing > 0 else math.inf


_N_DIFFERENCES = 9  # a sensor and its nearest 8, for averages of squared differences

REGION_RADIUS, MIN_REGION = 5.0, 6
"""Radius of a region in spacings, and minimum number of sensors."""

ELLIPSE_SCALE = 2.0
"""Ratio of the covariances of positions to the square of the expected error.

Errors of maps vary around the expected error, and errors of sensors around the error of their map.
Ellipses of 95 % contain 94 % of the true positions on 180 maps with errors of at most a spacing
(benchmark `trust`, seeds 7001 to 7119).
"""


def rms_in_spacings(differences: NDArray[np.float64], positions: NDArray[np.float64]) -> float:
    """Return the RMS length of differences, shape (n, k), in spacings of a map."""
    spacing = median_spacing(positions)
    rms = math.sqrt(float(np.square(differences).sum(axis=1).mean()))
    return rms / spacing if spacing > 0 else math.inf


def extent_in_spacings(positions: NDArray[np.float64]) -> float:
    """Return the RMS distance of the sensors of a map, (n, k), from their centre, in spacings."""
    return rms_in_spacings(positions - positions.mean(axis=0), positions)


def regional_difference(differences: NDArray[np.float64], positions: NDArray[np.float64]) -> float:
    """Return the RMS difference of two maps in separately aligned regions, in spacings.

    differences, positions (n, k). A map of fewer than 6 sensors within 5 spacings is one region.
    """
    spacing = median_spacing(positions)
    if spacing == 0 or not np.isfinite(differences).all():
        return math.inf
    near: Any = KDTree(positions).query_ball_point(positions, REGION_RADIUS * spacing)
    regions = [one for one in near if len(one) >= MIN_REGION] or [range(len(positions))]
    sizes, members = np.array([len(one) for one in regions]), np.concatenate(regions)
    begins = np.cumsum(sizes) - sizes

    def centred(points: NDArray[np.float64]) -> NDArray[np.float64]:
        means = np.add.reduceat(points[members], begins) / sizes[:, None]
        return np.asarray(points[members] - np.repeat(means, sizes, axis=0))

    here, there = centred(positions), centred(positions + differences)
    squares, of_other = (np.add.reduceat(np.square(x).sum(axis=1), begins) for x in (here, there))
    products = np.add.reduceat(np.einsum("mi,mj->mij", here, there), begins)
    fitted = np.linalg.svd(products, compute_uv=False).sum(axis=1)  # as in `fit_similarity`
    left = squares - fitted**2 / np.maximum(of_other, np.finfo(float).tiny)
    return math.sqrt(float(np.mean(np.maximum(left, 0) / sizes))) / spacing


def pooled(
    found: NDArray[np.float64], positions: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """Average values of each sensor over the nearest sensors and itself. found (n, k, k)."""
    nearest = KDTree(positions).query(positions, k=min(count, len(positions)))[1]
    return np.asarray(found[np.asarray(nearest)].mean(axis=1))


def with_systematic_errors(
    chance: NDArray[np.float64],
    differences: NDArray[np.float64],
    positions: NDArray[np.float64],
    error: float,
) -> NDArray[np.float64]:
    """Return covariances of positions that include systematic errors, (n, k, k).

    chance (n, k, k), differences (n, k), positions (n, k).

    The result is the mean of three shapes of equal size, scaled to the expected error in spacings:
    errors by chance, differences from another map around the sensor, and a sphere.
    """
    k = positions.shape[1]
    outer = pooled(np.einsum("ni,nj->nij", differences, differences), positions, _N_DIFFERENCES)
    shapes = [_of_unit_size(one) for one in (chance, outer)]
    sphere = np.broadcast_to(np.eye(k) / k, outer.shape)
    size = ELLIPSE_SCALE * (error * median_spacing(positions)) ** 2
    return np.asarray(size * (sum(shapes) + sphere) / 3)


def _of_unit_size(covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scale covariances, shape (n, k, k), such that the mean of their traces is 1."""
    size = float(np.trace(covariances, axis1=1, axis2=2).mean())
    if size > 0:
        return covariances / size
    k = covariances.shape[1]
    return np.broadcast_to(np.eye(k) / k, covariances.shape)
