"""Message types of tactile sensors: their readings, sensor names and positions.

A message is a tree of fields. Readings are addressed by a path, and each list of messages on the
path contributes a part of the sensor names. A new message type is usually one line in `KINDS`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.io.parsing.grids import grid_names, grid_positions

_LABELS = ("name", "sensor_pos", "cellId", "cell_id")
_CHANNELS = {"mono": 1, "rgb": 3, "bgr": 3, "rgba": 4, "bgra": 4}
_DEPTHS = {"U": "u", "S": "i", "F": "f"}
_WRAP = 1 << 16


@dataclass(frozen=True)
class Kind:
    """How to extract the readings of a message type.

    Parameters
    ----------
    field : str
        Default path of the readings, such as ``"sensors.taxels.z"``.
    values : callable
        ``values(message, path)`` returns the readings.
    names : callable
        ``names(message, path)`` returns the sensor names.
    positions : callable, optional
        ``positions(message)`` returns positions in metres, or None.
    wraps : bool
        Whether readings are 16-bit counters that overflow.
    cell : bool
        Whether each message holds one skin cell only.
    """

    field: str
    values: Callable[[Any, str], NDArray[Any]]
    names: Callable[[Any, str], tuple[str, ...]]
    positions: Callable[[Any], NDArray[np.float64] | None] | None = None
    wraps: bool = False
    cell: bool = False


def values_at(message: Any, path: str) -> NDArray[Any]:
    """Return all numbers at a path, in order."""
    parts = [np.atleast_1d(np.asarray(value)).ravel() for _, value in _walk(message, path)]
    return np.concatenate(parts) if parts else np.empty(0)


def names_at(message: Any, path: str) -> tuple[str, ...]:
    """Name the numbers at a path by the list items that hold them; empty without unique names."""
    names = []
    for label, value in _walk(message, path):
        size = np.size(value)
        if np.ndim(value):
            names += [f"{label}.{i}" if label else str(i) for i in range(size)]
        else:
            names.append(label)
    labelled = any("." in name for name in names) or all(names)
    return tuple(names) if labelled and len(set(names)) == len(names) else ()


def unwrap_counters(values: NDArray[Any], first: NDArray[Any]) -> NDArray[np.float64]:
    """Return 16-bit counters, signed or not, as differences from the first, without overflow."""
    steps = values.astype(np.int64) - first.astype(np.int64)
    return np.asarray((steps + _WRAP // 2) % _WRAP - _WRAP // 2, dtype=np.float64)


def cell_of(message: Any) -> str:
    """Return the skin cell of a message."""
    return next(str(getattr(message, name)) for name in _LABELS[2:] if hasattr(message, name))


def kind_of(message_type: str, fields: list[str]) -> Kind | None:
    """Return how to read a message type.

    Parameters
    ----------
    message_type : str
        Such as ``"package/msg/Name"``.
    fields : list of str
        Paths of all its arrays of numbers.

    Returns
    -------
    Kind or None
        None if the type is unknown and has no array of numbers.
    """
    package, _, name = message_type.partition("/msg/")
    known = KINDS.get(f"{package}/{name}") or KINDS.get(name)
    if known or not fields:
        return known
    only = fields[0] if len(fields) == 1 else ""
    return Kind("data" if "data" in fields and "Array" in name else only, values_at, names_at)


def is_tactile(message_type: str) -> bool:
    """Return whether a message type is intended for arrays of sensors."""
    package, _, name = message_type.partition("/msg/")
    return f"{package}/{name}" in KINDS or name in KINDS or name.endswith("MultiArray")


def _walk(value: Any, path: str, label: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, list | tuple):
        for index, item in enumerate(value):
            own = next((getattr(item, name) for name in _LABELS if hasattr(item, name)), index)
            yield from _walk(item, path, f"{label}.{own}" if label else str(own))
    elif path:
        field, _, rest = path.partition(".")
        yield from _walk(getattr(value, field), rest, label)
    else:
        yield label, value


def _pixels(message: Any, _: str) -> NDArray[Any]:
    """Return the pixels of an image in row-major order; colour channels are averaged."""
    height, width, encoding = message.height, message.width, message.encoding
    kind, channels = _encoding(encoding)
    if message.is_bigendian:
        kind = kind.newbyteorder(">")
    used = width * channels * kind.itemsize
    if message.step < used or len(message.data) < height * message.step:
        raise ValueError(f"the image of {height} x {width} pixels ({encoding}) is truncated")
    rows = np.asarray(message.data)[: height * message.step].reshape(height, message.step)
    pixels = np.ascontiguousarray(rows[:, :used]).view(kind).reshape(height * width, channels)
    return pixels[:, 0] if channels == 1 else pixels[:, :3].mean(axis=1)


def _encoding(encoding: str) -> tuple[np.dtype[Any], int]:
    """Parse an encoding such as mono8, bgr8, 16UC1 or 32FC3 into dtype and channels."""
    colours = encoding.rstrip("0123456789")
    if colours in _CHANNELS:
        return np.dtype(f"u{int(encoding[len(colours) :] or 8) // 8}"), _CHANNELS[colours]
    bits, _, channels = encoding.partition("C")
    if bits[-1:] not in _DEPTHS or not bits[:-1].isdecimal() or not (channels or "1").isdecimal():
        raise ValueError(f"unsupported image encoding {encoding!r}; use mono, rgb, bgr or 32FC1")
    return np.dtype(f"{_DEPTHS[bits[-1]]}{int(bits[:-1]) // 8}"), int(channels or 1)


def _pixel_names(message: Any, _: str) -> tuple[str, ...]:
    return grid_names(message.height, message.width)


def _pixel_positions(message: Any) -> NDArray[np.float64]:
    return grid_positions(message.height, message.width)


def _lengths(message: Any, path: str) -> NDArray[np.float64]:
    """Return the lengths of vectors that are stored as ``values_x``, ``values_y``, ``values_z``."""
    if path != "values":
        return values_at(message, path)
    parts = [np.asarray(getattr(message, f"values_{axis}"), np.float64) for axis in "xyz"]
    return np.asarray(np.sqrt(sum(part**2 for part in parts)))


def _no_names(message: Any, path: str) -> tuple[str, ...]:
    return ()


def _centres(message: Any) -> NDArray[np.float64] | None:
    parts = [np.asarray(getattr(message, f"centers_{axis}"), np.float64) for axis in "xyz"]
    return np.column_stack(parts) if len({part.size for part in parts}) == 1 else None


KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "TactileState": Kind("sensors.values", values_at, names_at),
        "SensStream": Kind("sensors.taxels.z", values_at, names_at, wraps=True),
        "BiotacAll": Kind("tactiles.electrodes", values_at, names_at),
        "SkinCellData": Kind("force", values_at, names_at, cell=True),
        "SkinCellDataArray": Kind("data.force", values_at, names_at),
        "TaxelArray": Kind("values", _lengths, _no_names, positions=_centres),
        "sensor_msgs/Range": Kind("range", values_at, lambda *_: ("range",)),
        "sensor_msgs/Image": Kind("data", _pixels, _pixel_names, positions=_pixel_positions),
    }
)
"""Known message types by name, or by package and name if the name is ambiguous."""
