"""Modules of a layout: their shape, the places where they are, and their orientations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from anisomap.errors import InputError
from anisomap.layout.repeats import blocks_of_size, rigid_repeats
from anisomap.numerics.neighbours import nearest_distances, padded
from anisomap.numerics.procrustes import fit_similarity
from anisomap.placement.frames import METRES
from anisomap.placement.modules import MIN_PADS, NO_MODULE, Modules, channel_numbers
from anisomap.sensor_map import SensorMap

_MIN_SIZE = 3
_MAX_GAPS = 100  # channels per sensor
_MAX_FOLD = 8  # largest order of a rotation that is tried
_SAME = 0.3  # of the spacing of pads; errors of places that count as equal; chosen by hand
_MIN_MAPPED = 0.8  # of the pads that a turned module has in common; thermal pads are others
_MAX_MISFIT = 0.5  # of the spacing of pads: modules of another shape than the found one
_OUTLYING = 0.3  # share of the pads of a module that may be misplaced one by one
_MAX_PULL = 1.5  # spacings by which bending displaces pads; pads beyond are on no module
_NEXT = 1.5  # of the median distance of the nearest modules: modules beside each other
_FREE = 0.6  # of the spacing between pads of a free place and others
_MAX_TAKEN = 0.1  # share of the pads of a free place that may be nearer to others


def find_modules(layout: SensorMap, modules: Modules | int | None = None) -> Modules:
    """Divide the sensors of a layout into modules.

    Parameters
    ----------
    layout : SensorMap
    modules : Modules or int, optional
        Modules of the sensors of the layout, or the number of channels of each module, those
        without a sensor included. By default, they are found: blocks of consecutive channels
        whose shapes repeat.

    Returns
    -------
    Modules
        Without a template, unless one was given. There are no modules if no shapes repeat.

    Raises
    ------
    InputError
        If the modules are of other sensors, or the size is not 3 to half the number of sensors.

    Notes
    -----
    Channels are the numbers at the end of the names (``taxel97``) if these are different, else the
    order of the sensors. The first channel of a module is chosen such that the shapes of most
    modules are the same, and that there are as few as possible.
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
    elif _MIN_SIZE <= modules <= max(_MIN_SIZE, len(placed) // 2):
        size, (first, _) = modules, blocks_of_size(positions, numbers, modules)
    else:
        raise InputError(
            f"the size of modules must be {_MIN_SIZE} to half the number of sensors "
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


@dataclass(frozen=True, eq=False)
class Orientation:
    """A rotation or reflection after which most pads of a module are where pads were before.

    angle: Of a rotation, in degrees, in (-180, 180]; 0 for a reflection.
    places (P, 2): Where the pads are then, in the frame of the module.
    """

    reflected: bool
    angle: float
    places: NDArray[np.float64]


def orientations(template: NDArray[np.float64]) -> tuple[Orientation, ...]:
    """Find the orientations in which a module fits its own place, the stated one first.

    template (P, 2): Positions of the pads; NaN for pads that do not exist.
    """
    exist = np.flatnonzero(np.isfinite(template).all(axis=1))
    pads = template[exist]
    found = [Orientation(reflected=False, angle=0.0, places=template)]
    if len(pads) < MIN_PADS:
        return tuple(found)
    allowed = _SAME * float(np.median(nearest_distances(pads)))
    known = {tuple(range(len(pads)))}
    for angle, reflected in _candidates(pads - pads.mean(axis=0), allowed):
        target = _mapped(_turned(pads, angle, reflected=reflected), pads, allowed)
        kept = target >= 0
        if np.mean(kept) < _MIN_MAPPED:
            continue
        # Without the pads that map onto none, which pull the centre.
        fit = fit_similarity(pads[kept], pads[target[kept]], scaling=False, reflection=reflected)
        image = fit.apply(pads)
        target = _mapped(image, pads, allowed)
        kept = target >= 0
        if tuple(target.tolist()) in known or np.mean(kept) < _MIN_MAPPED:
            continue
        known.add(tuple(target.tolist()))
        places = np.full_like(template, np.nan)
        places[exist] = np.where(kept[:, None], pads[target], image)
        turn = 0.0 if reflected else math.degrees(math.atan2(*fit.rotation[::-1, 0]))
        found.append(Orientation(reflected, turn, places))
    return tuple(found)


def _candidates(centred: NDArray[np.float64], allowed: float) -> list[tuple[float, bool]]:
    angles = {2 * math.pi * k / n for n in range(2, _MAX_FOLD + 1) for k in range(1, n)}
    radius, direction = np.linalg.norm(centred, axis=1), np.arctan2(*centred.T[::-1])
    # A reflection maps an outermost pad to one that is as far out.
    mirrors = [
        float(direction[outer] + direction[i])
        for outer in np.argsort(-radius)[: len(radius) // 2 + 1]
        for i in np.flatnonzero(np.abs(radius - radius[outer]) <= 2 * allowed)
    ]
    return [(angle, False) for angle in sorted(angles)] + [(angle, True) for angle in mirrors]


def _turned(points: NDArray[np.float64], angle: float, *, reflected: bool) -> NDArray[np.float64]:
    cos, sin, side = math.cos(angle), math.sin(angle), -1 if reflected else 1
    centre = points.mean(axis=0)
    return np.asarray((points - centre) @ [[cos, sin], [-side * sin, side * cos]] + centre)


def _mapped(
    image: NDArray[np.float64], points: NDArray[np.float64], allowed: float
) -> NDArray[np.intp]:
    """Return the point that each image falls on, -1 if on none."""
    distances = cdist(image, points)
    order = linear_sum_assignment(np.minimum(distances, 2 * allowed) ** 2)[1]
    return np.where(distances[np.arange(len(points)), order] <= allowed, order, -1)


@dataclass(frozen=True, eq=False)
class Mounting:
    """Where modules are, each fitted to its stated place, and where they could be.

    members: Sensors of each module, by pad.
    pads: Their pads.
    orientations: In which a module fits its place; the first is the stated one.
    frames (S, k, k), centres (S, k): Of each slot, a place of a module. The first slots are those
        of the modules, in order; others are free. Rows of a frame are the axes of a module.
    rms: Root mean square distance of each module from its stated places.
    pitch: Spacing of the pads.
    """

    members: tuple[NDArray[np.intp], ...]
    pads: tuple[NDArray[np.intp], ...]
    orientations: tuple[Orientation, ...]
    frames: NDArray[np.float64]
    centres: NDArray[np.float64]
    rms: NDArray[np.float64]
    pitch: float

    @classmethod
    def of(cls, modules: Modules, positions: NDArray[np.float64], units: str) -> Mounting:
        """Fit modules to positions (n, k), by their template, or one that they have in common."""
        k = positions.shape[1]
        members = [modules.members(m) for m in range(modules.n_modules)]
        members = [inside for inside in members if len(inside) >= MIN_PADS]
        known = bool(len(modules.template))
        if not members:
            return cls((), (), (), np.empty((0, k, k)), np.empty((0, k)), np.empty(0), 0.0)
        shapes = [(modules.pads[inside], positions[inside]) for inside in members]
        template = _scaled(modules, shapes, units) if known else _common_shape(shapes)
        exist = np.asarray(np.isfinite(template).all(axis=1))
        used = np.unique(np.concatenate([modules.pads[inside] for inside in members]))
        pitch = float(np.median(nearest_distances(template[used[exist[used]]])))
        members = [inside[exist[modules.pads[inside]]] for inside in members]
        fits = [
            _fit(template[modules.pads[inside]], positions[inside], pitch) for inside in members
        ]
        rms = np.array([fit[2] for fit in fits])
        fitted = np.ones(len(members), bool) if known else rms <= _MAX_MISFIT * pitch
        kept = []
        for inside, (frame, centre, _) in zip(members, fits, strict=True):
            # Pads that are elsewhere say nothing about the orientation of the others.
            there = template[modules.pads[inside]] @ frame[:2] + centre
            pull = np.linalg.norm(there - positions[inside], axis=1)
            kept.append(inside[pull <= _MAX_PULL * pitch])
        fitted &= np.array([len(inside) >= MIN_PADS for inside in kept])
        kept = [inside for inside, fits_well in zip(kept, fitted, strict=True) if fits_well]
        part = np.full_like(template, np.nan)
        part[used] = template[used]
        return cls(
            tuple(kept),
            tuple(modules.pads[inside] for inside in kept),
            orientations(part),
            np.array([fit[0] for fit in fits])[fitted],
            np.array([fit[1] for fit in fits])[fitted],
            rms[fitted],
            pitch,
        )

    @property
    def n_modules(self) -> int:
        """Number of modules."""
        return len(self.members)

    @cached_property
    def middles(self) -> NDArray[np.float64]:
        """Middle of the pads in each slot, (S, k)."""
        middle = np.nanmean(self.orientations[0].places, axis=0)
        return np.asarray(middle @ self.frames[:, :2] + self.centres)

    @cached_property
    def adjacent(self) -> NDArray[np.bool_]:
        """Pairs of modules that are beside each other, (M, M)."""
        middles = self.middles[: self.n_modules]
        between = cdist(middles, middles)
        np.fill_diagonal(between, np.inf)
        return np.asarray(between <= _NEXT * np.median(between.min(axis=1, initial=np.inf)))

    def places(self, module: int, slot: int, orientation: int) -> NDArray[np.float64]:
        """Return where the sensors of a module are in a slot, (m, k)."""
        pads = self.orientations[orientation].places[self.pads[module]]
        return np.asarray(pads @ self.frames[slot, :2] + self.centres[slot])

    def fitted(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions (n, k) with each module unbent."""
        found = positions.copy()
        for m, inside in enumerate(self.members):
            found[inside] = self.places(m, m, 0)
        return found

    def moved(self, modules: Sequence[int], positions: NDArray[np.float64]) -> Mounting:
        """Return the same with some modules at other positions (n, k), and new free places."""
        frames, centres = self.frames.copy(), self.centres.copy()
        for m in modules:
            pads = self.orientations[0].places[self.pads[m]]
            frames[m], centres[m], _ = _fit(pads, positions[self.members[m]], self.pitch)
        return replace(self, frames=frames, centres=centres).with_free_slots(positions)

    def with_free_slots(self, positions: NDArray[np.float64]) -> Mounting:
        """Return the same with the free places beside modules, as others are beside others."""
        if self.n_modules < 2:
            return self
        centres, frames = self.centres[: self.n_modules], self.frames[: self.n_modules]
        middle = np.nanmean(self.orientations[0].places, axis=0)
        first, second = np.nonzero(self.adjacent)
        inverse = frames[first].transpose(0, 2, 1)
        steps = np.einsum("ek,ekl->el", centres[second] - centres[first], inverse)
        turns = frames[second] @ inverse
        pads = self.orientations[0].places[np.isfinite(self.orientations[0].places).all(axis=1)]
        # Equal places that bending makes unequal are one.
        rounded = np.round(np.hstack([steps / self.pitch, turns.reshape(len(turns), -1)]))
        kinds = np.unique(rounded, axis=0, return_index=True)[1]
        taken = KDTree(positions)
        free_frames: list[NDArray[np.float64]] = []
        free_centres: list[NDArray[np.float64]] = []
        for kind in kinds.tolist():
            for slot in range(self.n_modules):
                frame = turns[kind] @ frames[slot]
                centre = centres[slot] + steps[kind] @ frames[slot]
                places = pads @ frame[:2] + centre
                if np.mean(taken.query(places)[0] < _FREE * self.pitch) > _MAX_TAKEN:
                    continue
                known = [middle @ f[:2] + c for f, c in zip(free_frames, free_centres, strict=True)]
                here = middle @ frame[:2] + centre
                if known and np.linalg.norm(known - here, axis=1).min() < self.pitch:
                    continue
                free_frames.append(frame)
                free_centres.append(centre)
        return replace(
            self,
            frames=np.concatenate([frames, *(frame[None] for frame in free_frames)]),
            centres=np.vstack([centres, *free_centres]),
        )


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
    scales = []
    for pads, places in shapes:
        k = places.shape[1]
        scales.append(fit_similarity(padded(flat[pads], k), places, reflection=None).scale)
    return np.asarray(flat * float(np.median(scales)))


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
    while np.isnan(median).any():  # pads that are on no module together
        worst = int(np.isnan(median).sum(axis=1).argmax())
        exist[np.flatnonzero(exist)[worst]] = False
        median = np.delete(np.delete(median, worst, 0), worst, 1)
    # Classical scaling, Torgerson (1952), Psychometrika 17(4): 401-419.
    centring = np.eye(len(median)) - 1 / len(median)
    values, vectors = np.linalg.eigh(-centring @ median**2 @ centring / 2)
    template = np.full((n_pads, 2), np.nan)
    template[exist] = vectors[:, -2:] * np.sqrt(np.maximum(values[-2:], 0))
    return template


def _fit(
    pads: NDArray[np.float64], places: NDArray[np.float64], pitch: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Fit a module, (m, 2), to places, (m, k): axes, origin, and root mean square distance.

    A few pads that are at other places do not count.
    """
    k = places.shape[1]
    source = padded(pads, k)

    def fit(kept: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        found = fit_similarity(source[kept], places[kept], scaling=False, reflection=None)
        off = np.linalg.norm(found.apply(source) - places, axis=1)
        return found.rotation.T, found.translation, float(np.sqrt(np.mean(off[kept] ** 2)))

    kept = np.arange(len(places))
    best = every = fit(kept)
    for _ in range(int(_OUTLYING * len(places))):
        if len(kept) <= MIN_PADS + 1:
            break
        off = np.linalg.norm(source @ best[0] + best[1] - places, axis=1)[kept]
        kept = np.delete(kept, int(off.argmax()))
        best = fit(kept)
    # Bent modules have no pad that stands out.
    return best if best[2] < _SAME * pitch < every[2] else every
