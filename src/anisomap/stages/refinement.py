"""The last stage: positions refined by the covariogram, by geodesic lengths, by contacts."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.contacts import ContactFit
from anisomap.numerics.covariogram.covariogram_fit import Covariogram, fit_covariogram
from anisomap.numerics.covariogram.minimisation import SharedCurvature
from anisomap.numerics.covariogram.objective import CovariogramOptions
from anisomap.numerics.geodesic.geodesic_refinement import (
    GeodesicOptions,
    refine_by_even_spacing,
)
from anisomap.numerics.geodesic.height_refinement import refine_by_contact_heights
from anisomap.numerics.geodesic.neighbours import (
    local_dimension,
    neighbour_graph,
    unevenness,
)
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.sampling_noise import typical_variance
from anisomap.stages.consensus import combine_with_paths
from anisomap.stages.pairs import PairStatistics

logger = logging.getLogger(__name__)

MIN_SENSORS = 8
"""Sensors of a refined map: fewer have hardly more pairs than coordinates."""

_MIN_FRAMES = 40  # in fewer frames, contacts cannot be distinguished
# At most 1.49 on rolling cylinders of 60 and 120 sensors that are thresholded; at least 1.98 on
# other skins, simulated (seed 1) and real, and 1.66 on a strip of 3 x 20 sensors.
_MAX_CURVE_DIMENSION = 1.55

_UNEVEN = "the covariogram map has very unequal distances between neighbours"
_LONG_CONTACTS = "contacts appear to be long in one direction"
_CONTACT_PEAKS = (
    f"{_LONG_CONTACTS}, so lengths were taken from the peak heights of contacts that pass over "
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
_NOT_CORRECTED = (
    f"{_UNEVEN}, and contacts give no better ones: neighbourhoods may be right, but do not trust "
    "the map's scale along one direction relative to another"
)
_NOT_EXAMINED = (
    f"{_UNEVEN}; peak heights of contacts, which may give better ones, were not examined: map a "
    "part of the recording that fits in memory"
)
_EVEN = "even spacing of neighbours was declared, not measured, and the map relies on it"
_NOT_EVEN = (
    f"{_UNEVEN}, and the halves of the recording disagree about which sensors are neighbours, so "
    "the declared even spacing could not be used: do not trust the map's scale along one "
    "direction relative to another"
)
_UNEXPLAINED = (
    "no single function of distance explains the correlations ({:.0%} of their variance is left), "
    "so contacts differ between places: neighbourhoods may be right, but do not rely on proportions"
)
_TOO_FEW = "even spacing was declared, but there are too few sensors or frames to use it"


@dataclass(frozen=True)
class RefinementFacts:
    """How a map was refined.

    Attributes
    ----------
    contact_peaks : bool
        Lengths were taken from the peak heights of contacts.
    even_spacing : bool or None
        Lengths were taken from declared even spacing; False if it was declared but could not be
        used, None if it was not declared.
    uneven : bool
        Neighbours lie at very unequal distances, and nothing corrected them.
    unresolved : bool
        The heights of contacts contradict the covariogram map, but do not give a reliable one.
    curved : bool
        Sensors lie along a curve on the map.
    heights_contradict : bool
        The heights of contacts contradict the covariogram map.
    n_contacts : int or None
        Number of fitted contacts; None if the map does not use them, 0 if the method
        "contact-fit" rejected them.
    unexplained : float or None
        Share of the variance of the similarity that no function of distance explains, if this is
        too much for the covariogram alone.
    path_weight : float
        Weight of distances along paths of neighbours in the map.
    """

    contact_peaks: bool = False
    even_spacing: bool | None = None
    uneven: bool = False
    unresolved: bool = False
    curved: bool = False
    heights_contradict: bool = False
    n_contacts: int | None = None
    unexplained: float | None = None
    path_weight: float = 0.0

    @property
    def distorted(self) -> bool:
        """Whether the map is distorted in a way that maps of halves of the recording share."""
        return self._along_curves or self.path_weight > 0

    @property
    def elongated(self) -> bool:
        """Whether contacts appear elongated, whereas a fit of contacts assumes compact ones."""
        return self.contact_peaks or bool(self.even_spacing) or self._along_curves

    @property
    def _along_curves(self) -> bool:
        return self.uneven or self.unresolved or self.curved


@dataclass(frozen=True, eq=False)
class ContactAverage:
    """A map that was averaged with a fit of contacts.

    Attributes
    ----------
    fit : ContactFit
    given : ndarray of shape (n, k)
        The map before the average, from which the fit started.
    share : float
        Weight of the fit in the average, in (0, 1].
    """

    fit: ContactFit
    given: Reals
    share: float

    @property
    def positions(self) -> Reals:
        """The average, shape (n, k)."""
        return np.asarray((1 - self.share) * self.given + self.share * self.fit.positions)


@dataclass(frozen=True, eq=False)
class Refined:
    """Refined positions.

    Attributes
    ----------
    positions : ndarray of shape (n, k)
    facts : RefinementFacts
    notes : tuple of str
        Caveats for users.
    contacts : ContactAverage, optional
        The average with a fit of contacts, if the positions are one.
    covariogram : Covariogram, optional
        The covariogram fit, from which all further steps started.
    """

    positions: Reals
    facts: RefinementFacts = field(default_factory=RefinementFacts)
    notes: tuple[str, ...] = ()
    contacts: ContactAverage | None = None
    covariogram: Covariogram | None = None


def refine_by_covariogram(
    pairs: PairStatistics,
    metric: Reals,
    positions: Reals,
    options: CovariogramOptions | None = None,
    *,
    evenly_spaced: bool = False,
    with_heights: bool = True,
    curvature: SharedCurvature | None = None,
) -> Refined:
    """Fit a covariogram, and refine an uneven result by lengths on a neighbour graph.

    Parameters
    ----------
    pairs : PairStatistics
    metric : ndarray of shape (n, n)
    positions : ndarray of shape (n, k)
        From scaling the metric.
    options : CovariogramOptions, optional
    evenly_spaced : bool
        Whether even spacing of neighbours was declared.
    with_heights : bool
        Whether lengths may be taken from the heights of contacts.
    curvature : SharedCurvature, optional
        Shared by covariogram fits of similar recordings of the same sensors, which saves time.

    Returns
    -------
    Refined
        With the given positions if there are fewer than 8 sensors.
    """
    unused = Refined(positions)
    if evenly_spaced:
        unused = Refined(positions, RefinementFacts(even_spacing=False), (_TOO_FEW,))
    if len(positions) < MIN_SENSORS:
        return unused
    fit = fit_covariogram(
        pairs.similarity,
        positions,
        metric,
        noise=typical_variance(pairs.noise),
        known=pairs.known,
        options=options,
        shared=curvature,
    )
    refined = _beyond_covariogram(
        pairs, fit, unused, evenly_spaced=evenly_spaced, with_heights=with_heights
    )
    return replace(refined, covariogram=fit)


def _beyond_covariogram(
    pairs: PairStatistics,
    fit: Covariogram,
    unused: Refined,
    *,
    evenly_spaced: bool,
    with_heights: bool,
) -> Refined:
    """Refine a covariogram map by lengths on a neighbour graph or along paths."""
    positions = fit.positions
    logger.debug(
        "covariogram %.2f exp(-d^%.2f) %+.2f after %d steps",
        fit.amplitude,
        fit.exponent,
        fit.offset,
        fit.iterations,
    )
    readings = pairs.readings if positions.shape[1] > 1 else None  # a line has no directions
    if readings is None or len(readings) < _MIN_FRAMES:
        return _combined(pairs, replace(unused, positions=positions))
    if evenly_spaced:
        spaced = refine_by_even_spacing(readings, fit.positions, similarity=pairs.correlation)
        logger.debug("unevenness %.2f; spacing used: %s", spaced.unevenness, spaced.applied)
        facts = RefinementFacts(even_spacing=spaced.applied)
        return Refined(spaced.positions, facts, (_EVEN if spaced.applied else _NOT_EVEN,))
    if not with_heights:
        return _combined(pairs, replace(unused, positions=positions))
    found = refine_by_contact_heights(
        readings,
        positions,
        similarity=pairs.correlation,
        changes=pairs.changes,
        heights=pairs.heights,
    )
    logger.debug("unevenness %.2f; heights used: %s", found.unevenness, found.applied)
    notes = {
        _CONTACT_PEAKS: found.applied,
        _UNRESOLVED: not found.trusted,
        _NOT_CORRECTED: not found.applied
        and found.trusted
        and found.unevenness > GeodesicOptions.max_unevenness,
        _CURVE: local_dimension(found.positions) < _MAX_CURVE_DIMENSION,
    }
    facts = RefinementFacts(
        contact_peaks=found.applied,
        uneven=notes[_NOT_CORRECTED],
        unresolved=notes[_UNRESOLVED],
        curved=notes[_CURVE],
        heights_contradict=found.contradicted,
    )
    refined = Refined(found.positions, facts, tuple(n for n, holds in notes.items() if holds))
    return refined if found.applied else _combined(pairs, refined)


def _combined(pairs: PairStatistics, mapped: Refined) -> Refined:
    """Combine a covariogram map with path lengths where it leaves correlations unexplained."""
    consensus = combine_with_paths(pairs, mapped.positions)
    logger.debug("unexplained share %.3f", consensus.unexplained)
    if not consensus.path_weight:
        return mapped
    facts = replace(
        mapped.facts, unexplained=consensus.unexplained, path_weight=consensus.path_weight
    )
    note = _UNEXPLAINED.format(consensus.unexplained)
    return Refined(consensus.positions, facts, (*mapped.notes, note))


def unexamined_unevenness(
    readings: NDArray[np.generic], positions: Reals, similarity: Reals
) -> tuple[str, ...]:
    """Return a caveat if a map has uneven neighbours, and contact peaks were not examined.

    Parameters
    ----------
    readings : ndarray of shape (T, n)
        Excerpts of the recording, in temporal order.
    positions : ndarray of shape (n, k)
    similarity : ndarray of shape (n, n)

    Returns
    -------
    tuple of str
        Empty if neighbours lie at similar distances.
    """
    if len(positions) < MIN_SENSORS or positions.shape[1] < 2:
        return ()
    joined = neighbour_graph(readings, positions, similarity=similarity).adjacency
    uneven = unevenness(positions, joined) > GeodesicOptions.max_unevenness
    return (_NOT_EXAMINED,) if uneven else ()
