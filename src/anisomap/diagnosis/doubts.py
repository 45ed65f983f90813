"""Other maps that explain a recording about as well: what all of them share can be relied on.

Each map rests on one assumption. The default method assumes that contacts are alike everywhere.
Paths of neighbours assume nothing of distant sensors, but that similar sensors are close. A map of
evenly spaced sensors assumes nothing of contacts, but that neighbours are equally far apart. Where
an assumption fails, maps differ, even if maps of parts of the recording agree.

Detectors of systematic errors: what bends all maps of a recording alike.

The sizes of doubts were tuned on simulated skins of ``make trust``: seeds 1 to 28, where a constant
does not state others. They are tested on seeds from 3001 on: see ``docs/explanation/trust.md``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import shortest_path
from scipy.spatial.distance import pdist

from anisomap.diagnosis.verdict import MAX_CHANCE, Doubt
from anisomap.evaluation.scoring import align, median_spacing, spacing_variation
from anisomap.health import Finding, spoiling
from anisomap.numerics.geodesic.neighbours import neighbour_graph, unevenness
from anisomap.numerics.geodesic.path_lengths import GeodesicOptions
from anisomap.numerics.graph.neighbour_graphs import local_path_lengths
from anisomap.numerics.precision import Reals
from anisomap.numerics.scaling.multidimensional_scaling import smacof
from anisomap.sensor_map import SensorMap

N_NEIGHBOURS = 5
"""Neighbours of each sensor in the map along paths.

Few, so that paths differ from the map of all correlations: differences from maps of 5, 8 and 15
neighbours followed the true error about equally well (tuning seeds 1 to 28), and those from 5 best.
"""


@dataclass(frozen=True)
class OtherMaps:
    """RMS differences of a map from other maps, after the best similarity, in its spacings.

    paths: From the map of path lengths along the most similar sensors.
    even: From the map of the numbers of steps between sensors on a graph of adjacent sensors.
    unevenness: Spread of the distances between adjacent sensors on the map itself.
    """

    paths: float
    even: float
    unevenness: float = 0.0


def compare_with_other_maps(
    readings: ArrayLike,
    positions: ArrayLike,
    similarity: ArrayLike,
    *,
    changes: ArrayLike | None = None,
    correlation: ArrayLike | None = None,
) -> OtherMaps:
    """Measure how much other maps of the same recording differ from a map.

    readings (T, N), positions (N, k), similarity (N, N), changes (N, N), correlation (N, N).
    """
    points, values = np.asarray(positions, dtype=np.float64), np.asarray(similarity)
    graph = neighbour_graph(
        readings, points, similarity=values if correlation is None else correlation, changes=changes
    )
    steps = shortest_path(graph.adjacency.astype(np.float64), unweighted=True)
    paths = local_path_lengths(values, min(N_NEIGHBOURS, len(points) - 1))
    return OtherMaps(
        paths=_difference(points, paths),
        even=_difference(points, steps),
        unevenness=unevenness(points, graph.adjacency) if points.shape[1] > 1 else 0.0,
    )


def _difference(positions: Reals, lengths: Reals) -> float:
    """RMS difference of a map from the scaled lengths, in spacings of the map."""
    spacing = median_spacing(positions)
    if spacing == 0 or not np.isfinite(lengths).all() or not lengths.any():
        return float("inf")
    # Classical scaling as start: the other maps must not inherit a fold of this one.
    scaled = smacof(lengths, dimensions=positions.shape[1])
    return align(scaled.positions, positions).rms / spacing


PATHS, PATHS_TOLERANCE = 1.05, 0.2
EVEN, EVEN_TOLERANCE = 1.0, 0.5
"""Expected error per difference from the other maps, and difference, in spacings, that is usual.

