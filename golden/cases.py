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
from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.method.named import METHODS
from anisomap.recording import MissingPolicy, Recording

_ROOT = Path(__file__).parents[1]

FOLDER = _ROOT / "tests" / "golden"
"""Folder of the record; its folder ``readings`` holds the recordings."""

SHARED = Path(os.environ.get("ANISOMAP_SHARED", _ROOT.parent / "shared"))
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


@dataclass(frozen=True)
class Source:
    """How a stored recording was made.

    Attributes
    ----------
    body, stimulus : str
        Body, and scenario of `anisomap.simulation` or stimulus of `benchmarks.skins.footprints`.
    n_sensors, n_frames : int
    fault : str
        As for `simulation.inject`; ``{sd}`` is that of `benchmarks.verdicts.faults.DAMAGES`.
    dtype : str
        Of the stored readings.
    skins : int
        Number of copies of the skin side by side, of which one is touched at a time.
    """

    body: str
    stimulus: str
    n_sensors: int = 60
    n_frames: int = 800
    fault: str = ""
    dtype: str = "float16"
    skins: int = 1


SOURCES: Mapping[str, Source] = MappingProxyType(
    {
        "sphere-bombarded": Source("sphere", "bombardment", 48, 1500),
        "cylinder-bombarded": Source("cylinder", "bombardment"),
        "y-shape-bombarded": Source("y-shape", "bombardment"),
        "plane-bombarded": Source("plane", "bombardment", 49),
        "hand-bombarded": Source("hand", "bombardment"),
        "sphere-rolling": Source("sphere", "locomotion", 48),
        "cylinder-rolling": Source("cylinder", "locomotion", 60, 1500),
        "hexagon-rubbed": Source("hexagon", "rubbing"),
        "torus-rubbed": Source("torus", "rubbing", 48, 1500),
        "cube-rubbed": Source("cube", "rubbing", 54, 1200),
        "hemisphere-roller": Source("hemisphere", "roller", 48),
        "uneven-sphere-pressed": Source("uneven-sphere", "pressing", 48),
        "tube-self-touch": Source("tube", "self-touch", 48),
        "holed-plate-pulses": Source("holed-plate", "pulses", 49, 400),
        "plane-walking": Source("plane", "walking", 49, 600),
        "plane-waves": Source("plane", "waves", 49, 600, dtype="uint8"),
        "hand-grasp": Source("hand", "grasp", 48),
        "sphere-potentials": Source("sphere", "conducted-sources", 32, 600),
        "binary": Source("hexagon", "rubbing", 60, 1000, "thresholded:*", "uint8"),
        "graded": Source("torus", "rubbing", 48, 1500, "quantised:*,levels=8"),
        "noisy-plane": Source("plane", "rubbing", 36, 500, "noisy:*,level=0.05", "float32"),
        "noisy-sphere": Source("sphere", "bombardment", 40, 1000, "noisy:*,level=0.02", "float32"),
        "few-contacts": Source("plane", "rubbing", 49, 800, "rarely-touched:20%"),
        "short": Source("hexagon", "rubbing", 60, 150),
        "two-skins": Source("plane", "rubbing", 25, 800, skins=2),
        "missing": Source("torus", "rubbing", 48, 1500, "nan-bursts:30%,mean_gap=150,mean_span=15"),
        "broken-sensors": Source("hexagon", "rubbing", 60, 800, "dead:5%+noisy:10%+stuck:5%"),
        "copies": Source("torus", "rubbing", 48, 1500, "duplicated:10%,factor=3,noise=0.1"),
        "leak": Source("hand", "bombardment", 48, 1000, "leaking:*,share=0.05"),
        "lags": Source("plane", "rubbing", 49, 1000, "lagging:*,board=12,frames=3"),
        "inverted": Source("torus", "rubbing", 48, 1500, "inverted:30%"),
        "common-noise": Source("hexagon", "rubbing", 60, 500, "common-noise:*,level=1"),
        "board-noise": Source("torus", "rubbing", 48, 1200, "common-noise:*,level=1,board=12"),
        "spikes": Source("hand", "bombardment", 48, 600, "spiking:*,board=12"),
        "hum": Source("hexagon", "rubbing", 60, 500, "humming:*,level=1"),
        "drift": Source("torus", "rubbing", 48, 1200, "drifting:*,level={sd}1"),
        "gaps": Source("hand", "bombardment", 48, 1200, "bridged-gaps:30%"),
        "saturation": Source("torus", "rubbing", 48, 1200, "clipped:30%,share=0.3"),
        "separate-regions": Source("plane", "rubbing", 49, 800, "separate-regions"),
        "one-period": Source("plane", "rubbing", 25, 300, "cycling:*"),
        "swapped": Source("hexagon", "rubbing", 60, 600, "swapped:s3,s17,s30,s41"),
    }
)
"""Stored recordings, by name."""

CASES: Mapping[str, Case] = MappingProxyType(
    {name: Case(name) for name in SOURCES}
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
