"""Recordings of the suite of verdicts: skins of two simulators, damages, noises, and real skins.

A seed gives one skin of the package's simulator, one of `benchmarks.skins.independent`, sound and
damaged, and one noise of sensors that are nowhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

import anisomap
from anisomap.simulation import BODIES, SCENARIOS, Body, find_body
from anisomap.simulation.bodies import CYLINDER_LENGTH, CYLINDER_RADIUS, midpoints
from anisomap.simulation.locomotion import can_roll
from benchmarks.accuracy.compare import MIN_TOUCHES, spanned_dimensions, touched
from benchmarks.skins.independent import damaged, drawn, make
from benchmarks.skins.readout import NOISES, noise

DAMAGES = (
    "swapped", "swapped:start=.5", "shifted:start=.5", "modules:start=.5", "posture", "mounting",
    "dead", "stuck", "intermittent", "inverted", "copied", "shorted", "saturating",
    "leak:share=.05", "leak:share=.2", "gain-drift", "common-noise:level=.3",
    "common-noise:level=1", "spikes", "spikes:of_boards=1", "frozen", "stuck-bit", "steps",
    "lost-frames", "gaps", "lags:frames=1", "lags:frames=3", "lags:frames=5",
)  # fmt: skip
"""Damages of `benchmarks.skins.independent`, in the sizes that are tried."""

ROLLED = tuple(product(("columns", "fibonacci", "random"), (30, 60, 120)))
"""Placements and numbers of sensors on rolling cylinders of the package's simulator."""

SHORTEST, LONGEST = 100, 8000
"""Frames of a recording; lengths are uniform on a logarithmic scale."""

PARTS = 4
"""Regions of a real skin that are mapped by themselves."""

REAL_FRAMES, REAL_SENSORS = 3000, 150
"""Most frames and sensors of a shortened or damaged recording of a real skin."""


@dataclass(frozen=True, eq=False)
class Case:
    """A recording to map.

    name: Unique in the suite.
    recording: With true positions; noise has none.
    dimensions: Of its map.
    damage: Empty if there is none.
    kind: Of touch or noise, all of which are left out of a calibration together.
    group: "package", "independent", "noise" or "real".
    """

    name: str
    recording: anisomap.Recording
    dimensions: int
    damage: str = ""
    kind: str = ""
    group: str = "real"


def cases_of_seed(seed: int) -> Iterator[Case]:
    """Yield the recordings of a seed."""
    yield _of_package(seed)
    damage = DAMAGES[seed % len(DAMAGES)]
    for case in (drawn(seed, longest=LONGEST), drawn(seed, damage=damage, longest=LONGEST)):
        recording = make(case).complete("interpolate")
        dimensions = np.asarray(recording.positions).shape[1]
        kind = case.stimulation
        yield Case(f"{seed} {case}", recording, dimensions, case.damage, kind, "independent")
    kind = [*NOISES][seed % len(NOISES)]
    readings = noise(kind, n_sensors=8 + seed % 40, seed=seed).astype(np.float32)
    yield Case(f"{seed} {kind}", anisomap.Recording(readings), 2, "", kind, "noise")


def _of_package(seed: int) -> Case:
    """Simulate a body under a scenario, wired at random; seeds run through both."""
    every = [
        (b, s) for b, s in product(BODIES, SCENARIOS) if s != "locomotion" or can_roll(find_body(b))
    ]
    name, scenario = every[(7 * seed) % len(every)]
    rng = np.random.default_rng(seed)
    body = find_body(name)
    if (name, scenario) == ("cylinder", "locomotion"):
        body = rolled(*ROLLED[seed % len(ROLLED)], seed)
    n_frames = drawn_length(rng, SHORTEST, LONGEST // 2)
    made = anisomap.simulate(body, scenario, n_frames=n_frames, seed=seed)
    made = made.select(rng.permutation(made.n_sensors))
    dimensions = spanned_dimensions(np.asarray(made.positions))
    text = f"{seed} {name} {made.n_sensors} {scenario}, {n_frames} frames"
    return Case(text, made, dimensions, "", scenario, "package")


def rolled(placement: str, n_sensors: int, seed: int) -> Body:
    """Make a cylinder with sensors in columns, on a Fibonacci lattice or at random places."""
    if placement == "columns":
        return find_body("cylinder", n_sensors)
    angles = np.pi * (3 - np.sqrt(5)) * np.arange(n_sensors)
    heights = midpoints(n_sensors, CYLINDER_LENGTH)
    if placement == "random":
        rng = np.random.default_rng(seed)
        angles = rng.uniform(0, 2 * np.pi, n_sensors)
        heights = rng.uniform(-CYLINDER_LENGTH / 2, CYLINDER_LENGTH / 2, n_sensors)
    around = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n_sensors)])
    places = CYLINDER_RADIUS * around + heights[:, None] * [0, 0, 1]
    solids = find_body("cylinder").solids
    return Body(f"cylinder-{placement}", places, around, solids)


def cases_of_file(path: Path) -> Iterator[Case]:
    """Yield recordings of a real skin: whole, in a wrong dimension, parts, and damaged."""
    kind = path.stem.split("_")[0]
    return (replace(case, kind=kind) for case in _cases_of_file(path))


def _cases_of_file(path: Path) -> Iterator[Case]:
    recording = anisomap.read(path)
    if recording.positions is None:
        return
    whole = recording.select(touched(recording, MIN_TOUCHES)).complete("interpolate")
    whole = whole.select(np.isfinite(np.asarray(whole.positions)).all(axis=1))
    truth = np.asarray(whole.positions)
    dimensions = spanned_dimensions(truth)
    yield Case(path.stem, whole, dimensions)
    rng = np.random.default_rng(0)

    def near(size: int) -> anisomap.Recording:
        centre = truth[rng.integers(len(truth))]
        return whole.select(np.sort(np.argsort(np.linalg.norm(truth - centre, axis=1))[:size]))

    part = cut(near(REAL_SENSORS), REAL_FRAMES)
    if dimensions == 2:
        yield Case(f"{path.stem} part, 3D", part, 3)
    for _ in range(3):
        short = cut(part, drawn_length(rng, SHORTEST, part.n_frames))
        yield Case(f"{path.stem} part, {short.n_frames} frames", short, dimensions)
    for number in range(PARTS):
        region = cut(near(int(rng.integers(30, REAL_SENSORS))), drawn_length(rng, 500, 8000))
        yield Case(f"{path.stem} region {number}", region, dimensions)
    for damage in rng.choice([one for one in DAMAGES if one != "posture"], 6, replace=False):
        spoilt = damaged(part, str(damage), rng).complete("interpolate")
        yield Case(f"{path.stem} part, {damage}", spoilt, dimensions, str(damage))


def cut(recording: anisomap.Recording, n_frames: int) -> anisomap.Recording:
    """Return the first frames of a recording."""
    times = None if recording.times is None else recording.times[:n_frames]
    return replace(recording, readings=recording.readings[:n_frames], times=times)


def drawn_length(rng: np.random.Generator, least: int, most: int) -> int:
    """Draw a number of frames, uniform on a logarithmic scale."""
    return int(np.exp(rng.uniform(np.log(min(least, most)), np.log(most))))
