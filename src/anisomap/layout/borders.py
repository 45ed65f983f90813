"""Evidence that modules are beside the modules around them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from anisomap.layout.evidence import Evidence

AGREEING = 0.35
"""Least evidence that two modules are adjacent, as a share of what is expected if they are.

In right layouts of the iCub's torso it is 0.5 and more, around a turned patch 0.05 and less, and of
modules that are elsewhere -0.6 and less.
"""


def bonds(
    evidence: Evidence, members: Sequence[NDArray[np.intp]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the evidence that modules are adjacent, and what is expected if they are, (M, M).

    It is the log-likelihood ratio of the similarities of near pads to those of distant pads.

    members: Sensors of each module.
    """
    falloff, bins = evidence.falloff, evidence.bins
    near = evidence.known & (cdist(evidence.positions, evidence.positions) <= evidence.reach)
    first, second = np.nonzero(near)
    here = bins[first, second]
    far = np.full_like(here, len(falloff.level) - 1)
    inside = np.zeros((len(members), len(near)))
    for m, sensors in enumerate(members):
        inside[m, sensors] = 1

    def summed(similarity: NDArray[np.floating]) -> NDArray[np.float64]:
        ratio = np.zeros(near.shape)
        ratio[first, second] = falloff.log_likelihood(similarity, here)
        ratio[first, second] -= falloff.log_likelihood(similarity, far)
        total = inside @ ratio @ inside.T
        np.fill_diagonal(total, 0)
        return np.asarray(total)

    return summed(evidence.similarity[first, second]), summed(falloff.level[here])


def border(
    evidence: Evidence, members: Sequence[NDArray[np.intp]], modules: Sequence[int]
) -> float:
    """Return the evidence that some modules are beside the others, over what is expected.

    It is about 1 if they are, and about -1 if they are elsewhere; NaN without any others near.
    """
    found, expected = (
        float(np.delete(one[list(modules)], modules, axis=1).sum())
        for one in bonds(evidence, members)
    )
    return found / expected if expected > 0 else float("nan")
