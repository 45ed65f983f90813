"""The verdict on one page: measurements of a map's errors, the expected accuracy, and the rule.

Resamples of a recording show errors by chance, but not errors common to all maps. Maps with
different assumptions show the latter: numbers of steps on a graph of neighbours make no assumption
about contacts, but assume equal distances between neighbours; the metric alone is too long around
thin parts. The accuracy of maps of known skins is related to these measurements, over the whole map
or in regions. The constants were chosen so that few wrong maps and many good maps are usable
(``docs/development/verdicts.md``); ``python -m benchmarks.verdicts.calibration`` fits them to other
maps, without each kind in turn.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from scipy.special import expit

from anisomap.map_verdict import COMPACT, ELONGATED, Verdict
from anisomap.notes import Note

MIN_AGREEMENT = 0.4
"""Minimum correlation of the similarities of two halves, over pairs of sensors.

Independent noise exceeds it with a probability below 1 in 1,000: 12 sensors have 66 pairs, whose
correlation has a standard deviation of .12 by chance. See ``docs/explanation/trust.md``.
"""

MAX_ERROR = 1.0
"""Maximum upper bound of the error of a usable map, in spacings."""

MIN_KEPT = 0.7
"""Minimum lower bound of the share of kept neighbours of a map that is usable for neighbours.

