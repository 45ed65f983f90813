"""From a metric to places: each connected piece is scaled, and refined, by itself."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from anisomap.methods import MethodOptions, Refine
from anisomap.numerics.graph.connectivity import components
from anisomap.numerics.precision import Reals, row_blocks
from anisomap.numerics.scaling.stress_minimisation import Scaling, SmacofOptions, smacof
from anisomap.recording import Scalar
from anisomap.refinement import Evidence

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Pieces:
    """Every connected component, scaled by itself.

    Attributes
    ----------
    positions : ndarray of shape (n, k)
        In the metric's unit; pieces share no frame.
    labels : ndarray of int, shape (n,)
        Which piece each sensor belongs to; 0 is the largest.
    stress : float
        Stress-1 of all pairs that lie within a piece.
    converged : bool
    iterations : int
        Most that a piece took.
    facts : mapping
        Of how the largest piece was refined, for `anisomap.SensorMap.provenance`.
    notes : tuple of str
        What refining speaks against, in any piece.
    """

    positions: NDArray[np.float64]
    labels: NDArray[np.intp]
    stress: float
    converged: bool
    iterations: int
    facts: Mapping[str, Scalar] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def scale_pieces(
    metric: Reals,
    dimensions: int,
    *,
    start: NDArray[np.float64] | None,
    weights: Reals | None,
    options: SmacofOptions,
) -> Pieces:
    """Scale each connected piece of a metric by itself.

    Parameters
    ----------
    metric : ndarray of shape (n, n)
        Infinite between pieces.
    dimensions : int
    start : ndarray of shape (n, k) or None
    weights : ndarray of shape (n, n) or None
        0 is unknown.
    options : SmacofOptions

    Returns
    -------
    Pieces
    """
    labels = components(metric if weights is None else np.where(weights > 0, metric, np.inf))
    positions = np.empty((len(metric), dimensions))
    scalings: list[Scaling] = []
    for label in range(labels.max() + 1):
        piece = labels == label
        logger.info("scaling %d sensors into %d dimensions", piece.sum(), dimensions)
        scaling = smacof(
            _among(metric, piece),
            dimensions=dimensions,
            start=None if start is None else start[piece],
            weights=None if weights is None else _among(weights, piece),
            options=options,
        )
        positions[piece] = scaling.positions
        scalings.append(scaling)
    # Stress-1 of all pairs that lie within a piece.
    raw = sum(scaling.raw_stress for scaling in scalings)
    spread = sum(scaling.spread for scaling in scalings)
    return Pieces(
        positions=positions,
        labels=labels,
        stress=float(np.sqrt(raw / spread)) if spread > 0 else 0.0,
        converged=all(scaling.converged for scaling in scalings),
        iterations=max(len(scaling.trace) - 1 for scaling in scalings),
    )


def refine_pieces(
    refine: Refine,
    evidence: Evidence,
    metric: Reals,
    pieces: Pieces,
    options: MethodOptions,
) -> Pieces:
    """Refine each piece by what is known of its sensors.

    Parameters
    ----------
    refine : callable
        See `anisomap.methods.Method`.
    evidence : Evidence
    metric : ndarray of shape (n, n)
    pieces : Pieces
        As they were scaled.
    options : MethodOptions

    Returns
    -------
    Pieces
    """
    positions = pieces.positions.copy()
    raw = spread = 0.0
    facts: dict[str, Scalar] = {}
    notes: list[str] = []
    for label in range(pieces.labels.max() + 1):
        piece = pieces.labels == label
        apart = _among(metric, piece)
        if np.count_nonzero(piece) >= options.fewest_sensors and (apart > 0).any():
            refined = refine(evidence.of(piece), apart, positions[piece], options)
            positions[piece] = refined.positions
            facts = dict(refined.facts) if label == 0 else facts
            notes += refined.notes
        # Refined places come in a unit of their own: bring all pieces back to the metric's.
        scale, missed, size = _best_scale(positions[piece], apart)
        positions[piece] *= scale if scale > 0 else 1.0
        raw += missed
        spread += scale**2 * size
    stress = float(np.sqrt(raw / spread)) if spread > 0 else 0.0
    return replace(
        pieces,
        positions=positions,
        stress=stress,
        facts=facts,
        notes=tuple(dict.fromkeys(notes)),
    )


def _among(matrix: Reals, sensors: NDArray[np.bool_]) -> Reals:
    """Keep only the pairs of some sensors; without a copy if these are all."""
    return matrix if sensors.all() else matrix[np.ix_(sensors, sensors)]


def _best_scale(positions: NDArray[np.float64], apart: Reals) -> tuple[float, float, float]:
    """Find the scale at which places fit distances best.

    Returns
    -------
    scale : float
        0 if the places coincide.
    missed : float
        Sum of the squares that are left, at that scale; as `size`, both (i, j) and (j, i) count.
    size : float
        Sum of the squares of the distances between the places.
    """
    size = product = missed = 0.0
    for rows in row_blocks(len(positions)):
        distances = cdist(positions[rows], positions)
        size += float(np.vdot(distances, distances))
        product += float((distances * apart[rows]).sum())
    scale = product / size if size > 0 else 0.0
    for rows in row_blocks(len(positions)):
        missed += float(
            ((scale * cdist(positions[rows], positions) - apart[rows]) ** 2).sum(dtype=np.float64)
        )
    return scale, missed, size
