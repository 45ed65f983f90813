"""The evidence that a verdict follows from.

The rule from evidence to a verdict.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from anisomap.usability import Verdict

MAX_CHANCE = 1.5
"""Repeatability, in spacings, up to which maps have the right neighbours.

Of the maps of tuning seeds 1 to 28 below it, 9 of 10 keep at least half of the neighbours.
"""


@dataclass(frozen=True)
class Doubt:
    """A systematic error that every map of a recording shares.

    kind: Name of the detector.
    size: RMS error of the positions because of it, in spacings, if nothing else explains what was
        found: see `anisomap.diagnosis.verdict.TYPICAL`.
    reason: What was found, in one sentence.
    keeps_neighbours: Whether sensors still have the right neighbours: only the shape as a whole is
        doubtful.
    measured: What was measured, in the unit of the detector; NaN if nothing was.
    excludes_usable: Whether the map is never called usable, however small the error.
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

    repeatability: RMS difference of the positions that chance makes, in spacings; NaN if unknown.
    extent: Standard deviation of the distances on the map, in spacings.
    dimensions: Number of coordinates.
    doubts: Systematic errors.
    unknown: Why the repeatability is unknown; empty if it is known.
    """

    repeatability: float = math.nan
    extent: float = math.nan
    dimensions: int = 3
    doubts: tuple[Doubt, ...] = ()
    unknown: str = ""


MAX_ERROR, MIN_MANTEL_R = 1.0, 0.9
"""Largest error, in spacings, and smallest Mantel r of a usable map.

Beyond an error of 1 spacing, sensors change places with neighbours; maps with a smaller Mantel r
show the shape of a skin only roughly.
"""

MARGIN = 2.4
"""Factor by which the error of a usable map may exceed the expected error, doubts in full size.

Among the usable ones of 97 maps of tuning seeds 101 to 111 and 190 to 300, the largest ratio of the
error to the expected error was 2.35 (a tube that rolls: .54 spacings, expected .23). With 2.4, the
same good maps are usable as with 2.
"""

TYPICAL = 0.75
"""Share of the sizes of doubts that errors typically reach.

Several detectors can find one cause, and the levels of verdicts rely on the sizes themselves. With
1, the median ratio of the expected to the true error is 1.52; with .75 it is 1.18, and most
expected errors, 72 %, are within a factor of 2 of the true ones (174 maps of seeds 1 to 44 of
``make trust``).
"""

MAX_LOCAL_DOUBT = 1.0
"""Size, in spacings, up to which doubts leave most sensors closer to their place than to others."""

_WORTH_SAYING = 0.25  # spacings: smaller doubts alone leave every map usable


def _weight(doubt: Doubt) -> float:
    """Size of a doubt, or that above which no map is usable, if that is what the doubt means."""
    return max(doubt.size, MAX_ERROR / MARGIN) if doubt.excludes_usable else doubt.size


def judge(evidence: Evidence) -> Verdict:
    """Return the verdict that follows from the evidence."""
    doubts = sorted(evidence.doubts, key=_weight, reverse=True)
    doubtful = math.hypot(*(doubt.size for doubt in doubts))
    systematic = TYPICAL * doubtful
    reasons = tuple(doubt.reason for doubt in doubts if _weight(doubt) >= _WORTH_SAYING)
    local = all(doubt.keeps_neighbours or doubt.size <= MAX_LOCAL_DOUBT for doubt in doubts)
    if math.isnan(evidence.repeatability):
        unknown = evidence.unknown or "the map was not examined"
        if not local:  # whatever chance adds
            return Verdict("not usable", systematic=systematic, reasons=(*reasons, unknown))
        reasons = (unknown, *reasons)
        return Verdict(systematic=systematic if doubts else math.nan, reasons=reasons)
    chance = evidence.repeatability
    stated = f"maps of parts of the recording agree within {chance:.2f} spacings"
    worst = MARGIN * math.hypot(chance, doubtful)
    r = expected_mantel_r(worst, evidence.extent, evidence.dimensions)
    excluded = any(doubt.excludes_usable for doubt in doubts)
    if worst < MAX_ERROR and r >= MIN_MANTEL_R and not excluded:
        level = "usable"
    elif chance <= MAX_CHANCE and local:
        level = "usable locally"
    else:
        level = "not usable"
    if chance > MAX_CHANCE:
        stated = (
            "insufficient evidence: maps of parts of the recording differ by "
            f"{chance:.2f} spacings; record longer, and touch all of the skin"
        )
    chance_first = not doubts or chance >= _weight(doubts[0])
    return Verdict(
        level,
        expected_error=math.hypot(chance, systematic),
        repeatability=chance,
        systematic=systematic,
        reasons=(stated, *reasons) if chance_first else (*reasons, stated),
    )


def expected_mantel_r(error: float, extent: float, dimensions: int) -> float:
    """Mantel r of a map with the truth if its positions have independent errors.

    To first order, a distance has an error of variance ``2 error^2 / k``: the sum of the variances
    of two positions along the line that joins them. The distances on the map contain that error.
    """
    if extent <= 0:
        return 0.0
    return math.sqrt(max(0.0, 1 - 2 * error**2 / dimensions / extent**2))
