"""Score of a map against the truth: Procrustes alignment, kept neighbours, Mantel r."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from anisomap.base import METRES, PERMUTATIONS
from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation.mantel_r import MIN_SENSORS_COMPARED, Mantel, mantel
from anisomap.names import default_names, match_sensors
from anisomap.numerics.neighbours import nearest_distances, nearest_others, padded
from anisomap.numerics.procrustes import Similarity, fit_similarity
from anisomap.recording import Recording
from anisomap.sensor_map import UNSCALED, SensorMap, check_coordinates


@dataclass(frozen=True, eq=False)
class Alignment(Similarity):
    """The similarity transform that best aligns a configuration with the truth.

    ``aligned = scale * positions @ rotation.T + translation``, in the units of the truth. If
    dimensions differ, the smaller configuration is padded with zeros.

    Attributes
    ----------
    rotation : ndarray of shape (k, k)
        Orthogonal; its determinant is -1 if `reflected`.
    scale : float
        Units of the truth per unit of the map.
    translation : ndarray of shape (k,)
        In units of the truth.
    reflected : bool
        Whether a mirror image fits better. Readings do not determine handedness.
    aligned : ndarray of shape (N, k)
        The map in the frame of the truth.
    errors : ndarray of shape (N,)
        Distance of each sensor from its true position.
    """

    aligned: NDArray[np.float64]
    errors: NDArray[np.float64]

    @property
    def rms(self) -> float:
        """Root mean square of `errors`, in units of the truth."""
        return float(np.sqrt(np.mean(self.errors**2)))

    def apply(self, positions: ArrayLike) -> NDArray[np.float64]:
        """Transform other points of the map, such as sensors without a true position.

        Parameters
        ----------
        positions : array_like of shape (n, k) or fewer columns
            In the frame and units of the map; padded with zeros as the map was.

        Returns
        -------
        ndarray of shape (n, k)
            In the frame and units of the truth; NaN where `positions` are NaN.

        Raises
        ------
        InputError
            If the points have more dimensions than the alignment.
        """
        points = np.array(positions, dtype=np.float64)
        most = len(self.translation)
        if points.ndim != 2 or points.shape[1] > most:
            raise InputError(f"positions may have at most {most} columns, got {points.shape}")
        return super().apply(padded(points, most))


def align(positions: ArrayLike, truth: ArrayLike) -> Alignment:
    """Align a configuration with the truth by rotation, scaling, translation and reflection.

    Parameters
    ----------
    positions, truth : array_like of shape (N, k), (N, l)
        The same sensors in the same order.

    Returns
    -------
    Alignment
        The least-squares optimum (ordinary Procrustes analysis with scaling and reflection).

    Raises
    ------
    InputError
        If the numbers of sensors differ, a coordinate is not finite or above 1e100, or a
        configuration is a single point.

    Notes
    -----
    Schoenemann & Carroll (1970), Psychometrika 35: 245-255, doi:10.1007/BF02291266. A flat
    configuration in space equals its mirror image and is never reported as reflected.
    """
    x, y = np.array(positions, dtype=np.float64), np.array(truth, dtype=np.float64)
    if x.ndim != 2 or y.ndim != 2 or len(x) != len(y):
        raise InputError(f"positions and truth must have as many rows, got {x.shape} and {y.shape}")
    dimensions = max(x.shape[1], y.shape[1])
    x, y = padded(x, dimensions), padded(y, dimensions)
    for points, where in ((x, "on the map"), (y, "in truth")):
        check_coordinates(points, default_names(len(points)), where)
    if (x == x[0]).all() or (y == y[0]).all():
        raise InputError("all positions coincide, so an alignment is undefined")
    fit = fit_similarity(x, y)
    aligned = fit.apply(x)
    errors = np.linalg.norm(aligned - y, axis=1)
    return Alignment(fit.rotation, fit.scale, fit.translation, aligned, errors)


NEIGHBOURS = 6
"""Number of neighbours of a sensor on a triangular lattice, the densest packing in the plane."""

TIE = 1e-3
"""Relative difference below which two distances are equal.

