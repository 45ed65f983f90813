"""Positions by the heights of contacts, where contacts are long in one direction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.dimensions import SPATIAL
from anisomap.evidence import PairStatistics
from anisomap.numerics.geodesic.adjacency import adjacency_graph, local_dimension
from anisomap.numerics.geodesic.contact_heights import (
    ContactHeights,
    explained_share,
    height_links,
    linear_share,
    peak_lengths,
)
from anisomap.numerics.geodesic.path_lengths import fit_path_lengths
from anisomap.numerics.neighbours import padded
from anisomap.numerics.precision import Reals
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.reliability.split_half import N_BLOCKS, at_frames
from anisomap.numerics.similarity.correlation import pearson
from anisomap.options import MethodOptions
from anisomap.refinements.chain import EXACT, MIN_FRAMES, MIN_SENSORS, Proposal

_HALF = 0.5
"""Reliability of the heights, share of them that a map explains, and share of a map that is a
linear image of another, from which each is taken to hold.

Maps explained at most .40 of the heights on rolling cylinders, and at least .89 on other simulated
skins. Maps of rolling cylinders were linear images of the maps by heights by at least .59, those of
insoles, whose heights they do not explain either, by at most .33.
"""

_MAX_UNEXPLAINED = 0.45
"""Share of the heights that a map left unexplained which remains in a better one: at most .36 on 43
of 44 rolling cylinders, .34 to .54 on parts of a recording of a sole, .15 to 1.3 on insoles."""

_MIN_SHARING = 0.05  # correlation of readings above which two sensors share contacts
_CURVE_DIMENSION = 1.5  # between those of a curve and of a surface
_MAX_EXAMINED = 250  # evenly chosen sensors; their 31,000 pairs tell whether heights contradict
_MAX_FRAMES = 10_000  # of blocks at even intervals, in which heights are examined

_LONG_CONTACTS = "contacts appear to be long in one direction"
_USED = (
    f"{_LONG_CONTACTS}, so lengths were taken from the heights of contacts that pass over "
    "neighbours; this assumes that ground or touch is equally rough in both directions"
)
CURVE = (
    "the sensors lie along a curve on the map: unless they form a line on the skin, "
    f"{_LONG_CONTACTS}, and the map must not be trusted"
)


def by_heights(
    pairs: PairStatistics, _: Reals, positions: Reals, _options: MethodOptions
) -> Proposal | None:
    """Replace the map by one with lengths from the heights of contacts, where these contradict it.

    They do if their similarity is the same in both halves of the recording and distances on the
    map do not explain it. The map is replaced if a map with lengths from heights explains it, and
    the given map is a compressed image of that one: long contacts compress a map, and do not
    rearrange it.
    """
    readings = pairs.readings
    if readings is None or len(readings) < MIN_FRAMES or len(positions) < MIN_SENSORS:
        return None
    if positions.shape[1] == 1:  # a line has no directions
        return None
    given = np.asarray(positions, dtype=np.float64)
    found = _corrected(pairs, given)
    final = given if found is None else found
    curved = bool(local_dimension(final) < _CURVE_DIMENSION)
    facts = {"contact_heights": found is not None, "curved": curved}
    return Proposal(
        final,
        0.0 if found is None else EXACT,
        notes=(() if found is None else (_USED,)) + ((CURVE,) if curved else ()),
        facts={name: True for name, holds in facts.items() if holds},
        distorted=curved,
        elongated=curved or found is not None,
    )


def _corrected(pairs: PairStatistics, given: Reals) -> Reals | None:
    """Map the heights of contacts; None if they do not show a compressed map. given (n, k)."""
    n_sensors = len(given)
    some = np.linspace(0, n_sensors - 1, min(n_sensors, _MAX_EXAMINED)).astype(np.intp)
    heights, sharing = _heights(pairs, some)
    explained = explained_share(heights.halves, given[some], sharing)
    contradicted = explained.reliability > _HALF > explained.share
    if not (heights.usable and contradicted):
        return None
    if len(some) < n_sensors:
        heights, sharing = _heights(pairs, np.arange(n_sensors))
    by_readings = adjacency_graph(
        np.asarray(pairs.readings), given, similarity=pairs.correlation, changes=pairs.changes
    )
    # Readings tell neighbours on regular columns, heights elsewhere: see the documentation.
    candidates = [
        lengths
        for links in (height_links(heights.compare()), by_readings)
        if (lengths := _relative_lengths(heights, links)) is not None
    ]
    # In three dimensions, also of flat maps: those of a body that rolls look flat.
    maps = [fit_path_lengths(lengths, SPATIAL) for lengths in candidates]
    shares = [explained_share(heights.halves, one, sharing).share for one in maps]
    if not shares:
        return None
    best = int(np.argmax(np.nan_to_num(shares, nan=-np.inf)))
    left = 1 - shares[best]
    explains = left <= _MAX_UNEXPLAINED * (1 - explained.share)
    compressed = explains and linear_share(maps[best], given) >= _HALF
    if not (compressed and _exceeds_chance(heights, candidates[best] > 0, maps[best], given)):
        return None
    k = given.shape[1]
    return _scaled(maps[best] if k == SPATIAL else fit_path_lengths(candidates[best], k), given)


def _exceeds_chance(
    heights: ContactHeights, links: NDArray[np.bool_], found: Reals, given: Reals
) -> bool:
    """Return whether two maps differ by more than maps by the heights of both halves do.

    links (n, n), found (n, 3), given (n, k).
    """
    n_axes = max(SPATIAL, given.shape[1])
    frame = padded(np.asarray(found, dtype=np.float64), n_axes)

    def in_frame(positions: Reals) -> NDArray[np.float64]:
        spatial = padded(np.asarray(positions, dtype=np.float64), n_axes)
        return fit_similarity(spatial, frame).apply(spatial)

    lengths = [_relative_lengths(half, links) for half in heights.in_halves()]
    maps = [in_frame(fit_path_lengths(one, SPATIAL)) for one in lengths if one is not None]
    if len(maps) < len(lengths):
        return False
    by_chance = np.square(maps[0] - maps[1]).sum()
    return bool(np.square(frame - in_frame(given)).sum() > by_chance)


def _relative_lengths(heights: ContactHeights, links: NDArray[np.bool_]) -> Reals | None:
    """Return lengths of links by contact peaks, with a median of 1; None if none is measured."""
    lengths = peak_lengths(heights, links)
    known = np.isfinite(lengths)
    if not known.any():
        return None
    return np.asarray(np.where(known, lengths / np.median(lengths[known]), links))


def _heights(
    pairs: PairStatistics, sensors: NDArray[np.intp]
) -> tuple[ContactHeights, NDArray[np.bool_]]:
    """Return the heights of contacts of sensors, and which of them share contacts, (n, n)."""
    readings = np.asarray(pairs.readings)[:, sensors]
    if len(readings) > _MAX_FRAMES:
        begins = np.linspace(0, len(readings), N_BLOCKS, endpoint=False).astype(np.intp)
        readings = at_frames(
            readings, np.add.outer(begins, np.arange(_MAX_FRAMES // N_BLOCKS)).ravel()
        )
    heights = ContactHeights.of(pairs.rest.select(sensors).depth(readings))
    return heights, pearson(readings) > _MIN_SHARING


def _scaled(positions: Reals, given: Reals) -> Reals:
    """Scale a map such that its linear image has the size of the given map."""
    source, target = (x - x.mean(axis=0) for x in (positions, given))
    image = np.linalg.lstsq(source, target, rcond=None)[0]
    return np.asarray(positions * np.linalg.norm(image, ord=2))
