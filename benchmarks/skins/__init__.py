"""Simulated skins beyond those of the package, and copies of real ones."""
