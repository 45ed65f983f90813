"""Number of dimensions that is chosen for skins of several shapes (``make dimension``).

Skins are simulated on seeds that were not used for tuning (1 to 720 were); each seed stimulates a
shape by another scenario. Real recordings are read from folders. The number of dimensions of a skin
is that of its true positions, except for skins that can be rolled out: those have 2. The output is
a table in Markdown and all results as CSV. All methods choose alike; r-ANISOMAP is the fastest.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass

import numpy as np

import anisomap
from anisomap.base.defaults import MIN_TOUCHES
from anisomap.errors import InputError
from anisomap.evaluation.compare import spanned_dimensions, touched
from anisomap.numerics.graph.dissimilarity import regularised_reciprocal
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.similarity.correlation import pearson
from anisomap.recording import Recording
from anisomap.simulation import BODIES, Body, find_body, find_scenario, simulate, solids
from anisomap.simulation.bodies import CYLINDER_LENGTH, CYLINDER_RADIUS, covered, midpoints
from benchmarks.harness import files_in, markdown_table, options, stream

FIRST_SEED = 721
FRAMES = 1000
SCENARIOS = ("bombardment", "rubbing", "pressing", "roller", "pulses", "locomotion")

OUTCOMES = ("right", "not clear", "wrong")
ANSWERS = ("line", "2", "3", "not clear")
HEADER = (
    "skin", "scenario", "seed", "sensors", "frames", "true", "answer", "largest drop", "elbow at 1",
    "elbow at 2", "elbow at 3",
)  # fmt: skip


def largest_drop(recording: Recording) -> int:
    """Choose the dimensions before the largest drop in the variance of classical scaling.

    Pierce & Kuipers (1997), "Map learning with uninterpreted sensors and effectors", Artificial
    Intelligence 92: 169-227, doi:10.1016/S0004-3702(96)00051-3; on the metric of r-ANISOMAP.
    """
    similarity = pearson(recording.readings[:, recording.varying()])
    squares = metricise(regularised_reciprocal(similarity)).astype(np.float64) ** 2
    rows = squares.mean(axis=0)
    inner = -(squares - np.add.outer(rows, rows) + rows.mean()) / 2
    return int(np.argmax(np.diff(np.linalg.eigvalsh(inner))[::-1])) + 1


@dataclass(frozen=True)
class Row:
    """One recording.

    body, scenario: For real recordings the name of the file, and "real".
    true: Dimensions that the true positions span, or that they have if they are rolled out.
    answer: One of `ANSWERS`: a map in 2 dimensions with a note that the sensors lie along a line, a
        map in 2 or 3 dimensions, or one in 3 with a note that their number is not clear.
    largest_drop: Dimensions by Pierce & Kuipers' rule, on the metric of r-ANISOMAP.
    elbow_1, elbow_2, elbow_3: Of the stress; NaN if the metric was not examined.
    """

    body: str
    scenario: str
    seed: int
    n_sensors: int
    n_frames: int
    true: int
    answer: str
    largest_drop: int
    elbow_1: float
    elbow_2: float
    elbow_3: float

    @property
    def outcome(self) -> str:
        """One of `OUTCOMES`."""
        if self.answer == "not clear":
            return "not clear"
        return "right" if self.answer == ("line" if self.true == 1 else str(self.true)) else "wrong"


def flat(name: str, columns: int, rows: int) -> Body:
    """Make a plate of 2 m with a lattice of sensors on its upper face."""
    spacing, height = 2 / columns, 0.1
    x, y = np.meshgrid(midpoints(columns, 2), midpoints(rows, rows * spacing), indexing="ij")
    positions = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height / 2)])
    normals = np.tile([0.0, 0.0, 1.0], (x.size, 1))
    return Body(name, positions, normals, [solids.box((1, rows * spacing / 2, height / 2))])


def half_cylinder() -> Body:
    """Make a cylinder with sensors on half of its side."""
    solid = solids.cylinder(CYLINDER_RADIUS, CYLINDER_LENGTH / 2)
    top = CYLINDER_LENGTH / 2 - 1e-9
    return covered("half-cylinder", [solid], 60, lambda p: (p[:, 0] > 0) & (np.abs(p[:, 2]) < top))


ROLLED_OUT: Mapping[str, Body] = {
    "line": flat("line", 24, 1),
    "strip": flat("strip", 20, 3),
    "half-cylinder": half_cylinder(),
}
"""Shapes that can be rolled out, beside those in `BODIES`."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Map all skins and write the results."""
    parser = options(__doc__, "dimension", seeds=20, first_seed=FIRST_SEED)
    parser.add_argument("--scenarios", nargs="*", default=SCENARIOS)
    chosen = parser.parse_args(arguments)
    rows = stream(chosen.output / "dimension.csv", _rows(chosen))
    (chosen.output / "dimension-table.md").write_text(markdown(rows), encoding="utf-8")
    return 0


