"""Look-up and matching of the names of sensors."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from anisomap.base.channels import match_by_number
from anisomap.base.wording import join_items
from anisomap.errors import InputError


def default_names(n_sensors: int) -> tuple[str, ...]:
    """Return default sensor names: ``s0, s1, ...``."""
    return tuple(f"s{i}" for i in range(n_sensors))


def column_names(values: object) -> tuple[str, ...]:
    """Return the names of the columns of a DataFrame; none for other values."""
    return tuple(map(str, getattr(values, "columns", ())))


def check_names(names: Sequence[str], n_sensors: int) -> None:
    """Check that there is one unique name per sensor."""
    if len(names) != n_sensors:
        raise InputError(f"each sensor needs a name: sensors: {n_sensors:,}, names: {len(names):,}")
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise InputError(f"names must be unique; repeated: {join_items(repeated, 5)}")


def find_sensors(
    names: Sequence[str], sensors: Iterable[str | int], kind: str = "sensor"
) -> NDArray[np.intp]:
    """Return the indices of the sensors that `sensor_mask` marks."""
    return np.flatnonzero(sensor_mask(names, sensors, kind))


def sensor_mask(
    names: Sequence[str], sensors: Iterable[str | int], kind: str = "sensor"
) -> NDArray[np.bool_]:
    """Mark sensors given by name, index, range (``c0-c35``) or pattern (``*_z``): shape (N,).

    kind: Name for the sensors in error messages.
    """
    if isinstance(sensors, str | int):
        sensors = [sensors]
    by_name = {name: i for i, name in enumerate(names)}
    found = np.zeros(len(names), dtype=bool)
    for sensor in sensors:
        text = str(sensor)
        if isinstance(sensor, str) and text in by_name:
            found[by_name[text]] = True
        elif text.isdecimal() and int(text) < len(names):
            found[int(text)] = True
        elif several := _several(names, by_name, text):
            found[several] = True
        else:
            raise InputError(
                f"there is no {kind} {text!r}; names are {names[0]} ... {names[-1]}, indices 0 to "
                f"{len(names) - 1}"
            )
    return found


def _several(names: Sequence[str], by_name: Mapping[str, int], text: str) -> list[int]:
    """Return the sensors of a pattern with ``*`` or ``?``, or of a range."""
    if "*" in text or "?" in text:
        pattern = re.escape(text).replace(r"\*", ".*").replace(r"\?", ".")
        return [i for i, name in enumerate(names) if re.fullmatch(pattern, name, re.DOTALL)]
    for match in re.finditer("-", text):
        ends = text[: match.start()].strip(), text[match.end() :].strip()
        if all(end in by_name for end in ends):
            first, last = sorted(by_name[end] for end in ends)
            return [*range(first, last + 1)]
        if all(end.isdecimal() and int(end) < len(names) for end in ends):
            first, last = sorted(map(int, ends))
            return [*range(first, last + 1)]
    return []


def match_names(names: Iterable[str], among: Sequence[str]) -> NDArray[np.intp]:
    """Return the indices of names among others; -1 for missing names."""
    place = {name: i for i, name in enumerate(among)}
    return np.array([place.get(name, -1) for name in names], dtype=np.intp)


def match_sensors(
    names: Sequence[str], among: Sequence[str], what: str
) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """Match sensors by name, by channel, or by order if one side has no names; return indices.

    Also return a note unless matched by name. Default names and numbers count as no names.
    """
    found = match_names(names, among)
    if (found >= 0).any():
        return found, ()
    by_number = match_by_number(names, among)
    if by_number is not None:
        first = int(np.flatnonzero(by_number >= 0)[0])
        pair = f"{names[first]} to {among[by_number[first]]}"
        return by_number, (f"{what} share no sensor name: matched by number, such as {pair}",)
    sides = " and ".join(f"{side[0]} ... {side[-1]}" for side in (names, among))
    if not (_unnamed(names) or _unnamed(among)):
        raise InputError(f"{what} share no sensor name ({sides}); use the same names")
    if len(names) != len(among):
        raise InputError(
            f"{what} share no sensor name, and {len(names)} sensors cannot be matched with "
            f"{len(among)} by order; use the same names"
        )
    return np.arange(len(names)), (f"{what} share no sensor name: matched by order",)


def _unnamed(names: Sequence[str]) -> bool:
    counted = (tuple(map(str, range(start, start + len(names)))) for start in (0, 1))
    return tuple(names) in (default_names(len(names)), *counted)
