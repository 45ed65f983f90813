"""Positions by distances along paths of neighbours, where contacts differ between places."""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import pdist, squareform

from anisomap.evidence import PairStatistics
from anisomap.numerics.covariogram.covariogram_fit import unexplained_share
from anisomap.numerics.graph.neighbour_graphs import local_path_lengths
from anisomap.numerics.precision import Reals
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.reliability.sampling_noise import typical_variance
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions, smacof
from anisomap.numerics.similarity.correlation import pearson
from anisomap.options import MethodOptions
from anisomap.refinements.chain import MIN_SENSORS, Proposal

EXPLAINED, UNEXPLAINED = 0.02, 0.04
"""Unexplained shares up to which a covariogram map is kept, and from which paths count as much.

The share was at most .02 on bombarded, rolling and rubbed bodies (seeds 101 to 103 and 312, 2,000
and 8,000 frames) and on the iCub's skin, and .045 to .54 on real bodies and arrays with contacts of
different sizes. Rollers, presses and self-touch of closed bodies are on either side.
"""

_NEAR = SmacofOptions(tolerance=1e-6)  # from a start near the minimum

_NOTE = (
    "contacts differ from place to place ({:.0%} of the variance of the correlations does not "
    "follow from distance): trust neighbours, not proportions"
)


def by_paths(
    pairs: PairStatistics, _: Reals, positions: Reals, _options: MethodOptions
) -> Proposal | None:
    """Propose a map of path lengths, as far as distances on the map leave pairs unexplained.

    A covariogram assumes that contacts are alike everywhere. Where they are not, its map is
    compressed in regions of wide contacts. Path lengths have other errors: they follow bends and
    are biased by noise, but assume nothing about distant regions. The average of both was closer
    to the truth than either on most real skins.
    """
    if len(positions) < MIN_SENSORS:
        return None
    noise = typical_variance(pairs.noise)
    share = unexplained_share(pairs.similarity, positions, noise, known=pairs.known)
    precision = float(np.clip((share - EXPLAINED) / (UNEXPLAINED - EXPLAINED), 0, 1))
    if precision == 0:
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
    return Proposal(
        fit_similarity(scaled, given).apply(scaled),
        precision,
        notes=(_NOTE.format(share),),
        facts={"unexplained": share},
        distorted=precision == 1,
    )


def _normalised_paths(similarity: Reals) -> Reals:
    """Return path lengths with a mean of 1, shape (n, n)."""
    lengths = local_path_lengths(similarity)
    n_sensors = len(lengths)
    return np.asarray(lengths * (n_sensors * (n_sensors - 1) / lengths.sum()))
