"""The refinements of a map: steps that propose positions, and the loop that averages them.

A step is a function ``step(pairs, metric, positions, options)`` that returns a `Proposal`, or
None where it has nothing to propose. A method names its steps in order, in `anisomap.method.named`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist, squareform

from anisomap.method.dimensions import SPATIAL
from anisomap.method.evidence import PairStatistics
from anisomap.method.options import MethodOptions
from anisomap.numerics.contacts import ContactFit, fit_contacts
from anisomap.numerics.contacts.contact_agreement import is_on_off
from anisomap.numerics.covariogram.covariogram_fit import Covariogram, fit_covariogram
from anisomap.numerics.geodesic.adjacency import (
    adjacency_graph,
    fit_path_lengths,
    refine_by_even_spacing,
)
from anisomap.numerics.geodesic.contact_heights import (
    ContactHeights,
    explained_share,
    height_links,
    peak_lengths,
)
from anisomap.numerics.graph.neighbour_graphs import local_path_lengths
from anisomap.numerics.neighbours import local_dimension
from anisomap.numerics.precision import Reals
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.reliability.sampling_noise import typical_variance
from anisomap.numerics.reliability.split_half import N_BLOCKS, at_frames
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions, smacof
from anisomap.numerics.similarity.correlation import pearson
from anisomap.recording import Scalar

logger = logging.getLogger(__name__)

MIN_FRAMES = 40
"""Frames of a map that is refined by contacts: in fewer, they cannot be distinguished."""

MIN_SENSORS = 8
"""Sensors of a refined map: fewer have hardly more pairs than coordinates."""

DIFFERENT = 0.04
"""Share of the variance of the correlations that distances on a map leave unexplained, from which
contacts differ from place to place: at least .045 where they did, and at most .02 elsewhere.
"""

EXACT = math.inf
"""Precision of a proposal that replaces the map, after which no step can add to it."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """Positions that a step proposes for the sensors of a map.

    positions (n, k): In the frame and unit of the map that the step started from.
    precision: Reciprocal of the variance of the positions, in units of that of the covariogram
        map; 0 leaves the map as it is.
    notes: Caveats for users.
    facts: What the step found, for the provenance of the map.
    distorted: Whether the map is distorted in a way that maps of halves of the recording share.
    elongated: Whether contacts appear long in one direction.
    fit: The covariogram of the positions, if they follow from one.
    """

    positions: Reals
    precision: float = 0.0
    notes: tuple[str, ...] = ()
    facts: Mapping[str, Scalar] = field(default_factory=dict)
    distorted: bool = False
    elongated: bool = False
    fit: Covariogram | None = None


Step: TypeAlias = Callable[[PairStatistics, Reals, Reals, MethodOptions], Proposal | None]


@dataclass(frozen=True, eq=False)
class RefinedMap:
    """Positions (n, k), the sum of the precisions of all proposals, and the proposals.

    proposals: That of each step that made one, in order.
    weights: Weight of each of them in the map that it was combined to, in [0, 1].
    """

    positions: Reals
    precision: float
    proposals: Mapping[str, Proposal]
    weights: Mapping[str, float]

    @property
    def notes(self) -> tuple[str, ...]:
        """Caveats of all steps."""
        return tuple(note for one in self.proposals.values() for note in one.notes)

    @property
    def facts(self) -> dict[str, Scalar]:
        """The weight of each step that moved the map, and what the steps found."""
        facts: dict[str, Scalar] = {
            f"weight_of_{name}": round(weight, 3) for name, weight in self.weights.items() if weight
        }
        for one in self.proposals.values():
            facts |= one.facts
        return facts

    @property
    def distorted(self) -> bool:
        """Whether any step found that maps of halves share a distortion."""
        return any(one.distorted for one in self.proposals.values())

    @property
    def elongated(self) -> bool:
        """Whether any step found contacts that are long in one direction."""
        return any(one.elongated for one in self.proposals.values())


def refine(
    pairs: PairStatistics,
    metric: Reals,
    positions: Reals,
    steps: Mapping[str, Step],
    options: MethodOptions,
) -> RefinedMap:
    """Average a map with the proposals of the steps of a method, weighted by precision.

    metric (n, n), positions (n, k).
    """
    precision = 0.0
    proposals: dict[str, Proposal] = {}
    weights: dict[str, float] = {}
    for name, step in steps.items():
        proposal = step(pairs, metric, positions, options)
        if proposal is None:
            continue
        precision += proposal.precision
        weight = 1.0 if precision == EXACT else 0.0
        if 0 < proposal.precision < EXACT:
            weight = proposal.precision / precision
        if weight == 1:
            positions = proposal.positions
        elif weight > 0:
            positions = (1 - weight) * positions + weight * proposal.positions
        logger.debug("%s has weight %.2f", name, weight)
        proposals[name], weights[name] = proposal, weight
        if precision == EXACT:
            break
    return RefinedMap(positions, precision, proposals, weights)


def by_covariogram(
    pairs: PairStatistics, metric: Reals, positions: Reals, options: MethodOptions
) -> Proposal | None:
    """Propose the positions at which one function of distance explains all correlations."""
    if len(positions) < MIN_SENSORS:
        return None
    fit = fit_covariogram(
        pairs.similarity,
        positions,
        metric,
        noise=typical_variance(pairs.noise),
        known=pairs.known,
        options=options.covariogram,
        near=pairs.near,
    )
    logger.debug(
        "covariogram %.2f exp(-d^%.2f) %+.2f after %d steps",
        fit.amplitude,
        fit.exponent,
        fit.offset,
        fit.iterations,
    )
    return Proposal(fit.positions, precision=1.0, fit=fit)


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
    return Proposal(spaced, EXACT, notes=(_EVEN,), facts={"even_spacing": True}, elongated=True)


_HALF = 0.5
"""Reliability of the heights, and share of them that a map explains, from which each is taken to
hold. Maps explained at most .40 of the heights on rolling cylinders, and at least .89 on others.
"""

_MAX_LINKS = 1.3
"""Links of a sensor by heights, on average and divided by the root of the number of sensors, up to
which heights tell neighbours: .6 to 1.1 on rolling cylinders and a bar, 1.6 to 6.6 on soles.
"""

_MIN_SHARING = 0.05  # correlation of readings above which two sensors share contacts
_CURVE_DIMENSION = 1.5  # between those of a curve and of a surface
_MAX_EXAMINED = 100  # evenly chosen sensors; their 4,950 pairs tell whether heights contradict
_MAX_FRAMES = 10_000  # of blocks at even intervals, in which heights are examined

_LONG_CONTACTS = "contacts appear to be long in one direction"
_BY_HEIGHTS = (
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

    Contacts that are long in one direction compress the map: they are alike everywhere, and the
    similarity of heights is the same in both halves of the recording, but distances on the map do
    not explain it.
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
        notes=(() if found is None else (_BY_HEIGHTS,)) + ((CURVE,) if curved else ()),
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
    candidates = []
    for links in (alike, by_readings):
        lengths = peak_lengths(heights, links)
        measured = np.isfinite(lengths)
        if measured.any():
            candidates.append(np.where(measured, lengths / np.median(lengths[measured]), links))
    # In three dimensions, also of flat maps: those of a body that rolls look flat.
    maps = [fit_path_lengths(lengths, SPATIAL) for lengths in candidates]
    shares = [explained_share(heights.halves, one, sharing).share for one in maps]
    best = int(np.argmax(np.nan_to_num([explained.share, *shares], nan=-np.inf))) - 1
    if best < 0:
        return None
    k = given.shape[1]
    chosen = maps[best] if k == SPATIAL else fit_path_lengths(candidates[best], k)
    # Scaled such that its linear image has the size of the given map.
    source, target = (x - x.mean(axis=0) for x in (chosen, given))
    image = np.linalg.lstsq(source, target, rcond=None)[0]
    return np.asarray(chosen * np.linalg.norm(image, ord=2))


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


_NEAR_MINIMUM = SmacofOptions(tolerance=1e-6)

_PATHS_UNEXPLAINED = 0.05
"""Unexplained share that the errors of path lengths themselves, from noise and bends, amount to;
.02 to .1 give about equal maps.
"""

_DIFFERENT_CONTACTS = (
    "contacts differ from place to place ({:.0%} of the variance of the correlations does not "
    "follow from distance), so lengths are less certain than neighbours"
)


def by_paths(
    pairs: PairStatistics, _: Reals, positions: Reals, _options: MethodOptions
) -> Proposal | None:
    """Propose a map of path lengths, where distances on the map leave correlations unexplained.

    The covariogram compresses regions of wide contacts. Paths follow bends, but assume nothing
    about distant regions. The variance of each map is taken to be proportional to the share that
    it leaves unexplained, to which paths add their own.
    """
    if len(positions) < MIN_SENSORS:
        return None
    share = pairs.unexplained(positions)
    if share <= 0:
        return None
    paths = _normalised_paths(pairs.similarity)
    if pairs.readings is not None:
        paths = (paths + _normalised_paths(pearson(pairs.ranks))) / 2
    dimensions = positions.shape[1]
    distances = squareform(pdist(positions))
    lengths = distances.sum() / (len(paths) * (len(paths) - 1)) * paths
    # Started from the scaling of the mean of both, which folds neither.
    given = scaled = np.asarray(positions, dtype=np.float64)
    for target in ((distances + lengths) / 2, lengths):
        found = smacof(target, dimensions=dimensions, start=scaled, options=_NEAR_MINIMUM)
        scaled = found.positions
    proposed = fit_similarity(scaled, given).apply(scaled)
    precision = share / (max(share, pairs.unexplained(proposed)) + _PATHS_UNEXPLAINED)
    distorted = share > DIFFERENT
    return Proposal(
        proposed,
        precision,
        notes=(_DIFFERENT_CONTACTS.format(share),) if distorted else (),
        facts={"unexplained": share},
        distorted=distorted,
    )


def _normalised_paths(similarity: Reals) -> Reals:
    """Return path lengths with a mean of 1, shape (n, n)."""
    lengths = local_path_lengths(similarity)
    n_sensors = len(lengths)
    return np.asarray(lengths * (n_sensors * (n_sensors - 1) / lengths.sum()))


_LEAST_UNEXPLAINED = 0.01  # share; keeps the odds finite for readings without noise


def by_contacts(
    pairs: PairStatistics, _: Reals, positions: Reals, options: MethodOptions
) -> Proposal | None:
    """Propose a map by contacts, where they are compact and alike and explain the readings.

    The precision is the odds of the share of the entropy of the readings that distances from
    contacts explain. The outline of a contact alone, of readings that are on or off, tells nothing
    that the covariogram of such readings does not.
    """
    if pairs.readings is None or len(positions) < MIN_SENSORS or is_on_off(pairs.readings):
        return None
    fit = fit_contacts(pairs.readings, positions, options.contacts, rest=pairs.rest)
    # Readings from which a common signal was subtracted are not depths of contacts.
    explained = fit.explained * (1 - pairs.common_share)
    odds = explained / max(1 - explained, _LEAST_UNEXPLAINED)
    return _by_fit(fit, odds) if fit.used else None


def only_contacts(
    pairs: PairStatistics, _: Reals, positions: Reals, options: MethodOptions
) -> Proposal | None:
    """Replace the map by that of a fit of contacts; a note says why, where it is not used."""
    if pairs.readings is None:
        reason = "readings of all sensors in the same frames were not given"
    elif len(positions) < MIN_SENSORS:
        reason = f"{len(positions)} sensors are too few"
    else:
        fit = fit_contacts(pairs.readings, positions, options.contacts, rest=pairs.rest)
        if fit.used:
            return _by_fit(fit, EXACT)
        reason = fit.reason
    note = f"the map was not refined by contacts: {reason}"
    return Proposal(positions, notes=(note,), facts={"n_contacts": 0})


def _by_fit(fit: ContactFit, precision: float) -> Proposal:
    facts: dict[str, Scalar] = {
        "n_contacts": fit.n_contacts,
        "explained": round(fit.explained, 3),
    }
    return Proposal(fit.positions, precision, facts=facts)
