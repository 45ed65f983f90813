"""Modules of a layout, and faults that explain why sensors have other places."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.base.wording import join_items
from anisomap.errors import InputError
from anisomap.numerics.layout.congruence import blocks_of_size, rigid_repeats
from anisomap.numerics.layout.evidence import Move
from anisomap.numerics.layout.moves import ModuleShapes, shifted_moves, turned_moves
from anisomap.placement.modules import NO_MODULE, Modules, trailing_numbers
from anisomap.sensor_map import SensorMap

_MIN_SIZE = 3
_MAX_GAPS = 100  # channels per sensor


def module_members(
    layout: SensorMap, modules: Modules | int | None = None
) -> list[NDArray[np.intp]]:
    """List the sensors of each module of a layout.

    Parameters
    ----------
    layout : SensorMap
    modules : Modules or int, optional
        Modules of the sensors of the layout, or the number of channels of each module, those
        without a sensor included. By default, they are found: blocks of consecutive channels
        whose shapes repeat.

    Returns
    -------
    list of ndarray of int
        Rows of the layout; empty if there are no modules. Sensors are in the order of the pads.

    Raises
    ------
    InputError
        If the modules are of other sensors, or the size is not 3 to half the number of sensors.

    Notes
    -----
    Channels are the numbers at the end of the names (``taxel97``) if these are different, else the
    order of the sensors. The first channel of a module is chosen such that the shapes of most
    modules are the same.
    """
    if isinstance(modules, Modules):
        if len(modules.index) != layout.n_sensors:
            raise InputError(
                f"modules of {len(modules.index)} sensors do not fit a layout of "
                f"{layout.n_sensors} sensors"
            )
        members = [modules.members(k) for k in range(modules.n_modules)]
        return [inside[layout.placed[inside]] for inside in members if len(inside)]
    placed = np.flatnonzero(layout.placed)
    positions = layout.positions[placed]
    numbers = _channels(layout, placed)
    if modules is None:
        labels = rigid_repeats(positions, numbers)
    else:
        if not _MIN_SIZE <= modules <= max(_MIN_SIZE, len(placed) // 2):
            raise InputError(
                f"the size of modules must be {_MIN_SIZE} to half the number of sensors "
                f"({len(placed) // 2}), got {modules}"
            )
        labels = blocks_of_size(positions, numbers, modules)[0]
    found = [placed[labels == k] for k in np.unique(labels[labels != NO_MODULE])]
    return [inside[np.argsort(_channels(layout, inside), kind="stable")] for inside in found]


def _channels(layout: SensorMap, sensors: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the number of each of some sensors."""
    found = trailing_numbers(layout.names)
    if None in found or len(set(found)) < len(found):
        return sensors
    numbers = np.array(found, dtype=np.intp)
    # Serial numbers far apart are no channels.
    return numbers[sensors] if np.ptp(numbers) < _MAX_GAPS * len(numbers) else sensors


_SAME = 1e-6  # spacings between places that count as the same: places of others are taken exactly
_MIN_RUN = 4  # sensors; fewer are swaps and cycles
_MAX_STEP = 2  # channels by which a run may be shifted; as `cable_shifts`
_MIN_SHARE = 0.7  # of the sensors of cycles that must be shifted equally; chosen by hand
_MAX_NAMED = 6


@dataclass(frozen=True, eq=False)
class Explained:
    """A group of sensors with new places, and the explanation.

    kind: A key of `anisomap.layout.KINDS`.
    sensors: Those that take part, some perhaps with the place that is stated.
    alternatives: See `anisomap.numerics.layout.evidence.Proposal`.
    """

    kind: str
    sensors: NDArray[np.intp]
    text: str
    alternatives: tuple[Move, ...] = ()


def explain(
    stated: NDArray[np.float64],
    proposed: NDArray[np.float64],
    modules: ModuleShapes,
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
    found = _of_modules(target, left, modules, names, stated)
    found += _shifted_runs(target, left, stated)
    found += _cycles(target, left, names)
    return found + _moved(target, left, rigid, names)


def _targets(
    stated: NDArray[np.float64], proposed: NDArray[np.float64], spacing: float
) -> NDArray[np.intp]:
    """Return the sensor whose stated place each sensor has; -1 for a place that no sensor has."""
    distance, owner = KDTree(stated).query(proposed)
    found = np.where(distance <= _SAME * spacing, owner, -1)
    unchanged = (stated == proposed).all(axis=1)
    return np.where(unchanged, np.arange(len(stated)), found)


def _of_modules(
    target: NDArray[np.intp],
    left: NDArray[np.bool_],
    modules: ModuleShapes,
    names: Sequence[str],
    stated: NDArray[np.float64],
) -> list[Explained]:
    slot = {}
    for k, members in enumerate(modules.members):
        for m in (k, *np.flatnonzero(modules.alike[k]).tolist()):
            if left[members].any() and set(target[members]) == set(modules.members[m]):
                slot[k] = m
                break
    found = []
    for k, m in slot.items():
        if k == m:
            members = modules.members[k]
            order = [members.tolist().index(t) for t in target[members]]
            for image in modules.symmetries[k]:
                if np.array_equal(image.order, order):
                    text = (
                        f"module {_span(members, names)} is a mirror image of what is stated"
                        if image.reflected
                        else f"module {_span(members, names)} is turned by "
                        + turn_in_words(stated[members], stated[target[members]], image.angle)
                    )
                    kind = "mirrored" if image.reflected else "turned"
                    turns = turned_moves(stated, members, modules.symmetries[k])
                    found.append(Explained(kind, members, text, turns))
                    left[members] = False
    for cycle in _closed({k: m for k, m in slot.items() if k != m}):
        sensors = np.concatenate([modules.members[k] for k in cycle])
        spans = [_span(modules.members[k], names) for k in cycle]
        text = (
            f"modules {spans[0]} and {spans[1]} have each other's places"
            if len(cycle) == 2
            else f"modules {', '.join(spans)} each have the place of the next"
        )
        found.append(Explained("exchanged", np.sort(sensors), text))
        left[sensors] = False
    return found


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


def _span(members: NDArray[np.intp], names: Sequence[str]) -> str:
    return f"{names[members[0]]} to {names[members[-1]]}"
