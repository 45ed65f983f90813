"""Recordings of the suite of verdicts: bodies, stimuli, faults, lengths, and real skins.

A seed gives one simulated skin, wired at random, of which several recordings are taken: whole,
shorter, and with faults. Seeds run through all settings in a fixed order, so that any range of
seeds covers bodies and stimuli evenly.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np

import anisomap
from anisomap.base.defaults import MIN_TOUCHES
from anisomap.evaluation.compare import spanned_dimensions, touched
from anisomap.simulation import BODIES, SCENARIOS, find_body, inject
from anisomap.simulation.options import options_for
from benchmarks.skins.footprints import FOOTPRINTS
from benchmarks.verdicts.faults import DAMAGES, sized

SENSORS = {
    "sphere": 60, "cylinder": 60, "y-shape": 60, "plane": 64, "hexagon": 60, "torus": 80,
    "cube": 72, "hemisphere": 60, "hand": 90, "tube": 70, "holed-plate": 64, "uneven-sphere": 60,
}  # fmt: skip
"""Sensors of each body: few, so that the suite takes less than half an hour."""

LARGE = (("sphere", 300), ("plane", 289), ("torus", 300))
ROLLED = tuple(product(("columns", "fibonacci", "random"), (30, 60, 120)))
"""Placements and numbers of sensors on rolling cylinders."""

SHORTEST, LONGEST = 100, 8000
"""Frames of a recording; lengths are uniform on a logarithmic scale."""

FAULTS = (
    *(fault for _, fault in DAMAGES.values()),
    "dead:5%",
    "stuck:10%",
    "saturating:10%",
    "noisy:*,level=0.1",
    "noisy:50%,level=0.3",
    "drifting:30%",
    "quantised:*,levels=8",
    "thresholded:*",
    "swapped:10%",
    "shifted:20%",
    "shorted:3%",
    "intermittent:10%",
    "gain-drift:*",
    "stepping:20%",
    "stuck-bit:10%",
    "freezing:*,board=12",
    "folded:after=0.5",
    "dropped-frames",
    "duplicated:3%",
    "rarely-touched:20%",
)
"""All kinds of `simulation.FAULTS`, in the sizes of ``make faults`` where that has them."""

RATE_HZ = 20.0
"""Frames per second, the default of all scenarios."""

PARTS = 4
"""Regions of a real skin that are mapped by themselves."""

REAL_FRAMES, REAL_SENSORS = 3000, 150
"""Most frames and sensors of a shortened or damaged recording of a real skin."""


@dataclass(frozen=True)
class Setting:
    """A body and how it is touched."""

    body: str
    scenario: str
    sensors: int
    placement: str = ""

    def __str__(self) -> str:
        return " ".join(filter(None, (self.body, self.placement, str(self.sensors), self.scenario)))


@dataclass(frozen=True, eq=False)
class Case:
    """A recording to map.

    name: Unique in the suite.
    recording: With true positions.
    dimensions: Of its map.
    fault: That was injected; empty if none.
    kind: Of skin and touch, all of which are left out of a calibration together.
    group: Simulator, or "real".
    """

    name: str
    recording: anisomap.Recording
    dimensions: int
    fault: str = ""
    kind: str = ""
    group: str = "simulated"


@cache
def settings() -> tuple[Setting, ...]:
    """Return all bodies with all stimuli, in a fixed order that mixes them."""
    bodies = {name: find_body(name, SENSORS[name]) for name in BODIES}
    every = [
        Setting(name, scenario, SENSORS[name])
        for (name, body), (scenario, kind) in product(bodies.items(), SCENARIOS.items())
        if kind.accepts(body) and (name, scenario) != ("cylinder", "locomotion")
    ]
    every += [Setting("cylinder", "locomotion", n, placement) for placement, n in ROLLED]
    every += [
        Setting(name, footprint, SENSORS[name])
        for number, footprint in enumerate(FOOTPRINTS)
        for name in np.roll([*BODIES], -3 * number)[:3].tolist()
    ]
    every += [Setting(name, "bombardment", n) for name, n in LARGE]
    order = np.random.default_rng(0).permutation(len(every))
    return tuple(every[i] for i in order)


def simulated(seed: int, folder: Path) -> anisomap.Recording:
    """Return the skin of a seed, wired at random; it is simulated once and kept in a folder."""
    every = settings()
    setting = every[seed % len(every)]
    path = folder / f"{seed}.npz"
    if path.exists():
        return anisomap.read(path)
    rng = np.random.default_rng(seed)
    n_frames = drawn_length(rng, 4 * SHORTEST, LONGEST)
    options = {"placement": setting.placement, "seed": seed} if setting.placement else {}
    body = find_body(setting.body, setting.sensors, **options)
    if setting.scenario in SCENARIOS:
        # Not `simulate`, which also computes distances along the surface; these take longer.
        scenario = SCENARIOS[setting.scenario]
        result = scenario.function(body, n_frames, options_for(scenario.options, body, {}), rng)
        readings, body = result.readings, result.body or body
    else:
        readings = FOOTPRINTS[setting.scenario](np.array(body.positions), n_frames, rng)
    made = anisomap.Recording(
        readings, names=body.names, positions=body.positions, units=body.units, rate_hz=RATE_HZ
    ).select(rng.permutation(body.n_sensors))
    folder.mkdir(parents=True, exist_ok=True)
    anisomap.write(made, path)
    return made


def cases_of_seed(seed: int, folder: Path) -> Iterator[Case]:
    """Yield the recordings of one seed: whole, shorter, and with two faults."""
    kind = settings()[seed % len(settings())].scenario
    return (replace(case, kind=kind) for case in _cases_of_seed(seed, folder))


def _cases_of_seed(seed: int, folder: Path) -> Iterator[Case]:
    every = settings()
    name = f"{seed} {every[seed % len(every)]}"
    whole = simulated(seed, folder)
    rng = np.random.default_rng([seed, 1])
    flat = spanned_dimensions(np.asarray(whole.positions))
    # One of three flat skins is mapped in 3D, as by users who leave the dimension at its default.
    dimensions = [3 if rng.random() < 1 / 3 else flat for _ in range(4)]
    yield Case(f"{name}, {whole.n_frames} frames", whole, flat)
    short = cut(whole, drawn_length(rng, SHORTEST, whole.n_frames))
    yield Case(f"{name}, {short.n_frames} frames, {dimensions[1]}D", short, dimensions[1])
    for number in range(2):
        fault = FAULTS[(2 * seed + number) % len(FAULTS)]
        part = cut(whole, drawn_length(rng, 4 * SHORTEST, whole.n_frames))
        yield from damaged(
            f"{name}, {part.n_frames} frames", part, dimensions[2 + number], fault, seed
        )


def cases_of_file(path: Path) -> Iterator[Case]:
    """Yield recordings of a real skin: whole, in a wrong dimension, parts, and with faults."""
    kind = path.stem.split("_")[0]
    return (replace(case, kind=kind, group="real") for case in _cases_of_file(path))


def _cases_of_file(path: Path) -> Iterator[Case]:
    recording = anisomap.read(path)
    if recording.positions is None:
        return
    whole = recording.select(touched(recording, MIN_TOUCHES)).complete("interpolate")
    truth = np.asarray(whole.positions)
    whole = whole.select(np.isfinite(truth).all(axis=1))
    truth = np.asarray(whole.positions)
    dimensions = spanned_dimensions(truth)
    yield Case(path.stem, whole, dimensions)
    rng = np.random.default_rng(0)
    centre = truth[rng.integers(len(truth))]
    near = np.sort(np.argsort(np.linalg.norm(truth - centre, axis=1))[:REAL_SENSORS])
    part = cut(whole.select(near), REAL_FRAMES)
    if dimensions == 2:
        yield Case(f"{path.stem} part, 3D", part, 3)
    for _ in range(3):
        short = cut(part, drawn_length(rng, SHORTEST, part.n_frames))
        yield Case(f"{path.stem} part, {short.n_frames} frames", short, dimensions)
    for number in range(PARTS):
        centre = truth[rng.integers(len(truth))]
        size = int(rng.integers(30, REAL_SENSORS))
        near = np.sort(np.argsort(np.linalg.norm(truth - centre, axis=1))[:size])
        region = cut(whole.select(near), drawn_length(rng, 500, whole.n_frames))
        yield Case(f"{path.stem} region {number}", region, dimensions)
    for index in rng.choice(len(FAULTS), 6, replace=False):
        yield from damaged(f"{path.stem} part", part, dimensions, FAULTS[index], 1)


def damaged(
    name: str, recording: anisomap.Recording, dimensions: int, fault: str, seed: int
) -> Iterator[Case]:
    """Yield a recording with a fault, if it can have it.

    Exchanged wires leave a map right and its labels wrong, which no map can show: the true
    positions are exchanged as well.
    """
    text = sized(fault, recording)
    if text.startswith("swapped:10%"):
        n_swapped = 2 * max(1, recording.n_sensors // 20)
        text = "swapped:" + ",".join(recording.names[:n_swapped])
    try:
        made = inject(recording, text, rng=seed)
    except anisomap.InputError:
        return  # no positions or times
    if text.startswith(("swapped", "shifted")) and "after" not in text:
        before, after = recording.readings, made.readings
        wired = [int((before == column[:, None]).all(axis=0).argmax()) for column in after.T]
        made = replace(made, positions=np.asarray(recording.positions)[wired])
    yield Case(f"{name}, {dimensions}D, {fault}", made.complete("interpolate"), dimensions, fault)


def cut(recording: anisomap.Recording, n_frames: int) -> anisomap.Recording:
    """Return the first frames of a recording."""
    times = None if recording.times is None else recording.times[:n_frames]
    return replace(recording, readings=recording.readings[:n_frames], times=times)


def drawn_length(rng: np.random.Generator, least: int, most: int) -> int:
    """Draw a number of frames, uniform on a logarithmic scale."""
    return int(np.exp(rng.uniform(np.log(min(least, most)), np.log(most))))
