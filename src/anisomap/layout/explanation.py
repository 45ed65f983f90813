"""Findings that explain the difference between two sets of positions."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.numerics.layout.evidence import Move
from anisomap.numerics.layout.permutations import ModuleShapes, shifted_moves, turned_moves
from anisomap.wording import join_items

_SAME = 1e-6  # spacings between places that count as the same: places of others are taken exactly
_MIN_RUN = 4  # sensors; fewer are swaps and cycles
_MAX_STEP = 2  # channels by which a run may be shifted; as `permutations.cable_shifts`
_MIN_SHARE = 0.7  # of the sensors of cycles that must be shifted equally; chosen by hand
_MAX_NAMED = 6


@dataclass(frozen=True, eq=False)
class Explained:
    """A group of sensors with new places, and the explanation.

    Attributes
    ----------
    kind : str
        A key of `anisomap.layout.KINDS`.
    sensors : ndarray of int
        Those that take part, some perhaps with the place that is stated.
    text : str
    alternatives : tuple of Move
        See `anisomap.numerics.layout.evidence.Proposal`.
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

    Parameters
    ----------
    stated, proposed : ndarray of shape (n, k)
    modules : ModuleShapes
    spacing : float
    rigid : sequence of ndarray of int
        Groups of sensors that were moved as a whole.
    names : sequence of str

    Returns
    -------
    list of Explained
        Each sensor with a new place is in exactly one.
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
                        else f"module {_span(members, names)} is turned by {image.angle:.0f} "
                        "degrees"
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
            text = f"{len(sensors)} sensors belong to another place, as a whole"
        elif target[sensors[0]] >= 0:
            text = f"{names[sensors[0]]} has the place of {names[target[sensors[0]]]}"
        else:
            text = f"{names[sensors[0]]} belongs to another place"
        found.append(Explained("moved", sensors, text))
        left[sensors] = False
    return found


def _closed(edges: dict[int, int]) -> list[list[int]]:
    """Return the cycles of a map; chains that end are left out."""
    found, seen = [], set()
    for start in sorted(edges):
        path = list(itertools.islice(_followed(edges, start), len(edges) + 1))
        if start not in seen and len(path) <= len(edges) and edges.get(path[-1]) == start:
            found.append(path)
            seen.update(path)
    return found


def _followed(edges: dict[int, int], start: int) -> Iterable[int]:
    at = start
    while True:
        yield at
        at = edges.get(at, -1)
        if at in (-1, start):
            return


def _span(members: NDArray[np.intp], names: Sequence[str]) -> str:
    return f"{names[members[0]]} to {names[members[-1]]}"
