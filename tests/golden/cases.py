"""The rows of the record: how each recording was made, and how it is mapped."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np

import anisomap
from anisomap.base import DEFAULT_METHOD
from anisomap.method.named import METHODS
from anisomap.recording import MissingPolicy, Recording

FOLDER = Path(__file__).parent
"""Folder of the record; its folder ``readings`` holds the recordings."""

SHARED = Path(os.environ.get("ANISOMAP_SHARED", FOLDER.parents[2] / "shared"))
"""Folder of the folders of real recordings, which the repository does not contain."""


@dataclass(frozen=True)
class Case:
    """A row of the record.

    Attributes
    ----------
    recording : str
        Name of the stored recording, or path of a real one in `SHARED`.
    method, dimensions, missing
        As for ``anisomap map``.
    halves : bool
        Whether the recording is divided into two, each without some of the sensors.
    part : tuple of (int, int)
        Largest number of frames and of sensors, those that come first.
    """

    recording: str
    method: str = DEFAULT_METHOD
    dimensions: int | Literal["auto"] = "auto"
    missing: MissingPolicy = "interpolate"
    halves: bool = False
    part: tuple[int | None, int | None] = (None, None)

    @property
    def is_real(self) -> bool:
        """Whether the recording is real; the record holds only numbers of its map."""
        return "/" in self.recording

    @property
    def path(self) -> Path:
        """Path of the recording."""
        return (SHARED if self.is_real else FOLDER / "readings") / f"{self.recording}.npz"

    def runs(self) -> list[Recording]:
        """Read the recording."""
        frames, sensors = map(slice, self.part)
        whole = _part(anisomap.read(self.path), frames, sensors).complete(self.missing)
        if not self.halves:
            return [whole]
        half, fifth = whole.n_frames // 2, whole.n_sensors // 5
        first = _part(whole, slice(half), slice(fifth, None))
        return [first, _part(whole, slice(half, None), slice(-fifth))]


def _part(recording: Recording, frames: slice, sensors: slice) -> Recording:
    times = None if recording.times is None else recording.times[frames]
    part = replace(recording, readings=recording.readings[frames], times=times)
    return part.select(np.arange(recording.n_sensors)[sensors])


STORED = tuple(sorted(path.stem for path in (FOLDER / "readings").glob("*.npz")))
"""Names of the stored recordings; ``README.md`` says how each was made."""

CASES: Mapping[str, Case] = MappingProxyType(
    {name: Case(name) for name in STORED}
    | {f"hexagon-rubbed, {m}": Case("hexagon-rubbed", m) for m in METHODS if m != DEFAULT_METHOD}
    | {
        "sphere-rolling, r-anisomap": Case("sphere-rolling", "r-anisomap", 3),
        "plane-bombarded, 2D": Case("plane-bombarded", dimensions=2),
        "noisy-plane, 3D": Case("noisy-plane", dimensions=3),
        "missing, drop-frames": Case("missing", missing="drop-frames"),
        "torus-rubbed, halves": Case("torus-rubbed", halves=True),
    }
)
"""Rows of the record, by name."""

REAL: Mapping[str, Case] = MappingProxyType(
    {
        path: Case(path, dimensions=2, part=part)
        for path, part in {
            "recordings/icub_hexagon": (2000, None),
            "recordings/icub_palm": (2000, None),
            "recordings/icub_torso": (2000, 80),
            "recordings/plantar": (1000, 80),
            "recordings-hard/insole_L": (None, 80),
            "recordings-hard/retina_stacy": (2000, None),
        }.items()
    }
)
"""Rows of real recordings whose licences allow to publish figures of them, by name."""
