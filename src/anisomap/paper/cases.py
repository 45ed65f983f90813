"""The paper's runs: six simulated scenarios, and five runs of the patch."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap import io
from anisomap.errors import InputError
from anisomap.method.named import PAPER_METHODS
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.paper.experiment import Settings
from anisomap.recording import Recording
from anisomap.simulation import LocomotionOptions, find_body, find_scenario, simulate, solids
from anisomap.simulation.bodies import CYLINDER_LENGTH, CYLINDER_RADIUS
from anisomap.simulation.body import Body

METHODS = PAPER_METHODS
"""The paper's methods in the order of all figures and tables."""

_LENGTH, _SPAN, _RANDOM = "cylinder.length", "patch.mean_span", "sphere.random"
_USUAL_SPAN, _MEAN_GAP = 20.0, 100.0  # frames
_STEEPEST = 0.35  # height of the ground over its correlation length
_USUAL_LENGTH = CYLINDER_LENGTH / CYLINDER_RADIUS
_WHOLE = ("bombardment.n_balls", "bombardment.one_sided")

OPEN: Mapping[str, str] = MappingProxyType(
    {
        "frames": "frames of a run (2,000 in the paper)",
        "mu": "the paper's mu",
        _LENGTH: "length of the cylinder over its radius",
        _RANDOM: "1 if sensors of the sphere are at random places",
        _SPAN: "mean number of frames for which the failing sensor is saturated",
        **{
            f"{scenario}.{entry.name}": f"parameter of {scenario}"
            for scenario in ("bombardment", "locomotion", "rubbing")
            for entry in fields(find_scenario(scenario).options)
        },
    }
)
"""Settings that the paper does not specify, by the names in `Settings.changes`."""


def parse_changes(texts: Iterable[str]) -> tuple[tuple[str, float], ...]:
    """Parse texts such as ``locomotion.detection_radius=.25``."""
    found: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name not in OPEN:
            raise InputError(f"the paper states {name!r}; choose from {', '.join(OPEN)}")
        try:
            found[name] = float(value)
        except ValueError:
            raise InputError(f"write NAME=NUMBER, as in mu=.1, got {text!r}") from None
    return tuple(found.items())


@dataclass(frozen=True)
class Case:
    """A body and a scenario: keys of `anisomap.simulation.BODIES` and `SCENARIOS`.

    n_sensors: Number of sensors if it is not the default of the body.
    """

    body: str
    scenario: str = "bombardment"
    n_sensors: int | None = None

    @property
    def name(self) -> str:
        """Name in tables."""
        return f"{self.body}-{self.scenario}"

    @property
    def label(self) -> str:
        """Label in figures."""
        return f"{self.body.replace('y-', 'Y-')},\n{self.scenario}"

    def run_name(self, dimensions: int) -> str:
        """Return the name of a run in tables of scores."""
        return self.name + (", 2D" if dimensions == 2 else "")

    def shape(self, settings: Settings) -> Body:
        """Return the body."""
        is_cylinder = self.body == "cylinder"
        length = settings.value(_LENGTH, _USUAL_LENGTH) if is_cylinder else _USUAL_LENGTH
        is_random = self.body == "sphere" and settings.value(_RANDOM, 0) == 1
        return _shape(self.body, self.n_sensors, length / _USUAL_LENGTH, is_random)

    def parameters(self, settings: Settings) -> dict[str, Any]:
        """Return the parameters of the scenario that differ from its defaults."""
        found: dict[str, Any] = {
            key.partition(".")[2]: int(value) if key in _WHOLE else value
            for key, value in settings.chosen.items()
            if key.startswith(f"{self.scenario}.")
        }
        if "correlation" in found:  # smaller bumps have finer cells and less height
            usual, longest = LocomotionOptions(), found["correlation"]
            found = {
                "cell": min(usual.cell, longest / 2),
                "roughness": min(usual.roughness, _STEEPEST * longest),
            } | found
        return found

    def record(self, settings: Settings, seed: int, n_frames: int | None = None) -> Recording:
        """Simulate a run."""
        chosen = tuple(self.parameters(settings).items())
        return _simulated(
            self.shape(settings), self.scenario, n_frames or settings.n_frames, seed, chosen
        )


@lru_cache(maxsize=16)
def _shape(name: str, n_sensors: int | None, stretched: float, is_random: bool) -> Body:
    body = find_body(name, n_sensors)
    if is_random:
        places = np.random.default_rng(0).standard_normal(body.positions.shape)
        places /= np.linalg.norm(places, axis=1, keepdims=True)
        return replace(body, positions=places * np.linalg.norm(body.positions[0]), normals=places)
    if stretched == 1:
        return body
    solid = solids.cylinder(CYLINDER_RADIUS, stretched * CYLINDER_LENGTH / 2)
    return replace(body, positions=body.positions * [1, 1, stretched], solids=[solid])


