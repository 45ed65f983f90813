"""Defaults that the help of the command line shows, without importing what uses them."""

DEFAULT_METHOD = "covariogram"

DEFAULT_MU = 1.0
"""Regularisation of the reciprocal; the paper gives no value, and 0.01 makes the same maps."""

TOLERANCE, MAX_ITERATIONS = 1e-8, 3000
"""Stopping criteria of the scaling."""

PERMUTATIONS = 10_000
"""Size of the null distribution, as in Figure 3 of the paper."""

N_SHIFTS = 19
"""Number of circular shifts: an unrelated sensor exceeds all of them with probability 1/20."""
