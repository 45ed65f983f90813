"""Corrections of published positions that recordings and the robot's own files contradict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

import anisomap
from anisomap.recording import Recording

TURNED: Mapping[str, Mapping[int, float]] = MappingProxyType(
    {"icub_torso": MappingProxyType({3073: -120.0, 3121: 120.0})}
)
"""Triangles of recordings, by the number of their first pad, and the angles in degrees by which
their published positions are turned back.

``skinGui/torso.ini`` of ``robotology/icub-main`` states these angles, and agrees with the other 42
triangles; `anisomap check` names the two in four recordings.
"""

_CENTRE = 3  # the pad at the centre of a triangle
_PADS = 12


def read_corrected(path: Path) -> Recording:
    """Read a recording, with its published positions corrected where that is known."""
    recording = anisomap.read(path)
    positions = None if recording.positions is None else np.array(recording.positions)
    for first, angle in TURNED.get(path.stem, {}).items():
        if positions is None:
            break
        names = [f"taxel{first + pad}" for pad in range(_PADS)]
        pads = [recording.names.index(name) for name in names if name in recording.names]
        centre = positions[recording.names.index(names[_CENTRE])]
        turn = np.deg2rad(angle)
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        positions[pads] = centre + (positions[pads] - centre) @ rotation.T
    return replace(recording, positions=positions)
