"""Modules that all packages use, and defaults that help shows without heavy imports."""

DEFAULT_METHOD = "covariogram"

METRES = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "\u00b5m": 1e-6, "in": 0.0254}
"""Length of each supported unit in metres."""

PERMUTATIONS = 10_000
"""Size of the null distribution, as in Figure 3 of the paper."""
