"""Faults of recordings: found, falsely found, and mended (``make faults``).

Each fault is injected into recordings of simulated skins that are wired at random, on seeds that
were not used for tuning (1 to 300 were), and into the recordings in a folder. The output is a table
in Markdown and all results as CSV: whether the fault was found, what else was found, and the
accuracy (Mantel r) of maps of the undamaged, the damaged and the repaired recording.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import anisomap
from anisomap.evaluation.compare import spanned_dimensions
from anisomap.sensor_map import is_faulty
from anisomap.simulation import inject
from benchmarks.harness import (
    files_in,
    frame,
    in_parallel,
    keyed_table,
    measured,
    options,
    write_rows,
)
from benchmarks.skins.clean_recordings import TRUE_OF_CLEAN, Case, cases

BODIES = (
    ("sphere", "bombardment"),
    ("torus", "rubbing"),
    ("hexagon", "rubbing"),
    ("hand", "bombardment"),
    ("cylinder", "locomotion"),
)
FIRST_SEED = 301
FRAMES = 2000


DAMAGES: Mapping[str, tuple[str, str]] = {
    "5 % of the sensors are copies": ("copies", "duplicated:5%"),
    "10 % are copies, other gains, 10 % noise": ("copies", "duplicated:10%,factor=3,noise=0.1"),
    "10 % are copies, other gains, 40 % noise": ("copies", "duplicated:10%,factor=3,noise=0.4"),
    "5 % leak into the next channel": ("leak", "leaking:*,share=0.05"),
    "20 % leak into the next channel": ("leak", "leaking:*,share=0.2"),
    "boards of 12 lag by 1 frame each": ("lags", "lagging:*,board=12,frames=1"),
    "boards of 12 lag by 3 frames each": ("lags", "lagging:*,board=12,frames=3"),
    "boards of 12 lag by 10 frames each": ("lags", "lagging:*,board=12,frames=10"),
    "half of the sensors lag by 10 frames": ("lags", "lagging:50%,frames=10"),
    "half of the sensors lag by 30 frames": ("lags", "lagging:50%,frames=30"),
    "30 % of the sensors are inverted": ("inverted", "inverted:30%"),
    "50 % of the sensors are inverted": ("inverted", "inverted:50%"),
    "common noise of 1 sd": ("common-noise", "common-noise:*,level=1"),
    "common noise of 3 sd": ("common-noise", "common-noise:*,level=3"),
    "noise of boards of 12, 1 sd": ("board-noise", "common-noise:*,level=1,board=12"),
    "spikes of boards of 12 in 2 % of the frames": ("spikes", "spiking:*,board=12"),
    "hum of 1 sd": ("hum", "humming:*,level=1"),
    "hum of 3 sd": ("hum", "humming:*,level=3"),
    "baselines wander by 0.5 sd": ("drift", "drifting:*,level={sd}0.5"),
    "baselines wander by 1 sd": ("drift", "drifting:*,level={sd}1"),
    "baselines warm up by 1 sd": ("drift", "warming:*,level={sd}1"),
    "half of the readings of 30 % interpolated": ("gaps", "bridged-gaps:30%"),
    "half of the readings of 30 % missing": ("gaps", "nan-bursts:30%,mean_gap=50,mean_span=50"),
    "30 % of the sensors clipped at 0.3": ("saturation", "clipped:30%,share=0.3"),
    "readings of 10 % at 1,000 times the range": ("glitches", "glitching:10%,level=1000"),
    "wires of 5 % exchanged half-way": ("changed", "shifted:5%,after=0.5"),
    "wires of 20 % exchanged after a third": ("changed", "shifted:20%,after=0.33"),
    "two regions touched one after the other": ("separate-regions", "separate-regions"),
    "sines of one period": ("one-period", "cycling:*"),
}
"""Kind of the finding that is right, and fault as for `simulation.inject`, by what it does.

``{sd}`` stands for one standard deviation of the median sensor as a share of the range of the
recording, times the number after it.
"""


SOUND = (
    *BODIES,
    ("hand", "pressing"),
    ("plane", "pulses"),
    ("plane", "roller"),
    ("cube", "rubbing"),
)
VARIANTS = {
    "exact": "",
    "noise of 1 %": "noisy:*,level=0.01",
    "16 levels": "quantised:*",
    "binary": "thresholded:*",
}
"""Forms of sound recordings, in which whatever is found is a false alarm."""


ALARMS = ("with a fault", "sensors", "called faulty")
"""What is counted in sound recordings."""

STATES = ("undamaged", "damaged", "repaired")
"""Of recordings, whose maps are scored."""


@dataclass(frozen=True)
class Result:
    """Findings about a damaged recording, and the accuracy of its maps."""

    recording: str
    damage: str
    found: bool
    falsely_found: str
    undamaged: float
    damaged: float
    repaired: float
    share_of_sensors: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Damage, examine, repair and map all recordings, and write the results."""
    parser = options(__doc__, "faults", seeds=2, workers=True)
    chosen = parser.parse_args(arguments)
    seeds = range(FIRST_SEED, FIRST_SEED + chosen.seeds)
    sources: list[tuple[tuple[str, str], int] | Path]
    sources = [*((body, seed) for seed in seeds for body in BODIES), *files_in(chosen.recordings)]
    results: list[Result] = []
    for found in in_parallel(examined, sources, chosen.workers):
        results += found
        write_rows(chosen.output / "faults.csv", results)
    text = "\n".join([table(results), false_alarms(seeds), clean_table(seeds, chosen.workers)])
    (chosen.output / "faults-table.md").write_text(text, encoding="utf-8")
    print(text)


