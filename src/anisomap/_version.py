"""The version, in one place: hatchling reads it for the package, users read it as a name."""

__version__ = "0.1.0"
