"""Contacts that nobody saw: found in the readings, located on a map, and used to refine it."""

from anisomap.numerics.contacts.fit import ContactFit, ContactOptions, fit_contacts

__all__ = ["ContactFit", "ContactOptions", "fit_contacts"]