def markdown(rows: Sequence[Row]) -> str:
    """Return the answers and outcomes by shape, and all that are not right."""
    simulated = [row for row in rows if row.scenario != "real"]
    real = [row for row in rows if row.scenario == "real"]
    lines = []
    if simulated:
        seeds = sorted({row.seed for row in simulated})
        shapes: dict[tuple[str, object], list[Row]] = {}
        for row in simulated:
            shapes.setdefault((row.body, row.true), []).append(row)
        shapes["all", ""] = simulated
        lines = [
            f"Simulated skins, seeds {seeds[0]} to {seeds[-1]}, {simulated[0].n_frames} frames.",
            "",
            *markdown_table(
                ("shape", "true", "skins", *ANSWERS, *OUTCOMES, "largest drop is right"),
                ((*shape, *_counts(found)) for shape, found in shapes.items()),
            ),
            "",
        ]
    listed = [*(row for row in simulated if row.outcome == "wrong"), *real]
    if listed:
        lines += [
            "Simulated skins with a wrong answer, and all real ones. Elbows: see the text.",
            "",
        ]
        cells = (
            (*astuple(row)[:2], row.seed or "", *astuple(row)[3:8],
             *(f"{elbow:.2f}" for elbow in astuple(row)[8:]))
            for row in listed
        )  # fmt: skip
        lines += markdown_table(HEADER, cells)
    return "\n".join(lines) + "\n"


def _counts(rows: Sequence[Row]) -> tuple[int, ...]:
    answers, outcomes = Counter(row.answer for row in rows), Counter(row.outcome for row in rows)
    dropped = sum(row.largest_drop == row.true for row in rows)
    return (len(rows), *map(answers.get, ANSWERS, 4 * [0]), *map(outcomes.get, OUTCOMES, 3 * [0]),
            dropped)  # fmt: skip


def _rows(chosen: argparse.Namespace) -> Iterator[Row]:
    for path in files_in(chosen.recordings):
        recording = anisomap.read(path)
        if recording.positions is None:
            raise InputError(f"{path.stem} has no true positions")
        true = spanned_dimensions(recording.positions)
        yield _row(recording.select(touched(recording, MIN_TOUCHES)), path.stem, "real", 0, true)
    shapes = {**ROLLED_OUT, **{name: find_body(name) for name in BODIES}}
    for seed in range(chosen.first_seed, chosen.first_seed + chosen.seeds):
        for name, body in shapes.items():
            accepted = [s for s in chosen.scenarios if _is_touched(name, body, s)]
            scenario = accepted[seed % len(accepted)]
            true = spanned_dimensions(body.positions) if name != "half-cylinder" else 2
            recording = simulate(body, scenario, n_frames=FRAMES, seed=seed)
            yield _row(recording, name, scenario, seed, true)


def _is_touched(name: str, body: Body, scenario: str) -> bool:
    """Whether a scenario touches a body on its skin."""
    rolls_on_its_back = name == "half-cylinder" and scenario == "locomotion"
    return find_scenario(scenario).accepts(body) and not rolls_on_its_back


def _row(recording: anisomap.Recording, body: str, scenario: str, seed: int, true: int) -> Row:
    complete = recording.complete()
    made = anisomap.reconstruct(complete, "r-anisomap", dimensions="auto")
    unclear = any("whether the skin is flat" in note for note in made.notes)
    along = any("along a line" in note for note in made.notes)
    answer = "not clear" if unclear else "line" if along else str(made.dimensions)
    drop = largest_drop(complete)
    elbows = [float(made.provenance.get(f"elbow_{k}", np.nan)) for k in (1, 2, 3)]
    n_sensors, n_frames = int(np.count_nonzero(made.placed)), recording.n_frames
    return Row(body, scenario, seed, n_sensors, n_frames, true, answer, drop, *elbows)


if __name__ == "__main__":
    raise SystemExit(main())
