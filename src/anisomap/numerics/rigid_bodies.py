"""Poses of rigid bodies from the distances between points on different bodies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation

_MAX_ITERATIONS = 100  # most fits converge within 30
_CONVERGED = 1e-8  # relative decrease of the objective
_FIRST_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-3, 1e-9, 1e9  # as usual for Levenberg-Marquardt
_DAMPING_STEP = 10.0


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of B rigid bodies: ``x = rotation[b] @ offset + translation[b]``.

    Attributes
    ----------
    rotation : ndarray of shape (B, k, k)
    translation : ndarray of shape (B, k)
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

    Attributes
    ----------
    pairs : ndarray of int, shape (P, 2)
        Points at a known distance.
    lengths : ndarray of shape (P,)
        Their distances.
    pair_sigma : float
        Standard deviation of the distances.
    targets : ndarray of shape (n, k)
        Approximate positions; NaN for points without one.
    target_sigma : float
        Their standard deviation per coordinate.
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

    Parameters
    ----------
    start : Poses
        Initial poses.
    offsets : ndarray of shape (n, k), k = 2 or 3
        Points in the frames of their bodies.
    body : ndarray of int, shape (n,)
        Body of each point.
    evidence : Evidence

    Returns
    -------
    Poses
        A local minimum of the sum of squared errors of distances and positions, each in units of
        its standard deviation.

    Notes
    -----
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
        if decrease < _CONVERGED:
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