def examined(source: tuple[tuple[str, str], int] | Path) -> list[Result]:
    """Examine a recording, or a simulated skin that is wired at random, with every damage."""
    if isinstance(source, Path):
        recording = anisomap.read(source)
        if recording.positions is None or not np.isfinite(recording.positions).all():
            return []
        return list(
            examinations(source.stem, recording, 1, spanned_dimensions(recording.positions))
        )
    (body, scenario), seed = source
    recording = anisomap.simulate(body, scenario, n_frames=FRAMES, seed=seed)
    order = np.random.default_rng(seed).permutation(recording.n_sensors)
    name = f"{body}, {scenario}, seed {seed}"
    return list(examinations(name, recording.select(order), seed, dimensions=3))


def examinations(
    name: str, recording: anisomap.Recording, seed: int, dimensions: int
) -> Iterator[Result]:
    """Yield the result of a sound recording, and of each damage."""
    sound = accuracy(recording, dimensions)
    kinds = sorted({one.kind for one in anisomap.find_faults(recording)})
    yield Result(
        name, "none", found=False, falsely_found=" ".join(kinds), undamaged=sound,
        damaged=sound, repaired=sound, share_of_sensors=1.0,
    )  # fmt: skip
    for text, (kind, fault) in DAMAGES.items():
        try:
            damaged = inject(recording, sized(fault, recording), rng=seed)
        except anisomap.InputError:
            continue  # no positions or times
        repaired = anisomap.repair(damaged)
        found = {one.kind for one in repaired.findings}
        yield Result(
            recording=name,
            damage=text,
            found=kind in found,
            falsely_found=" ".join(sorted(found - {kind})),
            undamaged=sound,
            damaged=accuracy(damaged, dimensions),
            repaired=accuracy(repaired.recording, dimensions),
            share_of_sensors=repaired.recording.n_sensors / recording.n_sensors,
        )


def sized(fault: str, recording: anisomap.Recording) -> str:
    """Replace a level in standard deviations by a share of the range."""
    before, mark, number = fault.partition("{sd}")
    if not mark:
        return fault
    deviation = float(np.median(recording.readings.std(axis=0)))
    return f"{before}{float(number) * deviation / float(np.ptp(recording.readings)):.6f}"


def accuracy(recording: anisomap.Recording, dimensions: int) -> float:
    """Return the Mantel r of a map of a recording; NaN if there is none."""
    try:
        made = anisomap.reconstruct(recording.complete("interpolate"), dimensions=dimensions)
        return anisomap.score(made, np.asarray(recording.positions), permutations=0).mantel.r
    except anisomap.InputError:
        return math.nan


def table(results: Sequence[Result]) -> str:
    """Return a table of all damages, one line each."""
    rows = (
        {
            "fault": text,
            "recordings": len(group),
            "found": "-" if text == "none" else group.found.sum(),
            "something else found": (group.falsely_found != "").sum(),
            **{f"r {what}": f"{group[what].median():.3f}" for what in STATES},
            "worst loss after repair": f"{(group.undamaged - group.repaired).max():.3f}",
            "sensors mapped": f"{group.share_of_sensors.mean():.0%}",
        }
        for text, group in frame(results).groupby("damage", sort=False)
    )
    return "\n".join(keyed_table(rows)) + "\n"


def alarms(
    recording: anisomap.Recording, allowed: frozenset[str] = frozenset()
) -> dict[str, object]:
    """Return whether faults are found in a sound recording, its sensors, and the faulty ones."""
    faulty = sum(is_faulty(sensor.status) for sensor in anisomap.assess(recording))
    kinds = {one.kind for one in anisomap.find_faults(recording)} - allowed
    return dict(zip(ALARMS, (bool(kinds), recording.n_sensors, faulty), strict=True))


def false_alarms(seeds: Sequence[int]) -> str:
    """Return a table of the faults and faulty sensors that are found in sound recordings."""
    rows = []
    for seed, (body, scenario) in product(seeds, SOUND):
        recording = anisomap.simulate(body, scenario, n_frames=FRAMES, seed=seed)
        order = np.random.default_rng(seed).permutation(recording.n_sensors)
        for text, fault in VARIANTS.items():
            sound = recording.select(order)
            if fault:
                sound = inject(sound, fault, rng=seed)
            rows.append({"scenario": scenario, "form": text, **alarms(sound)})
    return counts_table("simulated skins without faults", rows, {"scenario": "", "form": ""})


def clean_table(seeds: Sequence[int], workers: int) -> str:
    """Return a table of what is found in clean recordings of few and of many contacts."""
    rows = measured(accused, [*product(cases(), seeds)], workers)
    rows.sort(key=lambda row: (row["n_frames"], row["n_sensors"]))
    units = {"course": "", "form": "", "n_frames": " frames", "n_sensors": " sensors"}
    return counts_table("clean recordings of round contacts", rows, units)


def accused(drawn: tuple[Case, int]) -> list[dict[str, Any]]:
    """Return what is found in a clean recording, beside the case."""
    case, seed = drawn
    return [{**case._asdict(), **alarms(case.draw(seed), TRUE_OF_CLEAN)}]


def counts_table(
    title: str, recordings: Sequence[Mapping[str, object]], units: Mapping[str, str]
) -> str:
    """Return a table of recordings with a fault, and of sensors called faulty, by some columns."""
    rows = (
        {title: f"{value}{unit}", "number": len(group), **group[[*ALARMS]].sum()}
        for column, unit in units.items()
        for value, group in pd.DataFrame(recordings).groupby(column, sort=False)
    )
    return "\n".join(keyed_table(rows)) + "\n"


if __name__ == "__main__":
    main()