Least squares of the logarithms of errors, together with `DISTORTED`; the repeatability is added in
quadrature. The error was within a factor of 2 of the expected one in 86 % of 96 maps (seeds 1 to 28
of ``make trust``, apart from copies and signals of one period). Paths differ by .2 spacings on
regular lattices; sensors of few skins are spaced so evenly that steps differ by less than .5.
`EVEN` is larger than fitted (.45), so that flat skins whose contacts differ in size between
places, which nothing else shows, are not called usable.
"""

SPACING, SPACING_TOLERANCE = 3.0, 0.15
"""Expected error, in spacings, per variation of the distances between nearest neighbours, and
variation that is usual.

A surface that touches a body along lines or patches that are longer in one direction leaves a map
that is too short in that direction: correlations, paths and steps agree on it, but neighbours in
that direction are closer than others. Maps of a tube and a torus on which a flat surface is pressed
have variations of .22 to .35 and errors of 1.3 to 1.5 spacings; without this doubt, the errors to
expect were .27 to .59. Good maps have .03 to .09 (34 maps of 2,500 to 4,000 frames, seeds 103 to
111 and 190 to 240). Eight of nine real skins have true variations of at most .12. Skins that are
really uneven get this doubt as well, as readings do not tell them apart.
"""

DISTORTED = 0.3
"""Error of distorted maps, as a share of the extent of the map."""

SPOILT = 0.25
"""Error because of a fault that was found, or of several components, in spacings.

