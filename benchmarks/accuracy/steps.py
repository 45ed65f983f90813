"""What each step of the default method earns.

The default method maps recordings without one of its steps at a time. The tables hold, for each
kind of recording, the mean Mantel r and RMS error in spacings, and the mean CPU time of a map. The
kinds that are simulated have seeds that were not used for tuning; the real recordings were used.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import call
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import anisomap
from anisomap.base import DEFAULT_METHOD
from anisomap.method import evidence, refinement
from anisomap.method.named import METHODS, Method
from anisomap.method.pipeline import reconstruct_with_stages
from anisomap.method.refinement import Refinement, refine
from anisomap.recording import Recording
from benchmarks.accuracy.compare import MIN_TOUCHES, spanned_dimensions, touched
from benchmarks.harness import files_in, frame, markdown_table, measured, options, publish
from benchmarks.skins.corrections import read_corrected

FIRST_SEED = 831
N_FRAMES = 2000
SIMULATED = (
    ("bombarded", "sphere", "bombardment"),
    ("bombarded", "hand", "bombardment"),
    ("bombarded", "hemisphere", "bombardment"),
    ("rolled cylinder", "cylinder", "locomotion"),
    ("rolled sphere", "sphere", "locomotion"),
    ("rubbed", "sphere", "rubbing"),
    ("rubbed", "hand", "rubbing"),
    ("rubbed", "hexagon", "rubbing"),
)
REAL = {
    "icub": "iCub, real", "nao": "Nao, real", "insole": "feet, real", "plantar": "feet, real",
    "retina": "retinas, real", "eeg": "EEG, real",
}  # fmt: skip
"""Kind by the beginning of the name of the file."""

_DEFAULT = METHODS[DEFAULT_METHOD]


@dataclass(frozen=True)
class Row:
    """Score of one map, of the sensors in its largest component; cpu in seconds."""

    kind: str
    recording: str
    left_out: str
    r: float
    error: float
    cpu: float


def _without_paths(*stages: Any) -> Refinement | None:
    refined = refine(*stages)
    return refined and replace(refined, positions=refined.fit.positions, path_weight=0.0)


def _without_weight(*stages: Any) -> Refinement | None:
    with patch.object(refinement, "_METRIC_SHARE", 0.0):
        return refine(*stages)


VARIANTS: Mapping[str, Method] = {
    "nothing": _DEFAULT,
    "common signal": _DEFAULT,
    "kappa": replace(_DEFAULT, contact_similarity=None),
    "weight of the metric": replace(_DEFAULT, refine=_without_weight),
    "paths": replace(_DEFAULT, refine=_without_paths),
    "refinement": replace(_DEFAULT, refine=lambda *_: None),
}
"""Methods by what they leave out of the default method."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Map all recordings and write the results."""
    parser = options(__doc__, "quality", seeds=4, first_seed=FIRST_SEED, workers=True)
    chosen = parser.parse_args(arguments)
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.seeds)
    sources: list[Callable[[], list[Row]]] = [
        partial(rows_of_simulation, *skin, seed) for seed in seeds for skin in SIMULATED
    ]
    sources += [partial(rows_of_file, path) for path in files_in(chosen.recordings)]
    rows = measured(call, sources, chosen.workers)
    publish(chosen.output, "steps", rows, tables(rows))


def rows_of_simulation(kind: str, body: str, scenario: str, seed: int) -> list[Row]:
    """Simulate a skin and map it by all variants; rubbed skins as on or off, too."""
    recording = anisomap.simulate(body, scenario, n_frames=N_FRAMES, seed=seed)
    name = f"{body}, {scenario}, seed {seed}"
    rows = rows_of(kind, name, recording)
    if kind == "rubbed":
        on = (np.asarray(recording.readings) > 0).astype(np.float32)
        rows += rows_of(f"{kind}, on or off", name, Recording(on, positions=recording.positions))
    if kind == "bombarded":
        rows += rows_of(f"{kind}, common signal", name, _with_common_signal(recording, seed))
    return rows


def _with_common_signal(recording: Recording, seed: int) -> Recording:
    """Add a smooth signal to all sensors, with the standard deviation of their readings."""
    readings = np.asarray(recording.readings)
    rng = np.random.default_rng(seed)
    signal = np.convolve(rng.standard_normal(len(readings) + 20), np.hanning(21), "valid")
    added = readings + (signal / signal.std() * readings.std())[:, None]
    return Recording(added.astype(np.float32), positions=recording.positions)


def rows_of_file(path: Path) -> list[Row]:
    """Map a recording with known positions by all variants."""
    kind = next(
        (kind for start, kind in REAL.items() if path.stem.startswith(start)), "other, real"
    )
    return rows_of(kind, path.stem, read_corrected(path))


def rows_of(kind: str, name: str, recording: Recording) -> list[Row]:
    """Map a recording by all variants."""
    part = recording.select(np.flatnonzero(touched(recording, MIN_TOUCHES)))
    truth = np.asarray(part.positions)
    dimensions = spanned_dimensions(truth)
    rows = []
    for left_out, recipe in VARIANTS.items():
        started = time.process_time()
        with patch.object(evidence, "SIMILARITIES", _similarities(left_out)):
            made, _ = reconstruct_with_stages(part, dimensions=dimensions, recipe=recipe)
        cpu = time.process_time() - started
        found = anisomap.score(made, truth, permutations=0)
        rows.append(Row(kind, name, left_out, found.mantel.r, found.rms_in_spacings, cpu))
    return rows


def _similarities(left_out: str) -> Mapping[str, evidence.Similarity]:
    if left_out != "common signal":
        return evidence.SIMILARITIES
    plain = replace(evidence.SIMILARITIES[_DEFAULT.similarity], centred=False)
    return {**evidence.SIMILARITIES, _DEFAULT.similarity: plain}


def tables(rows: Sequence[Row]) -> str:
    """Return the table of accuracy and that of CPU time."""
    scores, times = [], []
    for kind, group in sorted(
        frame(rows).groupby("kind"), key=lambda one: ("real" in one[0], one[0])
    ):
        means = group.groupby("left_out")[["r", "error", "cpu"]].mean().loc[[*VARIANTS]]
        label = (kind, len(group) // len(VARIANTS))
        scores.append((*label, *(f"{one.r:.3f} ({one.error:.2f})" for one in means.itertuples())))
        times.append((*label, *(f"{cpu:.2f}" for cpu in means.cpu)))
    header = ("kind", "recordings", *VARIANTS)
    return "\n".join(
        [
            "### Mantel r (error in spacings) without one step", "",
            *markdown_table(header, scores), "",
            "### CPU seconds of a map without one step", "",
            *markdown_table(header, times), "",
        ]
    )  # fmt: skip


if __name__ == "__main__":
    main()
