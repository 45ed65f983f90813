"""The paper's runs: six simulated scenarios, and five runs of the patch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.method.named import PAPER_METHODS
from anisomap.paper.experiment import Settings
from anisomap.recording import Recording
from anisomap.simulation import inject, simulate

METHODS = PAPER_METHODS
"""In the order of all figures and tables."""


@dataclass(frozen=True)
class Case:
    """A body and a scenario: keys of `anisomap.simulation.BODIES` and `SCENARIOS`."""

    body: str
    scenario: str = "bombardment"

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

    def record(self, settings: Settings, seed: int, **parameters: Any) -> Recording:
        """Simulate a run; `parameters` are those of the scenario, and ``n_frames``."""
        chosen = {"n_frames": settings.n_frames, **parameters}
        return _simulated(self.body, self.scenario, seed, tuple(chosen.items()))


@lru_cache(maxsize=16)  # several experiments of one worker use the same runs
def _simulated(
    body: str, scenario: str, seed: int, chosen: tuple[tuple[str, Any], ...]
) -> Recording:
    return simulate(body, scenario, seed=seed, **dict(chosen))


BOMBARDED = tuple(map(Case, ("sphere", "cylinder", "y-shape", "plane")))
CASES = (*BOMBARDED, Case("sphere", "locomotion"), Case("cylinder", "locomotion"))
PATCH = Case("hexagon", "rubbing")

PATCH_FRAMES = (1120, 1054, 1487, 2128, 2105)
"""Frames of the paper's five hardware runs."""

PATCH_RUNS = range(1, len(PATCH_FRAMES) + 1)
FAILED_RUNS = PATCH_RUNS[3:]

SILENT = tuple(f"t5p{pad}" for pad in range(12) if pad not in (6, 10))
"""Sensors of the triangle that never responds."""

FAILING = "t3p0"
"""Sensor 30 of the patch, counted from 0; the paper's sensor 30 fails."""


def patch_seed(settings: Settings, number: int) -> int:
    """Return the seed of a run of the patch."""
    return settings.seed + number - 1


def patch_run(
    settings: Settings,
    number: int,
    *,
    failing: str = FAILING,
    fails: bool | None = None,
    **failure: float,
) -> Recording:
    """Simulate a run of the hardware patch.

    fails: Whether a sensor fails; by default in the runs in which the paper's sensor did.
    """
    seed = patch_seed(settings, number)
    frames = PATCH_FRAMES[number - 1]
    n_frames = frames // 8 if settings.quick else frames
    recording = inject(PATCH.record(settings, seed, n_frames=n_frames), "dead", SILENT)
    if number in FAILED_RUNS if fails is None else fails:
        recording = inject(recording, "saturating", [failing], rng=seed, **failure)
    return replace(
        recording,
        positions=1e3 * true_positions(recording),
        units="mm",
        source=f"simulated patch, run {number}, seed {seed}",
    )


def patch_runs(
    settings: Settings, *, fails: bool | None = None
) -> Iterator[tuple[int, Recording, int]]:
    """Yield number, recording and seed of the runs of the patch, see `patch_run`."""
    for number in PATCH_RUNS:
        yield number, patch_run(settings, number, fails=fails), patch_seed(settings, number)


def true_positions(recording: Recording, dimensions: int = 3) -> NDArray[np.float64]:
    """Return the true positions, shape (N, dimensions); coordinates that they lack are 0."""
    if recording.positions is None:
        raise ValueError(f"{recording.source} has no true positions")
    lacking = max(0, dimensions - recording.positions.shape[1])
    return np.pad(recording.positions, ((0, 0), (0, lacking)))[:, :dimensions]
