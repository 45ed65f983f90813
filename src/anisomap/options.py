"""Parameters of the methods."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from anisomap.base.defaults import DEFAULT_BINS, DEFAULT_MU
from anisomap.errors import InputError
from anisomap.numerics.contacts import ContactOptions
from anisomap.numerics.covariogram.objective import CovariogramOptions
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions


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
    contacts : ContactOptions
        Parameters of the fit of contacts, in "covariogram" and "contact-fit".
    split_unrelated : bool
        Whether the covariogram method separates components without statistically significant
        links.
    independent_frames : float
        Effective sample size of correlations that are given without readings, above 0.
    even_spacing : bool
        Whether neighbours are declared to be evenly spaced, for methods with
        `Method.takes_even_spacing`. A map that relies on the declaration carries a note.
    min_sensors : int
        Minimum number of sensors in the largest component of a map.

    Raises
    ------
    InputError
        If `regularisation` or `independent_frames` is out of range.
    """

    regularisation: float = DEFAULT_MU
    entropy_bins: int = DEFAULT_BINS
    n_neighbours: int | None = None
    smacof: SmacofOptions = field(default_factory=SmacofOptions)
    covariogram: CovariogramOptions = field(default_factory=CovariogramOptions)
    contacts: ContactOptions = field(default_factory=ContactOptions)
    split_unrelated: bool = True
    independent_frames: float = 500.0
    even_spacing: bool = False
    min_sensors: int = 3

    def __post_init__(self) -> None:
        for name, least in (("entropy_bins", 2), ("n_neighbours", 1), ("min_sensors", 1)):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int | np.integer) and value >= least):
                raise InputError(
                    f"{name} must be a whole number of at least {least}, got {value!r}"
                )
        mu = self.regularisation
        if not (isinstance(mu, int | float) and np.isfinite(mu) and mu >= 0):
            raise InputError(f"regularisation must be a finite number of at least 0, got {mu}")
        if not (np.isfinite(self.independent_frames) and self.independent_frames > 0):
            raise InputError(
                f"independent_frames must be a finite number above 0, got {self.independent_frames}"
            )
