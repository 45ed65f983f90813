"""Number of dimensions that is chosen for skins, and errors of maps (``make dimension``).

Skins are simulated on seeds that were not used for tuning (1 to 300 were); real recordings are read
from folders. The number of dimensions of a skin is that of its true positions. The output is a
table in Markdown and all results as CSV. All methods choose alike; r-ANISOMAP is the fastest.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass

import numpy as np

import anisomap
from anisomap.comparison import spanned_dimensions, touched
from anisomap.errors import InputError
from anisomap.simulation import BODIES, SCENARIOS, find_body, find_scenario, simulate
from benchmarks.harness import files_in, heading, line, markdown_table, options, quietly, write_rows

FIRST_SEED = 611
FRAMES = 1000
MIN_TOUCHES = 5
"""Sensors of real skins that were touched less often have no position on any map."""

OUTCOMES = ("right", "not clear", "wrong")
HEADER = (
    "skin", "scenario", "seed", "sensors", "frames", "true", "chosen", "outcome", "elbow at 2",
    "elbow at 3",
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One recording.

    body, scenario: For real recordings the name of the file, and "real".
    true: Dimensions that the true positions span.
    chosen: Dimensions of the map.
    outcome: One of `OUTCOMES`; "not clear" if the map has a note that says so.
    elbow_2, elbow_3: See `DimensionChoice.elbow`.
    """

    body: str
    scenario: str
    seed: int
    n_sensors: int
    n_frames: int
    true: int
    chosen: int
    outcome: str
    elbow_2: float
    elbow_3: float


def main(arguments: Sequence[str] | None = None) -> int:
    """Map all skins and write the results."""
    parser = options(__doc__, "dimension", seeds=2, first_seed=FIRST_SEED)
    parser.add_argument("--scenarios", nargs="*", default=list(SCENARIOS))
    chosen = parser.parse_args(arguments)
    rows: list[Row] = []
    with quietly():
        for row in _rows(chosen):
            print(*astuple(row), flush=True)
            rows.append(row)
            write_rows(chosen.output / "dimension.csv", rows)
            (chosen.output / "dimension-table.md").write_text(markdown(rows), encoding="utf-8")
    return 0


def markdown(rows: Sequence[Row]) -> str:
    """Return the numbers of outcomes by dimensions and scenario, and all that are not right."""
    simulated = [row for row in rows if row.scenario != "real"]
    real = [row for row in rows if row.scenario == "real"]
    seeds = sorted({row.seed for row in simulated})
    frames = sorted({row.n_frames for row in simulated})
    lines = []
    if simulated:
        lines = [
            f"Simulated skins, seeds {', '.join(map(str, seeds))}, "
            f"{', '.join(map(str, frames))} frames.",
            "",
            *heading(("scenario", "dimensions", "skins", *OUTCOMES)),
        ]
        groups = sorted({(row.scenario, row.true) for row in simulated})
        for scenario, true in groups:
            found = [row for row in simulated if (row.scenario, row.true) == (scenario, true)]
            lines.append(line((scenario, true, *_counts(found))))
        lines += [line(("all", "", *_counts(simulated))), ""]
    listed = [*(row for row in simulated if row.outcome != "right"), *real]
    if listed:
        lines += [
            "All real skins, and the simulated ones that are not right. Elbows: see the text.",
            "",
        ]
        cells = (
            (*astuple(row)[:2], row.seed or "", *astuple(row)[3:8], f"{row.elbow_2:.2f}",
             f"{row.elbow_3:.3f}")
            for row in listed
        )  # fmt: skip
        lines += markdown_table(HEADER, cells)
    return "\n".join(lines) + "\n"


def _counts(rows: Sequence[Row]) -> tuple[int, ...]:
    outcomes = [row.outcome for row in rows]
    return (len(rows), *map(outcomes.count, OUTCOMES))


def _rows(chosen: argparse.Namespace) -> Iterator[Row]:
    for path in files_in(chosen.recordings):
        recording = anisomap.read(path)
        yield _row(recording.select(touched(recording, MIN_TOUCHES)), path.stem, "real", 0)
    bodies = {name: find_body(name) for name in BODIES}
    for seed in range(chosen.first_seed, chosen.first_seed + chosen.seeds):
        for scenario in chosen.scenarios:
            for name, body in bodies.items():
                if find_scenario(scenario).accepts(body):
                    recording = simulate(body, scenario, n_frames=FRAMES, seed=seed)
                    yield _row(recording, name, scenario, seed)


def _row(recording: anisomap.Recording, body: str, scenario: str, seed: int) -> Row:
    if recording.positions is None:
        raise InputError(f"{body} has no true positions")
    made = anisomap.reconstruct(recording.complete(), "r-anisomap", dimensions="auto")
    true = spanned_dimensions(recording.positions)
    unclear = any("whether the skin is flat" in note for note in made.notes)
    outcome = "not clear" if unclear else "right" if made.dimensions == true else "wrong"
    elbows = [float(made.provenance.get(f"elbow_{k}", np.nan)) for k in (2, 3)]
    n_sensors, n_frames = int(np.count_nonzero(made.placed)), recording.n_frames
    return Row(body, scenario, seed, n_sensors, n_frames, true, made.dimensions, outcome, *elbows)


if __name__ == "__main__":
    raise SystemExit(main())
