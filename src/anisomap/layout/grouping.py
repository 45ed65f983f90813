"""Modules of a layout: given, by numbers in names, or found as rigid repeats."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.numerics.layout.congruence import blocks_of_size, rigid_repeats
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
