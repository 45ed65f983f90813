"""Number of dimensions that is chosen for skins, and errors of maps (``make dimension``).

Skins are simulated on seeds that were not used for tuning (1 to 300 were); real recordings are read
from folders. The number of dimensions of a skin is that of its true positions. The output is a
table in Markdown and all results as CSV. All methods choose alike; r-ANISOMAP is the fastest.
"""

from __future__ import annotations

import argparse
import csv
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

import anisomap
from anisomap.comparison import spanned_dimensions, touched
from anisomap.errors import InputError
from anisomap.simulation import BODIES, SCENARIOS, find_body, find_scenario, simulate

FIRST_SEED = 611
FRAMES = 1000
MIN_TOUCHES = 5
"""Sensors of real skins that were touched less often have no position on any map."""

OUTCOMES = ("right", "not clear", "wrong")


@dataclass(frozen=True)
class Row:
    """One recording.

    Attributes
    ----------
    body, scenario : str
        Body and scenario; name of the file and "real" for real recordings.
    seed, n_sensors, n_frames : int
    true : int
        Dimensions that the true positions span.
    chosen : int
        Dimensions of the map.
    outcome : str
        One of `OUTCOMES`; "not clear" if the map has a note that says so.
    elbow_2, elbow_3 : float
        See `anisomap.numerics.scaling.dimension.DimensionChoice.elbow`.
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
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--recordings", type=Path, nargs="*", default=[])
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--scenarios", nargs="*", default=list(SCENARIOS))
    chosen = parser.parse_args(arguments)
    chosen.output.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    with threadpool_limits(1):
        for row in _rows(chosen):
            print(*astuple(row), flush=True)
            rows.append(row)
            _write(rows, chosen.output)
    return 0


def _write(rows: Sequence[Row], folder: Path) -> None:
    with (folder / "dimension.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow([field.name for field in fields(Row)])
        table.writerows(astuple(row) for row in rows)
    (folder / "dimension-table.md").write_text(markdown(rows), encoding="utf-8")


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
            "| scenario | dimensions | skins | right | not clear | wrong |",
            "|---|---|---|---|---|---|",
        ]
        groups = sorted({(row.scenario, row.true) for row in simulated})
        for scenario, true in groups:
            found = [row for row in simulated if (row.scenario, row.true) == (scenario, true)]
            lines.append(f"| {scenario} | {true} | {_counts(found)} |")
        lines += [f"| all | | {_counts(simulated)} |", ""]
    listed = [*(row for row in simulated if row.outcome != "right"), *real]
    if listed:
        lines += [
            "All real skins, and the simulated ones that are not right. Elbows: see the text.",
            "",
            "| skin | scenario | seed | sensors | frames | true | chosen | outcome | elbow at 2 "
            "| elbow at 3 |",
            "|---|---|---|---|---|---|---|---|---|---|",
        ]
        lines += [
            f"| {row.body} | {row.scenario} | {row.seed or ''} | {row.n_sensors} | "
            f"{row.n_frames} | {row.true} | {row.chosen} | {row.outcome} | {row.elbow_2:.2f} | "
            f"{row.elbow_3:.3f} |"
            for row in listed
        ]
    return "\n".join(lines) + "\n"


def _counts(rows: Sequence[Row]) -> str:
    outcomes = [row.outcome for row in rows]
    return " | ".join(str(n) for n in (len(rows), *map(outcomes.count, OUTCOMES)))


def _rows(chosen: argparse.Namespace) -> Iterator[Row]:
    for folder in chosen.recordings:
        for path in sorted(folder.glob("*.npz")):
            recording = anisomap.read(path)
            known = touched(recording, MIN_TOUCHES)
            yield _row(recording.select(known), path.stem, "real", 0)
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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the notes remain on the map
        made = anisomap.reconstruct(recording.complete(), "r-anisomap", dimensions="auto")
    true = spanned_dimensions(recording.positions)
    unclear = any("whether the skin is flat" in note for note in made.notes)
    outcome = "not clear" if unclear else "right" if made.dimensions == true else "wrong"
    elbows = [float(made.provenance.get(f"elbow_{k}", np.nan)) for k in (2, 3)]
    n_sensors, n_frames = int(np.count_nonzero(made.placed)), recording.n_frames
    return Row(body, scenario, seed, n_sensors, n_frames, true, made.dimensions, outcome, *elbows)


if __name__ == "__main__":
    raise SystemExit(main())
