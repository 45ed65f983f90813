"""The evidence that a verdict follows from."""

from __future__ import annotations

import math
from dataclasses import dataclass

MAX_CHANCE = 1.5
"""Repeatability, in spacings, up to which maps have the right neighbours.

Of the maps of tuning seeds 1 to 28 below it, 9 of 10 keep at least half of the neighbours.
"""


@dataclass(frozen=True)
class Doubt:
    """A systematic error that every map of a recording shares.

    Parameters
    ----------
    kind : str
        Name of the detector.
    size : float
        RMS error of the positions because of it, in spacings, if nothing else explains what was
        found: see `anisomap.diagnosis.judgement.TYPICAL`.
    reason : str
        What was found, in one sentence.
    keeps_neighbours : bool
        Whether sensors still have the right neighbours: only the shape as a whole is doubtful.
    measured : float
        What was measured, in the unit of the detector; NaN if nothing was.
    excludes_usable : bool
        Whether the map is never called usable, however small the error.
    """

    kind: str
    size: float
    reason: str
    keeps_neighbours: bool = False
    measured: float = math.nan
    excludes_usable: bool = False


@dataclass(frozen=True)
class Evidence:
    """What is known about the errors of a map.

    Parameters
    ----------
    repeatability : float
        RMS difference of the positions that chance makes, in spacings; NaN if unknown.
    extent : float
        Standard deviation of the distances on the map, in spacings.
    dimensions : int
        Number of coordinates.
    doubts : tuple of Doubt
        Systematic errors.
    unknown : str
        Why the repeatability is unknown; empty if it is known.
    """

    repeatability: float = math.nan
    extent: float = math.nan
    dimensions: int = 3
    doubts: tuple[Doubt, ...] = ()
    unknown: str = ""
