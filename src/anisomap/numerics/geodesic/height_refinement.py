"""Refinement of maps that contacts long in one direction have compressed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import pdist

from anisomap.numerics.geodesic.contact_heights import (
    ContactHeights,
    Explained,
    HeightSimilarity,
    explained_share,
    height_halves,
)
from anisomap.numerics.geodesic.geodesic_refinement import refine_by_contact_peaks
from anisomap.numerics.geodesic.height_map import (
    HeightMap,
    HeightMapOptions,
    fit_height_map,
    linear_share,
    weakest_link,
)
from anisomap.numerics.geodesic.neighbours import neighbour_graph, unevenness
from anisomap.numerics.reliability.blending import blended_correlation
from anisomap.numerics.reliability.split_half import N_BLOCKS, at_frames

Matrix = NDArray[np.float64]

_MAX_EXAMINED = 250
"""Evenly chosen sensors in which heights are examined first.

Their 31,000 pairs suffice to tell whether heights contradict a map.
"""

_MAX_FRAMES = 10_000
"""Frames, of blocks at even intervals, in which heights are examined first."""


@dataclass(frozen=True)
class HeightOptions:
    """Conditions under which the heights of contacts correct a map.

    Tuned on rolling cylinders with sensors on columns, at even and at random places, seeds 1 to 5,
    and on 49 other simulated and 9 real recordings, of seed 1.

    Parameters
    ----------
    min_sharing : float
        Correlation of readings above which two sensors share contacts.
    min_reliability : float
        Minimum `Explained.reliability`.
    max_explained : float
        `Explained.share` below which heights contradict a map. It was at most 0.37 on compressed
        maps of rolling cylinders, and at least 0.58 on other skins except walking feet (0.37),
        where no map explains heights.
    min_explained : float
        Minimum `Explained.share` of a map that explains heights: at least 0.79 on rolling
        cylinders.
    min_gain : float
        Minimum difference of the shares that both maps explain: at least 0.54 on rolling cylinders,
        at most 0.42 under walking feet.
    min_compressed : float
        Minimum `linear_share` at which the given map is taken for a compressed image of that map:
        long contacts compress a map, and do not rearrange it. It was at most 0.22 where spikes or
        noise of read-out boards made heights similar.
    min_linear : float
        Minimum `linear_share` at which that map replaces the given one.
    min_weakest : float
        Minimum `weakest_link` of a map that is trusted.
    min_agreement : float
        Minimum Mantel r of the maps of both halves, of a map that is trusted.
    min_trusted_linear : float
        Minimum `linear_share` of a map that is trusted.
    min_confirmed : float
        Mantel r of the two maps with lengths from heights at which they confirm each other.
    maps : HeightMapOptions
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
    min_confirmed: float = 0.9
    maps: HeightMapOptions = field(default_factory=HeightMapOptions)


@dataclass(frozen=True, eq=False)
class HeightRefinement:
    """A map, and what the heights of contacts say about it.

    Attributes
    ----------
    positions : ndarray of shape (N, k)
        The given positions if not `applied`.
    applied : bool
        Whether lengths were taken from heights.
    trusted : bool
        False if heights contradict the given map, but do not suffice for a reliable one.
    unevenness : float
        `unevenness` of the given map.
    contradicted : bool
        Whether heights contradict the given map, so that it was attempted to apply lengths.
    """

    positions: Matrix
    applied: bool
    trusted: bool
    unevenness: float
    contradicted: bool = False


