"""What a check of a layout finds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.sensor_map import SensorMap
from anisomap.wording import html_table

OK = "ok"
"""Status of a tested sensor that reads as its place says."""

NOT_TESTED = "not tested"
"""Status of a sensor without evidence in the recording, or without a stated position."""

KINDS: Mapping[str, str] = MappingProxyType(
    {
        "turned": "a module that is rotated on its own places",
        "mirrored": "a module that is a mirror image of what the layout states",
        "exchanged": "modules that have each other's places",
        "shifted": "a run of consecutive sensors that each have the place of the next",
        "swapped": "two sensors that have each other's places",
        "cycle": "three and more sensors that each have the place of another of them",
        "moved": "sensors that belong to a place where no other sensor is",
        "doubled": "a sensor that repeats the readings of another",
        "dead": "a sensor that stays constant while its neighbours are touched",
    }
)
"""Kinds of findings."""


@dataclass(frozen=True, eq=False)
class LayoutFinding:
    """Sensors whose readings contradict their positions, and what would explain this.

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
        Mean similarity of the sensors to those around their stated and their proposed places; NaN
        if there are none.
    chance : float
        Largest gain of agreement by a free choice of places after circular shifts in time; NaN
        if no place is proposed.
    gain : float
        Increase of the log-likelihood of all similarities, in nats; NaN if no place is proposed.
    """

    kind: str
    sensors: NDArray[np.intp]
    explanation: str
    displacement: float = float("nan")
    agreement_stated: float = float("nan")
    agreement_proposed: float = float("nan")
    chance: float = float("nan")
    gain: float = float("nan")


@dataclass(frozen=True, eq=False, repr=False)
class LayoutCheck:
    """Result of `check_layout`.

    Attributes
    ----------
    layout : SensorMap
        The layout that was checked.
    corrected : SensorMap
        The same with the proposed places; equal if none are proposed.
    status : tuple of str
        Of each sensor of the layout: a key of `KINDS`, ``"ok"``, or ``"not tested"``.
    findings : tuple of LayoutFinding
        Ordered by kind as in `KINDS`, then by the first sensor.
    agreement : ndarray of shape (N,)
        Mean similarity of each sensor to those around its stated place; NaN if it is not tested
        or has no neighbour within 2.6 spacings.
    module : ndarray of int, shape (N,)
        Module of each sensor, from 0; -1 without one.
    spacing : float
        Median distance between neighbours, in units of the layout.
    notes : tuple of str
        What was not tested, and other caveats.
    """

    layout: SensorMap
    corrected: SensorMap
    status: tuple[str, ...]
    findings: tuple[LayoutFinding, ...]
    agreement: NDArray[np.float64]
    module: NDArray[np.intp]
    spacing: float
    notes: tuple[str, ...] = ()

    @property
    def consistent(self) -> bool:
        """Whether nothing was found."""
        return not self.findings

    @property
    def n_tested(self) -> int:
        """Number of sensors that were tested."""
        return sum(status != NOT_TESTED for status in self.status)

    @property
    def n_modules(self) -> int:
        """Number of modules."""
        return int(self.module.max(initial=-1)) + 1

    @property
    def accused(self) -> NDArray[np.bool_]:
        """Mask of the sensors in findings, shape (N,)."""
        return np.array([status not in (OK, NOT_TESTED) for status in self.status], dtype=bool)

    def names(self, finding: LayoutFinding) -> tuple[str, ...]:
        """Return the names of the sensors of a finding."""
        return tuple(self.layout.names[i] for i in finding.sensors)

    def __repr__(self) -> str:
        verdict = "consistent" if self.consistent else f"{len(self.findings)} findings"
        return (
            f"<LayoutCheck: {verdict}, {int(self.accused.sum())} sensors in them, "
            f"{self.n_tested} of {self.layout.n_sensors} tested>"
        )

    def _repr_html_(self) -> str:
        rows: dict[str, object] = {
            "sensors tested": f"{self.n_tested} of {self.layout.n_sensors}",
            "modules": self.n_modules,
            "verdict": "consistent" if self.consistent else "not consistent",
        }
        rows |= {
            f"{i}: {finding.kind}": finding.explanation
            for i, finding in enumerate(self.findings, 1)
        }
        return html_table("LayoutCheck", rows)


def at_positions(layout: SensorMap, positions: NDArray[np.float64]) -> SensorMap:
    """Return a layout with other positions for the sensors that have one.

    A sensor with another position takes the normal of the nearest stated place, if normals are
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
