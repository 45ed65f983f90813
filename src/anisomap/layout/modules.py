"""Modules of a layout: shapes, places and orientations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment, linprog
from scipy.spatial import ConvexHull, KDTree
from scipy.spatial.distance import cdist

from anisomap.base import METRES
from anisomap.base.channels import channel_numbers
from anisomap.errors import InputError
from anisomap.numerics.neighbours import nearest_distances, padded
from anisomap.numerics.procrustes import Similarity, fit_similarity
from anisomap.placement.modules import MIN_PADS, NO_MODULE, Modules
from anisomap.sensor_map import SensorMap

_MAX_GAPS = 100  # channels per sensor
_MAX_FOLD = 8  # largest order of rotations tried
_SAME = 0.3  # of the spacing of pads; errors of places that count as equal; chosen by hand
_MIN_MAPPED = 0.8  # share of pads that a rotation maps to pads; fewer because of thermal pads
_MAX_MISFIT = 0.5  # of the spacing of pads; modules with more have a different shape
# Shares of the extent of a module, and share of pads that agree with most others; by hand.
_SAME_LENGTH, _SAME_PLACE, _AGREEING = 0.15, 0.1, 0.75
_EXACT = 0.02  # of the extent: error of pads in unbent places, if most pads fit a module
_CLEARLY = 0.5  # maximum misfit of pads in reverse order, relative to pads in order
_MAX_PULL = 1.5  # spacings by which bending displaces pads; pads with more have no module
# Minimum distance, relative to adjacent modules, in 2D and 3D; otherwise correct layouts of the
# iCub have 0.73 in 3D.
_TOO_NEAR = {2: 0.8, 3: 0.65}
_NEXT = 1.5  # maximum distance of adjacent modules, relative to the median of nearest modules
_FREE = 0.6  # minimum distance of pads of a free place from other pads, in spacings
_MAX_TAKEN = 0.1  # share of the pads of a free place that may be nearer to others

_TOLERANCE = 0.25  # of the spacing: error that counts as equal; curved bodies bend by up to 0.1
_MAX_MODULE = 64  # channels
_MIN_REPEATED = 0.5  # share of the sensors that must be on modules of one shape
_CLEARLY_MORE = 0.1  # the share for a multiple of the true size is hardly larger
_MAX_SIZES = 8  # sizes of modules to try, by periodicity of distances
_N_NEXT = 3  # following channels whose distances are compared
_MIN_PADS = 5  # fewer places are too often congruent by chance


def find_modules(layout: SensorMap, modules: Modules | int | None = None) -> Modules:
    """Divide the sensors of a layout into modules.

    Parameters
    ----------
    layout : SensorMap
    modules : Modules or int, optional
        Modules of the sensors of the layout, or the number of channels of each module, including
        channels without a sensor. By default, modules are blocks of consecutive channels whose
        shapes repeat.

    Returns
    -------
    Modules
        Modules without a template, unless `modules` has one. Empty if no shapes repeat.

    Raises
    ------
    InputError
        If the modules are of other sensors, or the size is not 3 to half the number of sensors.

    Notes
    -----
    Channels are the numbers at the end of the names (``taxel97``) if they are unique, else the
    order of the sensors. The first channel of a module is chosen such that most modules have the
    same shape, and the number of modules is as small as possible.
    """
    if isinstance(modules, Modules):
        if len(modules.index) != layout.n_sensors:
            raise InputError(
                f"modules of {len(modules.index)} sensors do not fit a layout of "
                f"{layout.n_sensors} sensors"
            )
        return modules
    placed = np.flatnonzero(layout.placed)
    positions, numbers = layout.positions[placed], _channels(layout)[placed]
    if modules is None:
        size, first = rigid_repeats(positions, numbers)
    elif MIN_PADS <= modules <= max(MIN_PADS, len(placed) // 2):
        size, (first, _) = modules, blocks_of_size(positions, numbers, modules)
    else:
        raise InputError(
            f"the size of modules must be {MIN_PADS} to half the number of sensors "
            f"({len(placed) // 2}), got {modules}"
        )
    index, pads = (np.full(layout.n_sensors, NO_MODULE) for _ in range(2))
    if not size:
        return Modules(index, pads, ())
    block, pads[placed] = np.divmod(numbers - first, size)
    starts, index[placed] = np.unique(block, return_inverse=True)
    labels = [f"{max(0, n * size + first)}-{(n + 1) * size + first - 1}" for n in starts.tolist()]
    return Modules(index, pads, tuple(labels))


def _channels(layout: SensorMap) -> NDArray[np.intp]:
    """Return the number of each sensor."""
    found = channel_numbers(layout.names)
    known = [n for n, placed in zip(found, layout.placed.tolist(), strict=True) if placed]
    order = np.arange(layout.n_sensors)
    if None in known or len(set(known)) < len(known):
        return order
    numbers = np.array([-1 if n is None else n for n in found], dtype=np.intp)
    # Serial numbers far apart are no channels.
    spread = int(np.ptp(numbers[layout.placed])) if known else 0
    return numbers if spread < _MAX_GAPS * layout.n_sensors else order


def rigid_repeats(positions: NDArray[np.float64], numbers: NDArray[np.intp]) -> tuple[int, int]:
    """Find modules, blocks of consecutive sensors whose shapes repeat: size and first number.

    positions (N, k). The size is 0 if no shapes repeat.
    """
    best, best_share = (0, 0), _MIN_REPEATED
    sizes = np.arange(_MIN_PADS, min(_MAX_MODULE, len(positions) // 2) + 1)
    periodic = np.array([_share_periodic(positions, numbers, size) for size in sizes.tolist()])
    likely = np.argsort(-periodic, kind="stable")[:_MAX_SIZES]
    for size in sorted(sizes[likely[periodic[likely] >= _MIN_REPEATED]].tolist()):
        first, share = blocks_of_size(positions, numbers, size)
        if share > best_share + _CLEARLY_MORE:
            best, best_share = (size, first), share
    return best


def blocks_of_size(
    positions: NDArray[np.float64], numbers: NDArray[np.intp], size: int
) -> tuple[int, float]:
    """Divide sensors into blocks of `size` consecutive numbers: first number, share of congruence.

    The share is maximal, or, if bending makes all blocks unequal, the number of blocks is minimal.
    """
    distances = cdist(positions, positions)
    found = []
    for first in range(size):
        block, pad = np.divmod(numbers - first, size)
        block = np.unique(block, return_inverse=True)[1]
        share = _share_congruent(distances, block, pad)
        found.append((-round(share, 9), int(block.max()), first))
    share, _, first = min(found)
    return first, -share


def _share_periodic(positions: NDArray[np.float64], numbers: NDArray[np.intp], size: int) -> float:
    """Return the share of channels whose distances to the next three repeat `size` channels later.

    Modules of this size have most distances between nearby channels in common.
    """
    last = int(np.ptp(numbers)) + 1
    places = np.full((last + size + _N_NEXT, positions.shape[1]), np.nan)
    places[numbers - numbers.min()] = positions
    same, compared = np.ones(last, dtype=bool), np.zeros(last, dtype=bool)
    for step in range(1, _N_NEXT + 1):
        length = np.linalg.norm(places[step:] - places[:-step], axis=1)
        change = np.abs(length[size:][:last] - length[:last])
        known = np.isfinite(change)
        same &= ~known | (change <= _TOLERANCE * length[:last])
        compared |= known
    return float(same[compared].mean()) if compared.any() else 0.0


def _share_congruent(
    distances: NDArray[np.float64], block: NDArray[np.intp], pad: NDArray[np.intp]
) -> float:
    """Return the share of sensors in whole blocks with the median distances between pads."""
    sensor = np.full((block.max() + 1, pad.max() + 1), -1)
    sensor[block, pad] = np.arange(len(block))
    sensor = sensor[np.count_nonzero(sensor >= 0, axis=1) >= _MIN_PADS]
    if len(sensor) < 2:
        return 0.0
    sensor = sensor[:, (sensor >= 0).mean(axis=0) > 0.5]  # so that any two pads share a block
    known = sensor >= 0
    between = distances[sensor[:, :, None], sensor[:, None]]
    shapes = np.where(known[:, :, None] & known[:, None], between, np.nan)
    middle = np.nanmedian(shapes, axis=0)
    nearest = np.nanmin(middle + np.diag(np.full(len(middle), np.inf)), axis=0)
    off = np.nan_to_num(np.abs(shapes - middle)).max(axis=(1, 2))
    alike = (off <= _TOLERANCE * float(np.median(nearest))) & known.all(axis=1)
    return float(known[alike].sum()) / len(block)


@dataclass(frozen=True, eq=False)
class Orientation:
    """A possible arrangement of the pads of a module at its place.

    angle: Angle of the rotation, in degrees, in (-180, 180], after a reflection if there is one.
    places (P, 2): Resulting places of the pads, in the frame of the module.
    target (P,): The pad whose place each pad takes; -1 for a place without a pad.
    fits: Whether most pads are at places of pads.
    backwards: Whether the pads are in reverse order.
    """

    reflected: bool
    angle: float
    places: NDArray[np.float64]
    target: NDArray[np.intp]
    fits: bool = True
    backwards: bool = False


def orientations(template: NDArray[np.float64]) -> tuple[Orientation, ...]:
    """Find the possible orientations of a module at its place, the stated one first.

    These are the symmetries of the module. A module of odd symmetry, such as a triangle, also fits
    lattices half a step further. The last orientation has the pads in reverse order.

    template (P, 2): Positions of the pads; NaN for pads that do not exist.
    """
    exist = np.flatnonzero(np.isfinite(template).all(axis=1))
    pads, everyone = template[exist], np.arange(len(template))
    found = [Orientation(reflected=False, angle=0.0, places=template, target=everyone)]
    if len(pads) < MIN_PADS:
        return tuple(found)
    allowed = _SAME * float(np.median(nearest_distances(pads)))
    centre = pads.mean(axis=0)
    turns = ((n, _symmetry(pads, 2 * math.pi / n, allowed)) for n in range(_MAX_FOLD, 1, -1))
    fold, turn = next((one for one in turns if one[1]), (1, None))
    axes = _axes(pads - centre, allowed)
    mirrors = (_symmetry(pads, angle, allowed, reflected=True) for angle in axes)
    mirror = next((one for one in mirrors if one), None)
    if turn is None and mirror is None:
        return tuple(found)
    if turn is not None:
        centre = np.linalg.solve(np.eye(2) - turn.rotation, turn.translation)
    n_turns = fold if fold % 2 == 0 else 2 * fold
    images = {False: pads} if mirror is None else {False: pads, True: mirror.apply(pads)}
    for reflected, image in images.items():
        for k in range(0 if reflected else 1, n_turns):
            angle = 2 * math.pi * k / n_turns
            places, target = template.copy(), np.full(len(template), -1)
            places[exist] = _turned(image, angle, centre)
            onto = _mapped(places[exist], pads, allowed)
            if fits := bool(np.mean(onto >= 0) >= _MIN_MAPPED):
                target[exist[onto >= 0]] = exist[onto[onto >= 0]]
                places[target >= 0] = template[target[target >= 0]]
            degrees = math.degrees(math.remainder(angle, 2 * math.pi))
            found.append(Orientation(reflected, degrees, places, target, fits))
    target = everyone.copy()
    target[exist] = exist[::-1]
    return (*found, Orientation(False, 0.0, template[target], target, backwards=True))


def _symmetry(
    pads: NDArray[np.float64], angle: float, allowed: float, *, reflected: bool = False
) -> Similarity | None:
    """Return the rotation or reflection near a given angle that maps most pads onto pads."""
    middle = pads.mean(axis=0)
    image = (pads - middle) * [1, -1 if reflected else 1]
    target = _mapped(_turned(image, angle, np.zeros(2)) + middle, pads, allowed)
    for _ in range(2):
        # Pads that map onto no pad would displace the centre.
        kept = target >= 0
        if np.mean(kept) < _MIN_MAPPED:
            return None
        fit = fit_similarity(pads[kept], pads[target[kept]], scaling=False, reflection=reflected)
        target = _mapped(fit.apply(pads), pads, allowed)
    return fit if np.mean(target >= 0) >= _MIN_MAPPED else None


def _axes(centred: NDArray[np.float64], allowed: float) -> list[float]:
    """Return twice the angles of the axes of reflections that map an outermost pad to another."""
    radius, direction = np.linalg.norm(centred, axis=1), np.arctan2(*centred.T[::-1])
    return [
        float(direction[outer] + direction[i])
        for outer in np.argsort(-radius)[: len(radius) // 2 + 1]
        for i in np.flatnonzero(np.abs(radius - radius[outer]) <= 2 * allowed)
    ]


def _turned(
    points: NDArray[np.float64], angle: float, centre: NDArray[np.float64]
) -> NDArray[np.float64]:
    cos, sin = math.cos(angle), math.sin(angle)
    return np.asarray((points - centre) @ [[cos, sin], [-sin, cos]] + centre)


def _mapped(
    image: NDArray[np.float64], points: NDArray[np.float64], allowed: float
) -> NDArray[np.intp]:
    """Return the point at which each image lies; -1 if there is none."""
    distances = cdist(image, points)
    order = linear_sum_assignment(np.minimum(distances, 2 * allowed) ** 2)[1]
    return np.where(distances[np.arange(len(points)), order] <= allowed, order, -1)


@dataclass(frozen=True, eq=False)
class Mounting:
    """Modules fitted to their stated places, and other possible places.

    members: Sensors of each module, by pad.
    pads: Pads of these sensors.
    orientations: Orientations in which a module fits its place; the first is the stated one.
    frames (S, k, k), centres (S, k): Of each slot, i.e. each place for a module. The first slots
        belong to the modules, in order; the others are free. Rows of a frame are module axes.
    seats (S, P, k): Places of the pads in each slot, stated if known. Layouts of curved bodies bend
        the rigid modules, so modules take places of pads only in a changed orientation.
    home (n, k): Place of each sensor on its module; NaN without a module.
    pitch: Spacing of the pads.
    """

    members: tuple[NDArray[np.intp], ...]
    pads: tuple[NDArray[np.intp], ...]
    orientations: tuple[Orientation, ...]
    frames: NDArray[np.float64]
    centres: NDArray[np.float64]
    seats: NDArray[np.float64]
    home: NDArray[np.float64]
    pitch: float

    @classmethod
    def of(cls, modules: Modules, positions: NDArray[np.float64], units: str) -> Mounting:
        """Fit modules to positions (n, k), by their template or by their common shape."""
        k, home = positions.shape[1], np.full_like(positions, np.nan)
        members = [modules.members(m) for m in range(modules.n_modules)]
        members = [inside for inside in members if len(inside) >= MIN_PADS]
        known = bool(len(modules.template))
        if not members:
            none = np.empty((0, 0, k))
            return cls((), (), (), np.empty((0, k, k)), np.empty((0, k)), none, home, 0.0)
        shapes = [(modules.pads[inside], positions[inside]) for inside in members]
        template = _scaled(modules, shapes, units) if known else _common_shape(shapes)
        exist = np.asarray(np.isfinite(template).all(axis=1))
        members = [inside[exist[modules.pads[inside]]] for inside in members]
        used = np.unique(np.concatenate([modules.pads[inside] for inside in members]))
        pitch = float(np.median(nearest_distances(template[used])))
        back = np.arange(len(template))
        template[np.isin(back, used, invert=True)] = np.nan
        back[used] = used[::-1]
        kept, pads, fits = [], [], []
        for inside in members:
            here = positions[inside]
            fit, pad = _fit_either_way(template, modules.pads[inside], back, here, pitch)
            # Displaced pads are no evidence about the orientation of the others.
            at = template[pad] @ fit[0][:2] + fit[1]
            near = np.linalg.norm(at - here, axis=1) <= _MAX_PULL * pitch
            if np.count_nonzero(near) >= MIN_PADS and (known or fit[2] <= _MAX_MISFIT * pitch):
                home[inside] = at
                kept.append(inside[near])
                pads.append(pad[near])
                fits.append(fit)
        return cls(
            tuple(kept),
            tuple(pads),
            orientations(template),
            np.array([fit[0] for fit in fits]).reshape(-1, k, k),
            np.array([fit[1] for fit in fits]).reshape(-1, k),
            np.empty((len(kept), len(template), k)),
            home,
            pitch,
        )._seated(positions)

    @property
    def n_modules(self) -> int:
        """Number of modules."""
        return len(self.members)

    @cached_property
    def owner(self) -> NDArray[np.intp]:
        """Module of each sensor, (n,); -1 without one."""
        owner = np.full(len(self.home), NO_MODULE)
        for m, inside in enumerate(self.members):
            owner[inside] = m
        return owner

    @cached_property
    def _flat(self) -> NDArray[np.float64]:
        """Existing pads, (E, 2)."""
        places = self.orientations[0].places
        return places[np.isfinite(places).all(axis=1)]

    @cached_property
    def middles(self) -> NDArray[np.float64]:
        """Centre of the pads in each slot, (S, k)."""
        return np.asarray(self._flat.mean(axis=0) @ self.frames[:, :2] + self.centres)

    @cached_property
    def adjacent(self) -> NDArray[np.bool_]:
        """Pairs of adjacent modules, (M, M)."""
        middles = self.middles[: self.n_modules]
        between = cdist(middles, middles)
        np.fill_diagonal(between, np.inf)
        return np.asarray(between <= _NEXT * np.median(between.min(axis=1, initial=np.inf)))

    @cached_property
    def clearance(self) -> float:
        """Minimum distance of the centres of two adjacent modules."""
        return 2 * _inscribed(self._flat)[1] + self.pitch

    @cached_property
    def overlaps(self) -> list[tuple[int, int, float]]:
        """Return pairs of modules whose centres are nearer than the shape allows, and distances.

        On a curved skin, modules are tilted, and their places in bent layouts are less exact.
        """
        if self.n_modules < 2:
            return []
        middle = _inscribed(self._flat)[0]
        centres = (middle @ self.frames[:, :2] + self.centres)[: self.n_modules]
        between = cdist(centres, centres)
        least = _TOO_NEAR[self.frames.shape[1]] * self.clearance
        near = np.argwhere(np.triu(between < least, 1)).tolist()
        return [(a, b, float(between[a, b])) for a, b in near]

    @cached_property
    def shapes(self) -> NDArray[np.float64]:
        """Places of the pads of a module in each slot and orientation, (S, O, P, k)."""
        found = []
        for o, way in enumerate(self.orientations):
            rigid = np.nan_to_num(way.places) @ self.frames[:, :2] + self.centres[:, None]
            seated = (way.target >= 0) & (o > 0)
            found.append(np.where(seated[:, None], self.seats[:, way.target], rigid))
        return np.stack(found, axis=1)

    def places(self, module: int, slot: int, orientation: int) -> NDArray[np.float64]:
        """Return the places of the sensors of a module in a slot, (m, k)."""
        return np.asarray(self.shapes[slot, orientation, self.pads[module]])

    def arranged(
        self, positions: NDArray[np.float64], slots: NDArray[np.intp], turns: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """Return positions (n, k) of unbent modules in slots (M,) and orientations (M,)."""
        found = positions.copy()
        for m, inside in enumerate(self.members):
            found[inside] = self.places(m, int(slots[m]), int(turns[m]))
        return found

    def moved(self, modules: Sequence[int], positions: NDArray[np.float64]) -> Mounting:
        """Return a copy with some modules at other positions (n, k), and new free places."""
        frames, centres = self.frames.copy(), self.centres.copy()
        for m in modules:
            pads = self.orientations[0].places[self.pads[m]]
            frames[m], centres[m], _ = _fit(pads, positions[self.members[m]])
        return replace(self, frames=frames, centres=centres)._seated(positions)

    def without(self, modules: Sequence[int], positions: NDArray[np.float64]) -> Mounting:
        """Return a copy without some modules, at positions (n, k), with resulting free places."""
        chosen = [m for m in range(self.n_modules) if m not in modules]
        return replace(
            self,
            members=tuple(self.members[m] for m in chosen),
            pads=tuple(self.pads[m] for m in chosen),
            frames=self.frames[chosen],
            centres=self.centres[chosen],
        )._seated(positions, [i for m in modules for i in self.members[m].tolist()])

    def _seated(self, positions: NDArray[np.float64], gone: Sequence[int] = ()) -> Mounting:
        """Return a copy with seats at positions (n, k), and with free places adjacent to them.

        Free places are relative to modules as adjacent modules are to each other.

        gone: Sensors that do not occupy places.
        """
        n = self.n_modules
        frames, centres = self.frames[:n], self.centres[:n]
        flat = np.nan_to_num(self.orientations[0].places)
        seats = flat @ frames[:, :2] + centres[:, None]
        for seat, inside, pads in zip(seats, self.members, self.pads, strict=True):
            seat[pads] = positions[inside]
        own = replace(self, frames=frames, centres=centres, seats=seats)
        if n < 2:
            return own
        first, second = np.nonzero(own.adjacent)
        inverse = frames[first].transpose(0, 2, 1)
        steps = np.einsum("ek,ekl->el", centres[second] - centres[first], inverse)
        turns = frames[second] @ inverse
        # Places that differ only by bending are merged.
        rounded = np.round(np.hstack([steps / self.pitch, turns.reshape(len(turns), -1)]))
        kinds = np.unique(rounded, axis=0, return_index=True)[1]
        frame = (turns[kinds, None] @ frames).reshape(-1, *frames.shape[1:])
        centre = (steps[kinds, None, None] @ frames)[:, :, 0] + centres
        centre = centre.reshape(-1, centres.shape[1])
        there = self._flat @ frame[:, :2] + centre[:, None]
        others: Any = KDTree(np.delete(positions, list(gone), axis=0))
        taken = others.query(there)[0] < _FREE * self.pitch
        middles = there.mean(axis=1)
        chosen: list[int] = []
        for i in np.flatnonzero(taken.mean(axis=1) <= _MAX_TAKEN).tolist():
            if (np.linalg.norm(middles[chosen] - middles[i], axis=1) >= self.pitch).all():
                chosen.append(i)
        return replace(
            own,
            frames=np.concatenate([frames, frame[chosen]]),
            centres=np.concatenate([centres, centre[chosen]]),
            seats=np.concatenate([seats, flat @ frame[chosen, :2] + centre[chosen, None]]),
        )


def _inscribed(pads: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return the centre and radius of the largest circle in the convex hull of pads (P, 2)."""
    planes = ConvexHull(pads).equations
    sides = np.insert(planes[:, :2], 2, 1, axis=1)  # the length of their normals
    found: Any = linprog([0, 0, -1], sides, -planes[:, 2], bounds=(None, None))
    return np.asarray(found.x[:2]), float(found.x[2])


