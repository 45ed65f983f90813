"""Sensors that a recording shows at another place than a map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from anisomap.evaluation.neighbourhood import median_spacing
from anisomap.numerics.reliability.profiles import profile_agreement
from anisomap.sensor_map import SensorMap
from anisomap.tracking.evidence import Evidence

MIN_COMPARED = 8
"""Minimum number of sensors on the map and in the recording; fewer give no typical difference."""

FAR = 3.0
"""Smallest distance of a move that is looked for, in spacings; nearer profiles are alike."""

# From median absolute deviations to standard deviations of a normal distribution.
_TO_SIGMA = 1 / float(ndtri(0.75))


@dataclass(frozen=True, eq=False)
class Moves:
    """Sensors that moved.

    Attributes
    ----------
    names : tuple of str
        The compared sensors.
    p_values : ndarray of shape (n,)
        Probability that chance alone makes any sensor fit a far place so much better (Bonferroni);
        1 for sensors that fit their own place better than any far one.
    like : tuple of str
        The far sensor of the map that each fits best.
    moved : tuple of str
        Sensors with a p value below the level.
    """

    names: tuple[str, ...]
    p_values: NDArray[np.float64]
    like: tuple[str, ...]
    moved: tuple[str, ...]


def find_moves(
    sensor_map: SensorMap, evidence: Evidence, fresh: Evidence, level: float
) -> Moves | None:
    """Find sensors of which the similarity to all others is that of a far sensor before.

    Parameters
    ----------
    sensor_map : SensorMap
        Its places tell which sensors are far; sensors of other components are.
    evidence, fresh : Evidence
        Of the map, and of a new recording.
    level : float
        Probability that chance alone marks any sensor as moved.

    Returns
    -------
    Moves or None
        None if fewer than `MIN_COMPARED` sensors can be compared.

    Notes
    -----
    For each sensor, the agreement of its new profile with its own old one is compared with the
    best agreement with the profile of a far sensor. A sensor moved if the far one fits better, by
    more than chance explains: differences of sensors that did not move are taken as normal, with
    the median and the median absolute deviation of all.
    """
    compared = set(evidence.names) & set(fresh.names)
    placed = [
        i for i in np.flatnonzero(sensor_map.placed).tolist() if sensor_map.names[i] in compared
    ]
    if len(placed) < MIN_COMPARED:
        return None
    names = tuple(sensor_map.names[i] for i in placed)
    key = common_similarity(evidence, fresh)
    old_similarity, old_known = similarity_of(evidence, key, names)
    new_similarity, new_known = similarity_of(fresh, key, names)
    agreement = profile_agreement(new_similarity, old_similarity, new_known, old_known)
    far = _far(sensor_map, np.array(placed))
    if not far.any():
        return None
    elsewhere = np.where(far, agreement, -np.inf)
    gain = elsewhere.max(axis=1) - np.diag(agreement)
    finite = gain[np.isfinite(gain)]
    middle = float(np.median(finite))
    sigma = _TO_SIGMA * float(np.median(np.abs(finite - middle)))
    z = (gain - middle) / max(sigma, np.finfo(float).tiny)
    p_values = np.where(gain > 0, np.minimum(1.0, len(names) * ndtr(-z)), 1.0)
    p_values.setflags(write=False)
    best = elsewhere.argmax(axis=1)
    return Moves(
        names=names,
        p_values=p_values,
        like=tuple(names[j] for j in best),
        moved=tuple(name for name, p in zip(names, p_values, strict=True) if p < level),
    )


def common_similarity(first: Evidence, second: Evidence) -> str:
    """Return the most specific similarity of which both have sums."""
    return next(key for key in reversed(tuple(first.sums)) if key in second.sums)


def similarity_of(
    evidence: Evidence, key: str, names: Sequence[str]
) -> tuple[NDArray[np.floating], NDArray[np.bool_]]:
    """Return the similarity of some sensors, and which pairs of them are known.

    Parameters
    ----------
    evidence : Evidence
    key : str
        A key of `Evidence.sums`.
    names : sequence of str
        Sensors of the evidence.

    Returns
    -------
    similarity : ndarray of shape (n, n)
        In the order of the names.
    known : ndarray of bool, shape (n, n)
    """
    row = {name: i for i, name in enumerate(evidence.names)}
    rows = [row[name] for name in names]
    inside = np.ix_(rows, rows)
    pairs = evidence.sums[key].statistics(key)
    return pairs.similarity[inside], pairs.known[inside]


def _far(sensor_map: SensorMap, placed: NDArray[np.intp]) -> NDArray[np.bool_]:
    places, component = sensor_map.positions[placed], sensor_map.component[placed]
    spacing = median_spacing(sensor_map.positions[sensor_map.component == 0])
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    return np.asarray((apart > FAR * spacing) | (component[:, None] != component))
