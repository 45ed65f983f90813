"""The transform from a map to the frame of its anchors, with an error for each sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from anisomap.errors import InputError
from anisomap.numerics.kriging import Kernel, predict_field
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
# Fields of correction that are tried, in sizes of the map and in variances of the field.
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
        Whether a smooth field corrects the similarity.
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

    A similarity is fitted, with the scale weighted by what anchors and prior knowledge are worth.
    With `MIN_LEFT_OUT` and more anchors a smooth field of corrections is added if it predicts
    anchors that were left out better.

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
    kernel: Kernel | None = None
    left_out = np.full(n, np.nan)
    spacing = fit.scale * known.spacing
    freedom = n * k - k - k * (k - 1) // 2 - int(not np.isfinite(known.scale_sigma))
    variance = (spacing * _PRIOR_SIGMA) ** 2 * _PRIOR_FREEDOM
    residual = np.linalg.norm(fit.apply(x) - y, axis=1)
    if n >= MIN_LEFT_OUT:
        size = float(np.sqrt(np.sum(np.var(fit.apply(positions), axis=0))))
        reaches = sorted({max(factor * size, _MIN_REACH * spacing) for factor in _REACHES})
        kernel, predictions, relative = _choose_kernel(x, y, known, reflected, reaches)
        left_out = np.linalg.norm(predictions - y, axis=1)
        variance += float(np.sum(left_out**2 / relative)) * freedom / (n * k)
    else:
        variance += float(np.sum(residual**2))
    variance /= _PRIOR_FREEDOM + max(freedom, 0)
    found, relative = _predict(x, y, positions, fit, kernel)
    quantile = fdtri(k, _PRIOR_FREEDOM + max(freedom, 0), COVERAGE)
    return AnchorFit(
        positions=found,
        errors=np.sqrt(variance * relative * k * quantile),
        residuals=residual,
        left_out=left_out,
        warped=kernel is not None,
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
    squares = [float(np.sum((fit.apply(x) - targets) ** 2)) for fit in fits]
    better = int(squares[1] < squares[0])
    sigma = _PRIOR_SIGMA * fits[better].scale * known.spacing
    freedom = max(0, targets.size - k - k * (k - 1) // 2 - 1)
    variance = (_PRIOR_FREEDOM * sigma**2 + min(squares)) / (_PRIOR_FREEDOM + freedom)
    evidence = known.evidence + (squares[1] - squares[0]) / (2 * variance)
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


def _predict(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    positions: NDArray[np.float64],
    fit: Similarity,
    kernel: Kernel | None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return positions in the frame of the anchors, and variances relative to that of the map."""
    placed = fit.apply(positions)
    leverage = _leverage(fit.apply(x), placed)
    if kernel is None:
        return placed, 1.0 + leverage
    field, variance = predict_field(fit.apply(x), y - fit.apply(x), placed, kernel)
    share = 1.0 / (1.0 + kernel.noise)
    return placed + field, share * variance + (1.0 - share) + leverage


def _leverage(anchors: NDArray[np.float64], where: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variance of the fitted similarity at points, for unit variance of the anchors."""
    centre = anchors.mean(axis=0)
    size = float(np.sqrt(np.mean(np.sum((anchors - centre) ** 2, axis=1))))
    derivative = _derivatives((anchors - centre) / size)
    covariance = np.linalg.pinv(np.einsum("nki,nkj->ij", derivative, derivative), rcond=1e-9)
    there = _derivatives((where - centre) / size)
    k = anchors.shape[1]
    return np.asarray(np.einsum("nki,ij,nkj->n", there, covariance, there) / k)


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
    reaches: list[float],
) -> tuple[Kernel | None, NDArray[np.float64], NDArray[np.float64]]:
    """Choose a field of corrections, or none, by leaving anchors out.

    A field is used only if it lowers the squared error of anchors that were left out by more than
    the standard error of the difference.

    Returns
    -------
    kernel : Kernel or None
    predictions : ndarray of shape (n, k)
        Of each anchor without it.
    relative : ndarray of shape (n,)
        Their variances relative to that of the map.
    """
    kernels = [None, *(Kernel(reach, noise) for reach in reaches for noise in _NOISES)]
    n = len(x)
    predictions = np.empty((len(kernels), *y.shape))
    relative = np.empty((len(kernels), n))
    for fold in np.array_split(np.arange(n), min(n, _FEW_FOLDS if n > _MANY else _MAX_FOLDS)):
        rest = np.setdiff1d(np.arange(n), fold)
        fit = _fit(x[rest], y[rest], known, reflected)
        for i, kernel in enumerate(kernels):
            found = _predict(x[rest], y[rest], x[fold], fit, kernel)
            predictions[i, fold], relative[i, fold] = found
    squares = np.sum((predictions - y) ** 2, axis=2)
    gain = squares[0] - squares
    worth = gain.mean(axis=1) - gain.std(axis=1) / np.sqrt(n)
    best = int(np.argmax(worth)) if worth.max() > 0 else 0
    return kernels[best], predictions[best], relative[best]
