"""Positions by the heights of contacts, where contacts are long in one direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from anisomap.evidence import PairStatistics
from anisomap.numerics.geodesic.contact_heights import (
    ContactHeights,
    Explained,
    HeightSimilarity,
    explained_share,
    height_halves,
)
from anisomap.numerics.geodesic.height_map import (
    HeightMap,
    fit_height_map,
    linear_share,
    weakest_link,
)
from anisomap.numerics.geodesic.neighbours import local_dimension
from anisomap.numerics.geodesic.path_lengths import refine_by_contact_peaks
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.split_half import N_BLOCKS, at_frames
from anisomap.numerics.similarity.correlation import pearson
from anisomap.options import MethodOptions
from anisomap.refinements.chain import EXACT, MIN_FRAMES, MIN_SENSORS, Proposal

# At most 1.49 on rolling cylinders of 60 and 120 sensors that are thresholded; at least 1.98 on
# other skins, simulated (seed 1) and real, and 1.66 on a strip of 3 x 20 sensors.
_MAX_CURVE_DIMENSION = 1.55

_CONFIRMED = 0.9  # Mantel r of two maps by heights that confirm each other
_MAX_EXAMINED = 250  # evenly chosen sensors; their 31,000 pairs tell whether heights contradict
_MAX_FRAMES = 10_000  # of blocks at even intervals, in which heights are examined first

_LONG_CONTACTS = "contacts appear to be long in one direction"
_USED = (
    f"{_LONG_CONTACTS}, so lengths were taken from the heights of contacts that pass over "
    "neighbours; this assumes that ground or touch is equally rough in both directions"
)
_UNRESOLVED = (
    f"{_LONG_CONTACTS}, and the heights of contacts do not resolve it reliably: do not trust the "
    "map's scale along one direction relative to another, nor the map as a whole"
)
_CURVE = (
    "the sensors lie along a curve on the map: unless they form a line on the skin, "
    f"{_LONG_CONTACTS}, and the map must not be trusted"
)


@dataclass(frozen=True)
class HeightOptions:
    """Conditions under which the heights of contacts correct a map.

    Tuned on rolling cylinders with sensors on columns, at even and at random places, seeds 1 to 5,
    and on 49 other simulated and 9 real recordings, of seed 1.

    min_sharing: Correlation of readings above which two sensors share contacts.
    min_reliability: Minimum `Explained.reliability`.
    max_explained: `Explained.share` below which heights contradict a map. It was at most 0.37 on
        compressed maps of rolling cylinders, and at least 0.58 on other skins except walking feet
        (0.37), where no map explains heights.
    min_explained: Minimum `Explained.share` of a map that explains heights: at least 0.79 on
        rolling cylinders.
    min_gain: Minimum difference of the shares that both maps explain: at least 0.54 on rolling
        cylinders, at most 0.42 under walking feet.
    min_compressed: Minimum `linear_share` at which the given map is taken for a compressed image of
        that map: long contacts compress a map, and do not rearrange it. It was at most 0.22 where
        spikes or noise of read-out boards made heights similar.
    min_linear: Minimum `linear_share` at which that map replaces the given one.
    min_weakest: Minimum `weakest_link` of a map that is trusted.
    min_agreement: Minimum Mantel r of the maps of both halves, of a map that is trusted.
    min_trusted_linear: Minimum `linear_share` of a map that is trusted.
    """

    min_sharing: float = 0.05
    min_reliability: float = 0.6
    max_explained: float = 0.5
    min_explained: float = 0.74
    min_gain: float = 0.48
    min_compressed: float = 0.4
    min_linear: float = 0.7
    min_weakest: float = 0.43
    min_agreement: float = 0.85
    min_trusted_linear: float = 0.9


def by_heights(
    pairs: PairStatistics, _: Reals, positions: Reals, _options: MethodOptions
) -> Proposal | None:
    """Replace the map by one with lengths from the heights of contacts, where these contradict it.

    They do if their similarity is the same in both halves of the recording and distances on the
    map do not explain it. The map is replaced if a map with lengths from heights explains it, and
    the given map is a compressed image of that one.
    """
    readings = pairs.readings
    if readings is None or len(readings) < MIN_FRAMES or len(positions) < MIN_SENSORS:
        return None
    if positions.shape[1] == 1:  # a line has no directions
        return None
    given, options = np.asarray(positions, dtype=np.float64), HeightOptions()
    found = _corrected(pairs, given, options) if _contradicted(pairs, given, options) else None
    applied = found is not None and found.precision == EXACT
    final = given if found is None else found.positions
    curved = bool(local_dimension(final) < _MAX_CURVE_DIMENSION)
    distorted = curved or (found is not None and found.distorted)
    notes = () if found is None else found.notes
    facts = {"contact_heights": applied, "curved": curved}
    return Proposal(
        final,
        EXACT if applied else 0.0,
        notes=(*notes, _CURVE) if curved else notes,
        facts={name: True for name, holds in facts.items() if holds},
        distorted=distorted,
        elongated=distorted or applied,
    )


def _contradicted(pairs: PairStatistics, given: Reals, options: HeightOptions) -> bool:
    """Return whether heights of some sensors in some frames contradict a map."""
    readings = np.asarray(pairs.readings)
    n_frames, n_sensors = readings.shape
    some = np.linspace(0, n_sensors - 1, min(n_sensors, _MAX_EXAMINED)).astype(np.intp)
    if n_frames > _MAX_FRAMES:
        begins = np.linspace(0, n_frames, N_BLOCKS, endpoint=False).astype(np.intp)
        frames = np.add.outer(begins, np.arange(_MAX_FRAMES // N_BLOCKS)).ravel()
        readings = at_frames(readings, frames)
    heights = ContactHeights.of(pairs.rest.select(some).depth(readings[:, some]))
    if not heights.usable:
        return False
    sharing = _sharing(readings[:, some], options)
    return _is_contradiction(explained_share(heights.halves, given[some], sharing), options)


def _is_contradiction(explained: Explained, options: HeightOptions) -> bool:
    reliable = explained.reliability >= options.min_reliability
    return reliable and explained.share < options.max_explained


def _sharing(readings: NDArray[np.generic], options: HeightOptions) -> NDArray[np.bool_]:
    """Pairs of sensors that are touched in the same frames, shape (n, n)."""
    return pearson(readings) > options.min_sharing


def _corrected(pairs: PairStatistics, given: Reals, options: HeightOptions) -> Proposal | None:
    """Map the heights of all contacts; None if they do not show a compressed map."""
    readings = np.asarray(pairs.readings)
    heights = ContactHeights.of(pairs.rest.depth(readings))
    sharing = _sharing(readings, options)
    explained = explained_share(heights.halves, given, sharing)
    if not (heights.usable and _is_contradiction(explained, options)):
        return None
    whole = heights.compare()
    maps = _maps(pairs, whole, given)
    confirmed = len(maps) > 1 and _agreement(*(one.positions for one in maps)) >= _CONFIRMED
    resolved = weakest_link(whole, maps[-1].links) >= options.min_weakest
    least = max(options.min_explained, explained.share + options.min_gain)
    compressed = {
        linear_share(one.positions, given): one
        for one in (maps[::-1] if resolved and not confirmed else maps)
        if explained_share(heights.halves, one.positions, sharing).share >= least
    }
    if not any(share >= options.min_compressed for share in compressed):
        return None
    for share, one in compressed.items():
        if share < options.min_linear:
            continue
        trusted = confirmed or (
            weakest_link(whole, one.links) >= options.min_weakest
            and share >= options.min_trusted_linear
            and _halves_agree(heights, given, options)
        )
        notes = (_USED,) if trusted else (_USED, _UNRESOLVED)
        return Proposal(_scaled(one.positions, given), EXACT, notes=notes, distorted=not trusted)
    return Proposal(given, notes=(_UNRESOLVED,), distorted=True)


def _maps(pairs: PairStatistics, whole: HeightSimilarity, given: Reals) -> list[HeightMap]:
    """Return the maps by heights: by peaks on a graph of neighbours, if it has one, and by all."""
    fitted = fit_height_map(whole, given)
    passed = refine_by_contact_peaks(
        np.asarray(pairs.readings), given, similarity=pairs.correlation, changes=pairs.changes
    )
    if not passed.applied:
        return [fitted]
    return [HeightMap(passed.positions, passed.graph.adjacency), fitted]


def _halves_agree(heights: ContactHeights, given: Reals, options: HeightOptions) -> bool:
    halves = height_halves(heights, len(heights.ranks))
    first, second = (fit_height_map(half, given).positions for half in halves)
    return _agreement(first, second) >= options.min_agreement


def _agreement(first: Reals, second: Reals) -> float:
    return float(np.corrcoef(pdist(first), pdist(second))[0, 1])


def _scaled(positions: Reals, given: Reals) -> Reals:
    """Scale a map such that its linear image has the size of the given map."""
    source, target = (x - x.mean(axis=0) for x in (positions, given))
    image = np.linalg.lstsq(source, target, rcond=None)[0]
    return np.asarray(positions * np.linalg.norm(image, ord=2))