In the benchmark `trust` (seeds 7001 to 7119), 176 maps reach it, and 8 % of them keep fewer.
"""

MAX_RELATIVE = 0.4
"""Maximum expected error of a map for any use, relative to its extent. It was at most .26 on 63
skins, and above 1 for mixtures of few signals, which have no positions.
"""

GAIN_OF_BENT, BENT = 15.0, 0.23
"""Share explained by a third dimension, relative to noise, above which a flat map is doubtful; and
the share of bent skins among maps below it: 18 of 78 maps with expected errors below .5. Above it,
12 of 16 were of bent skins (seeds 63001 to 63200, 66001 to 66400). On saddles, a third dimension
hardly improves the fit of lengths.
"""

CONFIRMING, HEMISPHERE = 2.3, 0.35
"""Differences of the maps in 2 and 3 dimensions, relative to the expected error and to the extent,
between which 3 dimensions that were not clear are confirmed. The second is the difference of a
hemisphere and its equidistant map, sqrt(1 - (pi^2 / 16 + 1 / 4)^2 / (pi - 2) / .75). Skins that are
bent more are closed, and clear. On 800 skins, this prevents 3 of 5 false confirmations, and none of
14 of good maps.
"""

MAX_CHANCE = 1.0
"""Maximum repeatability, in spacings; beyond it, sensors and neighbours are exchanged by chance."""

MAX_RARELY_TOUCHED = 1 / 2
"""Maximum share of placed sensors with few contacts; with more, neighbours are uncertain."""

MIN_LARGEST, MIN_FRAGMENT = 0.9, 1 / 3
"""Minimum shares of placed sensors in the largest component: of a usable map, and of any map."""


_MUCH = 0.4  # difference of maps of resamples in spacings for which advice is given; by hand


@dataclass(frozen=True)
class Estimate:
    """A number, and the interval that contains the true number for nine of ten maps."""

    value: float
    low: float
    high: float

    def plus(self, size: float, scale: float) -> Estimate:
        """Add an independent error of known size to the estimate, and scale the result."""
        ends = self.value, self.low, self.high
        return Estimate(*(scale * math.hypot(one, size) for one in ends))


BY_CHANCE, BY_STEPS, BY_METRIC, BY_PATHS, BY_LENGTH = 0.84, 0.27, (0.63, 1.0), 0.8, 1.5
"""Expected error per RMS difference of resamples; per difference from the map of steps, and from
the map of the metric, in 2 and in 3 dimensions; per difference from the map of path lengths, if
sensors are unevenly spaced; and factor if contacts are stated to be elongated.
"""

MAX_EXTENT = 0.7
"""Maximum extent of n evenly spaced sensors, in spacings, relative to the root of n: as of lattices
about five times as long as wide; .41 for squares, .28 for spheres."""

ERROR_INTERVAL = (0.5, 2.0)
"""5 % and 95 % quantiles of true errors, relative to expected errors."""

REGION_BY_CHANCE, REGION_BY_DIFFERENCE, REGION_INTERVAL = 0.40, 0.51, (0.5, 2.0)
"""Error of regions per RMS difference of resamples, and per difference of regions of the two maps;
and the relative interval of this error.
"""

NEIGHBOURS, NEIGHBOURS_SLOPE, NEIGHBOURS_INTERVAL = 1.35, -1.08, (-1.0, 1.3)
"""Log odds that a neighbour is kept, ``NEIGHBOURS + NEIGHBOURS_SLOPE log(e)`` for an error e of
regions, and the interval of these log odds.
"""


@dataclass(frozen=True)
class Measurements:
    """Measurements of the errors of a map.

    repeatability: RMS difference of positions by chance, in spacings; NaN if unknown.
    difference: RMS difference from the second map, in spacings.
    metric: RMS difference from the map of the metric alone, in spacings.
    regional: `difference` of regions, each aligned separately.
    between: RMS difference of the maps in 2 and 3 dimensions, in spacings, if the number was
        chosen; else 0. regions_between: The same difference of regions.
    spatial: Whether the map has 3 dimensions. unclear: Whether the metric did not determine this.
    chosen: Whether the number was chosen. gain: Share of the variance of the correlations that a
        third dimension explains, relative to sampling noise; 0 if unknown.
    uneven: Whether the sensors are unevenly spaced on the map. crowded: Whether the density of
        sensors varies on the map. known_uneven: Whether sensors are stated to be unevenly spaced.
        contacts: Stated shape of contacts, one of `anisomap.map_verdict.CONTACTS`; empty if none
        is stated.
    extent: RMS distance of the sensors from their centre, in spacings.
    agreement: Agreement of two halves of the recording: see `agreement_of_halves`.
    paired: Whether the sensors form pairs: see `sensors_pair_off`.
    placed: Number of sensors with positions.
    rarely: Number of placed sensors with too few contacts for a position.
    largest: Number of sensors in the largest component.
    linked: Number of the latter that significant correlations connect; all, if None.
    faults: Sentences on faults of the recording that the measurements show.
    unseen: Sentences on faults of the map that the measurements do not show.
    fatal: Sentences on faults with which similar readings do not indicate near sensors.
    unknown: Reason why the repeatability is unknown, with advice; empty if it is known.
    """

    repeatability: float = math.nan
    difference: float = math.nan
    metric: float = 0.0
    regional: float = math.nan
    between: float = 0.0
    regions_between: float = 0.0
    spatial: bool = False
    unclear: bool = False
    chosen: bool = False
    gain: float = 0.0
    uneven: bool = False
    crowded: bool = False
    known_uneven: bool = False
    contacts: str = ""
    extent: float = math.inf
    agreement: float = 1.0
    paired: bool = False
    placed: int = 0
    rarely: int = 0
    largest: int = 0
    linked: int | None = None
    faults: tuple[str, ...] = ()
    unseen: tuple[str, ...] = ()
    fatal: tuple[str, ...] = ()
    unknown: str = ""

    @property
    def confirmed(self) -> bool:
        """Whether a third dimension changes the map by more than errors do."""
        least, most = CONFIRMING * self.error.value, HEMISPHERE * self.extent
        return self.unclear and least < self.between < most

    @property
    def doubt(self) -> float:
        """Share of such maps with an incorrect number of dimensions; 1 if this is the majority."""
        if self.unclear or self.spatial:
            return float(self.unclear and not self.confirmed)
        return 1.0 if self.gain > GAIN_OF_BENT else BENT

    @property
    def conditional(self) -> bool:
        """Whether the other number of dimensions remains possible, and results in another map."""
        return self.between > 0 and (self.unclear or not self.spatial)

    @property
    def untold(self) -> tuple[Note, ...]:
        """Note on an unclear number of dimensions if there is a single map, as for unequal runs."""
        return (Note("unclear-dimensions"),) if self.unclear and not self.between else ()

    @property
    def unseen_squash(self) -> bool:
        """Whether undetected compression by long contacts, or crowding by a fold, is possible."""
        irregular = self.uneven or self.crowded
        return irregular and not (self.known_uneven and self.contacts == COMPACT)

    @property
    def error(self) -> Estimate:
        """Expected error if the number of dimensions is correct: the root of a sum of squares."""
        parts = [BY_STEPS * self.difference, BY_METRIC[self.spatial] * self.metric]
        parts = [BY_PATHS * self.difference] if self.uneven else parts
        factor = BY_LENGTH if self.contacts == ELONGATED else 1.0
        error = factor * math.hypot(BY_CHANCE * self.repeatability, *parts)
        return Estimate(error, *(end * error for end in ERROR_INTERVAL))

    @property
    def clustering(self) -> float:
        """Spacing over that of as many evenly spaced sensors, at most 1: small in clusters."""
        clustered = self.uneven and not self.known_uneven and math.isfinite(self.extent)
        return min(1.0, MAX_EXTENT * math.sqrt(self.largest) / self.extent) if clustered else 1.0

    @property
    def ruining(self) -> tuple[str, ...]:
        """Sentences on faults that make the whole map unusable."""
        found = [*self.fatal]
        if self.agreement < MIN_AGREEMENT:
            found.append(Note("halves-disagree", agreement=self.agreement))
        if self.paired:
            found.append(Note("paired"))
        if self.rarely > MAX_RARELY_TOUCHED * self.placed:
            found.append(Note("rarely-touched", count=self.rarely, total=self.placed))
        return tuple(found)


def judge(measured: Measurements) -> Verdict:
    """Return the verdict that follows from the measurements."""
    ruined = measured.ruining
    limits = [*ruined, *measured.unseen, *measured.untold]
    if measured.largest < MIN_LARGEST * measured.placed:
        apart = measured.placed - measured.largest
        limits.append(Note("apart", apart=apart, placed=measured.placed))
    connected = measured.largest if measured.linked is None else measured.linked
    if connected < MIN_LARGEST * measured.largest:
        limits.append(Note("unlinked", count=measured.largest - connected, total=measured.largest))
    sizes = measured.repeatability, measured.difference
    if measured.unknown or any(map(math.isnan, (*sizes, measured.regional))):
        return Verdict(reasons=(measured.unknown or Note("not-examined"), *limits))
    error = measured.error
    region = region_error(measured.repeatability, measured.regional, error.value)
    share = math.sqrt(measured.doubt)
    scale, extent = measured.clustering, measured.clustering * measured.extent
    error = error.plus(share * measured.between, scale)
    region = region.plus(share * measured.regions_between, scale)
    kept = neighbours_kept(region.value / scale)
    shaped = error.value < MAX_RELATIVE * extent
    if shaped and error.high < MAX_ERROR and not limits and not measured.unseen_squash:
        level = "usable"
    elif (
        kept.low >= MIN_KEPT
        and measured.repeatability <= MAX_CHANCE
        and connected >= MIN_FRAGMENT * measured.placed
        and shaped
        and not ruined
    ):
        level = "usable for neighbours"
    else:
        level = "not usable"
    limits += _conditions(measured, error.value / scale, usable=level == "usable")
    if level != "usable":
        limits += measured.faults
    return Verdict(
        level,
        *(error.value, error.low, error.high),
        *(region.value, region.low, region.high),
        *(kept.value, kept.low, kept.high),
        measured.repeatability,
        reasons=(*limits, *_reasons(measured, advise=level != "usable")),
    )


def _conditions(measured: Measurements, error: float, *, usable: bool) -> Iterator[Note]:
    """Yield notes on the conditions of the expected error: dimensions, and compact contacts."""
    if measured.conditional:
        yield Note("if-flat" if measured.spatial else "if-bent", size=measured.between)
    elif measured.chosen and not measured.unclear and not usable:
        yield Note("chosen-dimensions")
    if measured.uneven or measured.crowded:
        yield Note("if-compact" if measured.unseen_squash else "compact", size=error)


def _reasons(measured: Measurements, *, advise: bool) -> tuple[Note, ...]:
    """Return notes on the measurements, ordered by contribution to the expected error."""
    repeatability, difference = measured.repeatability, measured.difference
    chance = Note("chance", size=repeatability, much=advise and repeatability > _MUCH)
    kind = "map-of-paths" if measured.uneven else "second-map"
    other = Note(kind, size=difference, much=advise and difference > 2 * _MUCH)
    return (chance, other) if repeatability >= difference / 2 else (other, chance)


_LEAST = 0.01  # spacings: smaller errors are not calibrated
_GREATEST = 1e6  # spacings: keeps the odds finite


def region_error(repeatability: float, difference: float, error: float) -> Estimate:
    """Estimate the RMS error of regions, at most the error of the map, all in spacings.

    difference: Difference of regions of two maps, each aligned separately.
    """
    found = math.hypot(REGION_BY_CHANCE * repeatability, REGION_BY_DIFFERENCE * difference)
    found = min(found, error)
    return Estimate(found, *(factor * found for factor in REGION_INTERVAL))


def neighbours_kept(region: float) -> Estimate:
    """Estimate the share of true neighbours that are neighbours on the map, from `region_error`."""
    odds = NEIGHBOURS + NEIGHBOURS_SLOPE * math.log(min(max(region, _LEAST), _GREATEST))
    return Estimate(*(float(expit(odds + more)) for more in (0.0, *NEIGHBOURS_INTERVAL)))
