"""Agreement of two halves of a recording, which have equal shares of what its sensors feel.

A few strong frames can make all correlations. Resamples then repeat these frames, and agree; two
halves that divide them agree only about what is true of both.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from anisomap.method.evidence import Evidence
from anisomap.numerics.columns import centred_rows
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.sampling_noise import block_edges

MIN_AGREEMENT = 0.4
"""Least correlation of the similarities of two halves, over pairs of sensors.

Independent noises exceed it with a probability below 1 in 1,000: 12 sensors have 66 pairs, whose
correlation has a standard deviation of .12 by chance. See ``docs/explanation/trust.md``.
"""

_N_SPLITS = 4
_MAX_SENSORS = 300  # sampled evenly; their pairs determine a correlation


def agreement_of_halves(evidence: Evidence, rng: np.random.Generator) -> float:
    """Correlate the similarities of halves of the frames; NaN without readings.

    Blocks of frames are ordered by energy, the sum of squared standardised readings, and one of
    each pair of successive blocks goes to either half. What a sensor has in common with all others
    is subtracted: an amplitude, a contact or a drift that all sensors share says nothing of places.
    The result is the mean over several splits.
    """
    if evidence.readings is None or evidence.scores is None:
        return math.nan
    n_sensors = len(evidence.similarity)
    chosen = np.zeros(n_sensors, dtype=bool)
    chosen[:: -(-n_sensors // _MAX_SENSORS)] = True
    readings = evidence.readings[:, chosen]
    edges = block_edges(readings)
    weights = _equal_halves(_energies(readings, edges), rng)
    halves = [_own(one) for one in evidence.scores.select(chosen).resampled(edges, weights)]
    return float(np.mean([_cosine(*halves[i : i + 2]) for i in range(0, len(halves), 2)]))


def _energies(readings: NDArray[np.generic], edges: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the energy of each block of frames, (B,). readings (T, n), edges (B + 1,)."""
    squares = np.square(centred_rows(readings).astype(np.float64))
    squares /= np.maximum(squares.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    return np.asarray(np.add.reduceat(squares.sum(axis=0), edges[:-1]))


def _equal_halves(energies: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Return weights of the blocks in both halves of each split, (2 splits, B)."""
    order = np.argsort(-energies, kind="stable")
    weights = np.zeros((2 * _N_SPLITS, len(energies)))
    for split in range(_N_SPLITS):
        for first in range(0, len(order), 2):
            pair = rng.permutation(order[first : first + 2])
            weights[2 * split + np.arange(pair.size), pair] = 1
    return weights


def _own(similarity: Reals) -> NDArray[np.float64]:
    """Return what pairs have beyond the means of their sensors, (n, n); 0 on the diagonal."""
    found = np.array(similarity, dtype=np.float64)
    n_sensors = len(found)
    np.fill_diagonal(found, 0)
    sums = found.sum(axis=1)
    mean = float(sums.sum()) / (n_sensors * (n_sensors - 1))
    beyond = (sums - (n_sensors - 1) * mean) / (n_sensors - 2)
    found -= mean + beyond[:, None] + beyond
    np.fill_diagonal(found, 0)
    return found


def _cosine(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    sizes = float(np.linalg.norm(one)) * float(np.linalg.norm(other))
    return float(np.vdot(one, other)) / sizes if sizes > 0 else 0.0
