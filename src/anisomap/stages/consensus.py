"""Combination of the covariogram map with distances along paths of neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import pdist, squareform

from anisomap.numerics.covariogram.misfit import unexplained_share
from anisomap.numerics.graph.local_paths import local_path_lengths
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.sampling_noise import typical_variance
from anisomap.numerics.scaling.stress_minimisation import smacof
from anisomap.numerics.similarity.correlation import pearson
from anisomap.numerics.similarity.rest import ranks_of_depths
from anisomap.stages.pairs import PairStatistics

EXPLAINED, UNEXPLAINED = 0.02, 0.04
"""Unexplained shares up to which a covariogram map is kept, and from which paths have full weight.

The share was at most .02 on bombarded, rolling and rubbed bodies (seeds 101 to 103 and 312, 2,000
and 8,000 frames) and on the iCub's skin, and .045 to .54 on real bodies and arrays with contacts of
different sizes. Rollers, presses and self-touch of closed bodies are on either side.
"""

PATH_WEIGHT = 0.5
"""Largest weight of path lengths. On real skins .25 to .75 give about equal maps."""


@dataclass(frozen=True, eq=False)
class Consensus:
    """A map between a covariogram map and distances along paths.

    Attributes
    ----------
    positions : ndarray of shape (n, k)
    unexplained : float
        `unexplained_share` of the covariogram map.
    path_weight : float
        Weight of path lengths in the distances, in [0, 0.5].
    """

    positions: Reals
    unexplained: float
    path_weight: float


def combine_with_paths(pairs: PairStatistics, positions: Reals) -> Consensus:
    """Average the distances of a map with path lengths, as far as the map leaves pairs unexplained.

    Parameters
    ----------
    pairs : PairStatistics
    positions : ndarray of shape (n, k)
        From the covariogram fit.

    Returns
    -------
    Consensus
        With the given positions if one function of distance explains the similarity.

    Notes
    -----
    A covariogram assumes that contacts are alike everywhere. Where they are not, its map is
    compressed in regions of wide contacts. Path lengths have other errors: they follow bends and
    are biased by noise, but assume nothing about distant regions. The average of both was closer
    to the truth than either on most real skins.
    """
    noise = typical_variance(pairs.noise)
    share = unexplained_share(pairs.similarity, positions, noise, known=pairs.known)
    weight = PATH_WEIGHT * float(np.clip((share - EXPLAINED) / (UNEXPLAINED - EXPLAINED), 0, 1))
    if weight == 0:
        return Consensus(positions, share, 0.0)
    paths = _normalised_paths(pairs.similarity)
    if pairs.readings is not None:
        ranks = ranks_of_depths(pairs.readings) if pairs.blended is None else pairs.blended.ranks
        paths = (paths + _normalised_paths(pearson(ranks))) / 2
    distances = pdist(positions)
    mean = distances.mean()
    mixed = (1 - weight) * squareform(distances) + weight * mean * paths
    scaled = smacof(mixed, dimensions=positions.shape[1], start=positions)
    return Consensus(scaled.positions, share, weight)


def _normalised_paths(similarity: Reals) -> Reals:
    """Return path lengths with a mean of 1, shape (n, n)."""
    lengths = local_path_lengths(similarity)
    n_sensors = len(lengths)
    return np.asarray(lengths * (n_sensors * (n_sensors - 1) / lengths.sum()))
