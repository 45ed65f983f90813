"""From the graph of a piece to places: landmarks, their map, all others, and all together."""

from __future__ import annotations

import logging
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from anisomap.large.landmarks.paths import paths_from
from anisomap.large.landmarks.refinement import Targets, refine, stress_of
from anisomap.large.landmarks.triangulation import triangulate
from anisomap.numerics.scaling.stress_minimisation import SmacofOptions, smacof

logger = logging.getLogger(__name__)

FINEST = 1e-7
"""Tolerance that refining stops at, whatever was asked for: paths are known no better."""


class Placed(NamedTuple):
    """Where the sensors of a piece are.

    Attributes
    ----------
    positions : ndarray of shape (n, k)
        Centred on the origin.
    raw_stress, spread : float
        Over the pairs of each sensor with each landmark: sums of (d - D)^2 and of d^2.
    converged : bool
    iterations : int
    """

    positions: NDArray[np.float64]
    raw_stress: float
    spread: float
    converged: bool
    iterations: int


def place(
    graph: csr_array[Any, tuple[int, int]],
    dimensions: int,
    *,
    landmarks: int,
    options: SmacofOptions,
    rng: np.random.Generator,
) -> Placed:
    """Place the sensors of a connected graph.

    Parameters
    ----------
    graph : csr_array of shape (n, n)
        Lengths of edges, above 0; symmetric, and connected.
    dimensions : int
    landmarks : int
        How many sensors are drawn to be landmarks; all, if there are no more.
    options : SmacofOptions
    rng : numpy.random.Generator
        Draws them.

    Returns
    -------
    Placed

    Notes
    -----
    Landmarks that are drawn at random lie about as densely as sensors do; de Silva & Tenenbaum
    (2004) found them as good as chosen ones where there are many more than dimensions.
    """
    n_sensors = graph.shape[0]
    if n_sensors == 1:
        return Placed(np.zeros((1, dimensions)), 0.0, 0.0, converged=True, iterations=0)
    chosen = np.sort(rng.choice(n_sensors, min(landmarks, n_sensors), replace=False))
    logger.info("finding shortest paths from %d landmarks", len(chosen))
    rows = paths_from(chosen, graph)
    apart = rows[chosen].astype(np.float64)
    anchors = smacof(np.minimum(apart, apart.T), dimensions=dimensions, options=options)
    positions = triangulate(rows, anchors.positions)
    positions[chosen] = anchors.positions
    targets = Targets(chosen, rows, graph)
    logger.info("refining %d sensors in %d dimensions", n_sensors, dimensions)
    found = refine(targets, positions, max(options.tolerance, FINEST), options.max_iterations)
    return Placed(
        found.positions - found.positions.mean(axis=0),
        *stress_of(targets, found.positions),
        converged=found.converged and anchors.converged,
        iterations=len(found.trace) - 1,
    )
