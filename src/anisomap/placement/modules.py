"""Rigid modules of a skin, such as the triangles of the iCub, and fits of modules to maps.

All modules of a skin are equal: a template gives the positions of the pads in the frame of a
module. The template may be unknown if modules are only compared or exchanged.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import coo_array
from scipy.spatial import KDTree

from anisomap.base import METRES
from anisomap.base.channels import channel_numbers, trailing_numbers
from anisomap.base.immutable import Immutable
from anisomap.base.wording import join_items
from anisomap.errors import InputError
from anisomap.numerics.neighbours import nearest_distances, padded
from anisomap.numerics.procrustes import extent, fit_similarity, rotations, similarity_freedom
from anisomap.numerics.surfaces import Points
from anisomap.placement.frames import mirrored
from anisomap.sensor_map import UNPLACED, SensorMap

NO_MODULE = -1
"""Index of the module, or of the pad, of a sensor without one."""


@dataclass(frozen=True, eq=False)
class Modules(Immutable):
    """The modules of N sensors.

    Parameters
    ----------
    index : array_like of int, shape (N,)
        Module of each sensor, from 0; -1 for a sensor without a module.
    pads : array_like of int, shape (N,)
        Pad of each sensor on its module, from 0, unique on the module; -1 without a module.
    labels : sequence of str
        Name of each module.
    template : array_like of shape (P, 2) or (P, 3), optional
        Positions of the pads in the frame of a module; NaN for pads that do not exist. Empty if
        unknown.
    units : str
        Unit of `template`.

    Raises
    ------
    InputError
        If shapes disagree, two sensors share a pad, or a pad is not on the template.
    """

    index: NDArray[np.intp]
    pads: NDArray[np.intp]
    labels: tuple[str, ...]
    template: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    units: str = ""

    def __post_init__(self) -> None:
        index, pads = (np.array(a, dtype=np.intp) for a in (self.index, self.pads))
        template = np.array(self.template, dtype=np.float64)
        if index.ndim != 1 or index.shape != pads.shape:
            raise InputError(f"modules and pads differ in length: {index.shape}, {pads.shape}")
        if ((index == NO_MODULE) != (pads == NO_MODULE)).any():
            raise InputError("sensors must have a pad if and only if they have a module")
        if min(index.min(initial=0), pads.min(initial=0)) < NO_MODULE or (
            index.max(initial=NO_MODULE) >= len(self.labels)
        ):
            raise InputError(f"modules must be numbered from 0 to {len(self.labels) - 1}, or -1")
        if template.ndim != 2 or template.shape[1] not in (2, 3):
            raise InputError(f"a template must have shape (P, 2) or (P, 3), got {template.shape}")
        self.set_fields(labels=tuple(self.labels), index=index, pads=pads, template=template)
        self._check_pads()

    def _check_pads(self) -> None:
        """Check that no two sensors share a pad, and that a known template has all pads."""
        taken = Counter(zip(self.index.tolist(), self.pads.tolist(), strict=True))
        exists = set(np.flatnonzero(np.isfinite(self.template).all(axis=1)).tolist())
        for (module, pad), count in taken.items():
            if module != NO_MODULE and count > 1:
                label = self.labels[module]
                raise InputError(f"{count} sensors share pad {pad} of module {label}")
            if module != NO_MODULE and len(self.template) and pad not in exists:
                raise InputError(
                    f"a sensor is pad {pad} of module {self.labels[module]}, but the template has "
                    f"no such pad (it has {len(exists)})"
                )

    @property
    def n_modules(self) -> int:
        """Number of modules."""
        return len(self.labels)

    @property
    def offsets(self) -> NDArray[np.float64]:
        """Position of each sensor in the frame of its module, shape (N, k); NaN if unknown."""
        found = np.full((len(self.index), self.template.shape[1]), np.nan)
        if len(self.template):
            on_module = self.index != NO_MODULE
            found[on_module] = self.template[self.pads[on_module]]
        return found

    def members(self, module: int) -> NDArray[np.intp]:
        """Return the indices of the sensors of a module, by pad."""
        found = np.flatnonzero(self.index == module)
        return found[np.argsort(self.pads[found])]

    def with_template(self, template: SensorMap) -> Modules:
        """Add the positions of the pads.

        Parameters
        ----------
        template : SensorMap
            One row per pad, in a unit of `METRES`. If all names end in different numbers (``P0``,
            ``P11``), these numbers are the pads; otherwise, pads are numbered in order from 0.

        Returns
        -------
        Modules

        Raises
        ------
        InputError
            If the template has no unit of length, does not have 2 or 3 dimensions, or lacks a pad.
        """
        if template.units not in METRES:
            raise InputError(f"the template needs a unit (x [mm]), got {template.units or 'none'}")
        numbers = trailing_numbers(template.names)
        if None in numbers or len(set(numbers)) < len(numbers):
            numbers = tuple(range(template.n_sensors))
        rows = np.array(numbers, dtype=np.intp)
        positions = np.full((int(rows.max()) + 1, template.dimensions), np.nan)
        positions[rows] = template.positions
        return replace(self, template=positions, units=template.units)

    def select(self, sensors: NDArray[np.intp]) -> Modules:
        """Return the modules of some sensors, in that order; modules keep their numbers."""
        return replace(self, index=self.index[sensors], pads=self.pads[sensors])


def modules_by_size(names: Sequence[str], size: int, first: int | None = None) -> Modules:
    """Divide sensors into modules by the numbers at the end of their names.

    Sensor number n is pad ``(n - first) % size`` of module ``(n - first) // size``. Sensors
    without a number have no module.

    Parameters
    ----------
    names : sequence of str
        Names such as ``taxel2749``.
    size : int
        Numbers per module, including numbers without a tactile sensor: 12 for the triangles of the
        iCub, which have 10 tactile sensors.
    first : int, optional
        Number of the first pad of some module. By default 0 or 1, whichever divides the sensors
        into fewer modules.

    Returns
    -------
    Modules
        Modules without a template; each label is the range of numbers of the module.

    Raises
    ------
    InputError
        If `size` is less than 2, no name ends in a number, two names end in the same number, or
        first numbers 0 and 1 result in equally many modules.
    """
    if size < 2:
        raise InputError(f"modules must have at least 2 pads, got {size}")
    found = channel_numbers(names)
    numbers = np.array([-1 if number is None else number for number in found], dtype=np.intp)
    numbered = numbers >= 0
    if not numbered.any():
        raise InputError("modules are found by numbers at the end of names, and no name has one")
    repeated = [n for n, count in Counter(numbers[numbered].tolist()).items() if count > 1]
    if repeated:
        raise InputError(
            "modules are found by the numbers at the end of names; repeated numbers: "
            f"{join_items(repeated, 5)}"
        )
    if first is None:
        counts = [len(np.unique((numbers[numbered] - start) // size)) for start in (0, 1)]
        if counts[0] == counts[1]:
            raise InputError(
                f"modules of {size} pads may start at number 0 or 1 ({counts[0]} modules each); "
                "give the number of the first pad of one module"
            )
        first = int(np.argmin(counts))
    block, pads = np.divmod(numbers - first, size)
    blocks, index = np.unique(block[numbered], return_inverse=True)
    full = np.full(len(numbers), NO_MODULE)
    full[numbered] = index
    starts = (blocks * size + first).tolist()
    return Modules(
        index=full,
        pads=np.where(numbered, pads, NO_MODULE),
        labels=tuple(f"{max(start, 0)}-{start + size - 1}" for start in starts),
    )


def modules_by_name(
    names: Sequence[str], assigned: Mapping[str, tuple[str, int | None]]
) -> Modules:
    """Assign sensors to modules one by one.

    Parameters
    ----------
    names : sequence of str
        Names of the sensors.
    assigned : mapping of str to (str, int or None)
        Module and pad of each sensor. If no pads are given, the sensors of each module are pads
        0, 1, ... in the order of `assigned`. Sensors that are not among `names` are left out.

    Returns
    -------
    Modules
        Modules without a template, in the order of `assigned`.

    Raises
    ------
    InputError
        If no sensor is among `names`, only some sensors have a pad, or two sensors share a pad.
    """
    if not set(names) & set(assigned):
        raise InputError("no sensor of the list of modules is on the map; use the same names")
    given = {pad is not None for _, pad in assigned.values()}
    if len(given) > 1:
        raise InputError("the list of modules must give a pad for all sensors, or for none")
    labels = tuple(dict.fromkeys(label for label, _ in assigned.values()))
    number = {label: i for i, label in enumerate(labels)}
    counted: Counter[str] = Counter()
    places = {}
    for name, (label, pad) in assigned.items():
        places[name] = (number[label], counted[label] if pad is None else pad)
        counted[label] += 1
    found = np.array([places.get(name, (NO_MODULE, NO_MODULE)) for name in names], dtype=np.intp)
    return Modules(index=found[:, 0], pads=found[:, 1], labels=labels)


# Tuned on the iCub hexagon, its halves, and rubbed simulated hexagons, seeds 201 to 203.
_REACH = 4.0  # pitches between sensors whose distance on the map is used
_MIN_NOISE = 1e-3  # pitches; keeps weights finite on exact maps
_MAX_STRETCH = 2.0  # of a module on the map, relative to the median over modules

MIN_PADS = 3
"""Minimum number of placed pads that determine the pose of a module."""


class ModuleFit(NamedTuple):
    """A map of rigid modules.

    Attributes
    ----------
    map : SensorMap
        In the unit of the template, known up to rotation and translation. Unplaced sensors of the
        original map are placed with their module.
    evidence : float
        Log likelihood ratio of the handedness of the map against its mirror image; negative if the
        map was reflected, 0 if modules do not determine it.
    """

    map: SensorMap
    evidence: float


def fit_modules(sensor_map: SensorMap, modules: Modules) -> ModuleFit:
    """Fit the poses of rigid modules to a map of one component.

    Poses are fitted to the positions on the map, and to the distances on the map between nearby
    sensors of different modules. Distances are multiplied by the local scale, which follows from
    the modules. Positions have less weight the more the local scale varies beyond noise, since maps
    bend over long distances. Sensors without a module, or on a module with fewer than 3 placed
    pads, are fitted singly.

    Parameters
    ----------
    sensor_map : SensorMap
        In two or three dimensions, of one connected component.
    modules : Modules
        Of the same sensors, with a template.

    Returns
    -------
    ModuleFit

    Raises
    ------
    InputError
        If there is no template, it has more dimensions than the map, or fewer than 3 pads of every
        module are placed.
    """
    template = modules.template
    if not len(template):
        raise InputError("the positions of the pads on a module are needed to fit modules to a map")
    k = sensor_map.dimensions
    if k not in (2, 3) or len(sensor_map.component_sizes) != 1:
        raise InputError("modules are fitted to one component of a map of 2 or 3 dimensions")
    pads = template[np.isfinite(template).all(axis=1)]
    if template.shape[1] > k and np.ptp(pads[:, 2]) > 0:
        raise InputError("modules that are not flat need a map of three dimensions")
    offsets, placed = padded(modules.offsets[:, :k], k), sensor_map.placed
    counts = np.bincount(modules.index[placed] + 1, minlength=modules.n_modules + 1)[1:]
    fitted = np.flatnonzero(counts >= MIN_PADS)
    if not fitted.size:
        raise InputError(f"no module has {MIN_PADS} sensors with a position on the map")
    number = np.full(modules.n_modules + 1, NO_MODULE)  # the last is for sensors without a module
    number[fitted] = np.arange(len(fitted))
    body = number[modules.index]
    groups = [np.flatnonzero(placed & (body == b)) for b in range(len(fitted))]
    evidence = _handedness(sensor_map.positions, offsets, groups)
    chosen = mirrored(sensor_map) if evidence < 0 else sensor_map
    pitch = float(np.median(nearest_distances(pads)))
    alone = _fit_alone(chosen.positions, offsets, groups, pitch)
    positions = _refined(chosen, offsets, body, alone, pitch)
    component = np.where(np.isfinite(positions).all(axis=1), 0, UNPLACED)
    found = replace(chosen, positions=positions, component=component, units=modules.units)
    return ModuleFit(found, evidence)


def _handedness(positions: Points, offsets: Points, groups: list[NDArray[np.intp]]) -> float:
    """Return the log likelihood ratio of the map and its mirror image, by errors of modules.

    Each module is scaled separately. The variance is unknown, so errors follow Student's t.
    """
    squares = np.zeros(2)
    freedom = 0
    for members in groups:
        source, target = offsets[members], positions[members]
        size = float(np.mean((target - target.mean(axis=0)) ** 2))
        if not size > 0:
            continue
        for i, reflection in enumerate((False, True)):
            fit = fit_similarity(source, target, reflection=reflection)
            squares[i] += float(np.sum((fit.apply(source) - target) ** 2)) / size
        freedom += similarity_freedom(*target.shape)
    if not freedom or not squares.any():
        return 0.0
    same, mirror = np.maximum(squares, np.finfo(float).eps)
    return float(freedom / 2 * np.log(mirror / same))


class _Alone(NamedTuple):
    """Separate fits of each module to the map.

    log_scale: Median logarithm of the units of the template per unit of the map.
    distortion: Standard deviation of this logarithm beyond noise.
    shrunk (B,): Logarithm at each module, shrunk towards the median according to the noise.
    noise: Standard deviation of a coordinate on the map, in units of the template.
    """

    log_scale: float
    distortion: float
    shrunk: NDArray[np.float64]
    noise: float


def _fit_alone(
    positions: Points, offsets: Points, groups: list[NDArray[np.intp]], pitch: float
) -> _Alone:
    found, spreads = [], []
    squares, freedom = 0.0, 0
    tiny = float(np.finfo(float).tiny)
    for members in groups:
        # Noise of the map lowers this scale, but not the scale of the inverse fit, which was 1 to
        # 6 % too large on the maps used for tuning, since maps shrink short distances.
        fit = fit_similarity(positions[members], offsets[members], reflection=False)
        found.append(max(fit.scale, tiny))
        residual = fit.apply(positions[members]) - offsets[members]
        centred = offsets[members] - offsets[members].mean(axis=0)
        spreads.append(float(np.sum(centred**2)))
        squares += float(np.sum(residual**2))
        freedom += similarity_freedom(*residual.shape)
    noise = max(float(np.sqrt(squares / max(freedom, 1))), _MIN_NOISE * pitch)
    scales = np.log(np.array(found))
    uncertainty = noise / np.sqrt(np.maximum(spreads, tiny))
    typical = float(np.median(scales))
    observed = float(np.mean((scales - typical) ** 2))
    distortion = float(np.sqrt(max(0.0, observed - float(np.mean(uncertainty**2)))))
    weights = distortion**2 / np.maximum(distortion**2 + uncertainty**2, tiny)
    limit = np.log(_MAX_STRETCH)
    shrunk = typical + weights * np.clip(scales - typical, -limit, limit)
    return _Alone(typical, distortion, shrunk, noise)


def _refined(
    sensor_map: SensorMap, offsets: Points, body: NDArray[np.intp], alone: _Alone, pitch: float
) -> Points:
    """Return positions in units of the template."""
    positions, placed = sensor_map.positions, sensor_map.placed
    n_modules, k = len(alone.shrunk), positions.shape[1]
    groups = [np.flatnonzero(placed & (body == b)) for b in range(n_modules)]
    scaled = np.exp(alone.log_scale) * positions
    free = np.flatnonzero(placed & (body == NO_MODULE))
    bodies = body.copy()
    bodies[free] = n_modules + np.arange(len(free))
    arms = np.where((body == NO_MODULE)[:, None], 0.0, offsets)
    rotation = np.tile(np.eye(k), (n_modules + len(free), 1, 1))
    translation = np.vstack([np.zeros((n_modules, k)), scaled[free]])
    for b, members in enumerate(groups):
        rigid = fit_similarity(offsets[members], scaled[members], scaling=False, reflection=False)
        rotation[b], translation[b] = rigid.rotation, rigid.translation
    nearest = np.array(KDTree(translation[:n_modules]).query(translation)[1], dtype=np.intp)
    stretch = alone.shrunk[nearest]
    here = np.flatnonzero(placed)
    pairs = here[KDTree(scaled[here]).query_pairs(_REACH * pitch, output_type="ndarray")]
    pairs = pairs[bodies[pairs[:, 0]] != bodies[pairs[:, 1]]]
    apart = np.linalg.norm(positions[pairs[:, 0]] - positions[pairs[:, 1]], axis=1)
    lengths = apart * np.exp(stretch[bodies[pairs]].mean(axis=1))
    # Distortions of the scale accumulate from module to module like steps of a random walk.
    pads = max(len(members) for members in groups)
    step = float(np.sqrt(np.median([np.sum(np.var(scaled[m], axis=0)) for m in groups])))
    # All modules share this drift, so their positions are as accurate as that of one module.
    drift = n_modules * alone.distortion**2 * extent(scaled[here]) * step
    # Distances from a pad to all pads of a module share the error of this pad.
    pair_sigma = alone.noise * float(np.sqrt(2 * pads))
    target_sigma = float(np.sqrt(alone.noise**2 + pads * drift))
    n_bodies, width = len(translation), 3 if k == 2 else 6  # angles, then a shift
    known = np.flatnonzero(bodies >= 0)

    def points(steps: NDArray[np.float64]) -> Points:
        by_body = steps.reshape(n_bodies, width)
        frames = rotations(by_body[:, :-k]) @ rotation
        found = np.full_like(positions, np.nan)
        found[known] = np.einsum("nij,nj->ni", frames[bodies[known]], arms[known])
        found[known] += (translation + by_body[:, -k:])[bodies[known]]
        return found

    def misfits(steps: NDArray[np.float64]) -> NDArray[np.float64]:
        found = points(steps)
        between = np.linalg.norm(found[pairs[:, 0]] - found[pairs[:, 1]], axis=1)
        off = (found - scaled)[here] / target_sigma
        return np.concatenate([(between - lengths) / pair_sigma, off.ravel()])

    rows = np.concatenate(
        [np.tile(np.arange(len(pairs)), 2), len(pairs) + np.arange(k * here.size)]
    )
    moves = bodies[np.concatenate([*pairs.T, np.repeat(here, k)])]
    columns = moves[:, None] * width + np.arange(width)
    depends = coo_array(
        (np.ones(columns.size), (np.repeat(rows, width), columns.ravel())),
        shape=(rows[-1] + 1, n_bodies * width),
    )
    start = np.zeros(n_bodies * width)
    best: Any = least_squares(misfits, start, jac_sparsity=depends.tocsr(), x_scale="jac")
    return points(best.x)
