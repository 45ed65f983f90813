"""Results of a check of a layout."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.sensor_map import SensorMap

OK = "ok"
"""Status of a tested sensor whose readings fit its place."""

NOT_TESTED = "not tested"
"""Status of a sensor without evidence in the recording, or without a stated position."""

DEAD, CONTRADICTING = "dead", "contradicting"
"""Kinds of findings, of `KINDS`, that are not about sensors at wrong places."""

KINDS: Mapping[str, str] = MappingProxyType(
    {
        "turned": "a module that is rotated in its place",
        "mirrored": "a module that is mirrored in its place",
        "exchanged": "modules that have each other's places",
        "reversed": "all sensors, the pads of a module, or modules in a row, in reverse order",
        "shifted": "consecutive sensors that each have the place of the next",
        "swapped": "two sensors that have each other's places",
        "cycle": "three or more sensors that each have the place of another of them",
        "moved": "sensors that belong to a place where the layout has no sensor",
        "overlapping": "a module closer to another module than their shape allows",
        "doubled": "a sensor that repeats the readings of another sensor",
        "contradicting": "modules that contradict each other; which are wrong cannot be told",
        "dead": "a sensor that stays constant while its neighbours are touched",
    }
)
"""Kinds of findings."""


CONSISTENT, NOT_CONSISTENT = "consistent", "not consistent"
REJECTED, UNKNOWN = "rejected", "unknown"
"""Verdicts on a layout; with the last two, no single sensors are listed."""


_CERTAIN_Z, _CERTAIN_GAIN = 5.0, 60.0  # standard errors, nats


@dataclass(frozen=True)
class ModuleChange:
    """Change of a module relative to the stated layout.

    angle: Degrees by which it is turned, counterclockwise in two dimensions, in (-180, 180].
    mirror: Whether it is mirrored.
    old_orientation, new_orientation: Degrees from the axes of the layout to the axes of the
        template, which is mirrored first if the module is; NaN in three dimensions.
    """

    module: str
    angle: float
    mirror: bool
    old_orientation: float
    new_orientation: float


@dataclass(frozen=True, eq=False)
class LayoutFinding:
    """Sensors that do not fit their positions, with an explanation.

    Attributes
    ----------
    kind : str
        A key of `KINDS`.
    sensors : ndarray of int
        Rows of the layout.
    explanation : str
    displacement : float
        Median distance between the stated and the proposed places, in units of the layout; NaN if
        no place is proposed.
    agreement_stated, agreement_proposed : float
        Mean similarity of the sensors to the sensors around their stated and proposed places; NaN
        if there are no such sensors or places.
    gain : float
        Increase of the log-likelihood of all similarities, in nats; NaN if no place is proposed.
    z : float
        `gain` in standard errors (jackknife over ten parts of the recording); NaN if no place is
        proposed.
    modules : tuple of ModuleChange
        Modules that are turned, mirrored or moved.
    """

    kind: str
    sensors: NDArray[np.intp]
    explanation: str
    displacement: float = float("nan")
    agreement_stated: float = float("nan")
    agreement_proposed: float = float("nan")
    gain: float = float("nan")
    z: float = float("nan")
    modules: tuple[ModuleChange, ...] = ()

    @property
    def certainty(self) -> str:
        """Certainty: ``"certain"`` or ``"likely"``; empty if no place is proposed."""
        if not np.isfinite(self.z):
            return ""
        return "certain" if self.z >= _CERTAIN_Z and self.gain >= _CERTAIN_GAIN else "likely"


@dataclass(frozen=True, eq=False, repr=False)
class LayoutCheck:
    """Result of `check_layout`.

    Attributes
    ----------
    layout : SensorMap
        The layout that was checked.
    corrected : SensorMap
        The layout with the proposed places; equal to `layout` if none are proposed.
    status : tuple of str
        Status of each sensor of the layout: a key of `KINDS`, ``"ok"``, or ``"not tested"``.
    findings : tuple of LayoutFinding
        Ordered by kind as in `KINDS`, then by the first sensor.
    agreement : ndarray of shape (N,)
        Mean similarity of each sensor to the sensors around its place; NaN if it is not tested
        or has no neighbour within 2.6 spacings.
    module : ndarray of int, shape (N,)
        Module of each sensor, from 0; -1 without one.
    spacing : float
        Median distance between neighbours, in units of the layout.
    p : float
        Probability that a layout whose sensors are shuffled agrees with the readings as well.
    explained : float
        Agreement of the layout relative to shuffled layouts (0) and to the highest possible
        agreement (1); about 1 for a correct layout, 0.25 if half of the sensors are shuffled.
    verdict : str
        ``"consistent"``; ``"not consistent"``: sensors are flagged, in findings; ``"rejected"``:
        at least half of the sensors are at wrong places, so single sensors are not listed; or
        ``"unknown"``: the recording has too little evidence.
    notes : tuple of str
        Untested sensors, and other caveats.
    """

    layout: SensorMap
    corrected: SensorMap
    status: tuple[str, ...]
    findings: tuple[LayoutFinding, ...]
    agreement: NDArray[np.float64]
    module: NDArray[np.intp]
    spacing: float
    p: float = float("nan")
    explained: float = float("nan")
    verdict: str = CONSISTENT
    notes: tuple[str, ...] = ()

    @property
    def consistent(self) -> bool:
        """Whether the layout explains the readings, and there are no findings."""
        return self.verdict == CONSISTENT

    @property
    def n_tested(self) -> int:
        """Number of sensors that were tested."""
        return sum(status != NOT_TESTED for status in self.status)

    @property
    def n_modules(self) -> int:
        """Number of modules."""
        return int(self.module.max(initial=-1)) + 1

    @property
    def flagged(self) -> NDArray[np.bool_]:
        """Mask of the sensors with a wrong place or wire, except dead sensors, shape (N,)."""
        return np.array(
            [status not in (OK, NOT_TESTED, DEAD, CONTRADICTING) for status in self.status], bool
        )

    def names(self, finding: LayoutFinding) -> tuple[str, ...]:
        """Return the names of the sensors of a finding."""
        return tuple(self.layout.names[i] for i in finding.sensors)

    def __repr__(self) -> str:
        return (
            f"<LayoutCheck: {self.verdict}, {int(self.flagged.sum())} of {self.n_tested} tested "
            f"sensors flagged, {self.layout.n_sensors} in the layout>"
        )


def at_positions(layout: SensorMap, positions: NDArray[np.float64]) -> SensorMap:
    """Return a layout with other positions of its placed sensors.

    A sensor with a changed position takes the normal of the nearest stated place, if normals are
    known.
    """
    normals = layout.normals
    placed = np.flatnonzero(layout.placed)
    changed = placed[(positions[placed] != layout.positions[placed]).any(axis=1)]
    if normals is not None and changed.size:
        nearest = KDTree(layout.positions[placed]).query(positions[changed])[1]
        normals = normals.copy()
        normals[changed] = normals[placed[nearest]]
    moved = np.where(layout.placed[:, None], positions, np.nan)
    return replace(layout, positions=moved, normals=normals)