def _scaled(
    modules: Modules, shapes: Sequence[tuple[NDArray[np.intp], NDArray[np.float64]]], units: str
) -> NDArray[np.float64]:
    """Return the template, flat, in the unit of the layout."""
    template = modules.template
    exist = np.isfinite(template).all(axis=1)
    if template.shape[1] > 2 and np.ptp(template[exist, 2]) > 0:
        raise InputError("a layout is checked with flat modules, but the template is not flat")
    flat = template[:, :2]
    if units in METRES and modules.units in METRES:
        return np.asarray(flat * (METRES[modules.units] / METRES[units]))
    k = shapes[0][1].shape[1]
    fits = [fit_similarity(padded(flat[pads], k), at, reflection=None) for pads, at in shapes]
    return np.asarray(flat * float(np.median([fit.scale for fit in fits])))


def _common_shape(
    shapes: Sequence[tuple[NDArray[np.intp], NDArray[np.float64]]],
) -> NDArray[np.float64]:
    """Return the flat shape with the median distances between pads; NaN for unknown pads."""
    n_pads = 1 + max(int(pads.max()) for pads, _ in shapes)
    distances = np.full((len(shapes), n_pads, n_pads), np.nan)
    for distance, (pads, places) in zip(distances, shapes, strict=True):
        distance[np.ix_(pads, pads)] = cdist(places, places)
    exist = np.isfinite(distances).any(axis=(0, 1))
    median = np.nanmedian(distances[:, exist][:, :, exist], axis=0)
    while np.isnan(median).any():  # pads that never occur on the same module
        worst = int(np.isnan(median).sum(axis=1).argmax())
        exist[np.flatnonzero(exist)[worst]] = False
        median = np.delete(np.delete(median, worst, 0), worst, 1)
    # Classical scaling, Torgerson (1952), Psychometrika 17(4): 401-419.
    centring = np.eye(len(median)) - 1 / len(median)
    values, vectors = np.linalg.eigh(-centring @ median**2 @ centring / 2)
    template = np.full((n_pads, 2), np.nan)
    template[exist] = vectors[:, -2:] * np.sqrt(np.maximum(values[-2:], 0))
    return template