def refine_by_contact_heights(
    readings: ArrayLike,
    positions: ArrayLike,
    *,
    similarity: ArrayLike | None = None,
    changes: ArrayLike | None = None,
    heights: ContactHeights | None = None,
    options: HeightOptions | None = None,
) -> HeightRefinement:
    """Refine a map by lengths from the heights of contacts, if these contradict the map.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings in temporal order.
    positions : array_like of shape (N, k)
        The map.
    similarity : array_like of shape (N, N), optional
        `blended_correlation` of the readings, if already computed.
    changes : array_like of shape (N, N), optional
        That of the differences between frames, if already computed.
    heights : ContactHeights, optional
        `examined_heights` of the readings, if already computed.
    options : HeightOptions, optional

    Returns
    -------
    HeightRefinement
        In the unit of the map. Applied only if the similarity of heights is the same in both halves
        of the recording, the map does not explain it, a map with lengths from heights does, and the
        given map is a compressed image of that map. Of two such maps, `refine_by_contact_peaks`
        and `fit_height_map`, the first is preferred where they agree, since its graph of neighbours
        comes from all readings.
    """
    chosen = options or HeightOptions()
    values = np.asarray(readings)
    given = np.asarray(positions, dtype=np.float64)
    correlation = blended_correlation(values) if similarity is None else np.asarray(similarity)
    graph = neighbour_graph(values, given, similarity=correlation, changes=changes)
    uneven = unevenness(given, graph.adjacency)
    unchanged = HeightRefinement(given, False, True, uneven)
    sharing = correlation > chosen.min_sharing
    some = _examined_sensors(len(given))
    heights = examined_heights(values) if heights is None else heights
    if not heights.usable:
        return unchanged
    halves = heights.halves
    explained = explained_share(halves, given[some], sharing[np.ix_(some, some)])
    if not _contradicted(explained, chosen):
        return unchanged
    if heights.ranks.shape != values.shape:
        heights = ContactHeights.of(values)
        halves = heights.halves
        explained = explained_share(halves, given, sharing)
        if not (heights.usable and _contradicted(explained, chosen)):
            return unchanged
    unchanged = replace(unchanged, contradicted=True)
    whole = heights.compare()
    fitted = fit_height_map(whole, given, chosen.maps)
    by_peaks = refine_by_contact_peaks(values, given, similarity=correlation, changes=changes)
    passed = HeightMap(by_peaks.positions, graph.adjacency) if by_peaks.applied else None
    confirmed = (
        passed is not None
        and _agreement(passed.positions, fitted.positions) >= chosen.min_confirmed
    )
    resolved = weakest_link(whole, fitted.links) >= chosen.min_weakest
    candidates = [fitted] if passed is None else [passed, fitted]
    if resolved and not confirmed:
        candidates.reverse()
    least = max(chosen.min_explained, explained.share + chosen.min_gain)
    explaining = [
        candidate
        for candidate in candidates
        if explained_share(halves, candidate.positions, sharing).share >= least
    ]
    compressed = [linear_share(candidate.positions, given) for candidate in explaining]
    if not any(share >= chosen.min_compressed for share in compressed):
        return unchanged
    for candidate, share in zip(explaining, compressed, strict=True):
        if share >= chosen.min_linear:
            trusted = confirmed or (
                weakest_link(whole, candidate.links) >= chosen.min_weakest
                and share >= chosen.min_trusted_linear
                and _halves_agree(height_halves(heights, len(values)), given, chosen)
            )
            scaled = _scaled(candidate.positions, given)
            return HeightRefinement(scaled, True, trusted, uneven, contradicted=True)
    return replace(unchanged, trusted=False)


def examined_heights(readings: NDArray[Any]) -> ContactHeights:
    """Find the heights of contacts from which it is seen whether they contradict a map.

    Parameters
    ----------
    readings : ndarray of shape (T, N)
        Finite readings in temporal order.

    Returns
    -------
    ContactHeights
        Of at most 250 sensors, evenly chosen, and of at most 10,000 frames in blocks: as
        `split_blocks`, each at the beginning of such a block.
    """
    n_frames, n_sensors = readings.shape
    if n_frames > _MAX_FRAMES:
        begins = np.linspace(0, n_frames, N_BLOCKS, endpoint=False).astype(np.intp)
        length = _MAX_FRAMES // N_BLOCKS
        readings = at_frames(readings, np.add.outer(begins, np.arange(length)).ravel())
    return ContactHeights.of(readings[:, _examined_sensors(n_sensors)])


def _examined_sensors(n_sensors: int) -> NDArray[np.intp]:
    return np.linspace(0, n_sensors - 1, min(n_sensors, _MAX_EXAMINED)).astype(np.intp)


def _contradicted(explained: Explained, options: HeightOptions) -> bool:
    """Return whether heights are reliable, and contradict a map."""
    reliable = explained.reliability >= options.min_reliability
    return reliable and explained.share < options.max_explained


def _halves_agree(halves: list[HeightSimilarity], given: Matrix, options: HeightOptions) -> bool:
    first, second = (fit_height_map(half, given, options.maps).positions for half in halves)
    return _agreement(first, second) >= options.min_agreement


def _agreement(first: Matrix, second: Matrix) -> float:
    return float(np.corrcoef(pdist(first), pdist(second))[0, 1])


def _scaled(positions: Matrix, given: Matrix) -> Matrix:
    """Scale a map such that its linear image has the size of the given map."""
    source, target = (x - x.mean(axis=0) for x in (positions, given))
    image = np.linalg.lstsq(source, target, rcond=None)[0]
    return np.asarray(positions * np.linalg.norm(image, ord=2))
