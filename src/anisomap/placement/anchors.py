"""Anchors (sensors with a known position), and transforms of maps to the frame of the anchors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from anisomap.base import METRES
from anisomap.base.immutable import Immutable
from anisomap.base.wording import join_items
from anisomap.errors import InputError
from anisomap.numerics.neighbours import Kernel, nearest_others
from anisomap.numerics.procrustes import SINGULAR, similarity_freedom
from anisomap.numerics.surfaces import Points
from anisomap.placement.handedness import (
    PRIOR_FREEDOM,
    Known,
    Tied,
    choose_hand,
    field_kernel,
    fit_scaled,
    krige,
)
from anisomap.sensor_map import SensorMap, check_coordinates

# Suggestion of anchors; tuned on real recordings, rubbed planes and cylinders.
_RING = 12  # neighbours that determine whether a sensor is inside
_SHARE_INSIDE = 0.5  # share of the sensors that count as inside


@dataclass(frozen=True, eq=False)
class Anchors(Immutable):
    """Sensors with a known position in the frame of the robot.

    Parameters
    ----------
    names : sequence of str
        Unique names of the sensors.
    positions : array_like of shape (n, 2) or (n, 3)
        In metres.

    Raises
    ------
    InputError
        If shapes disagree, names repeat, or a coordinate is not finite.
    """

    names: tuple[str, ...]
    positions: NDArray[np.float64]

    def __post_init__(self) -> None:
        positions = np.array(self.positions, dtype=np.float64)
        names = tuple(self.names)
        if positions.ndim != 2 or positions.shape[1] not in (2, 3) or len(positions) != len(names):
            raise InputError(f"{len(names)} anchors need 2 or 3 coordinates, got {positions.shape}")
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise InputError(f"anchor {join_items(repeated)} is given more than once")
        check_coordinates(positions, names, "among the anchors")
        self.set_fields(names=names, positions=positions)

    def select(self, rows: NDArray[np.intp]) -> Anchors:
        """Return some of the anchors."""
        return Anchors(tuple(self.names[i] for i in rows), self.positions[rows])


def parse_anchor(text: str) -> tuple[str, tuple[float, ...]]:
    """Parse an anchor such as ``s17=0.012,0.040,0.003``, in metres.

    Parameters
    ----------
    text : str

    Returns
    -------
    (str, tuple of float)
        Name of the sensor, and its two or three coordinates in metres.

    Raises
    ------
    InputError
        If the text is not a name, an equals sign and two or three numbers.
    """
    name, _, numbers = text.rpartition("=")
    try:
        position = tuple(float(number) for number in numbers.split(","))
    except ValueError:
        position = ()
    if not name or len(position) not in (2, 3) or not np.isfinite(position).all():
        raise InputError(f"{text!r} is not an anchor in metres, such as s17=0.012,0.040,0.003")
    return name, position


def anchors_at(given: Sequence[tuple[str, Sequence[float]]]) -> Anchors:
    """Make anchors from names and positions; positions in two dimensions have z = 0."""
    width = max(len(position) for _, position in given)
    rows = [(*position, *(0.0,) * (width - len(position))) for _, position in given]
    return Anchors(tuple(name for name, _ in given), np.array(rows))


def anchors_from_map(layout: SensorMap, units: str = "") -> Anchors:
    """Use the placed sensors of a layout as anchors.

    Parameters
    ----------
    layout : SensorMap
    units : str
        Unit of the layout, if the layout has none.

    Raises
    ------
    InputError
        If the unit is unknown.
    """
    unit = layout.units if layout.units in METRES else units
    if unit not in METRES:
        raise InputError("the unit of the anchors is unknown; give --units, or columns as x [mm]")
    placed = np.flatnonzero(layout.placed)
    names = tuple(layout.names[i] for i in placed)
    return Anchors(names, layout.positions[placed] * METRES[unit])


def suggest_anchors(sensor_map: SensorMap, count: int = 4) -> tuple[str, ...]:
    """Choose sensors to measure: far apart, and inside the skin, where maps are accurate.

    Parameters
    ----------
    sensor_map : SensorMap
    count : int
        Number of sensors of each component; at least 1.

    Returns
    -------
    tuple of str
        Names of the sensors; none of components of a single sensor.
    """
    found: list[str] = []
    for part in sensor_map.split():
        positions, n_sensors = part.positions, part.n_sensors
        if n_sensors < 2:
            continue
        distances, near = nearest_others(positions, _RING)
        centres = positions[near].mean(axis=1)
        # The neighbours of a sensor at the edge are on one side.
        lopsided = np.linalg.norm(centres - positions, axis=1) / distances.mean(axis=1)
        inside = np.flatnonzero(lopsided <= np.quantile(lopsided, _SHARE_INSIDE))
        middle = positions[inside].mean(axis=0)
        chosen = [int(inside[np.linalg.norm(positions[inside] - middle, axis=1).argmax()])]
        while len(chosen) < min(count, len(inside)):
            gaps = np.linalg.norm(positions[inside][:, None] - positions[chosen], axis=2)
            chosen.append(int(inside[gaps.min(axis=1).argmax()]))
        found += [part.names[i] for i in chosen]
    return tuple(found)


MIN_LEFT_OUT = 5
"""Minimum number of anchors for leave-one-out estimates of the error."""

COVERAGE = 0.9
"""Probability that a sensor is within its stated error."""

# Distortion of maps as a smooth field: reach in sizes of the map, and relative variance of
# independent errors. Tuned on the iCub hexagon, the plantar recording and rubbed planes; with less
# noise, independent errors would be underestimated.
_REACH, _NOISE = 1.0, 1.0
# Reaches and variances of further fields, tried with many anchors.
_REACHES, _NOISES = (0.25, 0.5, 1.0), (0.1, 0.3, 1.0)
_MIN_REACH = 3.0  # spacings; a field that changes faster would change the spacing
_MIN_LENGTH = 1e-50  # metres; fourth powers are within the range of float64
_MAX_FOLDS, _MANY, _FEW_FOLDS = 50, 200, 10  # groups left out in turn; fewer with many anchors


@dataclass(frozen=True, eq=False)
class AnchorFit:
    """A map in the frame of its anchors.

    positions (N, k): In metres.
    errors (N,): Radius with probability `COVERAGE`, in metres.
    residuals (n,): Distances of the anchors from their places on the map, in metres.
    left_out (n,): Residuals under fits to all other anchors; NaN with fewer than `MIN_LEFT_OUT`.
    warped: Whether a field of corrections was chosen by leaving anchors out.
    reflected: Whether the map was a mirror image.
    handed: Whether the handedness is known. If it is not, the skin is flat, and positions do not
        depend on the handedness.
    """

    positions: NDArray[np.float64]
    errors: NDArray[np.float64]
    residuals: NDArray[np.float64]
    left_out: NDArray[np.float64]
    warped: bool
    reflected: bool
    handed: bool


def fit_anchors(tied: Tied, known: Known) -> AnchorFit:
    """Transform a map to the frame of its anchors, by a similarity and a smooth field.

    With `MIN_LEFT_OUT` anchors or more, the field that best predicts left out anchors may be used.
    """
    x, y = tied.anchors, tied.targets
    _check_spread(x, known.spacing)
    furthest = float(np.abs(y).max())
    if np.ptp(y, axis=0).max() <= max(SINGULAR * furthest, _MIN_LENGTH):
        raise InputError(f"all {len(y)} anchors have the same position; measure them on the robot")
    reflected, handed = choose_hand(tied, known)
    fit = fit_scaled(x, y, known, reflected)
    n, k = y.shape
    kernel = usual = field_kernel(fit.apply(tied.positions), _REACH, _NOISE)
    left_out = np.full(n, np.nan)
    freedom = similarity_freedom(n, k, scaling=not np.isfinite(known.scale_sigma))
    variance = (fit.scale * known.sigma) ** 2 * PRIOR_FREEDOM
    if n >= MIN_LEFT_OUT:
        shortest = _MIN_REACH * (fit.scale * known.spacing)
        reaches = sorted({max(factor * (usual.reach / _REACH), shortest) for factor in _REACHES})
        kernels = [usual, *(Kernel(reach, noise) for reach in reaches for noise in _NOISES)]
        kernel, predictions, relative = _choose_kernel(x, y, known, reflected, kernels)
        left_out = np.linalg.norm(predictions - y, axis=1)
        variance += float(np.sum(left_out**2 / relative)) * freedom / (n * k)
    else:
        variance += float(np.sum((fit.apply(x) - y) ** 2))
    variance /= PRIOR_FREEDOM + freedom
    warped = kernel is not usual
    found = krige(x, y, tied.positions, fit, known, kernel=kernel, validated=warped)
    quantile = fdtri(k, PRIOR_FREEDOM + freedom, COVERAGE)
    return AnchorFit(
        positions=found.positions,
        errors=np.sqrt(variance * found.relative * k * quantile),
        residuals=np.linalg.norm(fit.apply(x) - y, axis=1),
        left_out=left_out,
        warped=warped,
        reflected=reflected,
        handed=handed,
    )


def _check_spread(anchors: Points, spacing: float) -> None:
    n, k = anchors.shape
    if n < k:
        raise InputError(f"positions in {k} coordinates need at least {k} anchors, got {n}")
    widths = np.linalg.svd(anchors - anchors.mean(axis=0), compute_uv=False)
    if widths[k - 2] / np.sqrt(n) < spacing / 2:
        where = "at one place" if k == 2 else "on a line"
        raise InputError(f"the {n} anchors lie {where} on the map; give another one far from them")


def _choose_kernel(
    x: Points, y: Points, known: Known, reflected: bool, kernels: list[Kernel]
) -> tuple[Kernel, Points, NDArray[np.float64]]:
    """Choose a field of corrections that predicts left out anchors better than the first field.

    The gain must exceed its standard error. Returns kernel, predictions (n, k), relative (n,).
    """
    n = len(x)
    predictions = np.empty((len(kernels), *y.shape))
    relative = np.empty((len(kernels), n))
    for fold in np.array_split(np.arange(n), min(n, _FEW_FOLDS if n > _MANY else _MAX_FOLDS)):
        rest = np.setdiff1d(np.arange(n), fold)
        fit = fit_scaled(x[rest], y[rest], known, reflected)
        for i, kernel in enumerate(kernels):
            found = krige(x[rest], y[rest], x[fold], fit, known, kernel=kernel, validated=i > 0)
            predictions[i, fold], relative[i, fold] = found.positions, found.relative
    squares = np.sum((predictions - y) ** 2, axis=2)
    gain = squares[0] - squares
    worth = gain.mean(axis=1) - gain.std(axis=1) / np.sqrt(n)
    best = int(np.argmax(worth)) if worth.max() > 0 else 0
    return kernels[best], predictions[best], relative[best]
