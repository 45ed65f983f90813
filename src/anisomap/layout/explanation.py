"""Texts about the faults that explain changed places of modules and sensors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.base.wording import join_items
from anisomap.layout.evidence import Proposal
from anisomap.layout.module_changes import Change, alike
from anisomap.layout.modules import Mounting
from anisomap.layout.sensors import MAX_STEP, chains
from anisomap.numerics.procrustes import fit_similarity

_SAME = 1e-6  # spacings between places that count as the same; exchanged places are exact
_MIN_SHARE = 0.7  # of the sensors of a run that must be shifted equally; chosen by hand
_SHIFTED = 15.0  # degrees; patches that turn less are reported as shifted
_MAX_NAMED = 6


def explain(
    stated: NDArray[np.float64],
    proposed: NDArray[np.float64],
    spacing: float,
    made: Sequence[Proposal],
    names: Sequence[str],
) -> list[tuple[str, str, NDArray[np.intp]]]:
    """Group the sensors with new places by the fault that explains them: kind, text, sensors.

    stated, proposed (n, k).
    made: Proposals that were accepted.
    """
    distance, owner = KDTree(stated).query(proposed)
    target = np.where(distance <= _SAME * spacing, owner, -1)
    everyone = np.arange(len(stated))
    left = (stated != proposed).any(axis=1) & (target != everyone)
    found: list[tuple[str, str, NDArray[np.intp]]] = []

    def tell(kind: str, sensors: NDArray[np.intp], text: str) -> None:
        found.append((kind, text, sensors))
        left[sensors] = False

    for one in made:
        run = one.move.sensors
        (step, count), *_ = Counter((target[run] - run).tolist()).most_common(1)
        alike = abs(step) <= MAX_STEP and count >= _MIN_SHARE * len(run)
        if one.kind == "shifted" and alike and left[run].all():
            channels = "one channel" if abs(step) == 1 else f"{abs(step)} channels"
            order = "next" if step > 0 else "previous"
            text = f"sensors are shifted by {channels}: each has the place of the {order}"
            tell("shifted", run, f"{len(run)} consecutive {text}")
    following = {int(i): int(target[i]) for i in np.flatnonzero(left & (target >= 0))}
    for cycle in chains(following):
        named = [names[i] for i in cycle]
        if following[cycle[-1]] != cycle[0]:
            continue
        text = f"{join_items(named, _MAX_NAMED)}: each has the place of the next"
        if len(cycle) == 2:
            text = f"{named[0]} and {named[1]} have each other's places"
        tell("swapped" if len(cycle) == 2 else "cycle", np.array(cycle), text)
    groups = [one.move.sensors for one in made if one.kind == "moved"]
    for group in [*groups, *everyone[left][:, None]]:
        sensors = np.sort(group[left[group]])
        if len(sensors) > 1:
            tell("moved", sensors, f"{len(sensors)} sensors belong to another place as a group")
        elif len(sensors):
            name, there = names[sensors[0]], target[sensors[0]]
            place = f"has the place of {names[there]}" if there >= 0 else "belongs to another place"
            tell("moved", sensors, f"{name} {place}")
    return found


def explain_modules(
    changes: Sequence[Change], mounting: Mounting, names: Sequence[str], usable: NDArray[np.bool_]
) -> list[tuple[str, str, list[Change]]]:
    """Explain changes of modules, grouped by patch: kind, text, and changes."""
    found = []
    for kind, angle, group in _causes(changes, mounting):
        modules = [m for change in group for m in change.modules]
        listed = [span(mounting.members[m], names) for m in modules]
        tested = sum(int(usable[mounting.members[m]].sum()) for m in modules)
        of_all = sum(len(mounting.members[m]) for m in modules)
        count = f" ({tested} of {of_all} pads tested)" if tested < of_all else ""
        if kind == "reversed":
            first, last = min(modules), max(modules)
            ends = f"{names[mounting.members[first][0]]} to {names[mounting.members[last][-1]]}"
            text = f"modules {ends}, {last - first + 1} in a row, in reverse order"
            if first == last:
                text = f"module {ends}: pads in reverse order"
        elif group[0].together and kind == "moved":
            text = (
                f"module {listed[0]} is shifted"
                if len(listed) == 1
                else f"the {len(listed)} modules {join_items(listed, _MAX_NAMED)} are shifted "
                "together"
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
                else "an empty place beside the other modules"
            )
        else:
            text = f"modules {join_items(listed, _MAX_NAMED)} belong to other places"
        found.append((kind, text + count, group))
    return found


def _causes(changes: Sequence[Change], mounting: Mounting) -> list[tuple[str, float, list[Change]]]:
    """Group changes by cause: kind, angle in degrees, and changes.

    Equal flips of adjacent modules have a common cause.
    """
    found: list[tuple[str, float, list[Change]]] = []
    for change in changes:
        if change.together:
            found.append((*motion(change.stated, change.move.places), [change]))
        elif change.slots != change.modules:
            closed = set(change.slots) == set(change.modules)
            kind = "reversed" if change.row else "exchanged" if closed else "moved"
            found.append((kind, 0.0, [change]))
    for group in alike(changes, mounting):
        way, those = mounting.orientations[changes[group[0]].turns[0]], [changes[i] for i in group]
        if way.backwards:
            found += [("reversed", 0.0, [one]) for one in those]
        else:
            found.append(("mirrored" if way.reflected else "turned", abs(way.angle), those))
    return found


def _in_place(kind: str, angle: float, group: Sequence[Change], listed: Sequence[str]) -> str:
    move, before = group[0].move, group[0].stated
    turn = turn_in_words(before, move.places, angle)
    if len(listed) > 1:
        modules = f"the {len(listed)} modules {join_items(listed, _MAX_NAMED)} of one patch are"
        if group[0].together:
            return f"{modules} {kind} together{'' if kind == 'mirrored' else f' by {turn}'}"
        if kind == "mirrored":
            return f"{modules} mirrored in their places"
        if before.shape[1] > 2:  # each has a different axis
            turn = f"{angle:.0f} degrees"
        return f"{modules} turned by {turn} in their places"
    if kind == "mirrored":
        return f"module {listed[0]} is mirrored in its place"
    return f"module {listed[0]} is turned by {turn}"


def motion(before: NDArray[np.float64], after: NDArray[np.float64]) -> tuple[str, float]:
    """Return whether places (m, k) were turned or mirrored, and the angle of a turn in degrees."""
    fit = fit_similarity(before, after, scaling=False, reflection=None)
    k = before.shape[1]
    if np.linalg.det(fit.rotation) < 0:
        return "mirrored", 0.0
    cosine = (np.trace(fit.rotation) - (k - 2)) / 2
    angle = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    return ("turned" if angle > _SHIFTED else "moved"), angle


def turn_in_words(before: NDArray[np.float64], after: NDArray[np.float64], angle: float) -> str:
    """Describe angle, direction and axis of the rotation of places.

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


def span(members: NDArray[np.intp], names: Sequence[str]) -> str:
    """Return the name of a module by its first and last sensors."""
    return f"{names[members[0]]} to {names[members[-1]]}"
