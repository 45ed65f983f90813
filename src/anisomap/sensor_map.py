"""A map: the positions of the sensors of a skin, and their reliability. Immutable."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray
from scipy.special import gammaincinv

from anisomap.base.immutable import Immutable
from anisomap.errors import InputError, import_extra
from anisomap.map_verdict import UNJUDGED, Verdict
from anisomap.names import check_names, default_names, find_sensors
from anisomap.recording import Recording, Scalar

UNPLACED = -1
"""The component label of a sensor without a position."""

UNSCALED = ("", "arbitrary")
"""Units of positions with unknown scale."""

MAX_COORDINATE = 1e75
"""Maximum coordinate of a map and of the truth; its fourth power is finite."""

UNASSESSED = "unassessed"
"""Health of a sensor before `anisomap.diagnose`."""

SILENT = "silent"
"""Status of a sensor that is constant at rest: never touched, or dead."""

FEW_CONTACTS = "few contacts"
"""Status of a sensor with too few contacts for other tests."""

DEFAULT_FRAME = "skin"

DEFAULT_KIND = "sensor"
"""Kind of the points of a map, unless it was made from dissimilarities of objects."""


@dataclass(frozen=True, eq=False, repr=False)
class SensorMap(Immutable):
    """Positions of N sensors, known up to rotation, translation, scale and reflection, or placed.

    ``len(m)`` is the number of sensors, ``m["name"]`` the position of a sensor, and
    ``np.asarray(m)`` all positions, shape (N, k); iteration yields the names.

    Parameters
    ----------
    positions : array_like of shape (N, k)
        One row per sensor, in the order of the recording; NaN for sensors that were not placed.
    names : sequence of str, optional
        Unique names, one per sensor; ``s0, s1, ...`` by default.
    component : array_like of int, shape (N,), optional
        Connected component of each sensor: 0 is the largest, -1 marks a sensor without a position.
        Components share no frame of reference: their relative positions are unknown.
    health : sequence of str, optional
        Status of each sensor, from `anisomap.diagnose`; ``"unassessed"`` by default.
    units : str
        Unit of `positions`; ``"arbitrary"`` until the map is given a scale.
    frame : str
        Name of the coordinate frame, for robot software.
    method : str
        Name of the method that made the map.
    similarity : str
        Name of the similarity that was computed from readings; empty if it was precomputed.
    stress : float
        Stress-1 of the scaling (Borg & Groenen 2005, eq. 3.9): 0 is a perfect fit of the metric.
    n_iterations : int
        Iterations of SMACOF; the largest number over all components.
    verdict : Verdict
        Verdict on the use of the map, from `anisomap.diagnose`; the level is ``"cannot tell"`` by
        default.
    distorted : bool
        Whether lengths in the largest component are distorted because contacts differ between
        places; maps of parts of the recording have the same distortion.
    kind : str
        Kind of the points: ``"sensor"``, or ``"object"`` if the map was made from dissimilarities.
    mirrored : bool
        Whether the map was reflected after it was made.
    handed : bool
        Whether the map is known to have the handedness of the skin.
    anchored : bool
        Whether positions are in the frame `frame` of the robot, up to `errors`.
    errors : array_like of shape (N,), optional
        Radius about each position, in `units`, that contains the true position with a probability
        of 90 %; NaN if unknown.
    covariances : array_like of shape (N, k, k), optional
        Covariance of each position, by chance and systematic errors, in squared `units`, up to a
        similarity transform of the component; symmetric, NaN if unknown. None if all are unknown.
        `ellipses` returns 95 % ellipses.
    normals : array_like of shape (N, 3), optional
        Outward unit normals, NaN if unknown; None if they are to be estimated from the positions.
    notes : sequence of str
        Caveats; empty if none are known.
    provenance : mapping of str to str, int, float or bool
        Source, parameters, seed and version, with which the map can be reproduced. It does not
        affect computations.

    Raises
    ------
    InputError
        If shapes disagree or names are not unique.
    """

    positions: NDArray[np.float64]
    names: tuple[str, ...] = ()
    component: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    health: tuple[str, ...] = ()
    units: str = "arbitrary"
    frame: str = DEFAULT_FRAME
    method: str = ""
    similarity: str = ""
    stress: float = float("nan")
    n_iterations: int = 0
    verdict: Verdict = UNJUDGED
    distorted: bool = False
    kind: str = DEFAULT_KIND
    mirrored: bool = False
    handed: bool = False
    anchored: bool = False
    errors: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    covariances: NDArray[np.float64] | None = None
    normals: NDArray[np.float64] | None = None
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Scalar] = field(default_factory=dict)

    def __post_init__(self) -> None:
        positions = np.array(self.positions, dtype=np.float64)
        if positions.ndim != 2 or 0 in positions.shape:
            raise InputError(f"positions must be of shape (N, k), got {positions.shape}")
        n_sensors = len(positions)
        names = tuple(str(name) for name in self.names) or default_names(n_sensors)
        check_names(names, n_sensors)
        placed = np.isfinite(positions).all(axis=1)
        known = [names[i] for i in np.flatnonzero(placed).tolist()]
        check_coordinates(positions[placed], known, "on the map")
        component = np.array(self.component, dtype=np.intp)
        if not component.size:
            component = np.where(placed, 0, UNPLACED)
        health = tuple(self.health) or (UNASSESSED,) * n_sensors
        errors = np.array(self.errors, dtype=np.float64)
        if not errors.size:
            errors = np.full(n_sensors, np.nan)
        sizes = (("component", component.size), ("health", len(health)), ("errors", errors.size))
        for name, size in sizes:
            if size != n_sensors:
                raise InputError(f"{name} must have {n_sensors} entries, got {size}")
        if ((component == UNPLACED) == placed).any():
            raise InputError("positions must be finite exactly where components are not -1")
        self.set_fields(
            positions=positions,
            names=names,
            component=component,
            health=health,
            errors=errors,
            covariances=None
            if self.covariances is None
            else _as_covariances(self.covariances, positions.shape),
            normals=None if self.normals is None else _as_normals(self.normals, n_sensors),
            notes=tuple(self.notes),
        )

    @property
    def n_sensors(self) -> int:
        """Number of sensors, N, with or without a position."""
        return len(self.names)

    @property
    def dimensions(self) -> int:
        """Number of coordinates, k."""
        return int(self.positions.shape[1])

    @property
    def known_up_to(self) -> str:
        """Transformations up to which the map is known; empty in the frame of the robot."""
        if self.anchored:
            return ""
        scale = ["scale"] if self.units in UNSCALED else []
        hand = [] if self.handed else ["reflection"]
        *first, last = ["rotation", "translation", *scale, *hand]
        return f"{', '.join(first)} and {last}"

    @property
    def pose(self) -> str:
        """Text: the map is in the frame of the robot, or the transformations it is known up to."""
        return "placed in the robot's frame" if self.anchored else f"known up to {self.known_up_to}"

    @property
    def reference(self) -> dict[str, str]:
        """Scale, handedness and frame of the coordinates, for files."""
        return {
            "scale": "unknown" if self.units in UNSCALED else f"in {self.units}",
            "handedness": "right-handed axes; the map "
            + (
                "has the handedness of the skin"
                if self.handed
                else "may be a mirror image of the skin"
            ),
            "frame": self.frame,
        }

    @property
    def placed(self) -> NDArray[np.bool_]:
        """Mask of the sensors that have a position, shape (N,)."""
        return np.asarray(self.component != UNPLACED)

    @property
    def component_sizes(self) -> tuple[int, ...]:
        """Number of sensors of each connected component."""
        return tuple(np.bincount(self.component[self.placed]).tolist())

    def __len__(self) -> int:
        return self.n_sensors

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __getitem__(self, sensor: str | int) -> NDArray[np.float64]:
        """Return the position of a sensor, shape (k,), by name or index."""
        return np.asarray(self.positions[self.indices([sensor])[0]])

    def __array__(
        self, dtype: DTypeLike | None = None, copy: bool | None = None
    ) -> NDArray[np.float64]:
        """Return the positions, shape (N, k)."""
        return np.array(self.positions, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        n_components, judged = len(self.component_sizes), self.verdict != UNJUDGED
        details = (
            f"{np.count_nonzero(self.placed)} of {self.n_sensors} {self.kind}s placed",
            f"{self.dimensions}D",
            f"{n_components} components" if n_components > 1 else "",
            f"method={self.method!r}, units={self.units!r}, Stress-1={self.stress:.3f}",
            f"verdict: {self.verdict.summary}" if judged else "not judged",
        )
        return f"<SensorMap: {', '.join(filter(None, details))}>"

    def indices(self, sensors: Iterable[str | int]) -> NDArray[np.intp]:
        """Look sensors up by name or index; see `Recording.indices`."""
        return find_sensors(self.names, sensors)

    def select(self, sensors: ArrayLike) -> SensorMap:
        """Keep some sensors.

        Parameters
        ----------
        sensors : array_like
            Indices or a boolean mask, as in numpy indexing.

        Returns
        -------
        SensorMap
            The map of the selected sensors; components are renumbered from 0 in the same order.
        """
        chosen = np.arange(self.n_sensors)[np.asarray(sensors)]
        labels = self.component[chosen]
        for new, old in enumerate(np.unique(labels[labels != UNPLACED])):
            labels = np.where(labels == old, new, labels)
        return replace(
            self,
            positions=self.positions[chosen],
            names=tuple(self.names[i] for i in chosen),
            component=labels,
            health=tuple(self.health[i] for i in chosen),
            errors=self.errors[chosen],
            covariances=None if self.covariances is None else self.covariances[chosen],
            normals=None if self.normals is None else self.normals[chosen],
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the map to a file: see `anisomap.write`."""
        import anisomap  # noqa: PLC0415, the writers import this module

        anisomap.write(self, path)

    def plot(
        self, truth: SensorMap | Recording | ArrayLike | None = None, *, ax: Any = None
    ) -> Any:
        """Plot the map, over true positions if given: see `anisomap.plot`."""
        import anisomap  # noqa: PLC0415, the figures import this module

        return anisomap.plot(self, truth, ax=ax)

    def to_dataframe(self) -> Any:
        """Return a table with one row per sensor.

        Returns
        -------
        pandas.DataFrame
            The sensors are the index; columns are the coordinates x, y, z (or x1, x2, ...),
            `component`, `health` and `error`.

        Raises
        ------
        MissingExtraError
            If pandas is not installed.
        """
        pandas = import_extra("pandas", "a DataFrame", "pandas")
        axes = dict(zip(axis_names(self.dimensions), self.positions.T, strict=True))
        facts = {"component": self.component, "health": self.health, "error": self.errors}
        return pandas.DataFrame(axes | facts, index=pandas.Index(self.names, name="sensor"))

    def split(self) -> tuple[SensorMap, ...]:
        """Return each connected component as a separate map, the largest first."""
        return tuple(
            self.select(self.component == label) for label in range(len(self.component_sizes))
        )


