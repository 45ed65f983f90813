"""Rigid modules of a skin, such as the triangles of the iCub: which sensors share one, and where.

All modules of a skin are alike: a template gives the positions of the pads in the frame of a
module. A template need not be known, to compare modules or to exchange them.
"""

from __future__ import annotations

import string
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.placement.scale import METRES
from anisomap.sensor_map import SensorMap
from anisomap.wording import noun_and_items

NO_MODULE = -1
"""Index of the module, or of the pad, of a sensor without one."""

_MAX_DIGITS = 9  # longer numbers are serial numbers, not positions on a cable


def _no_template() -> NDArray[np.float64]:
    return np.empty((0, 2))


@dataclass(frozen=True, eq=False)
class Modules:
    """The modules of N sensors.

    Parameters
    ----------
    index : array_like of int, shape (N,)
        Module of each sensor, from 0; -1 for a sensor on no module.
    pads : array_like of int, shape (N,)
        Place of each sensor on its module, from 0, unique on the module; -1 on no module.
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
    template: NDArray[np.float64] = field(default_factory=_no_template)
    units: str = ""

    def __post_init__(self) -> None:
        index, pads = (np.array(a, dtype=np.intp) for a in (self.index, self.pads))
        template = np.array(self.template, dtype=np.float64)
        if index.ndim != 1 or index.shape != pads.shape:
            raise InputError(
                f"modules and pads must have one entry per sensor, got {index.shape} and "
                f"{pads.shape}"
            )
        if ((index == NO_MODULE) != (pads == NO_MODULE)).any():
            raise InputError("sensors must have a pad if and only if they have a module")
        if min(index.min(initial=0), pads.min(initial=0)) < NO_MODULE or (
            index.max(initial=NO_MODULE) >= len(self.labels)
        ):
            raise InputError(f"modules must be numbered from 0 to {len(self.labels) - 1}, or -1")
        if template.ndim != 2 or template.shape[1] not in (2, 3):
            raise InputError(f"a template must have shape (P, 2) or (P, 3), got {template.shape}")
        _check_pads(index, pads, tuple(self.labels), template)
        for array in (index, pads, template):
            array.setflags(write=False)
        for name, value in {
            "index": index,
            "pads": pads,
            "labels": tuple(self.labels),
            "template": template,
        }.items():
            object.__setattr__(self, name, value)

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
            ``P11``), these are the numbers of the pads; otherwise pads are numbered in order from
            0.

        Returns
        -------
        Modules

        Raises
        ------
        InputError
            If the template has no unit of length or not 2 or 3 dimensions, or lacks a pad.
        """
        if template.units not in METRES:
            raise InputError(
                "the template of the modules must have a unit of length, such as a header "
                f"name,x [mm],y [mm], but its unit is {template.units or 'unknown'}"
            )
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


def _check_pads(
    index: NDArray[np.intp],
    pads: NDArray[np.intp],
    labels: tuple[str, ...],
    template: NDArray[np.float64],
) -> None:
    """Check that no two sensors share a pad, and that the template has all pads, if known."""
    taken = Counter(zip(index.tolist(), pads.tolist(), strict=True))
    for (module, pad), count in taken.items():
        if module != NO_MODULE and count > 1:
            raise InputError(f"{count} sensors share pad {pad} of module {labels[module]}")
    exists = set(np.flatnonzero(np.isfinite(template).all(axis=1)).tolist())
    for module, pad in taken:
        if len(template) and module != NO_MODULE and pad not in exists:
            raise InputError(
                f"a sensor is pad {pad} of module {labels[module]}, but the template has no such "
                f"pad (it has {len(exists)})"
            )


def modules_by_size(names: Sequence[str], size: int, first: int | None = None) -> Modules:
    """Divide sensors into modules by the numbers at the end of their names.

    Sensor number n is pad ``(n - first) % size`` of module ``(n - first) // size``. Sensors
    without a number are on no module.

    Parameters
    ----------
    names : sequence of str
        Such as ``taxel2749``.
    size : int
        Numbers per module, including those of pads that do not exist: 12 for the triangles of the
        iCub, of which 10 are tactile sensors.
    first : int, optional
        Number of the first pad of some module. By default 0 or 1, whichever divides the sensors
        into fewer modules.

    Returns
    -------
    Modules
        Without a template; each label is the range of numbers of the module.

    Raises
    ------
    InputError
        If `size` is less than 2, no name ends in a number, two names end in the same number, or
        0 and 1 divide the sensors into equally many modules.
    """
    if size < 2:
        raise InputError(f"modules must have at least 2 pads, got {size}")
    found = trailing_numbers(names)
    numbers = np.array([-1 if number is None else number for number in found], dtype=np.intp)
    numbered = numbers >= 0
    if not numbered.any():
        raise InputError(
            "modules are found by the numbers at the end of names, and no name has one"
        )
    repeated = [n for n, count in Counter(numbers[numbered].tolist()).items() if count > 1]
    if repeated:
        raise InputError(
            "modules are found by the numbers at the end of names, but several sensors have the "
            f"{noun_and_items('number', repeated)}"
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
        Module of a sensor, and its pad. If no pad is given, the sensors of each module are its
        pads 0, 1, ... in the order of `assigned`. Sensors that are not among `names` are left out.

    Returns
    -------
    Modules
        Without a template, in the order of `assigned`.

    Raises
    ------
    InputError
        If none of the sensors are among `names`, some have a pad and others none, or two share a
        pad.
    """
    if not set(names) & set(assigned):
        raise InputError(
            "no sensor of the list of modules is among the sensors of the map; use the same names"
        )
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


def trailing_numbers(names: Sequence[str]) -> tuple[int | None, ...]:
    """Return the number at the end of each name, or None: 97 of ``taxel97``."""
    ends = [name[len(name.rstrip(string.digits)) :] for name in names]
    return tuple(int(end) if 0 < len(end) <= _MAX_DIGITS else None for end in ends)
