"""Better places than scaling alone gives, from all that is known of the sensors."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.contacts import ContactOptions, fit_contacts
from anisomap.numerics.covariogram.fit import fit_covariogram
from anisomap.numerics.covariogram.objective import CovariogramOptions
from anisomap.numerics.geodesic.neighbours import neighbour_graph, unevenness
from anisomap.numerics.geodesic.refinement import (
    GeodesicOptions,
    refine_by_contact_peaks,
    refine_by_even_spacing,
)
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.sampling_noise import typical_variance
from anisomap.recording import Scalar

logger = logging.getLogger(__name__)

Matrix: TypeAlias = Reals

_FEWEST_TO_FIT = 8  # sensors; fewer have hardly more pairs than coordinates
_LENGTHWISE = ("passes", "uneven", "even_spacing")
"""Facts of maps whose contacts are longer than compact ones: these would bend such maps."""

_FEWEST_FRAMES = 40  # fewer hold no contacts that could be told apart

_UNEVEN = "the covariogram map drew neighbours at very unequal distances"
_PASSES = (
    f"{_UNEVEN}, so the map's lengths were taken from the heights of the contacts that pass over "
    "neighbours; this assumes a ground or touch that is equally rough in both directions"
)
_SQUEEZED = (
    f"{_UNEVEN}, and contacts do not tell better ones: where things lie may be right, but do not "
    "trust the map's scale along one direction against another"
)
_SQUEEZED_UNSEEN = (
    f"{_UNEVEN}, and the heights of contacts, which may tell better ones, were not looked at: map "
    "a part of the recording that memory holds"
)
_EVEN = "that neighbours are evenly spaced was declared, not measured, and the map rests on it"
_NOT_EVEN = (
    f"{_UNEVEN}, and the halves of the recording do not agree on who is whose neighbour, so the "
    "even spacing that was declared could not be used: do not trust the map's scale along one "
    "direction against another"
)
_TOO_LITTLE = (
    "that neighbours are evenly spaced was declared, but there are too few sensors or frames to "
    "make use of it"
)


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is known of some sensors: how alike they are, and how far that can be believed.

    Attributes
    ----------
    similarity : ndarray of shape (n, n)
    noise : ndarray of shape (n, n)
        Sampling variance of each similarity.
    known : ndarray of bool, shape (n, n)
        Which pairs were ever recorded together.
    readings : ndarray of shape (T, n), optional
        What the sensors read, in the order of time; None where only the similarity is known, or
        not all pairs are.
    """

    similarity: Matrix
    noise: Matrix
    known: NDArray[np.bool_]
    readings: NDArray[np.generic] | None = None

    def of(self, sensors: NDArray[np.bool_]) -> Evidence:
        """Keep only some sensors, given as a mask of shape (n,)."""
        if sensors.all():
            return self
        inside = np.ix_(sensors, sensors)
        readings = None if self.readings is None else self.readings[:, sensors]
        return Evidence(self.similarity[inside], self.noise[inside], self.known[inside], readings)

    def knowing(self, known: NDArray[np.bool_]) -> Evidence:
        """Take some pairs for unknown, and the readings with them, which would tell of them.

        Whatever their similarity was said to be, it is 0 from then on.
        """
        told = known | np.eye(len(known), dtype=bool)
        if told.all():
            return replace(self, known=known)
        alike = np.where(told, self.similarity, 0)
        return replace(self, similarity=alike, known=known, readings=None)


