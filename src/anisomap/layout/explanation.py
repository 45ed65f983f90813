"""Faults that explain why modules and sensors have other places, in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from anisomap.base.wording import join_items
from anisomap.layout.arranging import Change
from anisomap.layout.evidence import Move
from anisomap.layout.modules import Mounting
from anisomap.layout.sensors import shifted_moves
from anisomap.numerics.procrustes import fit_similarity

_SAME = 1e-6  # spacings between places that count as the same: places of others are taken exactly
_MIN_RUN = 4  # sensors; fewer are swaps and cycles
_MAX_STEP = 2  # channels by which a run may be shifted; as `cable_shifts`
_MIN_SHARE = 0.7  # of the sensors of cycles that must be shifted equally; chosen by hand
_SHIFTED = 15.0  # degrees; patches that turn less are told as shifted
_MAX_NAMED = 6


@dataclass(frozen=True, eq=False)
class Explained:
    """A group of sensors with new places, and the explanation.

    kind: A key of `anisomap.layout.KINDS`.
    sensors: Those that take part, some perhaps with the place that is stated.
    alternatives: See `anisomap.layout.evidence.Proposal`.
    """

    kind: str
    sensors: NDArray[np.intp]
    text: str
    alternatives: tuple[Move, ...] = ()


def explain(
    stated: NDArray[np.float64],
    proposed: NDArray[np.float64],
    *,
    spacing: float,
    rigid: Sequence[NDArray[np.intp]],
    names: Sequence[str],
) -> list[Explained]:
    """Divide the sensors with new places into groups that one fault explains.

    stated, proposed (n, k).
    """
    target = _targets(stated, proposed, spacing)
    left = target != np.arange(len(stated))
    found = _shifted_runs(target, left, stated)
    found += _cycles(target, left, names)
    return found + _moved(target, left, rigid, names)


def explain_modules(
    changes: Sequence[Change], mounting: Mounting, names: Sequence[str], usable: NDArray[np.bool_]
) -> list[tuple[str, str, list[Change]]]:
    """Explain changes of modules, those of one patch together: kind, text, and changes."""
    found = []
    for kind, angle, group in _alike(changes, mounting):
        modules = [m for change in group for m in change.modules]
        listed = [span(mounting.members[m], names) for m in modules]
        tested = sum(int(usable[mounting.members[m]].sum()) for m in modules)
        of_all = sum(len(mounting.members[m]) for m in modules)
        count = f" ({tested} of {of_all} pads tested)" if tested < of_all else ""
        if kind == "reversed":
            text = (
                f"module {listed[0]}: pads in reverse order"
                if len(group) == 1
                else _reversed_run(sorted(modules), mounting, names)
            )
        elif group[0].together and kind == "moved":
            text = (
                f"the {len(listed)} modules {join_items(listed, _MAX_NAMED)} are shifted together"
            )
        elif kind in ("turned", "mirrored"):
            text = _in_place(kind, angle, group, listed)
        elif kind == "exchanged":
            text = (
                f"modules {listed[0]} and {listed[1]} have each other's places"
                if len(listed) == 2
                else f"modules {join_items(listed, _MAX_NAMED)} each have the place of the next"
            )
        elif len(modules) == 1:
            slot = group[0].slots[0]
            text = f"module {listed[0]} belongs to " + (
                f"the place of module {span(mounting.members[slot], names)}"
                if slot < mounting.n_modules
                else "a place beside the others, where no module is"
            )
        else:
            text = f"modules {join_items(listed, _MAX_NAMED)} belong to other places"
        found.append((kind, text + count, group))
    return found


_Explained: TypeAlias = tuple[str, float, list[Change]]
"""A kind, an angle in degrees, and the changes that it explains."""


def _alike(changes: Sequence[Change], mounting: Mounting) -> list[_Explained]:
    """Divide changes by kind and angle, and by the patches of adjacent modules that share them."""
    by_kind: dict[tuple[str, float], list[Change]] = {}
    found: list[_Explained] = []
    for change in changes:
        if change.together:
            kind, angle = _motion(change.stated, change.move.places)
            found.append((kind, angle, [change]))
        elif set(change.slots) == set(change.modules) == set(change.modules[:1]):
            orientation = mounting.orientations[change.turns[0]]
            frame = mounting.frames[change.modules[0]]
            # Adjacent modules in space have the same side to the outside.
            hand = float(np.sign(np.linalg.det(frame))) if len(frame) == 2 else 1.0
            angle = hand * orientation.angle
            kind = "mirrored" if orientation.reflected else "turned"
            if orientation.backwards:
                found.append(("reversed", 0.0, [change]))
                continue
            by_kind.setdefault((kind, float(round(angle))), []).append(change)
        else:
            closed = set(change.slots) == set(change.modules)
            found.append(("exchanged" if closed else "moved", 0.0, [change]))
    found = _with_runs(found)
    for (kind, angle), group in by_kind.items():
        modules = [change.modules[0] for change in group]
        graph: Any = csr_array(mounting.adjacent[np.ix_(modules, modules)])
        label = connected_components(graph, directed=False)[1]
        found += [
            (kind, angle, [group[i] for i in np.flatnonzero(label == k).tolist()])
            for k in range(int(label.max()) + 1)
        ]
    return found


def _with_runs(
    found: list[_Explained],
) -> list[_Explained]:
    """Join exchanges of modules that together reverse a row of modules."""
    by_sum: dict[int, dict[int, Change]] = {}
    for kind, _, group in found:
        pair = sorted(group[0].modules)
        if kind == "exchanged" and len(pair) == 2:
            by_sum.setdefault(sum(pair), {})[pair[0]] = group[0]
    joined: list[_Explained] = []
    for total, pairs in by_sum.items():
        row: list[int] = []
        for low in sorted(pairs, reverse=True):
            if row and low != row[-1] - 1:
                break
            row.append(low)
        # All between the innermost two are in the row, but for a module in the middle.
        if len(row) > 1 and total - 2 * row[0] <= 2:
            joined.append(("reversed", 0.0, [pairs[low] for low in row]))
    known = {id(change) for _, _, group in joined for change in group}
    return [one for one in found if id(one[2][0]) not in known] + joined


def _reversed_run(modules: Sequence[int], mounting: Mounting, names: Sequence[str]) -> str:
    first, last = (span(mounting.members[m], names) for m in (modules[0], modules[-1]))
    count = modules[-1] - modules[0] + 1
    return f"modules {first} to {last}, {count} in a row, in reverse order"


def _in_place(kind: str, angle: float, group: Sequence[Change], listed: Sequence[str]) -> str:
    move, before = group[0].move, group[0].stated
    turn = turn_in_words(before, move.places, abs(angle))
    if len(listed) > 1:
        modules = f"the {len(listed)} modules {join_items(listed, _MAX_NAMED)} of one patch are"
        if group[0].together:
            return f"{modules} {kind} together{'' if kind == 'mirrored' else f' by {turn}'}"
        if kind == "mirrored":
            return f"{modules} mirrored in their places"
        if before.shape[1] > 2:  # each about an axis of its own
            turn = f"{abs(angle):.0f} degrees"
        return f"{modules} turned by {turn} in their places"
    if kind == "mirrored":
        return f"module {listed[0]} is a mirror image of what is stated"
    return f"module {listed[0]} is turned by {turn}"


def _motion(before: NDArray[np.float64], after: NDArray[np.float64]) -> tuple[str, float]:
    """Return whether places (m, k) were turned or mirrored, and the angle of a turn in degrees."""
    fit = fit_similarity(before, after, scaling=False, reflection=None)
    k = before.shape[1]
    if np.linalg.det(fit.rotation) < 0:
        return "mirrored", 0.0
    cosine = (np.trace(fit.rotation) - (k - 2)) / 2
    angle = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    return ("turned" if angle > _SHIFTED else "moved"), angle


def _targets(
    stated: NDArray[np.float64], proposed: NDArray[np.float64], spacing: float
) -> NDArray[np.intp]:
    """Return the sensor whose stated place each sensor has; -1 for a place that no sensor has."""
    distance, owner = KDTree(stated).query(proposed)
    found = np.where(distance <= _SAME * spacing, owner, -1)
    unchanged = (stated == proposed).all(axis=1)
    return np.where(unchanged, np.arange(len(stated)), found)


def turn_in_words(before: NDArray[np.float64], after: NDArray[np.float64], angle: float) -> str:
    """Say by how much, in which direction and about which axis places were turned.

    before, after (m, k). In 3D, the axis points to the side of its largest coordinate.
    """
    first, second = (
        np.pad(p - p.mean(axis=0), ((0, 0), (0, 3 - p.shape[1]))) for p in (before, after)
    )
    axis: NDArray[np.float64] = np.cross(first, second).sum(axis=0)
    length = float(np.linalg.norm(axis))
    size = f"{angle:.0f} degrees"
    if length <= _SAME * float((first**2).sum()):
        return size  # half a turn has no direction
    if before.shape[1] == 2:
        return f"{size} {'counterclockwise' if axis[2] > 0 else 'clockwise'}"
    sign = float(np.sign(axis[np.abs(axis).argmax()]))
    sense = "+" if sign > 0 else "-"
    listed = ", ".join(f"{0.0 + round(one, 2):g}" for one in (sign / length * axis).tolist())
    return f"{sense}{size} about the axis ({listed})"


def _shifted_runs(
    target: NDArray[np.intp], left: NDArray[np.bool_], stated: NDArray[np.float64]
) -> list[Explained]:
    step = np.where(left & (target >= 0), target - np.arange(len(target)), 0)
    cycles = _closed({int(i): int(target[i]) for i in np.flatnonzero(left) if target[i] >= 0})
    # A run that is shifted by two channels closes in two cycles.
    joined: list[list[int]] = []
    for cycle in sorted(sorted(cycle) for cycle in cycles):
        if joined and cycle[0] <= joined[-1][-1] + 1 and len(cycle) >= _MIN_RUN // 2:
            joined[-1] = sorted(joined[-1] + cycle)
        else:
            joined.append(cycle)
    found = []
    for sensors in joined:
        steps = step[sensors]
        values, counts = np.unique(steps, return_counts=True)
        most = int(values[counts.argmax()])
        if (
            len(sensors) >= _MIN_RUN
            and abs(most) <= _MAX_STEP
            and counts.max() >= _MIN_SHARE * len(sensors)
        ):
            channels = "one channel" if abs(most) == 1 else f"{abs(most)} channels"
            order = "next" if most > 0 else "previous"
            text = (
                f"{len(sensors)} consecutive sensors are shifted by {channels}: each has the place "
                f"of the {order}"
            )
            run = np.array(sensors)
            found.append(Explained("shifted", run, text, shifted_moves(stated, run)))
            left[sensors] = False
    return found


def _cycles(
    target: NDArray[np.intp], left: NDArray[np.bool_], names: Sequence[str]
) -> list[Explained]:
    found = []
    edges = {int(i): int(target[i]) for i in np.flatnonzero(left) if target[i] >= 0}
    for cycle in _closed(edges):
        named = [names[i] for i in cycle]
        if len(cycle) == 2:
            text = f"{named[0]} and {named[1]} have each other's places"
            found.append(Explained("swapped", np.array(cycle), text))
        else:
            text = f"{join_items(named, _MAX_NAMED)}: each has the place of the next"
            found.append(Explained("cycle", np.array(cycle), text))
        left[cycle] = False
    return found


def _moved(
    target: NDArray[np.intp],
    left: NDArray[np.bool_],
    rigid: Iterable[NDArray[np.intp]],
    names: Sequence[str],
) -> list[Explained]:
    found = []
    groups = [*rigid, *(np.array([i]) for i in np.flatnonzero(left))]
    for group in groups:
        sensors = np.sort(group[left[group]])
        if not sensors.size:
            continue
        if len(sensors) > 1:
            text = f"{len(sensors)} sensors belong to another place, all together"
        elif target[sensors[0]] >= 0:
            text = f"{names[sensors[0]]} has the place of {names[target[sensors[0]]]}"
        else:
            text = f"{names[sensors[0]]} belongs to another place"
        found.append(Explained("moved", sensors, text))
        left[sensors] = False
    return found


def _closed(edges: dict[int, int]) -> list[list[int]]:
    """Return the cycles of a map; chains that end, or run into a cycle, are left out."""
    found: list[list[int]] = []
    seen: set[int] = set()
    for start in sorted(edges):
        path = [start]
        while len(path) <= len(edges) and (following := edges.get(path[-1], start)) != start:
            path.append(following)
        if start not in seen and edges.get(path[-1]) == start:
            found.append(path)
            seen.update(path)
    return found


def span(members: NDArray[np.intp], names: Sequence[str]) -> str:
    """Name a module by its first and last sensors."""
    return f"{names[members[0]]} to {names[members[-1]]}"