@lru_cache(maxsize=16)  # several experiments of a worker use the same runs
def _simulated(
    body: Body, scenario: str, n_frames: int, seed: int, chosen: tuple[tuple[str, Any], ...]
) -> Recording:
    return simulate(body, scenario, n_frames=n_frames, seed=seed, **dict(chosen))


BOMBARDED = tuple(map(Case, ("sphere", "cylinder", "y-shape", "plane")))
CASES = (*BOMBARDED, Case("sphere", "locomotion"), Case("cylinder", "locomotion"))
PATCH = Case("hexagon", "rubbing", 72)

PATCH_FRAMES = (1120, 1054, 1487, 2128, 2105)
"""Frames of the paper's five hardware runs."""

PATCH_RUNS = range(1, len(PATCH_FRAMES) + 1)
"""Runs of the paper, shown in figures; claims use more runs, of the same lengths."""

_FAILED_RUNS = PATCH_RUNS[3:]

SILENT = tuple(f"t5p{pad}" for pad in range(12))
"""Sensors of the triangle that never responds."""

FAILING = "t2p6"
"""Sensor 30 of the patch, counted from 0; the paper's sensor 30 fails."""


def patch_seed(settings: Settings, number: int) -> int:
    """Return the seed of a run of the patch."""
    return settings.seed + number - 1


def dead(recording: Recording, sensors: Sequence[str]) -> Recording:
    """Fix sensors at their readings at rest."""
    readings, dead_ones = np.array(recording.readings), recording.indices(sensors)
    readings[:, dead_ones] = estimate_rest(readings[:, dead_ones]).value
    return replace(recording, readings=readings)


def saturating(
    recording: Recording, sensor: str, rng: np.random.Generator, mean_span: float
) -> Recording:
    """Set a sensor to full scale, i.e. the highest reading of all sensors, for spans of frames.

    Gaps and spans are geometrically distributed; the paper gives no lengths.
    """
    readings = np.array(recording.readings)
    # A gap and a span take at least two frames together, so this number suffices.
    shape = (len(readings) // 2 + 1, 2)
    edges = rng.geometric([1 / _MEAN_GAP, 1 / mean_span], shape).cumsum().reshape(shape)
    (column,) = recording.indices([sensor])
    for start, stop in edges[edges[:, 0] < len(readings)]:
        readings[start:stop, column] = recording.readings.max()
    return replace(recording, readings=readings)


def patch_run(
    settings: Settings, number: int, *, failing: str = FAILING, fails: bool | None = None
) -> Recording:
    """Simulate a run of the hardware patch.

    fails: Whether a sensor fails; by default as in the runs of the paper.
    """
    seed, of_paper = patch_seed(settings, number), (number - 1) % len(PATCH_FRAMES) + 1
    frames = PATCH_FRAMES[of_paper - 1]
    n_frames = frames // 8 if settings.quick else frames
    recording = dead(PATCH.record(settings, seed, n_frames=n_frames), SILENT)
    span = settings.value(_SPAN, _USUAL_SPAN)
    if of_paper in _FAILED_RUNS if fails is None else fails:
        recording = saturating(recording, failing, np.random.default_rng(seed), span)
    return replace(
        recording,
        positions=1e3 * true_positions(recording),
        units="mm",
        source=f"simulated patch, run {number}, seed {seed}",
    )


def patch_runs(
    settings: Settings, *, fails: bool | None = None, n_runs: int = len(PATCH_RUNS)
) -> Iterator[tuple[int, Recording, int]]:
    """Yield number, recording and seed of runs of the patch, see `patch_run`."""
    for number in range(1, n_runs + 1):
        yield number, patch_run(settings, number, fails=fails), patch_seed(settings, number)


REAL_RECORDING = "icub_hexagon.npz"
"""File of a recording of real skin of the same kind."""


def real_recording(settings: Settings) -> Recording:
    """Read the recording of real skin from the folder of recordings."""
    return io.read((settings.recordings or Path()) / REAL_RECORDING)


def true_positions(recording: Recording, dimensions: int = 3) -> NDArray[np.float64]:
    """Return the true positions, shape (N, dimensions); missing coordinates are 0."""
    if recording.positions is None:
        raise ValueError(f"{recording.source} has no true positions")
    lacking = max(0, dimensions - recording.positions.shape[1])
    return np.pad(recording.positions, ((0, 0), (0, lacking)))[:, :dimensions]
