"""Agreement of a layout as a whole with the readings, its order of sensors, and its symmetry."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist, pdist

from anisomap.layout.evidence import Evidence, Move
from anisomap.layout.judging import MIN_GROUP_GAIN, Judge, neighbour_weights

N_PERMUTATIONS = 199
"""Number of shuffled layouts for comparison."""

_MAX_STEP = 24  # maximum shift of a whole order in sensors
_N_RIVALS = 5  # orders compared exactly
_SAME = 0.25  # spacings between places that count as the same
_MAX_IMAGES = 400  # rotations and reflections of a layout to try


def agreement_as_a_whole(evidence: Evidence, rng: np.random.Generator) -> tuple[float, float]:
    """Return the agreement of a layout with the similarities as a whole: p and share.

    p: Probability that a layout with shuffled sensors agrees as well.
    share: Agreement beyond shuffled layouts, relative to the highest possible agreement, i.e. of
        each sensor with as many of the most similar sensors as it has neighbours. If a share s of
        the sensors is shuffled, it is (1 - s)^2 of the correct layout's, as for pairs.
    """
    usable = np.flatnonzero(evidence.usable)
    weights: Any = neighbour_weights(evidence)[usable][:, usable]
    similarity = np.array(evidence.similarity[np.ix_(usable, usable)], dtype=np.float64)
    np.fill_diagonal(similarity, 0)
    first, second = weights.nonzero()
    if not first.size:
        return 1.0, 0.0
    values = weights[first, second]

    def total(order: NDArray[np.intp]) -> float:
        return float(values @ similarity[order[first], order[second]])

    stated = total(np.arange(usable.size))
    shuffled = np.array([total(rng.permutation(usable.size)) for _ in range(N_PERMUTATIONS)])
    p = (1 + np.count_nonzero(shuffled >= stated)) / (1 + N_PERMUTATIONS)
    by_sensor = np.lexsort((-values, first))
    rank = np.arange(first.size) - np.searchsorted(first[by_sensor], first[by_sensor])
    highest = -np.sort(-similarity, axis=1)
    best = float(values[by_sensor] @ highest[first[by_sensor], rank])
    expected = float(shuffled.mean())
    return p, (stated - expected) / max(best - expected, 1e-12)


@dataclass(frozen=True, eq=False)
class ScanOrder:
    """Another order of all sensors.

    step: Each sensor has the place of the sensor `step` later; 0 if the order is reversed.
    order (n,): Sensor i has the place ``order[i]``.
    """

    step: int
    order: NDArray[np.intp]

    @property
    def text(self) -> str:
        """Description of the order."""
        if not self.step:
            return "the reverse order"
        count = "one place" if abs(self.step) == 1 else f"{abs(self.step)} places"
        return f"an order that is shifted by {count} {'forwards' if self.step > 0 else 'backwards'}"


@dataclass(frozen=True, eq=False)
class Rival:
    """The order of all sensors, other than the stated one, that fits the readings best.

    better: Whether it explains the readings certainly better than the stated and other orders.
    worse: Whether it explains them clearly worse.
    evidence: Evidence in this order.
    """

    order: ScanOrder
    better: bool
    worse: bool
    evidence: Evidence


def best_rival(evidence: Evidence, judge: Judge) -> Rival | None:
    """Find the best-fitting shifted or reversed order of all sensors, unless all are equal."""
    n_sensors = len(evidence.positions)
    everyone = np.arange(n_sensors)
    weights: Any = neighbour_weights(evidence)
    first, second = weights.nonzero()
    values = weights[first, second]
    orders = [ScanOrder(0, everyone[::-1].copy())]
    steps = range(1, min(_MAX_STEP, n_sensors // 3) + 1)
    orders += [ScanOrder(sign * s, np.roll(everyone, -sign * s)) for s in steps for sign in (1, -1)]

    def fit(order: NDArray[np.intp]) -> float:
        """Sum the similarities of neighbouring sensors in some order."""
        at = np.argsort(order)  # the sensor at each place
        known = evidence.usable[at[first]] & evidence.usable[at[second]]
        return float(values @ (evidence.similarity[at[first], at[second]] * known))

    moves = []
    for one in sorted(orders, key=lambda one: -fit(one.order)):
        places = evidence.positions[one.order]
        # Rotations and reflections of the layout are not rivals.
        if not np.allclose(pdist(places), pdist(evidence.positions), atol=_SAME * evidence.reach):
            moves.append((Move(everyone, places), one))
        if len(moves) == _N_RIVALS:
            break
    if not moves:
        return None
    # The falloff in a wrong order is nearly flat.
    falloff = evidence.moved(moves[0][0]).refitted().falloff
    gains = [replace(evidence, falloff=falloff).gain(move) for move, _ in moves]
    move, best = moves[int(np.argmax(gains))]
    *_, second = sorted([0.0, *gains])[:-1]
    there = evidence.moved(move).refitted()
    back = there.moved(Move(everyone, evidence.positions))
    distinct = max(gains) - second >= MIN_GROUP_GAIN
    better = distinct and judge.certainly_gains(back, move)
    return Rival(best, better, evidence.gain(move) < -MIN_GROUP_GAIN, there)


def own_images(positions: NDArray[np.float64], spacing: float) -> int:
    """Count the rotations and reflections, except the identity, that map a layout onto itself.

    positions (n, k), k 2 or 3. Such layouts fit the same readings equally well.
    """
    centred = positions - positions.mean(axis=0)
    tree, apart, allowed = KDTree(centred), cdist(centred, centred), _SAME * spacing
    radius, left, images = np.linalg.norm(centred, axis=1), centred, [list[int]()]
    chosen: list[int] = []  # sensors that span the layout; their images determine an image
    for _ in range(positions.shape[1]):
        chosen.append(int(np.linalg.norm(left, axis=1).argmax()))
        unit = left[chosen[-1]] / max(float(np.linalg.norm(left[chosen[-1]])), 1e-12)
        left = left - np.outer(left @ unit, unit)
        like = np.abs(radius - radius[chosen[-1]]) <= allowed
        images = [
            [*image, i]
            for image in images
            for i in np.flatnonzero(
                like
                & (np.abs(apart[:, image] - apart[chosen[-1], chosen[:-1]]) <= allowed).all(axis=1)
            ).tolist()
        ][:_MAX_IMAGES]
    back, found = np.linalg.pinv(centred[chosen], rcond=1e-6), set()
    for image in images:
        distance, order = map(np.asarray, tree.query(centred @ back @ centred[image]))
        if distance.max() <= allowed and len(set(order.tolist())) == len(order):
            found.add(order.tobytes())
    return len(found - {np.arange(len(positions)).tobytes()})
