"""The score of a map against the truth."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation.alignment import Alignment, align
from anisomap.evaluation.mantel_r import MIN_SENSORS_COMPARED, PERMUTATIONS, Mantel, mantel
from anisomap.evaluation.neighbourhood import median_spacing, neighbour_agreement
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

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
        """Median error after alignment, in units of the truth; few sensors do not change it."""
        return float(np.median(self.alignment.errors))

    def worst(self, count: int = 5) -> NDArray[np.intp]:
        """Return the positions in `sensors` of those with the largest errors, the worst first."""
        return np.argsort(-self.alignment.errors, kind="stable")[:count]


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
        or recording is matched by sensor names and gives the units; if no name is shared and the
        numbers of sensors agree, it is matched by order, with a note and a warning.
    exclude : iterable of str or int
        Sensors to leave out of the comparison, by name or index; the paper excludes a failed one.
    units : str
        Units of the truth, if it is an array.
    permutations, rng, progress
        See `mantel`. For more than 4000 sensors, Mantel r and its null use a random sample of
        2000, with a note; all other figures use all sensors.

    Returns
    -------
    Score

    Raises
    ------
    InputError
        If the truth does not match the sensors of the map, an excluded sensor is unknown, or fewer
        than 4 sensors can be compared.
    """
    notes = []
    if not isinstance(sensor_map, SensorMap):
        raise InputError(
            f"score takes a SensorMap first, got {type(sensor_map).__name__}; mantel and align "
            "compare arrays"
        )
    if isinstance(truth, Recording):
        truth = _as_map(truth)
    if isinstance(truth, SensorMap):
        units = truth.units
        true_positions, by_order = _matched(sensor_map, truth)
        if by_order:
            note = "map and truth share no sensor name: matched by order"
            warnings.warn(note, AnisomapWarning, stacklevel=2)
            notes.append(note)
    else:
        true_positions = np.asarray(truth, dtype=np.float64)
    if true_positions.ndim != 2 or len(true_positions) != sensor_map.n_sensors:
        raise InputError(
            f"true positions must have {sensor_map.n_sensors} rows, one per sensor, got shape "
            f"{true_positions.shape}"
        )
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
    generator = np.random.default_rng(0 if rng is None else rng)
    drawn = _sample(len(chosen), generator)
    if drawn.size < len(chosen):
        notes.append(
            f"Mantel r uses a random sample of {drawn.size} of the {len(chosen)} sensors compared"
        )
    return Score(
        mantel=mantel(
            SensorMap(positions[drawn]),
            SensorMap(true_positions[drawn]),
            permutations=permutations,
            rng=generator,
            progress=progress,
        ),
        alignment=align(positions, true_positions),
        truth=true_positions,
        sensors=chosen,
        spacing=median_spacing(true_positions),
        neighbours_kept=neighbour_agreement(positions, true_positions),
        excluded=np.flatnonzero(~included),
        units=units,
        notes=tuple(notes),
    )


def _as_map(recording: Recording) -> SensorMap:
    if recording.positions is None:
        raise InputError("the recording has no true positions to score against")
    return SensorMap(recording.positions, names=recording.names, units=recording.units)


def _compared(
    sensor_map: SensorMap, known: NDArray[np.bool_], included: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], list[str]]:
    """Return the sensors that can be compared, and notes on the others."""
    largest = sensor_map.component == 0
    reasons = {
        "no position on the map": ~sensor_map.placed,
        "excluded": sensor_map.placed & ~included,
        "outside the largest component": sensor_map.placed & ~largest & included,
        "no known true position": largest & included & ~known,
    }
    notes = [
        f"{np.count_nonzero(mask)} of {sensor_map.n_sensors} sensors not compared: {why}"
        for why, mask in reasons.items()
        if mask.any()
    ]
    return np.flatnonzero(largest & included & known), notes


def _sample(n_sensors: int, rng: np.random.Generator) -> NDArray[np.intp]:
    if n_sensors <= MAX_ALL_PAIRS:
        return np.arange(n_sensors)
    return np.sort(rng.choice(n_sensors, SAMPLED, replace=False))


def _matched(sensor_map: SensorMap, truth: SensorMap) -> tuple[NDArray[np.float64], bool]:
    """Return true positions in the order of the map, and whether they were matched by order."""
    row = {name: i for i, name in enumerate(truth.names)}
    rows = [row.get(name) for name in sensor_map.names]
    if all(i is None for i in rows):
        if truth.n_sensors != sensor_map.n_sensors:
            raise InputError(
                f"map and truth share no sensor name, and {sensor_map.n_sensors} sensors cannot be "
                f"matched with {truth.n_sensors} by order; use the same names"
            )
        return truth.positions, True
    unknown = np.full(truth.dimensions, np.nan)
    return np.array([unknown if i is None else truth.positions[i] for i in rows]), False
