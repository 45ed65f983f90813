"""The rule from evidence to a verdict."""

from __future__ import annotations

import math

from anisomap.usability import Verdict
from anisomap.verdict.evidence import Evidence

MAX_ERROR = 1.0
"""Expected error of a usable map, in spacings: beyond it, sensors change places with neighbours."""

MIN_MANTEL_R = 0.9
"""Expected Mantel r of a usable map: below it, maps show the shape of a skin only roughly."""


def judge(evidence: Evidence) -> Verdict:
    """Return the verdict that follows from the evidence.

    Parameters
    ----------
    evidence : Evidence

    Returns
    -------
    Verdict
        Its expected error is the root of the sum of squares of the repeatability and of the sizes
        of all doubts. The map is usable if that error is at most 1 spacing and the Mantel r that
        follows from it at least .9; usable locally if chance alone would leave it usable, and all
        doubts that are larger keep neighbourhoods.
    """
    doubts = sorted(evidence.doubts, key=lambda doubt: -doubt.size)
    systematic = math.hypot(*(doubt.size for doubt in doubts))
    reasons = tuple(doubt.reason for doubt in doubts)
    if math.isnan(evidence.repeatability):
        reasons = (evidence.unknown or "the map was not examined", *reasons)
        return Verdict(systematic=systematic if doubts else math.nan, reasons=reasons)
    chance = evidence.repeatability
    expected = math.hypot(chance, systematic)
    stated = f"maps of parts of the recording agree within {chance:.2f} spacings"
    level = "usable"
    if not _is_accurate(chance, evidence):
        level = "not usable"
        stated = (
            "insufficient evidence: maps of parts of the recording differ by "
            f"{chance:.2f} spacings; record longer, and touch all of the skin"
        )
    elif not _is_accurate(expected, evidence):
        local = all(doubt.keeps_neighbours or doubt.size <= MAX_ERROR for doubt in doubts)
        level = "usable locally" if local else "not usable"
    chance_first = not doubts or chance >= doubts[0].size
    return Verdict(
        level,
        expected_error=expected,
        repeatability=chance,
        systematic=systematic,
        reasons=(stated, *reasons) if chance_first else (*reasons, stated),
    )


def expected_mantel_r(error: float, extent: float, dimensions: int) -> float:
    """Mantel r of a map with the truth if its positions have independent errors.

    Parameters
    ----------
    error : float
        RMS error of the positions.
    extent : float
        Standard deviation of the distances on the map, in the same unit.
    dimensions : int
        Number of coordinates, k.

    Returns
    -------
    float
        In [0, 1].

    Notes
    -----
    To first order, a distance has an error of variance ``2 error^2 / k``: the sum of the variances
    of two positions along the line that joins them. The distances on the map contain that error.
    """
    if extent <= 0:
        return 0.0
    return math.sqrt(max(0.0, 1 - 2 * error**2 / dimensions / extent**2))


def _is_accurate(error: float, evidence: Evidence) -> bool:
    r = expected_mantel_r(error, evidence.extent, evidence.dimensions)
    return error <= MAX_ERROR and r >= MIN_MANTEL_R
