"""Maps whose lengths come from a graph of neighbours, where correlations say little of one way.

What rolls on a line is touched along whole lines at once: correlations along them hardly fall, and
a map made from them is squeezed flat along the axis. Who is whose neighbour can still be told.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import shortest_path
from scipy.spatial.distance import cdist

from anisomap.errors import InputError
from anisomap.numerics.geodesic.contact_peaks import pass_lengths
from anisomap.numerics.geodesic.neighbours import (
    NeighbourOptions,
    agreement,
    direct_neighbours,
    edge_distances,
    find_links,
    unevenness,
)
from anisomap.numerics.scaling.stress_minimisation import SmacofOptions, smacof

Matrix = NDArray[np.float64]

_SHORTEST = 0.3  # of a typical step: no pair may outweigh all others
_SAME = 1e-9  # logarithms of distances that differ by less differ by rounding
_ROUNDS = 3  # of fitting places and the scale of the guide by turns


@dataclass(frozen=True)
class UnrollingOptions:
    """When lengths are taken from the graph of neighbours; chosen on simulated skins.

    Parameters
    ----------
    neighbours : NeighbourOptions
    power : float
        A path of length H weighs ``H^-power``; 4 to 8 are about as good.
    trust : float
        Weight of a map that helps, at least 0.
    uneven : float
        `unevenness`, above 0, beyond which a map is not believed; 0.4 to 0.7 are as good on the
        skins that were tried.
    agree : float
        Least `agreement` at which the graph is believed where the map is not.
    forced : float
        Most share of forced links at which passes are looked at: where the ends of a body are
        hardly touched, they are joined to anything. It was at most 0.04 on cylinders with bare
        ends, and 0.18 and more on those with sensors there.
    measured : float
        Least share of the links whose length passes must tell.
    confirmed : float
        Most `confirmation` of an uneven map by passes at which it is still set aside. Of 50
        cylinders that rolled it was at most 0.2 (0.31 of one with 200 sensors); of skins that
        touch themselves, whose maps are uneven but right, at least 0.5.
    smacof : SmacofOptions
        When to stop scaling.
    """

    neighbours: NeighbourOptions = field(default_factory=NeighbourOptions)
    power: float = 6.0
    trust: float = 0.003
    uneven: float = 0.5
    agree: float = 0.5
    forced: float = 0.1
    measured: float = 0.5
    confirmed: float = 0.35
    smacof: SmacofOptions = field(default_factory=lambda: SmacofOptions(1e-6, 500))

    def __post_init__(self) -> None:
        for name in ("power", "trust"):
            if not (np.isfinite(value := getattr(self, name)) and value >= 0):
                raise InputError(f"{name} is {value}; it must be at least 0")
        if not self.uneven > 0:
            raise InputError(f"uneven is {self.uneven}; it must be above 0")


@dataclass(frozen=True, eq=False)
class Unrolled:
    """A map, and whether it was made anew.

    Attributes
    ----------
    positions : ndarray of shape (N, k)
        Those that were given, where nothing was done.
    acted : bool
    unevenness : float
        Of the map that was given.
    """

    positions: Matrix
    acted: bool
    unevenness: float


def fit_paths(
    lengths: ArrayLike,
    dimensions: int = 3,
    *,
    guide: ArrayLike | None = None,
    options: UnrollingOptions | None = None,
) -> Matrix:
    """Place sensors so that short paths along a graph come out right, helped by a map.

    Parameters
    ----------
    lengths : array_like of shape (N, N)
        Of the links between neighbours, typically 1; 0 elsewhere. Symmetric, connected.
    dimensions : int
        Number of coordinates, k >= 1; the guide's where there is one.
    guide : array_like of shape (N, k), optional
        A map that is followed as far as it draws neighbours evenly; in any unit.
    options : UnrollingOptions, optional

    Returns
    -------
    ndarray of shape (N, k)
        Centred, in the unit of the lengths.

    Raises
    ------
    InputError
        If the links do not connect all sensors, or shapes disagree.

    Notes
    -----
    Minimises over positions and the guide's scale g ::

        sum_{i<j} H_ij^-p (d_ij - H_ij)^2 + kappa (1 + g c_ij)^-2 (d_ij - g c_ij)^2
        kappa = trust max(0, v^-2 - uneven^-2),  v = unevenness of the guide

    with path lengths H, distances c on the guide, and SMACOF (`smacof`) for the positions. Long
    paths zigzag and cross over folds, so they count next to nothing; a guide that draws neighbours
    evenly knows long distances better, and an uneven one is not listened to.
    """
    chosen = options or UnrollingOptions()
    links = np.asarray(lengths, dtype=np.float64)
    paths = np.asarray(shortest_path(csr_matrix(links), directed=False))
    identity = np.eye(len(links))
    near = (np.maximum(paths, _SHORTEST) + identity) ** -chosen.power
    kappa = 0.0
    if guide is not None:
        steps = edge_distances(guide, links > 0)
        spread = max(float(np.log(steps).std()), np.finfo(np.float64).eps)
        kappa = chosen.trust * max(0.0, spread**-2 - chosen.uneven**-2)
        dimensions = np.shape(guide)[1]
    if kappa == 0:
        start = smacof(paths, dimensions=dimensions, options=chosen.smacof).positions
        return smacof(paths, weights=near, start=start, options=chosen.smacof).positions
    drawn = cdist(np.asarray(guide), np.asarray(guide))
    scale = float(np.exp(-np.log(steps).mean()))
    positions = scale * np.asarray(guide, dtype=np.float64)
    for _ in range(_ROUNDS):
        far = kappa * (1 + scale * drawn) ** -2.0
        weights = near + far
        targets = (near * paths + far * scale * drawn) / weights
        positions = smacof(
            targets, weights=weights, start=positions, options=chosen.smacof
        ).positions
        distances = cdist(positions, positions)
        scale = float((far * distances * drawn).sum() / (far * drawn**2).sum())
    return positions


def even_spacing(
    readings: ArrayLike,
    positions: ArrayLike,
    *,
    similarity: ArrayLike | None = None,
    options: UnrollingOptions | None = None,
) -> Unrolled:
    """Correct a map, given that neighbours are evenly spaced: a prior that must be declared.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings in the order of time.
    positions : array_like of shape (N, k)
        The map.
    similarity : array_like of shape (N, N), optional
        As for `direct_neighbours`.
    options : UnrollingOptions, optional

    Returns
    -------
    Unrolled
        By `fit_paths` with all links of length 1 and the map as its guide, in the map's unit. Not
        acted where the map is too uneven to go by and the halves of the recording do not agree on
        the neighbours.
    """
    chosen = options or UnrollingOptions()
    places = np.asarray(positions, dtype=np.float64)
    joined = direct_neighbours(readings, places, similarity=similarity, options=chosen.neighbours)
    uneven = unevenness(places, joined)
    if uneven > chosen.uneven and not _agreed(readings, places, chosen):
        return Unrolled(places, False, uneven)
    return _unrolled(joined.astype(np.float64), places, uneven, chosen)


def contact_passes(
    readings: ArrayLike,
    positions: ArrayLike,
    *,
    similarity: ArrayLike | None = None,
    options: UnrollingOptions | None = None,
) -> Unrolled:
    """Give a map that draws neighbours very unevenly lengths from the contacts that pass over it.

    Parameters
    ----------
    readings, positions, similarity, options
        As for `even_spacing`.

    Returns
    -------
    Unrolled
        By `fit_paths` with lengths from `pass_lengths` (the median where a link has none), in the
        map's unit. Acted only where all hold: the map is more uneven than
        `UnrollingOptions.uneven`, hardly a link is forced, both halves of the recording agree on
        the neighbours, most links have lengths, and these contradict the map (`confirmation`); any
        other map comes back as it is, to the bit.
    """
    chosen = options or UnrollingOptions()
    places = np.asarray(positions, dtype=np.float64)
    links = find_links(readings, places, similarity=similarity, options=chosen.neighbours)
    joined, uneven = links.joined, unevenness(places, links.joined)
    if (
        uneven <= chosen.uneven
        or links.forced > chosen.forced
        or not _agreed(readings, places, chosen)
    ):
        return Unrolled(places, False, uneven)
    lengths = pass_lengths(readings, joined)
    known = np.isfinite(lengths)
    if (
        np.count_nonzero(known) < max(1.0, chosen.measured * np.count_nonzero(joined))
        or confirmation(places, lengths) > chosen.confirmed
    ):
        return Unrolled(places, False, uneven)
    typical = np.where(known, lengths / np.median(lengths[known]), 1.0)
    return _unrolled(np.where(joined, typical, 0.0), places, uneven, chosen)


def confirmation(positions: ArrayLike, lengths: ArrayLike) -> float:
    """Tell how far lengths of links confirm what a map draws.

    Parameters
    ----------
    positions : array_like of shape (N, k)
    lengths : array_like of shape (N, N)
        Symmetric, above 0 where known and NaN elsewhere, as from
        `anisomap.numerics.geodesic.contact_peaks.pass_lengths`.

    Returns
    -------
    float
        Slope of the logarithms of the lengths over those of the distances on the map: 1 if they
        are proportional, 0 if they have nothing to do with each other, or all distances are equal.
    """
    told = np.asarray(lengths, dtype=np.float64)
    known = np.isfinite(told)
    drawn = np.log(edge_distances(positions, known))
    off = drawn - drawn.mean()
    if not (np.abs(off) > _SAME).any():
        return 0.0
    return float(off @ np.log(told[np.triu(known, 1)])) / float(off @ off)


def _agreed(readings: ArrayLike, places: Matrix, options: UnrollingOptions) -> bool:
    return agreement(readings, places, options=options.neighbours) >= options.agree


def _unrolled(
    lengths: Matrix, places: Matrix, uneven: float, options: UnrollingOptions
) -> Unrolled:
    fitted = fit_paths(lengths, guide=places, options=options)
    before, after = (np.log(edge_distances(x, lengths > 0)).mean() for x in (places, fitted))
    return Unrolled(np.exp(before - after) * fitted, True, uneven)