def axis_names(dimensions: int) -> tuple[str, ...]:
    """Return the coordinate names x, y, z, or x1, x2, ... for more than three dimensions."""
    return (
        tuple("xyz"[:dimensions])
        if dimensions <= 3
        else tuple(f"x{i + 1}" for i in range(dimensions))
    )


def _as_covariances(covariances: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    array = np.array(covariances, dtype=np.float64)
    if array.shape != (*shape, shape[1]):
        raise InputError(f"covariances must have shape {(*shape, shape[1])}, got {array.shape}")
    lower = np.tril_indices(shape[1], -1)
    array[:, lower[0], lower[1]] = array[:, lower[1], lower[0]]  # exactly symmetric
    return array


def _as_normals(normals: ArrayLike, n_sensors: int) -> NDArray[np.float64]:
    array = np.array(normals, dtype=np.float64)
    if array.shape != (n_sensors, 3):
        raise InputError(f"normals must have shape ({n_sensors}, 3), got {array.shape}")
    return array


def check_coordinates(points: NDArray[np.float64], names: Sequence[str], what: str) -> None:
    """Check that the coordinates of sensors are finite, and their squares as well."""
    wrong = np.flatnonzero(~(np.abs(points) <= MAX_COORDINATE).all(axis=1))
    if wrong.size:
        first = int(wrong[0])
        raise InputError(
            f"{what}, sensor {names[first]} is at {points[first].tolist()}, which is out of range; "
            "check the units, and leave out sensors without a position"
        )


def is_faulty(status: str) -> bool:
    """Return whether a status in `SensorMap.health` denotes a faulty sensor."""
    return status not in ("ok", UNASSESSED, SILENT, FEW_CONTACTS)


def ellipses(
    covariances: ArrayLike, level: float = 0.95
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the half axes of the ellipses, or ellipsoids, of covariances.

    Parameters
    ----------
    covariances : array_like of shape (n, k, k)
        Symmetric; NaN for unknown ones.
    level : float
        Probability within each ellipse, in (0, 1), for a normal distribution.

    Returns
    -------
    lengths : ndarray of shape (n, k)
        Lengths of the half axes, the longest first; NaN if unknown.
    directions : ndarray of shape (n, k, k)
        Unit vectors along the half axes, in rows.
    """
    values = np.asarray(covariances, dtype=np.float64)
    known = np.isfinite(values).all(axis=(1, 2))
    lengths = np.full(values.shape[:2], np.nan)
    directions = np.full(values.shape, np.nan)
    found, vectors = np.linalg.eigh(values[known])
    lengths[known] = radius(values.shape[1], level) * np.sqrt(np.maximum(found[:, ::-1], 0))
    directions[known] = vectors[:, :, ::-1].transpose(0, 2, 1)
    return lengths, directions


def radius(dimensions: int, level: float = 0.95) -> float:
    """Return the radius of the ball that contains a share of a standard normal distribution."""
    return float(np.sqrt(2 * gammaincinv(dimensions / 2, level)))  # chi distribution