Faults make maps differ from other maps and from maps of parts of the recording, which shows most of
their effect: with .25, the median ratio of the expected to the true error of 37 faulty recordings
is 1.8, with .5 it is 2.1 (all kinds of faults on 6 skins, seeds 228 to 287). A map of a recording
with a fault is never called usable, as the fault can be mended first.
"""

HARMLESS = ("clock-jitter",)
"""Faults that change no map: the default method does not use times."""

LEAST_DISTORTED = 0.5
"""Least error, in spacings, of maps that the method calls distorted; maps of a torus on which a
flat surface is pressed, which it does, have errors of 1.5 (seeds 105 and 232)."""

_UNEVEN = (
    "the map has very unequal distances between neighbours: do not trust the map's scale along one "
    "direction relative to another"
)

# Shares of the sensors, chosen by hand: in the largest component of a whole map; of a map at all.
_MIN_LARGEST, _MIN_SHARE = 0.9, 1 / 3
_FRAGMENT = 1.5  # spacings: enough that the map of a fragment is not usable


def systematic_doubts(
    sensor_map: SensorMap,
    faults: Sequence[Finding] = (),
    *,
    readings: ArrayLike | None = None,
    similarity: ArrayLike | None = None,
    changes: ArrayLike | None = None,
    correlation: ArrayLike | None = None,
    repeatability: float = 0.0,
    halves: float = 0.0,
) -> tuple[Doubt, ...]:
    """Find out what may bend all maps of a recording alike.

    readings (T, n), similarity (n, n), changes (n, n), correlation (n, n).
    """
    largest = sensor_map.component == 0
    positions = sensor_map.positions[largest]
    found = [*_of_components(sensor_map), *_of_faults(faults, positions)]
    uneven = False
    if readings is not None and similarity is not None:
        others = compare_with_other_maps(
            readings, positions, similarity, changes=changes, correlation=correlation
        )
        uneven = others.unevenness > GeodesicOptions.max_unevenness
        found += _of_halves(halves, repeatability)
        found += _of_spacings(positions)
        found += _of_other_maps(others, max(repeatability, halves))
    return (*_of_distortion(sensor_map, uneven=uneven), *found)


def extent_in_spacings(positions: ArrayLike) -> float:
    """Return the standard deviation of the distances on a map, in its spacings.

    positions (N, k).
    """
    points = np.asarray(positions, dtype=np.float64)
    spacing = median_spacing(points)
    return float(np.std(pdist(points))) / spacing if spacing > 0 else math.inf


def _of_halves(halves: float, repeatability: float) -> Iterator[Doubt]:
    if halves > repeatability:
        size = math.sqrt(halves**2 - repeatability**2) if math.isfinite(halves) else math.inf
        yield Doubt(
            "halves",
            size,
            f"maps of the two halves of the recording differ by {halves:.2f} spacings, more than "
            "by chance: the fit can end in different maps",
            keeps_neighbours=halves <= MAX_CHANCE,
            measured=halves,
        )


def _of_spacings(positions: NDArray[np.float64]) -> Iterator[Doubt]:
    variation = spacing_variation(positions)
    yield Doubt(
        "spacing",
        SPACING * max(0.0, variation - SPACING_TOLERANCE),
        f"distances between nearest neighbours on the map vary by {variation:.0%}: contacts may be "
        "longer in one direction, in which the map is too short, or sensors are unevenly spaced",
        keeps_neighbours=True,
        measured=variation,
    )


def _of_other_maps(others: OtherMaps, repeatability: float) -> Iterator[Doubt]:
    usual = math.hypot(repeatability, PATHS_TOLERANCE)
    beyond = math.sqrt(max(0.0, others.paths**2 - usual**2)) if others.paths > usual else 0.0
    yield Doubt(
        "paths",
        PATHS * beyond,
        f"a map by paths along similar sensors differs by {others.paths:.2f} spacings: contacts "
        "may differ between places",
        keeps_neighbours=True,
        measured=others.paths,
    )
    yield Doubt(
        "even",
        EVEN * max(0.0, others.even - EVEN_TOLERANCE),
        f"a map for evenly spaced sensors differs by {others.even:.2f} spacings: contacts may be "
        "longer in one direction, or larger in one place",
        keeps_neighbours=True,
        measured=others.even,
    )


def _of_distortion(sensor_map: SensorMap, *, uneven: bool) -> Iterator[Doubt]:
    if not (sensor_map.uneven or uneven):
        return
    said = [note for note in sensor_map.notes if "trust" in note] if sensor_map.uneven else []
    size = DISTORTED * extent_in_spacings(sensor_map.positions[sensor_map.component == 0])
    yield Doubt(
        "distortion",
        max(LEAST_DISTORTED, size),
        said[0] if said else _UNEVEN,
        keeps_neighbours=True,
    )


def _of_components(sensor_map: SensorMap) -> Iterator[Doubt]:
    largest = np.count_nonzero(sensor_map.component == 0)
    placed = np.count_nonzero(sensor_map.placed)
    apart = f"the positions of {placed - largest} of {placed} sensors relative to the others are "
    if largest < _MIN_SHARE * placed:
        reason = f"{apart}unknown: the map shows only {largest} sensors"
        yield Doubt("fragment", _FRAGMENT, reason, measured=largest / placed)
    elif largest < _MIN_LARGEST * placed:
        yield Doubt(
            "components",
            SPOILT,
            f"{apart}unknown",
            keeps_neighbours=True,
            measured=largest / placed,
            excludes_usable=True,
        )


def _of_faults(faults: Sequence[Finding], positions: NDArray[np.float64]) -> Iterator[Doubt]:
    for fault in faults:
        sentences = spoiling([fault])
        if not sentences or fault.kind in HARMLESS:
            continue
        size, measured = SPOILT, fault.size
        if fault.kind == "one-period":
            size, measured = _misplaced(positions, 1.0), math.nan
        elif fault.kind == "copies":
            # One of each pair of sensors, at least, lies at the place of the other.
            share = min(1.0, len(fault.sensors) / 2 / len(positions))
            size, measured = _misplaced(positions, share), math.nan
        yield Doubt(
            fault.kind,
            size,
            sentences[0],
            keeps_neighbours=fault.kind != "one-period",
            measured=measured,
            excludes_usable=True,
        )


def _misplaced(positions: NDArray[np.float64], share: float) -> float:
    """RMS error, in spacings, if a share of the sensors lies at the places of other ones.

    Two places drawn at random are apart by the root of two standard deviations of the positions.
    """
    spacing = median_spacing(positions)
    spread = math.sqrt(float(positions.var(axis=0).sum()))
    return math.sqrt(2 * share) * spread / spacing if spacing > 0 else math.inf
