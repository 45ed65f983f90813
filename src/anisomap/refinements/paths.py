"""Positions by distances along paths of neighbours, where contacts differ between places."""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import pdist, squareform

from anisomap.evidence import PairStatistics
from anisomap.numerics.graph.neighbour_graphs import local_path_lengths
from anisomap.numerics.precision import Reals
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions, smacof
from anisomap.numerics.similarity.correlation import pearson
from anisomap.options import MethodOptions
from anisomap.refinements.chain import DIFFERENT, MIN_SENSORS, Proposal

_NEAR = SmacofOptions(tolerance=1e-6)  # from a start near the minimum

_OWN = 0.05
"""Unexplained share that the errors of path lengths themselves, from noise and bends, amount to.

With .02 to .1, errors of maps of real and of simulated skins differ by less than 1 %.
"""

_NOTE = (
    "contacts differ from place to place ({:.0%} of the variance of the correlations does not "
    "follow from distance), so lengths are less certain than neighbours"
)


def by_paths(
    pairs: PairStatistics, _: Reals, positions: Reals, _options: MethodOptions
) -> Proposal | None:
    """Propose a map of path lengths, where distances on the map leave correlations unexplained.

    A covariogram assumes that contacts are alike everywhere. Where they are not, its map is
    compressed in regions of wide contacts. Path lengths have other errors: they follow bends and
    are biased by noise, but assume nothing about distant regions. The variance of each map is taken
    to be proportional to the share of the variance of the correlations that it leaves unexplained,
    to which paths add their own.
    """
    if len(positions) < MIN_SENSORS:
        return None
    share = pairs.unexplained(positions)
    if share <= 0:
        return None
    paths = _normalised_paths(pairs.similarity)
    if pairs.readings is not None:
        paths = (paths + _normalised_paths(pearson(pairs.ranks))) / 2
    dimensions = positions.shape[1]
    distances = squareform(pdist(positions))
    lengths = distances.sum() / (len(paths) * (len(paths) - 1)) * paths
    # Started from the scaling of the mean of both, which folds neither.
    given = scaled = np.asarray(positions, dtype=np.float64)
    for target in ((distances + lengths) / 2, lengths):
        scaled = smacof(target, dimensions=dimensions, start=scaled, options=_NEAR).positions
    proposed = fit_similarity(scaled, given).apply(scaled)
    precision = share / (max(share, pairs.unexplained(proposed)) + _OWN)
    distorted = share > DIFFERENT
    return Proposal(
        proposed,
        precision,
        notes=(_NOTE.format(share),) if distorted else (),
        facts={"unexplained": share},
        distorted=distorted,
    )


def _normalised_paths(similarity: Reals) -> Reals:
    """Return path lengths with a mean of 1, shape (n, n)."""
    lengths = local_path_lengths(similarity)
    n_sensors = len(lengths)
    return np.asarray(lengths * (n_sensors * (n_sensors - 1) / lengths.sum()))
