"""Robots whose numbering of sensors is known: names for them, and what is no sensor left out.

A new robot is one function, from the recording's readings to the kept sensors and their names, and
one line in `PRESETS`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from anisomap.errors import InputError
from anisomap.recording import Recording

Numbering: TypeAlias = Callable[[Recording], dict[int, str]]
"""Given a recording, the index and the name of every value in it that is a sensor."""

_BOARD, _TRIANGLE = 192, 12
_THERMAL = (6, 10)
_FINGERS = ("index", "middle", "ring", "little", "thumb")
_PALM, _PALM_PADS = 96, 48
_NO_PALM_PADS = (11, 23, 35, 43)
_RAW_REST = 128  # raw skin rests near 240, compensated skin at 0


def apply_preset(recording: Recording, preset: str) -> Recording:
    """Name the sensors of a known robot, and leave out values that are no sensors.

    Parameters
    ----------
    recording : Recording
        As the robot's port gave it: not yet renumbered. Ports that were joined are numbered each
        by itself.
    preset : str
        A name in `PRESETS`; empty for none.

    Returns
    -------
    Recording
        Its metadata says which preset it was, and whether the skin is raw or compensated.

    Raises
    ------
    InputError
        If there is no such preset, or the recording does not have its numbering.
    """
    if not preset:
        return recording
    kept = numbering(recording, preset)
    chosen = recording.select(list(kept))
    rest = float(np.nanmedian(chosen.readings[0]))
    state = "raw, falls when pressed" if rest > _RAW_REST else "compensated, rests at 0"
    return replace(
        chosen,
        names=tuple(kept.values()),
        metadata={**recording.metadata, "preset": preset, "skin": state},
    )


def numbering(recording: Recording, preset: str) -> dict[int, str]:
    """Tell which values of a robot's recording are sensors, and what these are called.

    Parameters
    ----------
    recording : Recording
        As for `apply_preset`. Of its readings it matters only which vary.
    preset : str
        A name in `PRESETS`.

    Returns
    -------
    dict of int to str
        By the index of the value, in the order in which `apply_preset` keeps them.

    Raises
    ------
    InputError
        As `apply_preset`.
    """
    if preset not in PRESETS:
        raise InputError(f"there is no preset {preset!r}; known are {', '.join(PRESETS)}")
    kept = {
        index: name
        for port, indices in _ports(recording).items()
        for index, name in _numbered(recording, port, indices, PRESETS[preset])
    }
    if not kept:
        raise InputError(f"under the preset {preset}, no sensor of this recording ever varies")
    return kept


def _ports(recording: Recording) -> dict[str, list[int]]:
    """Tell which values came from which port: by what stands before their numbers."""
    found: dict[str, list[int]] = {}
    for index, name in enumerate(recording.names):
        found.setdefault(name.rpartition("/")[0], []).append(index)
    return found


def _numbered(
    recording: Recording, port: str, indices: list[int], known: Numbering
) -> list[tuple[int, str]]:
    if not port:
        return list(known(recording).items())
    part = replace(recording.select(indices), source=port, metadata={})
    return [(indices[i], f"{port}/{name}") for i, name in known(part).items()]


def icub(recording: Recording) -> dict[int, str]:
    """Name the pads of an iCub: index = 192 * board + 12 * triangle + k, without thermal pads.

    Pads 6 and 10 of a triangle measure temperature. Triangles that are not there read the same
    value all the time. A port whose name ends on a hand is numbered as `icub_hand` says.

    Parameters
    ----------
    recording : Recording
        Of whole triangles.

    Returns
    -------
    dict of int to str
        ``b0.t3.k11`` is pad 11 of triangle 3 of board 0.

    Notes
    -----
    Schmitz et al. (2011), IEEE Transactions on Robotics 27(3): 389-400,
    doi:10.1109/TRO.2011.2132930.
    """
    if _is_hand(recording):
        return icub_hand(recording)
    if recording.n_sensors % _TRIANGLE:
        raise InputError(
            f"{recording.n_sensors} values are no whole triangles of {_TRIANGLE}, as the skin of "
            "an iCub has; read the port of one part of the skin"
        )
    varying = recording.varying().reshape(-1, _TRIANGLE)
    there = np.asarray(varying.any(axis=1))
    return {
        index: f"b{index // _BOARD}.t{index % _BOARD // _TRIANGLE}.k{index % _TRIANGLE}"
        for index in range(recording.n_sensors)
        if there[index // _TRIANGLE] and index % _TRIANGLE not in _THERMAL
    }


def icub_hand(recording: Recording) -> dict[int, str]:
    """Name the pads of the hand of an iCub: five fingertips of 12 pads, and the palm from 96 on.

    In the palm, 11, 23, 35 and 43 of 48 are no pads.

    Parameters
    ----------
    recording : Recording
        Of the hand's 192 values.

    Returns
    -------
    dict of int to str
        ``thumb.0``, ``palm.47``. Fingertips and palm that never vary are left out as absent.
    """
    if recording.n_sensors != _BOARD:
        raise InputError(f"the hand of an iCub has {_BOARD} values, not {recording.n_sensors}")
    parts = {name: range(12 * i, 12 * i + 12) for i, name in enumerate(_FINGERS)}
    parts["palm"] = range(_PALM, _PALM + _PALM_PADS)
    varying = recording.varying()
    return {
        index: f"{part}.{index - indices.start}"
        for part, indices in parts.items()
        if varying[indices].any()
        for index in indices
        if part != "palm" or index - _PALM not in _NO_PALM_PADS
    }


def _is_hand(recording: Recording) -> bool:
    named = f"{recording.source} {recording.metadata.get('port', '')}"
    return recording.n_sensors == _BOARD and bool(re.search(r"hand(_comp)?\b", named))


PRESETS: Mapping[str, Numbering] = MappingProxyType({"icub": icub, "icub-hand": icub_hand})
