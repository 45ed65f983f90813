"""The score of a map: everything that can be said of it once the truth is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.evaluation.alignment import Alignment, align
from anisomap.evaluation.mantel_r import FEWEST_SENSORS, PERMUTATIONS, Mantel, mantel
from anisomap.evaluation.neighbourhood import median_spacing, neighbour_agreement
from anisomap.sensor_map import SensorMap

ALL_PAIRS = 4000
"""Up to so many sensors Mantel r is of all pairs."""

SAMPLED = 2000
"""So many sensors, drawn at random, stand for more."""


@dataclass(frozen=True, eq=False)
class Score:
    """How a map compares with the truth.

    Attributes
    ----------
    mantel : Mantel
        Mantel r and its null.
    alignment : Alignment
        The map laid onto the truth.
    truth : ndarray of shape (n, l)
        True positions of the sensors that were compared.
    sensors : ndarray of int, shape (n,)
        Which sensors of the map were compared.
    spacing : float
        Median distance between true neighbours, in units of the truth.
    neighbours_kept : float
        See `neighbour_agreement`.
    units : str
        Units of the truth.
    notes : tuple of str
        What the score leaves out, and why.
    """

    mantel: Mantel
    alignment: Alignment
    truth: NDArray[np.float64]
    sensors: NDArray[np.intp]
    spacing: float
    neighbours_kept: float
    units: str
    notes: tuple[str, ...]

    @property
    def rms(self) -> float:
        """RMS error after alignment, in units of the truth."""
        return self.alignment.rms

    @property
    def rms_in_spacings(self) -> float:
        """RMS error after alignment, in units of the median sensor spacing."""
        return self.rms / self.spacing if self.spacing > 0 else float("inf")


def score(
    sensor_map: SensorMap,
    truth: SensorMap | ArrayLike,
    *,
    units: str = "",
    permutations: int = PERMUTATIONS,
    rng: np.random.Generator | int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Score:
    """Compare a map with the true positions of its sensors.

    Parameters
    ----------
    sensor_map : SensorMap
        The map. Sensors that it does not place or excludes are not compared, and of separate
        pieces only the largest is: the others lie in frames of their own.
    truth : SensorMap or array_like of shape (N, 2) or (N, 3)
        True positions. An array is in the order of the map, with NaN where one is not known. A map
        is matched by the names of its sensors, and gives the units; where no name is shared but
        the numbers of sensors agree, by order, with a note that says so.
    units : str
        Units of the truth, if it is an array.
    permutations, rng, progress
        See `mantel`. Of more than 4000 sensors, Mantel r and its null are of 2000 that are drawn at
        random, which a note says; everything else is of all.

    Returns
    -------
    Score

    Raises
    ------
    InputError
        If the truth is not of this map's sensors, or fewer than 4 can be compared.
    """
    notes = []
    if isinstance(truth, SensorMap):
        units = truth.units
        true_positions, by_order = _matched(sensor_map, truth)
        if by_order:
            notes.append("no name of the truth is a name of the map: matched by order instead")
    else:
        true_positions = np.asarray(truth, dtype=np.float64)
    if true_positions.ndim != 2 or len(true_positions) != sensor_map.n_sensors:
        raise InputError(
            f"true positions have shape {true_positions.shape}, but the map has "
            f"{sensor_map.n_sensors} sensors; give one row for each"
        )
    known = np.isfinite(true_positions).all(axis=1)
    largest = sensor_map.component == 0
    chosen = np.flatnonzero(sensor_map.scored & largest & known)
    for count, why in (
        (np.count_nonzero(~sensor_map.placed), "are not on the map"),
        (np.count_nonzero(sensor_map.placed & sensor_map.excluded), "were excluded"),
        (np.count_nonzero(sensor_map.scored & ~largest), "lie in separate pieces of the map"),
        (np.count_nonzero(sensor_map.scored & largest & ~known), "have no known true position"),
    ):
        if count:
            notes.append(f"{count} of {sensor_map.n_sensors} sensors {why}")
    positions, true_positions = sensor_map.positions[chosen], true_positions[chosen]
    if len(chosen) < FEWEST_SENSORS:
        raise InputError(
            f"only {len(chosen)} sensors can be compared with the truth; it takes at least 4"
            + (f" ({'; '.join(notes)})" if notes else "")
        )
    generator = np.random.default_rng(0 if rng is None else rng)
    drawn = _drawn(len(chosen), generator)
    if drawn.size < len(chosen):
        notes.append(
            f"Mantel r is of {drawn.size} of the {len(chosen)} sensors compared, drawn at random"
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
        units=units,
        notes=tuple(notes),
    )


def _drawn(n_sensors: int, rng: np.random.Generator) -> NDArray[np.intp]:
    if n_sensors <= ALL_PAIRS:
        return np.arange(n_sensors)
    return np.sort(rng.choice(n_sensors, SAMPLED, replace=False))


def _matched(sensor_map: SensorMap, truth: SensorMap) -> tuple[NDArray[np.float64], bool]:
    """Give true positions in the order of the map, and whether order is all they have in common."""
    row = {name: i for i, name in enumerate(truth.names)}
    rows = [row.get(name) for name in sensor_map.names]
    if all(i is None for i in rows):
        if truth.n_sensors != sensor_map.n_sensors:
            raise InputError(
                f"the map and the truth share no sensor name, and {sensor_map.n_sensors} sensors "
                f"cannot be matched with {truth.n_sensors} by order; name them alike"
            )
        return truth.positions, True
    unknown = np.full(truth.dimensions, np.nan)
    return np.array([unknown if i is None else truth.positions[i] for i in rows]), False
