"""Handedness of a map: anchors are fitted to the map and to the mirror image, with error fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from anisomap.errors import InputError
from anisomap.numerics.neighbours import Kernel
from anisomap.numerics.procrustes import (
    SINGULAR,
    Similarity,
    extent,
    fit_similarity,
    leverage,
    similarity_derivatives,
    similarity_freedom,
)
from anisomap.numerics.surfaces import Points
from anisomap.placement.frames import median_spacing
from anisomap.sensor_map import SensorMap

PRIOR_FREEDOM = 4.0
"""Degrees of freedom of the prior of the variance of a map (a scaled inverse chi-squared).

The standard deviation of the logarithm of errors of even maps is then .40; measured: .46.
"""

# RMS error of a coordinate relative to the size of a map, i.e. the root of the summed variance of
# the coordinates. Medians over 62 maps without `SensorMap.distorted`, of the iCub and of simulated
# bodies, and over four distorted maps, of feet and of Nao.
ERROR_EVEN, ERROR_UNEVEN = 0.06, 0.25


@dataclass(frozen=True, eq=False)
class Tied:
    """A map with anchors: positions (N, k), anchor sensors (n,), and anchor positions (n, k)."""

    positions: Points
    sensors: NDArray[np.intp]
    targets: Points

    @property
    def anchors(self) -> Points:
        """Positions of the anchors on the map."""
        return self.positions[self.sensors]


@dataclass(frozen=True)
class Known:
    """Prior knowledge of a map, before anchors are used.

    spacing: Distance between neighbouring sensors on the map.
    size: Root of the summed variance of the coordinates of the map.
    uneven: Whether the map is known to be distorted: `SensorMap.distorted`.
    scale_sigma: Standard deviation of the logarithm of the scale; inf if the scale is unknown.
    evidence: Log likelihood ratio of the handedness of the map against its mirror image.
    handedness: Whether the map is a mirror image, if the user specified it.
    """

    spacing: float
    size: float
    uneven: bool
    scale_sigma: float
    evidence: float
    handedness: bool | None

    @classmethod
    def of(
        cls,
        sensor_map: SensorMap,
        handedness: bool | None,
        scale_sigma: float = np.inf,
        evidence: float = 0.0,
    ) -> Known:
        """Measure a map of one component."""
        size = extent(sensor_map.positions[sensor_map.placed])
        spacing = median_spacing(sensor_map)
        return cls(spacing, size, sensor_map.distorted, scale_sigma, evidence, handedness)

    @property
    def sigma(self) -> float:
        """Standard deviation of a coordinate of the map, as assumed before anchors are used."""
        return (ERROR_UNEVEN if self.uneven else ERROR_EVEN) * self.size


def fit_scaled(x: Points, y: Points, known: Known, reflected: bool) -> Similarity:
    """Fit a similarity of given handedness, with the prior of the scale."""
    free = fit_similarity(x, y, reflection=reflected)
    if not np.isfinite(known.scale_sigma):
        return free
    sigma = known.sigma / float(np.sqrt(np.sum((x - x.mean(axis=0)) ** 2)))
    weight = known.scale_sigma**2 / (known.scale_sigma**2 + sigma**2)
    scale = float(np.exp(weight * np.log(max(free.scale, np.finfo(float).tiny))))
    rigid = fit_similarity(scale * x, y, scaling=False, reflection=reflected)
    return Similarity(rigid.rotation, scale, rigid.translation)


def field_kernel(placed: Points, reach: float, noise: float) -> Kernel:
    """Return the covariance of a field; reach in sizes of a placed map."""
    return Kernel(max(reach * extent(placed), float(np.finfo(float).tiny)), noise)


class Kriged(NamedTuple):
    """Predicted positions.

    positions (m, k): In the frame of the anchors.
    relative (m,): Variances of a coordinate relative to the variance of the map.
    squares: Weighted sum of squares of the residuals of the anchors; its expectation is the
        variance of the map times the degrees of freedom.
    """

    positions: Points
    relative: NDArray[np.float64]
    squares: float


def krige(
    x: Points,
    y: Points,
    positions: Points,
    fit: Similarity,
    known: Known,
    *,
    kernel: Kernel,
    validated: bool = False,
) -> Kriged:
    """Predict positions by universal kriging; the drift is a small change of a similarity.

    x, y (n, k), positions (m, k). Chiles & Delfiner (2012), Geostatistics, section 3.4.
    """
    anchors, placed = fit.apply(x), fit.apply(positions)
    centre, size = anchors.mean(axis=0), extent(anchors)
    here, there = (similarity_derivatives((points - centre) / size) for points in (anchors, placed))
    covariance = kernel.between(anchors, anchors)
    covariance[np.diag_indices_from(covariance)] += kernel.noise
    inverse = np.linalg.inv(covariance)
    across = kernel.between(placed, anchors)
    weights = across @ inverse
    total = 1.0 + kernel.noise
    information = np.einsum("nki,nm,mkj->ij", here, inverse, here)
    residual = y - anchors
    wanted = np.einsum("nki,nm,mk->i", here, inverse, residual)
    if np.isfinite(known.scale_sigma):
        # The last parameter is the change of scale, whose prior is in `known`.
        sigma = known.sigma * fit.scale / np.sqrt(total)
        precision = (sigma / (size * max(known.scale_sigma, np.finfo(float).eps))) ** 2
        information[-1, -1] += precision
        wanted[-1] -= precision * size * np.log(fit.scale)
    spread = np.linalg.pinv(information, rcond=1e-9)
    drift = spread @ wanted
    rest = residual - here @ drift
    # Without validation, errors are as for a similarity with independent errors: an incorrect field
    # must not make them smaller.
    relative = 1.0 + leverage(anchors, placed) / anchors.shape[1]
    if validated:
        relative -= np.einsum("mn,mn->m", weights, across) / total
    return Kriged(
        placed + there @ drift + weights @ rest,
        np.maximum(relative, 0.0),
        float(total * np.einsum("nk,nm,mk->", rest, inverse, rest)),
    )


DECISIVE = float(np.log(1000.0))
"""Log likelihood ratio from which the handedness counts as known.

