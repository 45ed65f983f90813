"""Defaults that the help of the command line shows, without importing what uses them."""

DEFAULT_METHOD = "covariogram"

PERMUTATIONS = 10_000
"""Size of the null distribution, as in Figure 3 of the paper."""

N_SHIFTS = 19
"""Number of circular shifts: an unrelated sensor exceeds all of them with probability 1/20."""
