"""Inverted sensors: contact lowers their readings, while it raises those of the others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anisomap.health.recording_faults.found import Found
from anisomap.numerics.graph.neighbour_graphs import greatest_of_rows
from anisomap.numerics.neighbours import tree_edges
from anisomap.numerics.signals import MAX_FRAMES, standardised
from anisomap.recording import Recording

_MIN_SKEWNESS = 0.5  # magnitude of the skewness of sensors that are touched now and then; by hand
_MIN_SHARE = 0.8  # of the sensors that must be skewed so; chosen by hand
_MIN_AGREEMENT = 0.7  # share of the strongest correlations whose sign must be explained; by hand
_MAX_UNSKEWED = 0.4  # share of the smaller part of sensors that are not skewed; chosen by hand
_MIN_CROSSING = 0.5  # of the strongest correlations that would join both parts at random; by hand
_N_PARTNERS = 4
_MIN_CORRELATION = 0.2  # magnitude of correlations whose sign counts; chosen by hand


def find_inverted(recording: Recording) -> Iterator[Found]:
    """Find sensors on which contact has the opposite sign.

    Sensors are at rest most of the time, so contact skews readings to its own side. Sensors of both
    signs are a finding only if correlations agree: the signs of the strongest correlations must be
    negative between the two parts, and positive within them. If most readings are not skewed or do
    not rest, such as those of sensors that are often in contact, the parts are those that the signs
    of the strongest correlations give, along a maximum spanning tree; they must be mixed.
    """
    step = -(-recording.n_frames // MAX_FRAMES)
    values = standardised(recording.readings[::step])
    varying = values.any(axis=0)
    if np.count_nonzero(varying) < 3:
        return
    skewness = np.einsum("ti,ti,ti->i", values, values, values) / len(values)
    skewed = np.abs(skewness) >= _MIN_SKEWNESS
    skewed_apart = np.mean(skewed[varying]) >= _MIN_SHARE
    if skewed_apart and np.ptp(np.sign(skewness[skewed])) == 0:
        return
    known = recording.signals.rest.known
    skewed_apart &= np.mean(known[varying]) >= _MIN_SHARE
    judged = np.flatnonzero(skewed if skewed_apart else varying)
    correlation = values[:, judged].T @ values[:, judged] / np.float32(len(values))
    np.fill_diagonal(correlation, 0)
    skewness = skewness[judged]
    signs = np.sign(skewness) if skewed_apart else _signs_along_tree(correlation)
    lowered = signs * np.sign(signs @ skewness or 1) < 0
    if not skewed_apart and not _mixed(correlation, lowered):
        return
    fewer = lowered if 2 * np.count_nonzero(lowered) <= judged.size else ~lowered
    found = judged[_confirmed(correlation, fewer)]
    if found.size:
        yield Found(
            found,
            found.size / recording.n_sensors,
            f"contact has the opposite sign in {found.size} of {recording.n_sensors} sensors",
            lambda recording: _mirrored(recording, found),
        )


def _mirrored(recording: Recording, sensors: NDArray[np.intp]) -> Recording:
    """Mirror sensors at rest."""
    readings = np.array(recording.readings)
    rest = recording.signals.rest.value[sensors].astype(readings.dtype)
    readings[:, sensors] = 2 * rest - readings[:, sensors]
    return replace(recording, readings=readings)


def _signs_along_tree(correlation: NDArray[np.float32]) -> NDArray[np.float64]:
    """Multiply the signs of correlations along a maximum spanning tree of their magnitudes."""
    signs = np.ones(len(correlation))
    for new, joined in tree_edges(np.abs(correlation)):
        signs[new] = signs[joined] if correlation[joined, new] >= 0 else -signs[joined]
    return signs


def _mixed(correlation: NDArray[np.float32], lowered: NDArray[np.bool_]) -> bool:
    """Return whether the strongest correlations join both parts, as if drawn at random.

    Where a signal changes its sign across the skin, such as bending, or the field of a source, the
    strongest correlations of a sensor are with its neighbours, of its own part, and the parts are
    halves: these cannot be told from inverted ones.
    """
    sizes = np.count_nonzero(lowered), np.count_nonzero(~lowered)
    if min(sizes) > _MAX_UNSKEWED * lowered.size:
        return False
    crossing = np.count_nonzero(lowered[np.abs(correlation).argmax(axis=1)] != lowered)
    expected = 2 * sizes[0] * sizes[1] / max(1, lowered.size - 1)
    return bool(crossing > 0 and crossing >= _MIN_CROSSING * expected)


def _confirmed(correlation: NDArray[np.float32], suspects: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mark suspects whose strongest correlations have the signs that an inversion gives."""
    if not suspects.any() or suspects.size < 3:
        return np.zeros_like(suspects)
    strength = np.abs(correlation)
    counted = greatest_of_rows(strength, min(_N_PARTNERS, suspects.size - 1))
    counted &= strength >= _MIN_CORRELATION
    same = suspects[:, None] == suspects
    explained = (counted & ((correlation > 0) == same)).sum(axis=1)
    confirmed = suspects & (explained > 0)
    confirmed &= explained >= _MIN_AGREEMENT * counted.sum(axis=1)
    return np.asarray(confirmed & (counted & ~same)[suspects].any())