Prior probabilities of both hands are equal, so at most 1 in 1001 of such decisions is wrong if the
errors of maps are as assumed below.
"""

# Errors of neighbours are correlated: parts of a map are shifted, bent or even mirrored as a whole,
# so close anchors provide little more evidence than one anchor. FIELD_REACH is the reach of the
# field of errors in sizes of the map, and FIELD_NOISE the relative variance of independent errors;
# both fit the errors of the maps of `ERROR_EVEN`. RMS errors of the fields are the median over even
# maps, and the root mean square over distorted maps, which differ more.
FIELD_REACH, FIELD_NOISE = 0.5, 0.05
_FIELD_EVEN, _FIELD_DISTORTED = 0.045, 0.4
_DOUBT = 0.02
"""Probability that a map without the mark is distorted: (1 + 0) / (2 + 62), by the rule of
succession, since none of the 62 maps was distorted."""


def choose_hand(tied: Tied, known: Known) -> tuple[bool, bool]:
    """Return whether a map is a mirror image, and whether the handedness is known."""
    evidence, irrelevant = known.evidence, True
    if not is_flat(tied.positions):
        found, irrelevant = _evidence(tied, known)
        evidence += found
    dimensions = tied.targets.shape[1]
    if irrelevant and dimensions == 3:
        # Two rotations map a plane to another plane; the placed maps are mirror images. The fit
        # takes the better rotation, so anchors must show that it is the correct one.
        plane = Tied(in_plane(tied.positions), tied.sensors, in_plane(tied.targets))
        within, either = _evidence(plane, known)
        if abs(within) < DECISIVE and not either:
            raise InputError(_undecided(len(tied.sensors), 2, known.uneven, sides=True))
    if known.handedness is not None:
        against = evidence if known.handedness else -evidence
        if against > DECISIVE:
            raise InputError("the anchors contradict the stated handedness; check both")
        return known.handedness, True
    if abs(evidence) >= DECISIVE:
        return evidence < 0, True
    if irrelevant:
        return evidence < 0, False
    raise InputError(_undecided(len(tied.sensors), dimensions, known.uneven))


def _undecided(count: int, dimensions: int, uneven: bool, *, sides: bool = False) -> str:
    """Return advice on how to determine the handedness of a map, or the side of a flat map."""
    if dimensions == 2:
        more = "a third anchor off their line" if count < 3 else "more anchors off their line"
    elif count < dimensions + 1:
        more = "a fourth anchor off their plane (map a flat skin in 2D)"
    else:
        more = "more anchors"
    doubt = "the map is distorted, and " if uneven else ""
    if sides:
        return f"{doubt}the anchors do not distinguish the two sides of the flat map; give {more}"
    return (
        f"{doubt}the anchors do not distinguish the map from its mirror image; give {more}, "
        "--mesh, --module-layout, or --handedness same or mirrored"
    )


def _evidence(tied: Tied, known: Known) -> tuple[float, bool]:
    """Compare the fits of anchors to a map and to its mirror image.

    Returns the log likelihood ratio, and whether both place the sensors equally.
    """
    x, y = tied.anchors, tied.targets
    fits = [fit_scaled(x, y, known, hand) for hand in (False, True)]
    # Errors are in the unit of the map, so residuals are converted by the same factor for both
    # hands: the fitted scale of the incorrect hand is too small, and would reduce its errors.
    unit = float(np.sum((x - x.mean(axis=0)) ** 2) / np.sum((y - y.mean(axis=0)) ** 2))
    placed = [fit.apply(tied.positions) for fit in fits]
    kernels = [field_kernel(points, FIELD_REACH, FIELD_NOISE) for points in placed]
    same, mirror = (
        unit * krige(x, y, x, fit, known, kernel=kernel).squares
        for fit, kernel in zip(fits, kernels, strict=True)
    )
    freedom = similarity_freedom(*y.shape)
    value = mirror_evidence((same, mirror), freedom, known.size, uneven=known.uneven)
    error = fits[int(mirror < same)].scale * ERROR_EVEN * known.size
    return value, float(np.mean((placed[0] - placed[1]) ** 2)) < error**2


def mirror_evidence(
    squares: tuple[float, float], freedom: int, size: float, *, uneven: bool
) -> float:
    """Compare the residuals of anchors under a map and under its mirror image.

    The prior of the variance is a mixture of scaled inverse chi-squared distributions, for good and
    for distorted maps, so the likelihood is a mixture of densities of Student's t (Gelman et al.
    2013, Bayesian Data Analysis, section 3.2).
    """
    doubt = 1.0 if uneven else _DOUBT
    prior = PRIOR_FREEDOM * (size * np.array([_FIELD_EVEN, _FIELD_DISTORTED])) ** 2

    def log_likelihood(value: float) -> float:
        peaks = PRIOR_FREEDOM / 2 * np.log(prior)
        tails = (PRIOR_FREEDOM + freedom) / 2 * np.log(prior + value)
        return float(logsumexp(peaks - tails, b=[1 - doubt, doubt]))

    return log_likelihood(squares[0]) - log_likelihood(squares[1])


def is_flat(positions: Points) -> bool:
    """Return whether points in space are in a plane, up to rounding."""
    widths = np.linalg.svd(positions - positions.mean(axis=0), compute_uv=False)
    return positions.shape[1] == 3 and bool(widths[-1] <= SINGULAR * widths[0])


def in_plane(points: Points) -> Points:
    """Return the coordinates of points in the plane fitted to them, shape (n, 2)."""
    centred = points - points.mean(axis=0)
    return np.asarray(centred @ np.linalg.svd(centred, full_matrices=False)[2][:2].T)
