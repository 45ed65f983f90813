"""Refinement of maps by contacts that are detected in the readings and located on the map."""

from anisomap.numerics.contacts.contact_fit import ContactFit, ContactOptions, fit_contacts

__all__ = ["ContactFit", "ContactOptions", "fit_contacts"]
