"""A map: where the sensors of a skin are, and how far that may be believed. Immutable."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.recording import Scalar, check_names, default_names, find_sensors

UNPLACED = -1
"""The component of a sensor that the map leaves out."""

UNSCALED = ("", "arbitrary")
"""Units of positions whose scale nobody knows."""

DEFAULT_FRAME = "skin"


def _not_given() -> NDArray[np.intp]:
    return np.empty(0, dtype=np.intp)


@dataclass(frozen=True, eq=False)
class SensorMap:
    """Positions of N sensors, known up to rotation, translation, scale and mirror image.

    Parameters
    ----------
    positions : array_like of shape (N, k)
        A row a sensor, in the order of the recording; NaN for sensors that were not placed.
    names : sequence of str, optional
        One unique name a sensor; ``s0, s1, ...`` unless given.
    component : array_like of int, shape (N,), optional
        Which connected piece a sensor belongs to: 0 is the largest, -1 a sensor not placed.
        Pieces share no frame of reference: where one lies beside another is not known.
    health : sequence of str, optional
        A word a sensor, from `anisomap.health`: ``"ok"`` unless given.
    excluded : array_like of bool, shape (N,), optional
        Sensors that take part in the map but not in its scores.
    units : str
        Unit of `positions`. The statistics of readings know no millimetres: ``"arbitrary"``.
    method : str
        Name of the method that made the map.
    stress : float
        Stress-1 of the scaling (Borg & Groenen 2005, eq. 3.9): 0 is a perfect fit of the metric.
    confidence : float
        Mantel r that the map is expected to reach with the truth, judged by how alike maps of
        halves of the recording are (`anisomap.evaluation.confidence`). It is that of the largest
        piece; NaN if nobody can tell.
    notes : sequence of str
        Why the map may be weaker than it looks; empty if nothing speaks against it.
    provenance : mapping of str to str, int, float or bool
        What it takes to make the map again: source, parameters, seed, version.

    Raises
    ------
    InputError
        If shapes disagree or names are not unique.
    """

    positions: NDArray[np.float64]
    names: tuple[str, ...] = ()
    component: NDArray[np.intp] = field(default_factory=_not_given)
    health: tuple[str, ...] = ()
    excluded: NDArray[np.bool_] = field(default_factory=lambda: _not_given().astype(bool))
    units: str = "arbitrary"
    method: str = ""
    stress: float = float("nan")
    confidence: float = float("nan")
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Scalar] = field(default_factory=dict)

    def __post_init__(self) -> None:
        positions = np.array(self.positions, dtype=np.float64)
        if positions.ndim != 2 or 0 in positions.shape:
            raise InputError(f"positions have shape {positions.shape}; they must be (N, k)")
        n_sensors = len(positions)
        names = tuple(str(name) for name in self.names) or default_names(n_sensors)
        check_names(names, n_sensors)
        placed = np.isfinite(positions).all(axis=1)
        component = np.array(self.component, dtype=np.intp)
        if not component.size:
            component = np.where(placed, 0, UNPLACED)
        excluded = np.array(self.excluded, dtype=bool)
        if not excluded.size:
            excluded = np.zeros(n_sensors, dtype=bool)
        health = tuple(self.health) or ("ok",) * n_sensors
        for what, size in (
            ("component", component.size),
            ("excluded", excluded.size),
            ("health", len(health)),
        ):
            if size != n_sensors:
                raise InputError(f"{what} has {size} entries for {n_sensors} sensors")
        if ((component == UNPLACED) == placed).any():
            raise InputError("a sensor has a finite position exactly if its component is not -1")
        for array in (positions, component, excluded):
            array.setflags(write=False)
        for name, value in {
            "positions": positions,
            "names": names,
            "component": component,
            "health": health,
            "excluded": excluded,
            "notes": tuple(self.notes),
            "provenance": MappingProxyType(dict(self.provenance)),
        }.items():
            object.__setattr__(self, name, value)

    def __reduce__(self) -> tuple[Callable[..., SensorMap], tuple[dict[str, object]]]:
        # A read-only view of a mapping cannot be pickled (and so sent to another process) itself.
        return _rebuilt, ({**vars(self), "provenance": dict(self.provenance)},)

    @property
    def n_sensors(self) -> int:
        """Number of sensors, N, placed or not."""
        return len(self.names)

    @property
    def dimensions(self) -> int:
        """Number of coordinates, k."""
        return int(self.positions.shape[1])

    @property
    def known_up_to(self) -> str:
        """What its readings cannot tell of it; a map in millimetres has been given its scale."""
        scale = ", scale" if self.units in UNSCALED else ""
        return f"rotation, translation{scale} and mirror image"

    @property
    def reference(self) -> dict[str, str]:
        """What its coordinates are relative to, for files: scale, handedness and frame."""
        return {
            "scale": "unknown" if self.units in UNSCALED else f"in {self.units}",
            "handedness": "right-handed axes; the map may be a mirror image of the skin",
            "frame": str(self.provenance.get("frame", DEFAULT_FRAME)),
        }

    @property
    def placed(self) -> NDArray[np.bool_]:
        """Which sensors have a position, shape (N,)."""
        return np.asarray(self.component != UNPLACED)

    @property
    def scored(self) -> NDArray[np.bool_]:
        """Which sensors a score looks at, shape (N,): placed, and not excluded."""
        return np.asarray(self.placed & ~self.excluded)

    @property
    def n_components(self) -> int:
        """Number of separate pieces."""
        return int(self.component.max(initial=UNPLACED)) + 1

    def indices(self, sensors: Iterable[str | int]) -> NDArray[np.intp]:
        """Find sensors by name, or else by index; see `Recording.indices`."""
        return find_sensors(self.names, sensors)

    def select(self, sensors: ArrayLike) -> SensorMap:
        """Keep only some sensors.

        Parameters
        ----------
        sensors : array_like
            Indices or a boolean mask, as numpy takes them.

        Returns
        -------
        SensorMap
            Their part of this map; components keep their numbers' order but count from 0 again.
        """
        chosen = np.arange(self.n_sensors)[np.asarray(sensors)]
        labels = self.component[chosen]
        for new, old in enumerate(np.unique(labels[labels != UNPLACED])):
            labels = np.where(labels == old, new, labels)
        return SensorMap(
            self.positions[chosen],
            names=tuple(self.names[i] for i in chosen),
            component=labels,
            health=tuple(self.health[i] for i in chosen),
            excluded=self.excluded[chosen],
            units=self.units,
            method=self.method,
            stress=self.stress,
            confidence=self.confidence,
            notes=self.notes,
            provenance=self.provenance,
        )

    def split(self) -> tuple[SensorMap, ...]:
        """Give each connected piece as a map of its own, the largest first."""
        return tuple(self.select(self.component == label) for label in range(self.n_components))


def _rebuilt(fields: dict[str, Any]) -> SensorMap:
    return SensorMap(**fields)
