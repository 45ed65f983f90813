"""Positions at which the distances from contacts explain the readings."""

from __future__ import annotations

from anisomap.evidence import PairStatistics
from anisomap.numerics.contacts import ContactFit, fit_contacts
from anisomap.numerics.contacts.contact_agreement import is_on_off
from anisomap.numerics.precision import Reals
from anisomap.options import MethodOptions
from anisomap.refinements.chain import EXACT, MIN_SENSORS, Proposal

_LEAST_UNEXPLAINED = 0.01  # share; keeps the odds finite for readings without noise


def by_contacts(
    pairs: PairStatistics, _: Reals, positions: Reals, options: MethodOptions
) -> Proposal | None:
    """Propose a map by contacts, where they are compact and alike and explain the readings.

    The covariogram assumes that correlation falls with distance in the same way everywhere, which
    curvature and edges of the skin violate; the fit assumes that contacts are round. Both have
    systematic errors, which differ. The precision is the odds of the share of the entropy of the
    readings that distances from contacts explain. The outline of a contact alone, of readings that
    are on or off, tells nothing that the covariogram of such readings does not.
    """
    if pairs.readings is None or len(positions) < MIN_SENSORS or is_on_off(pairs.readings):
        return None
    fit = fit_contacts(pairs.readings, positions, options.contacts, rest=pairs.rest)
    if not fit.used:
        return None
    # Readings from which a common signal was subtracted are not depths of contacts.
    explained = fit.explained * (1 - pairs.common_share)
    odds = explained / max(1 - explained, _LEAST_UNEXPLAINED)
    return _proposed(fit, odds)


def only_contacts(
    pairs: PairStatistics, _: Reals, positions: Reals, options: MethodOptions
) -> Proposal | None:
    """Replace the map by that of a fit of contacts; a note says why, where it is not used."""
    if pairs.readings is None:
        return _rejected(positions, "readings of all sensors in the same frames were not given")
    if len(positions) < MIN_SENSORS:
        return _rejected(positions, f"{len(positions)} sensors are too few")
    fit = fit_contacts(pairs.readings, positions, options.contacts, rest=pairs.rest)
    return _proposed(fit, EXACT) if fit.used else _rejected(positions, fit.reason)


def _proposed(fit: ContactFit, precision: float) -> Proposal:
    return Proposal(
        fit.positions,
        precision,
        facts={"n_contacts": fit.n_contacts, "explained": round(fit.explained, 3)},
    )


def _rejected(positions: Reals, reason: str) -> Proposal:
    note = f"the map was not refined by contacts: {reason}"
    return Proposal(positions, notes=(note,), facts={"n_contacts": 0})
