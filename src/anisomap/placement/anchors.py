"""Known positions of some sensors, and sensors of which the position is worth measuring."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.errors import InputError
from anisomap.placement.scale import METRES
from anisomap.sensor_map import SensorMap
from anisomap.wording import join_items

# Anchors that are suggested; tuned on the iCub hexagon and palm, the plantar recording, and halves
# of rubbed planes and cylinders, seeds 301 to 306.
_RING = 12  # neighbours that tell whether a sensor is inside
_SHARE_INSIDE = 0.5  # of the sensors


@dataclass(frozen=True, eq=False)
class Anchors:
    """Sensors with a known position in the frame of the robot.

    Parameters
    ----------
    names : sequence of str
        Unique names of the sensors.
    positions : array_like of shape (n, 2) or (n, 3)
        In metres.
    normals : array_like of shape (n, 3), optional
        Outward normals of the skin there, of any length; NaN if unknown. None if all are unknown.

    Raises
    ------
    InputError
        If shapes disagree, names repeat, or a coordinate is not finite.
    """

    names: tuple[str, ...]
    positions: NDArray[np.float64]
    normals: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        positions = np.array(self.positions, dtype=np.float64)
        names = tuple(self.names)
        if positions.ndim != 2 or positions.shape[1] not in (2, 3) or len(positions) != len(names):
            raise InputError(
                f"anchors need 2 or 3 coordinates for each of {len(names)} sensors, got an array "
                f"of shape {positions.shape}"
            )
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise InputError(f"anchor {join_items(repeated)} is given more than once")
        bad = [n for n, row in zip(names, positions, strict=True) if not np.isfinite(row).all()]
        if bad:
            raise InputError(f"anchor {join_items(bad)} must have finite coordinates")
        positions.setflags(write=False)
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "positions", positions)
        if self.normals is not None:
            normals = np.array(self.normals, dtype=np.float64)
            if normals.shape != (len(names), 3) or positions.shape[1] != 3:
                raise InputError(
                    "normals of anchors need three coordinates, and so do their positions, got "
                    f"arrays of shapes {normals.shape} and {positions.shape}"
                )
            lengths = np.linalg.norm(normals, axis=1, keepdims=True)
            known = np.isfinite(lengths) & (lengths > 0)
            normals = np.where(known, normals / np.where(known, lengths, 1.0), np.nan)
            normals.setflags(write=False)
            object.__setattr__(self, "normals", normals)

    def select(self, rows: NDArray[np.intp]) -> Anchors:
        """Return some of the anchors."""
        return Anchors(
            tuple(self.names[i] for i in rows),
            self.positions[rows],
            None if self.normals is None else self.normals[rows],
        )


def parse_anchor(text: str) -> tuple[str, tuple[float, ...]]:
    """Parse an anchor such as ``s17=0.012,0.040,0.003``, in metres.

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
        raise InputError(
            f"{text!r} is not an anchor; write a sensor and its position in metres, such as "
            "s17=0.012,0.040,0.003"
        )
    return name, position


def anchors_from_map(layout: SensorMap, units: str = "") -> Anchors:
    """Use the placed sensors of a layout as anchors, with the normals that it states.

    Parameters
    ----------
    layout : SensorMap
    units : str
        Unit of the layout, if it states none.

    Raises
    ------
    InputError
        If the unit is unknown.
    """
    unit = layout.units if layout.units in METRES else units
    if unit not in METRES:
        raise InputError(
            "the unit of the anchors is unknown; give it with --units, or in the header of the "
            f"file, such as x [mm] (units: {', '.join(METRES)})"
        )
    placed = np.flatnonzero(layout.placed)
    return Anchors(
        tuple(layout.names[i] for i in placed),
        layout.positions[placed] * METRES[unit],
        None if layout.normals is None or layout.dimensions != 3 else layout.normals[placed],
    )


def suggest_anchors(sensor_map: SensorMap, count: int = 4) -> tuple[str, ...]:
    """Choose sensors of which the positions are worth measuring.

    They are far apart, so that they determine the pose well, and inside the skin, where maps are
    more accurate than at its edge.

    Parameters
    ----------
    sensor_map : SensorMap
    count : int
        Number of sensors of each component.

    Returns
    -------
    tuple of str
        Names, the largest component first; fewer than `count` of small components.
    """
    found: list[str] = []
    for part in sensor_map.split():
        positions, n_sensors = part.positions, part.n_sensors
        n_neighbours = min(_RING, n_sensors - 1)
        if n_neighbours < 1:
            continue
        distances, near = map(np.asarray, KDTree(positions).query(positions, n_neighbours + 1))
        centres = positions[near[:, 1:]].mean(axis=1)
        # Neighbours of a sensor at the edge are on one side of it.
        lopsided = np.linalg.norm(centres - positions, axis=1) / distances[:, 1:].mean(axis=1)
        inside = np.flatnonzero(lopsided <= np.quantile(lopsided, _SHARE_INSIDE))
        middle = positions[inside].mean(axis=0)
        chosen = [int(inside[np.linalg.norm(positions[inside] - middle, axis=1).argmax()])]
        while len(chosen) < min(count, len(inside)):
            gaps = np.linalg.norm(positions[inside][:, None] - positions[chosen], axis=2)
            chosen.append(int(inside[gaps.min(axis=1).argmax()]))
        found += [part.names[i] for i in chosen]
    return tuple(found)
