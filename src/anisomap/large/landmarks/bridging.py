"""Pieces of a skin that their sensors' nearest kin leave apart, joined where there is evidence."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.large.landmarks.correlations import Links, correlations, pairs_of
from anisomap.large.landmarks.links import Joined, chance_level, pieces_of
from anisomap.large.landmarks.sketch import Sketch
from anisomap.numerics.similarity.search import most_similar

logger = logging.getLogger(__name__)

STRANGERS = 8
"""Sensors outside its piece that each sensor is compared with."""

ROUNDS = 3
"""Times at most that frames are gone through for bridges: each joins pieces to others."""


def bridge(
    joined: Joined, known: Sketch, chunks: Callable[[], Iterable[NDArray[Any]]]
) -> tuple[Joined, Links]:
    """Look for links between pieces: r that is beyond what chance gives the best of all pairs.

    Parameters
    ----------
    joined : Joined
    known : Sketch
    chunks : callable
        Opens the frames that were sketched, from the first on.

    Returns
    -------
    joined : Joined
        Pieces that are left have nothing beyond chance in common, as far as their sketches tell.
    looked_at : Links
        All pairs that r was worked out for on the way.

    Notes
    -----
    Sensors that share a rigid plate are so like one another that their nearest kin are all on it.
    """
    looked_at = joined.links.chosen(np.zeros(len(joined.links.r), dtype=bool))
    for _ in range(ROUNDS):
        outside = np.flatnonzero((joined.pieces > 0) & known.varying)
        if not outside.size:
            break
        logger.info("looking for relations of %d sensors with other pieces", outside.size)
        found, _ = most_similar(known.projections, STRANGERS, groups=joined.pieces, sensors=outside)
        links = correlations(chunks(), known, pairs_of(found, outside))
        looked_at = looked_at.joined(links)
        bridges = links.chosen(links.r >= chance_level(links, known))
        if not bridges.r.size:
            break
        edges = joined.links.joined(bridges)
        joined = Joined(edges, pieces_of(edges, len(known.mean)))
    return joined, looked_at
