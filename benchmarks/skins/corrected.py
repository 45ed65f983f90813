"""True positions of a real skin whose published layout states some triangles turned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import anisomap
from anisomap.placement.modules import match_by_number, modules_by_size

_TRIANGLE = 12  # channels
_ROUNDED = 1.0  # mm; the display rounds the places of triangles


def corrected_truth(recording: anisomap.Recording, display: Path) -> anisomap.Recording:
    """Turn the triangles of a recording's positions as the display of the robot states them.

    recording: Of taxels that count the values of a port, with positions in millimetres.
    display: File ``*.ini`` of the same part. Of the torso, 42 of 44 triangles agree with it.
    """
    layout = anisomap.read_map(display)
    matched = match_by_number(recording.names, layout.names)
    if matched is None or recording.positions is None:
        raise ValueError(f"{display} is not of the skin that was recorded")
    stated = layout.positions[matched[0]]
    positions = np.array(recording.positions, dtype=np.float64)
    modules = modules_by_size(layout.names, _TRIANGLE, first=0).select(matched[0])
    for m in range(modules.n_modules):
        pads = modules.members(m)
        middle = positions[pads].mean(axis=0)
        turned = stated[pads] - stated[pads].mean(axis=0) + middle
        if np.abs(turned - positions[pads]).max() > _ROUNDED:
            positions[pads] = turned
    return replace(recording, positions=positions)
