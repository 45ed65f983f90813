"""Procrustes analysis: similarity transforms, and poses of rigid bodies and of patches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation
from scipy.special import gammaincinv

from anisomap.errors import InputError

SINGULAR = 1e-9
"""Relative singular value below which points are flat: reflection and rotation fit equally."""

_MAX_ITERATIONS = 100  # of robust fits, which converge within about 20
_FIRST_ITERATIONS = 10  # with least absolute distances
_CONVERGED = 1e-6  # largest change of a weight
_WIDTH = 2.0  # noise scales at which the weight is 1/4; tuned with `evaluation.difference`


@dataclass(frozen=True, eq=False)
class Similarity:
    """The map ``x -> scale * rotation @ x + translation``.

    rotation (k, k): Orthogonal; a reflection if its determinant is -1.
    scale: Positive.
    translation (k,)
    """

    rotation: NDArray[np.float64]
    scale: float
    translation: NDArray[np.float64]

    @property
    def reflected(self) -> bool:
        """Whether the map is a mirror image."""
        return bool(np.linalg.det(self.rotation) < 0)

    def apply(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transform points, shape (n, k)."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)


def fit_similarity(
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    weights: NDArray[np.float64] | None = None,
    *,
    scaling: bool = True,
    reflection: bool | None = None,
) -> Similarity:
    """Fit the similarity that minimises the weighted sum of squared distances to the target.

    source, target (n, k), weights (n,).

    Umeyama (1991), IEEE Trans. PAMI 13(4): 376-380, with weights.
    """
    shares = np.ones(len(source)) if weights is None else np.asarray(weights, dtype=np.float64)
    shares = shares / shares.sum()
    source_mean, target_mean = shares @ source, shares @ target
    x, y = source - source_mean, target - target_mean
    with np.errstate(over="ignore", invalid="ignore"):
        covariance = (y * shares[:, None]).T @ x
    if not np.isfinite(covariance).all():
        raise InputError("positions that are aligned are not finite, or their squares are not")
    left, singular, right = np.linalg.svd(covariance)
    sign = np.ones(len(singular))
    handed = np.linalg.det(left @ right) < 0
    wanted = handed and singular[-1] > SINGULAR * singular[0] if reflection is None else reflection
    if handed != wanted:
        sign[-1] = -1.0
    rotation = (left * sign) @ right
    spread = float(shares @ np.einsum("nd,nd->n", x, x))
    scale = 1.0
    if scaling:
        scale = max(0.0, float(singular @ sign) / spread) if spread > 0 else 0.0
    return Similarity(rotation, scale, target_mean - scale * rotation @ source_mean)


def similarity_freedom(n_points: int, dimensions: int, *, scaling: bool = True) -> int:
    """Return the degrees of freedom of the residuals of a similarity, at least 0."""
    k = dimensions
    return max(0, n_points * k - k - k * (k - 1) // 2 - scaling)


def extent(points: NDArray[np.float64]) -> float:
    """Return the root of the summed variance of the coordinates. points (n, k)."""
    return float(np.sqrt(np.sum(np.var(points, axis=0))))


def noise_scale(residuals: NDArray[np.float64], dimensions: int) -> float:
    """Estimate the standard deviation per coordinate from lengths of residuals, robustly.

    The median length over that of a standard normal vector (the median of the chi distribution).
    """
    return float(np.median(residuals) / np.sqrt(2 * gammaincinv(dimensions / 2, 0.5)))


def fit_similarity_robustly(
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    *,
    scaling: bool = True,
    reflection: bool | None = None,
) -> Similarity:
    """Fit a similarity that points far from their target do not bend.

    source, target (n, k).

    Iteratively reweighted least squares: first least absolute distances, then the weights of
    Geman & McClure (1987), which vanish for large residuals. Fewer than half of the points may be
    far off.
    """
    fits = []
    # Residuals of an exact fit are rounding errors, of which the ratios mean nothing.
    least = max(float(np.finfo(float).eps * np.ptp(target)), float(np.finfo(float).tiny))
    for hand in (False, True) if reflection is None else (reflection,):
        fit = fit_similarity(source, target, scaling=scaling, reflection=hand)
        weights = np.ones(len(source))
        for i in range(_MAX_ITERATIONS):
            residuals = np.linalg.norm(fit.apply(source) - target, axis=1)
            scale = max(noise_scale(residuals, source.shape[1]), least)
            before = weights
            if i < _FIRST_ITERATIONS:
                weights = scale / np.maximum(residuals, scale)
            else:
                weights = 1 / (1 + (residuals / (_WIDTH * scale)) ** 2) ** 2
            fit = fit_similarity(source, target, weights, scaling=scaling, reflection=hand)
            if i > _FIRST_ITERATIONS and np.abs(weights - before).max() < _CONVERGED:
                break
        fits.append((float(np.median(residuals)), hand, fit))
    return min(fits, key=lambda found: found[:2])[2]


_CONVERGED_POSES = 1e-8  # relative decrease of the objective
_FIRST_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-3, 1e-9, 1e9  # as usual for Levenberg-Marquardt
_DAMPING_STEP = 10.0


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of B rigid bodies: ``x = rotation[b] @ offset + translation[b]``.

    rotation (B, k, k)
    translation (B, k)
    """

    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]

    def points(self, offsets: NDArray[np.float64], body: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the positions of points, shape (n, k), from their offsets on their bodies."""
        turned = np.einsum("nij,nj->ni", self.rotation[body], offsets)
        return np.asarray(turned + self.translation[body])

    def moved(self, step: NDArray[np.float64]) -> Poses:
        """Turn and shift each body by a row of `step`: rotation vector or angle, then shift."""
        k = self.translation.shape[1]
        turn, shift = step[:, :-k], step[:, -k:]
        if k == 2:
            cosine, sine = np.cos(turn[:, 0]), np.sin(turn[:, 0])
            extra = np.array([[cosine, -sine], [sine, cosine]]).transpose(2, 0, 1)
        else:
            extra = Rotation.from_rotvec(turn).as_matrix()
        return Poses(extra @ self.rotation, self.translation + shift)


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is known of n points on rigid bodies.

    pairs: Points at a known distance.
    lengths (P,): Their distances.
    pair_sigma: Standard deviation of the distances.
    targets (n, k): Approximate positions; NaN for points without one.
    target_sigma: Their standard deviation per coordinate.
    """

    pairs: NDArray[np.intp]
    lengths: NDArray[np.float64]
    pair_sigma: float
    targets: NDArray[np.float64]
    target_sigma: float


def fit_poses(
    start: Poses, offsets: NDArray[np.float64], body: NDArray[np.intp], evidence: Evidence
) -> Poses:
    """Fit poses of rigid bodies to positions of points and to distances between them.

    offsets (n, k).

    Levenberg-Marquardt on the manifold of poses, with sparse normal equations (Nocedal & Wright
    2006, Numerical Optimization, section 10.3).
    """
    poses, damping = start, _FIRST_DAMPING
    residuals, jacobian = _linearised(poses, offsets, body, evidence)
    value = float(residuals @ residuals)
    for _ in range(_MAX_ITERATIONS):
        normal, slope = (jacobian.T @ jacobian).tocsc(), jacobian.T @ residuals
        scale = normal.diagonal()
        scale = scale + np.finfo(float).eps * max(float(scale.max()), 1.0)
        improved = False
        while damping < _MAX_DAMPING:
            step = -spsolve((normal + diags_array(damping * scale)).tocsc(), slope)
            trial = poses.moved(step.reshape(len(poses.translation), -1))
            found, found_jacobian = _linearised(trial, offsets, body, evidence)
            found_value = float(found @ found)
            if found_value < value:
                improved = True
                break
            damping *= _DAMPING_STEP
        if not improved:
            break
        decrease = (value - found_value) / value
        poses, residuals, jacobian, value = trial, found, found_jacobian, found_value
        damping = max(damping / _DAMPING_STEP, _MIN_DAMPING)
        if decrease < _CONVERGED_POSES:
            break
    return poses


def _linearised(
    poses: Poses, offsets: NDArray[np.float64], body: NDArray[np.intp], evidence: Evidence
) -> tuple[NDArray[np.float64], csr_array]:
    """Return errors in standard deviations, and their derivatives by turns and shifts of bodies."""
    points = poses.points(offsets, body)
    arms = points - poses.translation[body]
    first, second = evidence.pairs.T
    between = points[first] - points[second]
    distances = np.linalg.norm(between, axis=1)
    along = between / np.maximum(distances, np.finfo(float).tiny)[:, None] / evidence.pair_sigma
    known = np.flatnonzero(np.isfinite(evidence.targets).all(axis=1))
    offs = (points[known] - evidence.targets[known]) / evidence.target_sigma
    k = points.shape[1]
    unit = np.eye(k) / evidence.target_sigma
    rows = np.arange(len(first) + k * len(known))
    axes = rows[len(first) :].reshape(len(known), k)
    entries = [
        (rows[: len(first)], first, along),
        (rows[: len(first)], second, -along),
        *((axes[:, i], known, np.tile(unit[i], (len(known), 1))) for i in range(k)),
    ]
    width = k + (1 if k == 2 else 3)
    values, row_of, column_of = [], [], []
    for row, point, direction in entries:
        arm = arms[point]
        if k == 2:
            turn = (arm[:, 0] * direction[:, 1] - arm[:, 1] * direction[:, 0])[:, None]
        else:
            turn = np.cross(arm, direction)
        values.append(np.hstack([turn, direction]).ravel())
        row_of.append(np.repeat(row, width))
        column_of.append((body[point][:, None] * width + np.arange(width)).ravel())
    jacobian = coo_array(
        (np.concatenate(values), (np.concatenate(row_of), np.concatenate(column_of))),
        shape=(len(rows), width * len(poses.translation)),
    )
    errors = (distances - evidence.lengths) / evidence.pair_sigma
    return np.concatenate([errors, offs.ravel()]), jacobian.tocsr()


MIN_PLACES = 6
"""Fewest places: twice the three that determine a pose, so that a wrong one is outvoted."""

_PARAMETERS = 6  # of a pose
FAR = 4.0
"""Noise scales beyond which a place is wrong: 1 in 900 of normal errors in space."""


@dataclass(frozen=True, eq=False)
class PatchPose:
    """A transform from the frame of a patch to that of its link.

    similarity: Rigid.
    used: False for places that contradict the others.
    residuals (C,): Distances between the two places of each contact, in units of the link.
    sigma: Standard deviation of a coordinate of the places that were used.
    covariance (6, 6): Of a rotation vector about `centre` and a shift.
    centre (3,): In the frame of the link.
    """

    similarity: Similarity
    used: NDArray[np.bool_]
    residuals: NDArray[np.float64]
    sigma: float
    covariance: NDArray[np.float64]
    centre: NDArray[np.float64]

    @property
    def freedom(self) -> int:
        """Degrees of freedom of `sigma`."""
        return 3 * int(self.used.sum()) - _PARAMETERS

    def position_covariances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariances of points of the link, shape (n, 3), due to that of the pose.

        The result has the shape (n, 3, 3).
        """
        slopes = _derivatives(points - self.centre)
        return np.asarray(np.einsum("nip,pq,njq->nij", slopes, self.covariance, slopes))


def fit_patch_pose(places: NDArray[np.float64], targets: NDArray[np.float64]) -> PatchPose:
    """Fit the pose of a rigid patch to where it was touched.

    places (C, 3), targets (C, 3).

    Least squares of a pose have a closed form (Umeyama 1991), so for given weights the global
    minimum is found. Weights are those of `fit_similarity_robustly`; then wrong places are left out
    and the others count alike. The covariance is that of linear least squares at the minimum.
    """
    if len(places) < MIN_PLACES:
        raise InputError(
            f"a pose needs at least {MIN_PLACES} contacts between the patches, got {len(places)}"
        )
    robust = fit_similarity_robustly(places, targets, scaling=False, reflection=False)
    off = np.linalg.norm(robust.apply(places) - targets, axis=1)
    # Rounding errors of exact places must not exclude any.
    least = SINGULAR * float(np.ptp(targets))
    used = off <= FAR * max(noise_scale(off, 3), least)
    x, y = places[used], targets[used]
    widths = np.linalg.svd(x - x.mean(axis=0), compute_uv=False)
    if len(x) < MIN_PLACES or widths[1] <= SINGULAR * widths[0]:
        raise InputError(
            f"the pose is not determined: the {len(x)} contacts that agree are fewer than "
            f"{MIN_PLACES} or lie on a line of the patch; touch more of it, in other postures"
        )
    fit = fit_similarity(x, y, scaling=False, reflection=False)
    placed = fit.apply(x)
    centre = placed.mean(axis=0)
    slopes = _derivatives(placed - centre).reshape(-1, _PARAMETERS)
    errors = (placed - y).ravel()
    sigma = float(np.sqrt(errors @ errors / (len(errors) - _PARAMETERS)))
    return PatchPose(
        similarity=fit,
        used=used,
        residuals=np.linalg.norm(fit.apply(places) - targets, axis=1),
        sigma=sigma,
        covariance=np.asarray(sigma**2 * np.linalg.inv(slopes.T @ slopes), dtype=np.float64),
        centre=centre,
    )


def _derivatives(arms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the derivatives of points by rotation vector and shift, shape (n, 3, 6)."""
    found = np.zeros((len(arms), 3, _PARAMETERS))
    for i, axis in enumerate(np.eye(3)):
        found[:, :, i] = np.cross(axis, arms)
        found[:, i, 3 + i] = 1.0
    return found
