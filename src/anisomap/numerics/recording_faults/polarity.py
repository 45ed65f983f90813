"""Inverted sensors: contact lowers their readings, while it raises those of the others."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.graph.neighbour_graphs import greatest_of_rows
from anisomap.numerics.neighbours import tree_edges
from anisomap.numerics.signals import MAX_FRAMES, standardised

_MIN_SKEWNESS = 0.5  # magnitude of the skewness of sensors that are touched now and then; by hand
_MIN_SHARE = 0.8  # of the sensors that must be skewed so; chosen by hand
_MIN_AGREEMENT = 0.7  # share of the strongest correlations whose sign must be explained; by hand
_MAX_UNSKEWED = 0.4  # share of the smaller part of sensors that are not skewed; chosen by hand
_MIN_CROSSING = 0.5  # of the strongest correlations that would join both parts at random; by hand
_N_PARTNERS = 4
_MIN_CORRELATION = 0.2  # magnitude of correlations whose sign counts; chosen by hand


def find_inverted(readings: NDArray[Any], known: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Find sensors on which contact has the opposite sign.

    readings (T, N), known (N,): Whether each has a rest.

    Sensors are at rest most of the time, so contact skews readings to its own side. Sensors of both
    signs are a finding only if correlations agree: the signs of the strongest correlations must be
    negative between the two parts, and positive within them. If most readings are not skewed or do
    not rest, such as those of sensors that are often in contact, the parts are those that the signs
    of the strongest correlations give, along a maximum spanning tree; they must be mixed.
    """
    step = -(-len(readings) // MAX_FRAMES)
    values = standardised(readings[::step])
    varying = values.any(axis=0)
    if np.count_nonzero(varying) < 3:
        return np.empty(0, dtype=np.intp)
    skewness = np.einsum("ti,ti,ti->i", values, values, values) / len(values)
    skewed = np.abs(skewness) >= _MIN_SKEWNESS
    share = min(np.mean(skewed[varying]), np.mean(known[varying]))
    skewed_apart = bool(share >= _MIN_SHARE)
    sides = np.unique(np.sign(skewness[skewed]))
    if skewed_apart and sides.size < 2:
        return np.empty(0, dtype=np.intp)
    correlation: NDArray[np.float32] = values.T @ values / np.float32(len(values))
    np.fill_diagonal(correlation, 0)
    if skewed_apart:
        lowered = skewed & (skewness < 0)
        judged = np.flatnonzero(skewed)
    else:
        judged = np.flatnonzero(varying)
        signs = _signs_along_tree(correlation[np.ix_(judged, judged)])
        if signs @ skewness[judged] < 0:
            signs = -signs
        lowered = np.zeros(varying.size, dtype=bool)
        lowered[judged[signs < 0]] = True
    suspects = judged[lowered[judged]]
    if not skewed_apart and not _mixed(correlation, suspects, judged):
        return np.empty(0, dtype=np.intp)
    if 2 * suspects.size > judged.size:
        suspects = judged[~lowered[judged]]
    return _confirmed(correlation, suspects, judged)


def _signs_along_tree(correlation: NDArray[np.float32]) -> NDArray[np.float64]:
    """Multiply the signs of correlations along a maximum spanning tree of their magnitudes."""
    signs = np.ones(len(correlation))
    for new, joined in tree_edges(np.abs(correlation)):
        signs[new] = signs[joined] if correlation[joined, new] >= 0 else -signs[joined]
    return signs


def _mixed(
    correlation: NDArray[np.float32], suspects: NDArray[np.intp], judged: NDArray[np.intp]
) -> bool:
    """Return whether the strongest correlations join both parts, as if drawn at random.

    Where a signal changes its sign across the skin, such as bending, or the field of a source, the
    strongest correlations of a sensor are with its neighbours, of its own part, and the parts are
    halves: these cannot be told from inverted ones.
    """
    inside = np.isin(judged, suspects)
    if min(inside.sum(), (~inside).sum()) > _MAX_UNSKEWED * judged.size:
        return False
    strength = np.abs(correlation[np.ix_(judged, judged)])
    crossing = np.count_nonzero(inside[strength.argmax(axis=1)] != inside)
    expected = 2 * inside.sum() * (~inside).sum() / max(1, judged.size - 1)
    return bool(crossing > 0 and crossing >= _MIN_CROSSING * expected)


def _confirmed(
    correlation: NDArray[np.float32], suspects: NDArray[np.intp], judged: NDArray[np.intp]
) -> NDArray[np.intp]:
    """Select suspects whose strongest correlations have the signs that an inversion gives."""
    if not suspects.size or judged.size < 3:
        return np.empty(0, dtype=np.intp)
    r = correlation[np.ix_(suspects, judged)]
    count = min(_N_PARTNERS, judged.size - 1)
    strength = np.abs(r)
    same = np.isin(judged, suspects)
    counted = greatest_of_rows(strength, count) & (strength >= _MIN_CORRELATION)
    explained = (counted & ((r > 0) == same)).sum(axis=1)
    crossing = (counted & ~same).any() or suspects.size == judged.size
    confirmed = (explained >= _MIN_AGREEMENT * counted.sum(axis=1)) & (explained > 0)
    return np.asarray(suspects[confirmed]) if crossing else np.empty(0, dtype=np.intp)
