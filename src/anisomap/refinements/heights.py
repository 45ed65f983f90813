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
    peak_lengths,
)
from anisomap.numerics.geodesic.path_lengths import fit_path_lengths
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.split_half import N_BLOCKS, at_frames
from anisomap.numerics.similarity.correlation import pearson
from anisomap.options import MethodOptions
from anisomap.refinements.chain import DIFFERENT, EXACT, MIN_FRAMES, MIN_SENSORS, Proposal

_HALF = 0.5
"""Reliability of the heights, and share of them that a map explains, from which each is taken to
hold. Maps explained at most .40 of the heights on rolling cylinders, and at least .89 on other
simulated skins.
"""

_MAX_LINKS = 1.3
"""Links of a sensor by heights, on average and divided by the root of the number of sensors, up to
which heights tell neighbours.

The root is the number of sensors across a skin. Rolling cylinders of 30 to 400 sensors and a bar
had .6 to 1.1, simulated soles of 30 to 400 sensors 1.6 to 6.6.
"""

_MIN_SHARING = 0.05  # correlation of readings above which two sensors share contacts
_CURVE_DIMENSION = 1.5  # between those of a curve and of a surface
_MAX_EXAMINED = 100  # evenly chosen sensors; their 4,950 pairs tell whether heights contradict
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

    The map is replaced if contacts are alike everywhere, so that one function of distance explains
    the correlations, and the similarity of heights is the same in both halves of the recording, but
    distances on the map do not explain it: contacts are long in one direction, and compress the
    map.
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
    """Map the heights of contacts; None if they do not contradict the map. given (n, k)."""
    # Heights of contacts that differ between places, as under a foot, do not show distances.
    if pairs.unexplained(given) > DIFFERENT:
        return None
    n_sensors = len(given)
    some = np.linspace(0, n_sensors - 1, min(n_sensors, _MAX_EXAMINED)).astype(np.intp)
    heights, sharing = _heights(pairs, some)
    explained = explained_share(heights.halves, given[some], sharing)
    if not (heights.usable and explained.reliability > _HALF > explained.share):
        return None
    if len(some) < n_sensors:
        heights, sharing = _heights(pairs, np.arange(n_sensors))
    alike = height_links(heights.compare())
    # All sensors share the load of a step, so that heights on feet do not tell neighbours.
    if np.count_nonzero(alike) > _MAX_LINKS * n_sensors**1.5:
        return None
    by_readings = adjacency_graph(
        np.asarray(pairs.readings), given, similarity=pairs.correlation, changes=pairs.rank_changes
    )
    # Readings tell neighbours on regular columns, heights elsewhere: see the documentation.
    candidates = [
        lengths
        for links in (alike, by_readings)
        if (lengths := _relative_lengths(heights, links)) is not None
    ]
    # In three dimensions, also of flat maps: those of a body that rolls look flat.
    maps = [fit_path_lengths(lengths, SPATIAL) for lengths in candidates]
    shares = [explained_share(heights.halves, one, sharing).share for one in maps]
    best = int(np.argmax(np.nan_to_num([explained.share, *shares], nan=-np.inf))) - 1
    if best < 0:
        return None
    k = given.shape[1]
    return _scaled(maps[best] if k == SPATIAL else fit_path_lengths(candidates[best], k), given)


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