Files store positions as float32 or with four to six digits, so that equal distances of a lattice
differ by up to about 1e-4; the errors of maps are far larger.
"""

_SHELLS = 16  # neighbours searched around a tie, per neighbour requested


def median_spacing(positions: ArrayLike) -> float:
    """Compute the median distance from a sensor to its nearest neighbour.

    Parameters
    ----------
    positions : array_like of shape (N, k)
        Finite positions of at least two sensors.

    Returns
    -------
    float
        In the units of `positions`.
    """
    return float(np.median(nearest_distances(np.asarray(positions, dtype=np.float64))))


def check_distances(positions: NDArray[np.float64], what: str) -> None:
    """Check that positions differ, and that the squares of their distances are finite.

    positions (N, k).
    """
    placed = positions[np.isfinite(positions).all(axis=1)]
    with np.errstate(over="ignore", under="ignore"):
        square = float(((placed.max(axis=0) - placed.min(axis=0)) ** 2).sum()) if len(placed) else 0
    if square == 0:
        raise InputError(f"all sensors of {what} have the same position")
    if not np.isfinite(square):
        raise InputError(f"the distances of {what} are out of range; check its units")


def neighbour_agreement(
    positions: ArrayLike, truth: ArrayLike, *, n_neighbours: int = NEIGHBOURS
) -> float:
    """Compute the share of nearest neighbours on the map that are nearest neighbours in the truth.

    Parameters
    ----------
    positions, truth : array_like of shape (N, k), (N, l)
        The same sensors in the same order.
    n_neighbours : int
        Number of nearest neighbours; at most N - 1 are used.

    Returns
    -------
    float
        In [0, 1]; about ``n_neighbours / (N - 1)`` by chance, and more with ties.

    Notes
    -----
    Distances that differ by less than 0.1 % are ties. In the truth, all sensors tied with the last
    neighbour count as neighbours. On the map, the sensors tied with the last neighbour share the
    remaining places equally, so that coincident sensors on a map are no advantage. Ties are
    searched for among the ``16 * n_neighbours`` nearest sensors.
    """
    x, y = np.asarray(positions, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    count = min(n_neighbours, len(x) - 1)
    reach = (1 + TIE) * nearest_others(y, count)[0][:, -1]
    distances, neighbours = nearest_others(x, count + 1)
    found = _share(distances, _near(y, neighbours, reach), count)
    tied = distances[:, -1] <= (1 + TIE) * distances[:, count - 1]
    if tied.any() and count < len(x) - 1:
        distances, neighbours = nearest_others(x, _SHELLS * count, np.flatnonzero(tied))
        found[tied] = _share(distances, _near(y, neighbours, reach, tied), count)
    return float(found.mean())


def _share(
    distances: NDArray[np.float64], right: NDArray[np.bool_], count: int
) -> NDArray[np.float64]:
    """Share of true neighbours among the `count` nearest of each row; mean over orders of ties."""
    last = distances[:, count - 1, None]
    certain, within = distances < (1 - TIE) * last, distances <= (1 + TIE) * last
    tied = within & ~certain
    places = (count - certain.sum(axis=1)) / tied.sum(axis=1)
    return np.asarray(((certain & right).sum(axis=1) + places * (tied & right).sum(axis=1)) / count)


def _near(
    points: NDArray[np.float64],
    neighbours: NDArray[np.intp],
    reach: NDArray[np.float64],
    rows: NDArray[np.bool_] | slice = slice(None),
) -> NDArray[np.bool_]:
    """Mark the listed neighbours of each point that lie within its reach."""
    apart = np.linalg.norm(points[rows, None] - points[neighbours], axis=2)
    return np.asarray(apart <= reach[rows, None])


MAX_ALL_PAIRS = 4000
"""Maximum number of sensors for which Mantel r uses all pairs."""

SAMPLED = 2000
"""Number of sensors sampled from a larger map."""


@dataclass(frozen=True, eq=False, repr=False)
class Score:
    """Comparison of a map with the truth.

    Attributes
    ----------
    mantel : Mantel
        Mantel r and its null.
    alignment : Alignment
        The map aligned with the truth.
    truth : ndarray of shape (n, l)
        True positions of the sensors that were compared.
    sensors : ndarray of int, shape (n,)
        Indices of the sensors that were compared.
    spacing : float
        Median distance between true neighbours, in units of the truth.
    neighbours_kept : float
        See `neighbour_agreement`.
    excluded : ndarray of int
        Indices of the sensors that were excluded on request.
    units : str
        Units of the truth.
    notes : tuple of str
        Sensors that were not compared, and other caveats.
    scale : float
        Size of the map relative to the truth, if both have units; else NaN.
    rigid_rms : float
        RMS error after alignment without scaling, in units of the truth; NaN without units.
    """

    mantel: Mantel
    alignment: Alignment
    truth: NDArray[np.float64]
    sensors: NDArray[np.intp]
    spacing: float
    neighbours_kept: float
    excluded: NDArray[np.intp]
    units: str
    notes: tuple[str, ...]
    scale: float = math.nan
    rigid_rms: float = math.nan

    def __repr__(self) -> str:
        units = f" {self.units}" if self.units else ""
        return (
            f"<Score: Mantel r={self.mantel.r:.4f}, RMS error {self.rms:.4g}{units} "
            f"({self.rms_in_spacings:.3g} spacings), {len(self.sensors)} sensors compared>"
        )

    @property
    def rms(self) -> float:
        """RMS error after alignment, in units of the truth."""
        return self.alignment.rms

    @property
    def rms_in_spacings(self) -> float:
        """RMS error after alignment, in units of the median sensor spacing."""
        return self.rms / self.spacing if self.spacing > 0 else float("inf")

    @property
    def median_error(self) -> float:
        """Median error after alignment, in units of the truth; robust to a few large errors."""
        return float(np.median(self.alignment.errors))

    def worst(self, count: int = 5) -> NDArray[np.intp]:
        """Return the indices in `sensors` of those with the largest errors, the worst first."""
        return np.argsort(-self.alignment.errors, kind="stable")[:count]

    @property
    def exchanged(self) -> tuple[tuple[int, int], ...]:
        """Pairs of indices of sensors that occupy each other's places, as if wires were exchanged.

        Both errors exceed a spacing; if the two sensors were exchanged, both would be below it.
        """
        far = np.flatnonzero(self.alignment.errors > self.spacing)
        if len(far) < 2:
            return ()
        aligned = self.alignment.aligned[far]
        truth = padded(self.truth[far], aligned.shape[1])
        across, partner = map(np.asarray, KDTree(truth).query(aligned))
        first = np.arange(len(far))
        mutual = (first < partner) & (partner[partner] == first)
        mutual &= np.maximum(across, across[partner]) < self.spacing
        pairs = self.sensors[far[np.column_stack([first, partner])[mutual]]]
        return tuple((int(i), int(j)) for i, j in pairs)


def score(
    sensor_map: SensorMap,
    truth: SensorMap | Recording | ArrayLike,
    *,
    exclude: Iterable[str | int] = (),
    units: str = "",
    permutations: int = PERMUTATIONS,
    rng: np.random.Generator | int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Score:
    """Compare a map with the true positions of its sensors.

    Parameters
    ----------
    sensor_map : SensorMap
        Sensors without a position are not compared, nor are those outside the largest connected
        component, since their relative position is unknown.
    truth : SensorMap, Recording or array_like of shape (N, 2) or (N, 3)
        True positions. An array is in the order of the map, with NaN for unknown positions. A map
        or recording is matched by sensor names and gives the units; if one side has no names, it is
        matched by order, with a note and a warning.
    exclude : iterable of str or int
        Sensors to leave out of the comparison, by name or index; such as failed sensors.
    units : str
        Units of the truth, if it is an array.
    permutations, rng, progress
        See `mantel`. For more than 4000 sensors, Mantel r and its null use a random sample of
        2000, with a note; all other results use all sensors.

    Returns
    -------
    Score

    Raises
    ------
    InputError
        If the truth does not match the sensors of the map, an excluded sensor is unknown, or fewer
        than 4 sensors can be compared.
    """
    notes: tuple[str, ...] = ()
    if not isinstance(sensor_map, SensorMap):
        raise InputError("score takes a SensorMap first; mantel and align compare arrays")
    if isinstance(truth, Recording):
        if truth.positions is None:
            raise InputError("the recording has no true positions to score against")
        truth = SensorMap(truth.positions, names=truth.names, units=truth.units)
    if isinstance(truth, SensorMap):
        units = truth.units
        rows, notes = match_sensors(sensor_map.names, truth.names, "map and truth")
        true_positions = np.where(rows[:, None] >= 0, truth.positions[rows], np.nan)
        for note in notes:
            warnings.warn(note, AnisomapWarning, stacklevel=2)
    else:
        true_positions = np.asarray(truth, dtype=np.float64)
    if true_positions.ndim != 2 or len(true_positions) != sensor_map.n_sensors:
        raise InputError(f"true positions need {len(sensor_map)} rows, got {true_positions.shape}")
    included = np.ones(sensor_map.n_sensors, dtype=bool)
    included[sensor_map.indices(exclude)] = False
    known = np.asarray(np.isfinite(true_positions).all(axis=1))
    chosen, left_out = _compared(sensor_map, known, included)
    notes += left_out
    positions, true_positions = sensor_map.positions[chosen], true_positions[chosen]
    if len(chosen) < MIN_SENSORS_COMPARED:
        raise InputError(
            f"a score requires at least {MIN_SENSORS_COMPARED} sensors with known true positions, "
            f"got {len(chosen)}" + (f" ({'; '.join(notes)})" if notes else "")
        )
    compared = [sensor_map.names[i] for i in chosen]
    check_coordinates(positions, compared, "on the map")
    check_coordinates(true_positions, compared, "in truth")
    generator = np.random.default_rng(0 if rng is None else rng)
    drawn = np.arange(len(chosen))
    if len(chosen) > MAX_ALL_PAIRS:
        drawn = np.sort(generator.choice(len(chosen), SAMPLED, replace=False))
        notes += (
            f"Mantel r uses a random sample of {drawn.size} of the {len(chosen)} sensors compared",
        )
    alignment = align(positions, true_positions)
    factor, rigid_rms = _unit_in(sensor_map.units, units), math.nan
    if math.isfinite(factor):
        x, y = (padded(p, len(alignment.translation)) for p in (factor * positions, true_positions))
        offsets = fit_similarity(x, y, scaling=False).apply(x) - y
        rigid_rms = float(np.sqrt(np.mean((offsets**2).sum(axis=1))))
    return Score(
        mantel=mantel(
            SensorMap(positions[drawn]),
            SensorMap(true_positions[drawn]),
            permutations=permutations,
            rng=generator,
            progress=progress,
        ),
        alignment=alignment,
        truth=true_positions,
        sensors=chosen,
        spacing=median_spacing(true_positions),
        neighbours_kept=neighbour_agreement(positions, true_positions),
        excluded=np.flatnonzero(~included),
        units=units,
        notes=notes,
        scale=factor / alignment.scale if alignment.scale > 0 else math.nan,
        rigid_rms=rigid_rms,
    )


def _unit_in(unit: str, other: str) -> float:
    """Return the length of a unit in another unit; NaN if either is unknown."""
    if unit in METRES and other in METRES:
        return METRES[unit] / METRES[other]
    return 1.0 if unit not in UNSCALED and unit == other else math.nan


def _compared(
    sensor_map: SensorMap, known: NDArray[np.bool_], included: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """Return the sensors that can be compared, and notes on all other sensors."""
    largest = sensor_map.component == 0
    reasons = {
        "no position on the map": ~sensor_map.placed,
        "excluded": sensor_map.placed & ~included,
        "outside the largest component": sensor_map.placed & ~largest & included,
        "no known true position": largest & included & ~known,
    }
    notes = tuple(
        f"{np.count_nonzero(mask)} of {sensor_map.n_sensors} sensors not compared: {why}"
        for why, mask in reasons.items()
        if mask.any()
    )
    return np.flatnonzero(largest & included & known), notes
