"""The transform from a map to the frame of its anchors, with an error for each sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from anisomap.errors import InputError
from anisomap.numerics.kriging import Kernel
from anisomap.numerics.procrustes import Similarity, fit_similarity

MIN_LEFT_OUT = 5
"""Number of anchors from which each is left out in turn to measure the error."""

COVERAGE = 0.9
"""Probability that a sensor is within its stated error."""

DECISIVE = float(np.log(1000.0))
"""Log likelihood ratio from which the handedness counts as known: odds of 1000 to 1."""

# Error of a coordinate of a map in spacings, and its weight in degrees of freedom, before anchors
# tell more. On the iCub torso the RMS distance of .73 spacings is .52 per coordinate.
_PRIOR_SIGMA, _PRIOR_FREEDOM = 0.5, 4.0
# Distortion of maps as a smooth field: its reach in sizes of the map, and the variance of the rest
# relative to it. Tuned on the iCub hexagon, the plantar recording and rubbed planes, seeds 301 and
# 302, with 4 random anchors. Less noise lowers their errors by another 1 %, but the errors of maps
# with independent errors are then stated too small.
_REACH, _NOISE = 1.0, 1.0
# Other fields that are tried with many anchors, likewise.
_REACHES, _NOISES = (0.25, 0.5, 1.0), (0.1, 0.3, 1.0)
_MIN_REACH = 3.0  # spacings; a field that changes faster would change the spacing
_MAX_FOLDS, _MANY, _FEW_FOLDS = 50, 200, 10  # groups left out in turn; fewer of many anchors


@dataclass(frozen=True)
class Known:
    """What is known of a map before anchors are used.

    Parameters
    ----------
    spacing : float
        Distance between neighbouring sensors on the map.
    scale_sigma : float
        Standard deviation of the logarithm of the scale; inf if the scale is unknown.
    evidence : float
        Log likelihood ratio of the handedness of the map against its mirror image.
    handedness : bool, optional
        Whether the map is a mirror image, if the user states it.
    """

    spacing: float
    scale_sigma: float = np.inf
    evidence: float = 0.0
    handedness: bool | None = None


@dataclass(frozen=True, eq=False)
class AnchorFit:
    """A map in the frame of its anchors.

    Attributes
    ----------
    positions : ndarray of shape (N, k)
        In metres.
    errors : ndarray of shape (N,)
        Radius with probability `COVERAGE`, in metres.
    residuals : ndarray of shape (n,)
        Distances of the anchors from their places on the map, in metres.
    left_out : ndarray of shape (n,)
        The same with a fit to the other anchors; NaN with fewer than `MIN_LEFT_OUT`.
    warped : bool
        Whether anchors that were left out tell the field of corrections.
    reflected : bool
        Whether the map was a mirror image.
    handed : bool
        Whether the handedness is known. If not, the skin is flat, and its positions do not depend
        on it.
    """

    positions: NDArray[np.float64]
    errors: NDArray[np.float64]
    residuals: NDArray[np.float64]
    left_out: NDArray[np.float64]
    warped: bool
    reflected: bool
    handed: bool


def fit_anchors(
    positions: NDArray[np.float64],
    sensors: NDArray[np.intp],
    targets: NDArray[np.float64],
    known: Known,
) -> AnchorFit:
    """Transform a map to the frame of its anchors.

    A similarity and a smooth field of corrections are fitted together, with the scale weighted by
    what anchors and prior knowledge are worth. With `MIN_LEFT_OUT` and more anchors another field
    is taken if it predicts anchors that were left out better.

    Parameters
    ----------
    positions : ndarray of shape (N, k)
        The map, of one component, k = 2 or 3. A flat map in space has zeros as third coordinates.
    sensors : ndarray of int, shape (n,)
        Rows of the anchors.
    targets : ndarray of shape (n, k)
        Positions of the anchors in metres.
    known : Known

    Returns
    -------
    AnchorFit

    Raises
    ------
    InputError
        If anchors are too few or on a line, or do not determine the handedness.
    """
    _check_spread(positions, sensors, known.spacing)
    reflected, handed = _choose_hand(positions, sensors, targets, known)
    x, y = positions[sensors], targets
    fit = _fit(x, y, known, reflected)
    n, k = y.shape
    usual = _usual_kernel(fit.apply(positions))
    kernel = usual
    left_out = np.full(n, np.nan)
    spacing = fit.scale * known.spacing
    freedom = n * k - k - k * (k - 1) // 2 - int(not np.isfinite(known.scale_sigma))
    variance = (spacing * _PRIOR_SIGMA) ** 2 * _PRIOR_FREEDOM
    if n >= MIN_LEFT_OUT:
        size = usual.reach / _REACH
        reaches = sorted({max(factor * size, _MIN_REACH * spacing) for factor in _REACHES})
        kernels = [usual, *(Kernel(reach, noise) for reach in reaches for noise in _NOISES)]
        kernel, predictions, relative = _choose_kernel(x, y, known, reflected, kernels)
        left_out = np.linalg.norm(predictions - y, axis=1)
        variance += float(np.sum(left_out**2 / relative)) * freedom / (n * k)
    else:
        variance += float(np.sum((fit.apply(x) - y) ** 2))
    variance /= _PRIOR_FREEDOM + max(freedom, 0)
    found = _krige(x, y, positions, fit, known, kernel=kernel, told=kernel is not usual)
    quantile = fdtri(k, _PRIOR_FREEDOM + max(freedom, 0), COVERAGE)
    return AnchorFit(
        positions=found.positions,
        errors=np.sqrt(variance * found.relative * k * quantile),
        residuals=np.linalg.norm(fit.apply(x) - y, axis=1),
        left_out=left_out,
        warped=kernel is not usual,
        reflected=reflected,
        handed=handed,
    )


def _check_spread(
    positions: NDArray[np.float64], sensors: NDArray[np.intp], spacing: float
) -> None:
    n, k = len(sensors), positions.shape[1]
    if n < k:
        raise InputError(f"positions in {k} coordinates need at least {k} anchors, got {n}")
    anchors = positions[sensors] - positions[sensors].mean(axis=0)
    spread = np.linalg.svd(anchors, compute_uv=False)[k - 2] / np.sqrt(n)
    if spread < spacing / 2:
        where = "at one place" if k == 2 else "on a line"
        raise InputError(
            f"the {n} anchors lie {where} on the map, so the rotation is unknown; give another "
            "anchor far from them"
        )


def _choose_hand(
    positions: NDArray[np.float64],
    sensors: NDArray[np.intp],
    targets: NDArray[np.float64],
    known: Known,
) -> tuple[bool, bool]:
    """Return whether to reflect the map, and whether that is known rather than irrelevant."""
    k = positions.shape[1]
    x = positions[sensors]
    fits = [_fit(x, targets, known, hand) for hand in (False, True)]
    squares = [
        _krige(x, targets, x, fit, known, kernel=_usual_kernel(fit.apply(positions))).squares
        for fit in fits
    ]
    better = int(squares[1] < squares[0])
    sigma = _PRIOR_SIGMA * fits[better].scale * known.spacing
    freedom = max(0, targets.size - k - k * (k - 1) // 2 - 1)
    # The variance of errors is unknown: its prior makes the likelihoods those of Student's t.
    same, mirrored = (_PRIOR_FREEDOM * sigma**2 + value for value in squares)
    evidence = known.evidence + (_PRIOR_FREEDOM + freedom) / 2 * float(np.log(mirrored / same))
    if known.handedness is not None:
        against = evidence if known.handedness else -evidence
        if against > DECISIVE:
            raise InputError(
                "the anchors contradict the stated handedness; check their positions and names"
            )
        return known.handedness, True
    if abs(evidence) >= DECISIVE:
        return evidence < 0, True
    apart = fits[0].apply(positions) - fits[1].apply(positions)
    if float(np.mean(apart**2)) < sigma**2:
        return bool(better), False
    more = (
        "a third anchor off their line"
        if k == 2
        else "a fourth anchor off their plane (map a flat skin in 2D)"
    )
    raise InputError(
        f"the anchors do not tell the map from its mirror image; give {more}, --mesh, --module, or "
        "--handedness same or mirrored"
    )


def _fit(
    x: NDArray[np.float64], y: NDArray[np.float64], known: Known, reflected: bool
) -> Similarity:
    """Fit a similarity of given handedness; its scale is a compromise with what is known of it."""
    free = fit_similarity(x, y, reflection=reflected)
    if not np.isfinite(known.scale_sigma):
        return free
    sigma = _PRIOR_SIGMA * known.spacing / float(np.sqrt(np.sum((x - x.mean(axis=0)) ** 2)))
    weight = known.scale_sigma**2 / (known.scale_sigma**2 + sigma**2)
    scale = float(np.exp(weight * np.log(max(free.scale, np.finfo(float).tiny))))
    rigid = fit_similarity(scale * x, y, scaling=False, reflection=reflected)
    return Similarity(rigid.rotation, scale, rigid.translation)


def _usual_kernel(placed: NDArray[np.float64]) -> Kernel:
    """Return the field by which maps are distorted, for a map in the frame of the anchors."""
    size = float(np.sqrt(np.sum(np.var(placed, axis=0))))
    return Kernel(max(_REACH * size, float(np.finfo(float).tiny)), _NOISE)


@dataclass(frozen=True, eq=False)
class _Kriged:
    """Positions in the frame of the anchors, and variances relative to that of the map.

    `squares` is the weighted sum of squares of residuals; its expectation is the variance of the
    map times the degrees of freedom.
    """

    positions: NDArray[np.float64]
    relative: NDArray[np.float64]
    squares: float


def _krige(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    positions: NDArray[np.float64],
    fit: Similarity,
    known: Known,
    *,
    kernel: Kernel,
    told: bool = False,
) -> _Kriged:
    """Predict positions by universal kriging, with small changes of a similarity as the drift.

    Chiles & Delfiner (2012), Geostatistics, section 3.4.
    """
    anchors, placed = fit.apply(x), fit.apply(positions)
    centre, k = anchors.mean(axis=0), anchors.shape[1]
    size = float(np.sqrt(np.mean(np.sum((anchors - centre) ** 2, axis=1))))
    here, there = (_derivatives((points - centre) / size) for points in (anchors, placed))
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
        # The last parameter is the change of the scale, which the fit knows from elsewhere.
        sigma = _PRIOR_SIGMA * known.spacing * fit.scale / np.sqrt(total)
        precision = (sigma / (size * max(known.scale_sigma, np.finfo(float).eps))) ** 2
        information[-1, -1] += precision
        wanted[-1] -= precision * size * np.log(fit.scale)
    spread = np.linalg.pinv(information, rcond=1e-9)
    drift = spread @ wanted
    rest = residual - here @ drift
    # Errors are stated as for a similarity whose errors are independent, unless anchors that were
    # left out told the field: a wrong field must not make them smaller.
    even = np.linalg.pinv(np.einsum("nki,nkj->ij", here, here), rcond=1e-9)
    relative = 1.0 + np.einsum("mki,ij,mkj->m", there, even, there) / k
    if told:
        relative -= np.einsum("mn,mn->m", weights, across) / total
    return _Kriged(
        placed + there @ drift + weights @ rest,
        np.maximum(relative, 0.0),
        float(total * np.einsum("nk,nm,mk->", rest, inverse, rest)),
    )


def _derivatives(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return derivatives of points by shift, rotation and scale of a similarity, (n, k, p)."""
    n, k = points.shape
    shift = np.tile(np.eye(k), (n, 1, 1))
    turns = []
    for i in range(k):
        for j in range(i):
            turn = np.zeros((n, k, 1))
            turn[:, i, 0], turn[:, j, 0] = points[:, j], -points[:, i]
            turns.append(turn)
    return np.concatenate([shift, *turns, points[:, :, None]], axis=2)