def _fit_either_way(
    template: NDArray[np.float64],
    pads: NDArray[np.intp],
    back: NDArray[np.intp],
    places: NDArray[np.float64],
    pitch: float,
) -> tuple[tuple[NDArray[np.float64], NDArray[np.float64], float], NDArray[np.intp]]:
    """Fit a module with its pads in order, or in reverse order if this fits clearly better.

    back (P,): For each pad, the pad in its place in reverse order.
    """
    ways, fits, misfits = (pads, back[pads]), [], []
    for way in ways:
        fits.append(_fit(template[way], places))
        off = np.linalg.norm(template[way] @ fits[-1][0][:2] + fits[-1][1] - places, axis=1)
        misfits.append(float(np.minimum(off, pitch).mean()))
    reverse = len(pads) > MIN_PADS + 1 and misfits[1] < _CLEARLY * misfits[0]
    return fits[reverse], ways[reverse]


def _fit(
    pads: NDArray[np.float64], places: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Fit a module, (m, 2), to places, (m, k): axes, origin, and root mean square distance.

    Displaced pads are ignored: their distances to most pads differ from those on the module.
    """
    source, between = padded(pads, places.shape[1]), cdist(pads, pads)
    size = float(between.max())
    change = np.abs(between - cdist(places, places))
    agree = np.count_nonzero(change < _SAME_LENGTH * size, axis=1)
    exact = change <= _EXACT * size
    exact = np.unique(exact[2 * exact.sum(axis=1) > len(pads)], axis=0)
    fits = []
    for kept in [agree >= _AGREEING * agree.max(), *exact]:
        near = kept
        for _ in range(2):
            found = fit_similarity(source[near], places[near], scaling=False, reflection=None)
            off = np.linalg.norm(found.apply(source) - places, axis=1)
            rms = float(np.sqrt(np.mean(off[near] ** 2)))
            near = off <= max(_SAME_PLACE * size, float(np.median(off)))
        fits.append((np.count_nonzero(off <= _EXACT * size), found, rms))
    count, found, rms = max(fits, key=lambda fit: fit[0])
    if 2 * count <= len(pads):  # bent
        _, found, rms = fits[0]
    return found.rotation.T, found.translation, rms


def orientation(pads: NDArray[np.float64], places: NDArray[np.float64]) -> tuple[float, bool]:
    """Return the angle of a flat module in degrees, and whether it is mirrored; NaN in space.

    pads (m, 2), places (m, k).
    """
    frame = _fit(pads, places)[0]
    if len(frame) > 2:
        return math.nan, False
    degrees = math.degrees(math.atan2(-frame[1, 0], frame[1, 1]))
    return degrees, bool(np.linalg.det(frame) < 0)
