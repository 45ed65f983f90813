"""What all rooms use, and defaults that help shows without importing what uses them."""

DEFAULT_METHOD = "covariogram"

PERMUTATIONS = 10_000
"""Size of the null distribution, as in Figure 3 of the paper."""
