"""The last stage of some methods: maps averaged with, or replaced by, a fit of contacts."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.contacts import ContactFit, ContactOptions, fit_contacts
from anisomap.numerics.contacts.contact_fit import refit_contacts
from anisomap.numerics.procrustes import fit_similarity
from anisomap.stages.pairs import PairStatistics
from anisomap.stages.refinement import MIN_SENSORS, ContactAverage, Refined

logger = logging.getLogger(__name__)

# Weights of the contact fit in the average with the covariogram map. Graded readings locate a
# contact better than readings that are on or off, of which the covariogram already compares
# contacts. Of .5, .67, .75 and 1, chosen on simulated skins, seeds 101 and 102, and the iCub's.
_GRADED_WEIGHT, _BINARY_WEIGHT = 0.75, 0.5

_NEAR = 0.5
"""Departure of a map of some frames from that of all frames, in spacings and before contacts are
fitted, up to which contacts and their readings are those of the map of all frames.

It is the standard deviation up to which a fit of contacts follows the map that it starts from.
"""


def average_with_contacts(
    pairs: PairStatistics, mapped: Refined, options: ContactOptions | None = None
) -> Refined:
    """Average a map with a fit of contacts, where contacts are compact and alike.

    Parameters
    ----------
    pairs : PairStatistics
    mapped : Refined
        A nearly correct map.
    options : ContactOptions, optional

    Returns
    -------
    Refined
        The given map if there are no readings, contacts are elongated or differ between places, or
        the fit does not explain the readings.

    Notes
    -----
    The covariogram assumes that correlation falls with distance in the same way everywhere, which
    curvature and edges of the skin violate; the fit assumes that contacts are round. Both have
    systematic errors, which differ.
    """
    if (
        pairs.readings is None
        or len(mapped.positions) < MIN_SENSORS
        or mapped.facts.elongated
        or mapped.facts.path_weight
    ):
        return mapped
    fit = fit_contacts(pairs.readings, mapped.positions, options)
    logger.debug("%d contacts explain %.2f of their readings", fit.n_contacts, fit.explained)
    if not fit.used:
        return mapped
    return _averaged(mapped, fit, _BINARY_WEIGHT if fit.n_levels == 1 else _GRADED_WEIGHT)


def average_with_known_contacts(
    known: ContactAverage, mapped: Refined, frames: NDArray[np.intp]
) -> Refined | None:
    """Average a map of some frames with a fit of their contacts, which are known from all frames.

    Parameters
    ----------
    known : ContactAverage
        Of the map of all frames.
    mapped : Refined
        A map of the same sensors.
    frames : ndarray of int
        Indices of its frames.

    Returns
    -------
    Refined or None
        In the frame and unit of the map of all frames, with the same exceptions as
        `average_with_contacts`. None if the map is too far from that of all frames, so that its
        contacts have to be detected.
    """
    if mapped.facts.elongated or mapped.facts.path_weight:
        return mapped
    if known.fit.solution is None:
        return None
    given = np.asarray(known.given, dtype=np.float64)
    positions = np.asarray(mapped.positions, dtype=np.float64)
    moved = fit_similarity(positions, given).apply(positions)
    spacing = known.fit.solution.unit
    if float(np.sqrt(np.square(moved - given).sum(axis=1).mean())) > _NEAR * spacing:
        return None
    aligned = replace(mapped, positions=moved)
    fit = refit_contacts(known.fit, moved, frames)
    return _averaged(aligned, fit, known.share) if fit.used else aligned


def _averaged(mapped: Refined, fit: ContactFit, share: float) -> Refined:
    average = ContactAverage(fit, mapped.positions, share)
    return replace(
        mapped,
        positions=average.positions,
        facts=replace(mapped.facts, n_contacts=fit.n_contacts),
        contacts=average,
    )


def refine_by_contacts(
    pairs: PairStatistics, mapped: Refined, options: ContactOptions | None = None
) -> Refined:
    """Fit the contacts that caused the readings, if they are compact and explain the readings.

    Parameters
    ----------
    pairs : PairStatistics
        Without readings, the map is returned unchanged.
    mapped : Refined
        A nearly correct map.
    options : ContactOptions, optional

    Returns
    -------
    Refined
        With the number of contacts among its facts, or 0 and a note why the map is unchanged.
    """
    if pairs.readings is None:
        return _rejected(mapped, "readings of all sensors in the same frames were not given")
    if len(mapped.positions) < MIN_SENSORS:
        return _rejected(mapped, f"{len(mapped.positions)} sensors are too few")
    if mapped.facts.elongated:
        return _rejected(mapped, "the contacts are elongated, and the fit assumes compact ones")
    fit = fit_contacts(pairs.readings, mapped.positions, options)
    logger.debug("%d contacts explain %.2f of their readings", fit.n_contacts, fit.explained)
    if not fit.used:
        return _rejected(mapped, fit.reason)
    return _averaged(mapped, fit, 1.0)


def _rejected(mapped: Refined, reason: str) -> Refined:
    note = f"contacts did not refine the map, which is that of the covariogram method: {reason}"
    return replace(mapped, facts=replace(mapped.facts, n_contacts=0), notes=(*mapped.notes, note))
