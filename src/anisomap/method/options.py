"""Parameters of the methods."""

from __future__ import annotations

from dataclasses import dataclass, field

from anisomap.base.defaults import DEFAULT_MU
from anisomap.numerics.covariogram.objective import CovariogramOptions
from anisomap.numerics.ranges import COUNT, NOT_NEGATIVE, POSITIVE, at_least, check_ranges
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions
from anisomap.numerics.similarity.binning import DEFAULT_BINS


@dataclass(frozen=True)
class MethodOptions:
    """Parameters of the methods; each method uses those of its stages.

    Parameters
    ----------
    regularisation : float
        Regularisation of the reciprocal, mu in the paper, at least 0. With 0, unrelated sensors are
        infinitely far apart, and components come out as separate maps.
    entropy_bins : int
        Bins per sensor for entropies, at least 2.
    n_neighbours : int, optional
        Neighbours per sensor in ISOMAP's graph; by default the smallest number that connects all.
    smacof : SmacofOptions
        Stopping criteria of the scaling.
    covariogram : CovariogramOptions
        Parameters of the method "covariogram".
    independent_frames : float
        Effective sample size of correlations that are given without readings, above 0.
    min_sensors : int
        Minimum number of sensors in the largest component of a map.

    Raises
    ------
    InputError
        If a value is out of range.
    """

    regularisation: float = DEFAULT_MU
    entropy_bins: int = DEFAULT_BINS
    n_neighbours: int | None = None
    smacof: SmacofOptions = field(default_factory=SmacofOptions)
    covariogram: CovariogramOptions = field(default_factory=CovariogramOptions)
    independent_frames: float = 500.0
    min_sensors: int = 3

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)


_RANGES = {
    "regularisation": NOT_NEGATIVE,
    "entropy_bins": at_least(2, whole=True),
    "n_neighbours": COUNT,
    "independent_frames": POSITIVE,
    "min_sensors": COUNT,
}
