"""Sensors that a recording shows at another place than a map."""

from __future__ import annotations

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
    rows = {name: i for i, name in enumerate(fresh.names)}
    old_rows = {name: i for i, name in enumerate(evidence.names)}
    placed = [
        i
        for i in np.flatnonzero(sensor_map.placed).tolist()
        if sensor_map.names[i] in rows and sensor_map.names[i] in old_rows
    ]
    if len(placed) < MIN_COMPARED:
        return None
    names = tuple(sensor_map.names[i] for i in placed)
    key = common_similarity(evidence, fresh)
    old = evidence.sums[key].statistics(key).select(_mask(old_rows, names))
    new = fresh.sums[key].statistics(key).select(_mask(rows, names))
    # `select` keeps the order of the evidence.
    here = _order([n for n in evidence.names if n in set(names)], names)
    there = _order([n for n in fresh.names if n in set(names)], names)
    agreement = profile_agreement(
        new.similarity[np.ix_(there, there)],
        old.similarity[np.ix_(here, here)],
        new.known[np.ix_(there, there)],
        old.known[np.ix_(here, here)],
    )
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


def _mask(rows: dict[str, int], names: tuple[str, ...]) -> NDArray[np.bool_]:
    mask = np.zeros(len(rows), dtype=bool)
    mask[[rows[name] for name in names]] = True
    return mask


def _order(present: list[str], names: tuple[str, ...]) -> NDArray[np.intp]:
    row = {name: i for i, name in enumerate(present)}
    return np.array([row[name] for name in names], dtype=np.intp)


def _far(sensor_map: SensorMap, placed: NDArray[np.intp]) -> NDArray[np.bool_]:
    places, component = sensor_map.positions[placed], sensor_map.component[placed]
    spacing = median_spacing(sensor_map.positions[sensor_map.component == 0])
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    return np.asarray((apart > FAR * spacing) | (component[:, None] != component))
