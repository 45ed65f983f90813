"""Positions at which neighbours are evenly spaced, where users declare that they are."""

from __future__ import annotations

from anisomap.evidence import PairStatistics
from anisomap.numerics.geodesic.path_lengths import refine_by_even_spacing
from anisomap.numerics.precision import Reals
from anisomap.options import MethodOptions
from anisomap.refinements.chain import EXACT, MIN_FRAMES, MIN_SENSORS, Proposal

_EVEN = "even spacing of neighbours was declared, not measured, and the map relies on it"
_NOT_EVEN = (
    "the halves of the recording disagree about which sensors are neighbours, so the declared even "
    "spacing could not be used: do not trust the map's scale along one direction relative to "
    "another"
)
_TOO_FEW = "even spacing was declared, but there are too few sensors or frames to use it"


def by_even_spacing(
    pairs: PairStatistics, _: Reals, positions: Reals, options: MethodOptions
) -> Proposal | None:
    """Replace the map by one with evenly spaced neighbours, if that was declared."""
    if not options.even_spacing:
        return None
    readings = pairs.readings
    if readings is None or len(readings) < MIN_FRAMES or len(positions) < MIN_SENSORS:
        return Proposal(positions, notes=(_TOO_FEW,), facts={"even_spacing": False})
    if positions.shape[1] == 1:  # a line has no directions
        return None
    spaced = refine_by_even_spacing(readings, positions, similarity=pairs.correlation)
    if spaced is None:
        return Proposal(positions, notes=(_NOT_EVEN,), facts={"even_spacing": False})
    return Proposal(
        spaced,
        EXACT,
        notes=(_EVEN,),
        facts={"even_spacing": True},
        elongated=True,
    )