def _choose_kernel(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    known: Known,
    reflected: bool,
    kernels: list[Kernel],
) -> tuple[Kernel, NDArray[np.float64], NDArray[np.float64]]:
    """Choose a field of corrections by leaving anchors out.

    Another field than the first is used only if it lowers the squared error of anchors that were
    left out by more than the standard error of the difference.

    Returns
    -------
    kernel : Kernel
    predictions : ndarray of shape (n, k)
        Of each anchor without it.
    relative : ndarray of shape (n,)
        Their variances relative to that of the map.
    """
    n = len(x)
    predictions = np.empty((len(kernels), *y.shape))
    relative = np.empty((len(kernels), n))
    for fold in np.array_split(np.arange(n), min(n, _FEW_FOLDS if n > _MANY else _MAX_FOLDS)):
        rest = np.setdiff1d(np.arange(n), fold)
        fit = _fit(x[rest], y[rest], known, reflected)
        for i, kernel in enumerate(kernels):
            found = _krige(x[rest], y[rest], x[fold], fit, known, kernel=kernel, told=i > 0)
            predictions[i, fold], relative[i, fold] = found.positions, found.relative
    squares = np.sum((predictions - y) ** 2, axis=2)
    gain = squares[0] - squares
    worth = gain.mean(axis=1) - gain.std(axis=1) / np.sqrt(n)
    best = int(np.argmax(worth)) if worth.max() > 0 else 0
    return kernels[best], predictions[best], relative[best]