@dataclass(frozen=True, eq=False)
class Refined:
    """Better places, and what must be said of them.

    Attributes
    ----------
    positions : ndarray of shape (n, k)
    facts : mapping
        For `anisomap.SensorMap.provenance`.
    notes : tuple of str
        What speaks against the map.
    """

    positions: Matrix
    facts: Mapping[str, Scalar] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def refine_by_covariogram(
    evidence: Evidence,
    metric: Matrix,
    positions: Matrix,
    options: CovariogramOptions | None = None,
    *,
    evenly_spaced: bool = False,
) -> Refined:
    """Fit a covariogram, and take lengths from neighbours where it says little of one direction.

    Parameters
    ----------
    evidence : Evidence
    metric : ndarray of shape (n, n)
    positions : ndarray of shape (n, k)
        Where scaling the metric put the sensors.
    options : CovariogramOptions, optional
    evenly_spaced : bool
        Whether neighbours were declared to be.

    Returns
    -------
    Refined
        With ``"passes"`` or ``"even_spacing"`` among its facts where lengths come from
        `anisomap.numerics.geodesic.refinement.refine_by_contact_peaks` or
        `refine_by_even_spacing`, and
        ``"uneven"`` where they should but cannot. Fewer than 8 sensors are left where they are.
    """
    unused = Refined(positions)
    if evenly_spaced:
        unused = Refined(positions, {"even_spacing": False}, (_TOO_LITTLE,))
    if len(positions) < _FEWEST_TO_FIT:
        return unused
    fit = fit_covariogram(
        evidence.similarity,
        positions,
        metric,
        noise=typical_variance(evidence.noise),
        known=evidence.known,
        options=options,
    )
    logger.info(
        "covariogram %.2f exp(-d^%.2f) %+.2f after %d steps",
        fit.amplitude,
        fit.exponent,
        fit.offset,
        fit.iterations,
    )
    readings = evidence.readings if positions.shape[1] > 1 else None  # in a line, nothing turns
    if readings is None or len(readings) < _FEWEST_FRAMES:
        return replace(unused, positions=fit.positions)
    unroll = refine_by_even_spacing if evenly_spaced else refine_by_contact_peaks
    found = unroll(readings, fit.positions, similarity=evidence.similarity)
    logger.info(
        "neighbours are %.2f uneven; lengths from them: %s", found.unevenness, found.applied
    )
    if evenly_spaced:
        return Refined(
            found.positions,
            {"even_spacing": found.applied},
            (_EVEN if found.applied else _NOT_EVEN,),
        )
    if found.applied:
        return Refined(found.positions, {"passes": True}, (_PASSES,))
    if found.unevenness > GeodesicOptions.max_unevenness:
        return Refined(found.positions, {"uneven": True}, (_SQUEEZED,))
    return Refined(found.positions)


def notes_on_squeezing(
    readings: NDArray[np.generic], positions: Matrix, similarity: Matrix
) -> tuple[str, ...]:
    """Say so if a map that was not refined by passes would have been.

    Parameters
    ----------
    readings : ndarray of shape (T, n)
        Stretches of the recording, in the order of time.
    positions : ndarray of shape (n, k)
    similarity : ndarray of shape (n, n)

    Returns
    -------
    tuple of str
        Empty where neighbours lie at similar distances.
    """
    if len(positions) < _FEWEST_TO_FIT or positions.shape[1] < 2:
        return ()
    joined = neighbour_graph(readings, positions, similarity=similarity).adjacency
    uneven = unevenness(positions, joined) > GeodesicOptions.max_unevenness
    return (_SQUEEZED_UNSEEN,) if uneven else ()


def refine_by_contacts(
    evidence: Evidence, mapped: Refined, options: ContactOptions | None = None
) -> Refined:
    """Refine a map by contacts, where these can be believed.

    Parameters
    ----------
    evidence : Evidence
        With readings; without, the map stays.
    mapped : Refined
        A map that is nearly right.
    options : ContactOptions, optional

    Returns
    -------
    Refined
        With ``"contacts"``, how many there were, among its facts, or 0 and a note why the map
        stayed as it was.
    """
    if evidence.readings is None:
        return _unrefined(mapped, "readings of all sensors in the same frames were not given")
    if len(mapped.positions) < _FEWEST_TO_FIT:
        return _unrefined(mapped, f"{len(mapped.positions)} sensors are too few")
    if any(mapped.facts.get(fact) for fact in _LENGTHWISE):
        return _unrefined(mapped, "contacts here are long, and those that are fitted are compact")
    fit = fit_contacts(evidence.readings, mapped.positions, options)
    logger.info("%d contacts explain %.2f of their readings", fit.n_contacts, fit.explained)
    if not fit.used:
        return _unrefined(mapped, fit.reason)
    return replace(
        mapped, positions=fit.positions, facts={**mapped.facts, "contacts": fit.n_contacts}
    )


def _unrefined(mapped: Refined, doubt: str) -> Refined:
    note = f"contacts did not refine the map, which is the covariogram method's: {doubt}"
    return replace(mapped, facts={**mapped.facts, "contacts": 0}, notes=(*mapped.notes, note))
