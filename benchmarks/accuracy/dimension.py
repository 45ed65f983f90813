"""Number of dimensions that is chosen for skins of several shapes.

Skins are those of `benchmarks.skins.independent`: each seed stimulates every body in another way. A
cylinder can be rolled out, and may be mapped in 2D or 3D. Real recordings are read from folders.
The output is a table in Markdown and all results as CSV.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass

import numpy as np

import anisomap
from anisomap.errors import InputError
from benchmarks.accuracy.compare import MIN_TOUCHES, spanned_dimensions, touched
from benchmarks.harness import columns, files_in, markdown_table, options, stream
from benchmarks.skins.independent import FLAT, SOLID, Case, drawn, make

FIRST_SEED = 801
BODIES = (*FLAT, "strip:rows=1,n=24", *SOLID)
ROLLED_OUT = "cylinder"
LONGEST = 4000

OUTCOMES = ("right", "not clear", "wrong")
ANSWERS = ("line", "2", "3", "not clear")


@dataclass(frozen=True)
class Row:
    """One recording.

    body, stimulation: For real recordings the name of the file, and "real".
    true: Dimensions that the true positions span.
    answer: One of `ANSWERS`: a map in 2 dimensions with a note that the sensors lie along a line, a
        map in 2 or 3 dimensions, or one in 3 with a note that their number is not clear.
    """

    body: str
    stimulation: str
    transducer: str
    seed: int
    n_sensors: int
    n_frames: int
    true: int
    answer: str

    @property
    def outcome(self) -> str:
        """One of `OUTCOMES`."""
        if self.answer == "not clear":
            return "not clear"
        right = ["line" if self.true == 1 else str(self.true)]
        right += ["2"] if self.body == ROLLED_OUT else []
        return "right" if self.answer in right else "wrong"


def main(arguments: Sequence[str] | None = None) -> int:
    """Map all skins and write the results."""
    parser = options(__doc__, "dimension", seeds=6, first_seed=FIRST_SEED)
    chosen = parser.parse_args(arguments)
    rows = stream(chosen.output / "dimension.csv", _rows(chosen))
    (chosen.output / "dimension-table.md").write_text(markdown(rows), encoding="utf-8")
    return 0


def markdown(rows: Sequence[Row]) -> str:
    """Return the answers and outcomes by shape, and all that are not right."""
    shapes: dict[tuple[str, object], list[Row]] = {}
    simulated = [row for row in rows if row.stimulation != "real"]
    for row in simulated:
        shapes.setdefault((row.body, row.true), []).append(row)
    lines = []
    if simulated:
        shapes["all", ""] = simulated
        counts = ((*shape, *_counts(found)) for shape, found in shapes.items())
        lines = [*markdown_table(("shape", "true", "skins", *ANSWERS, *OUTCOMES), counts), ""]
    listed = [row for row in rows if row.outcome == "wrong" or row.stimulation == "real"]
    lines += ["Simulated skins with a wrong answer, and all real ones:", ""]
    lines += markdown_table(columns(Row), map(astuple, listed))
    return "\n".join(lines) + "\n"


def _counts(rows: Sequence[Row]) -> tuple[int, ...]:
    answers, outcomes = Counter(row.answer for row in rows), Counter(row.outcome for row in rows)
    return (len(rows), *map(answers.__getitem__, ANSWERS), *map(outcomes.__getitem__, OUTCOMES))


def _rows(chosen: argparse.Namespace) -> Iterator[Row]:
    for path in files_in(chosen.recordings):
        recording = anisomap.read(path)
        if recording.positions is None:
            raise InputError(f"{path.stem} has no true positions")
        known = recording.select(touched(recording, MIN_TOUCHES))
        yield _row(known, Case(path.stem, "real", "", "", known.n_frames, 0))
    for seed in range(chosen.first_seed, chosen.first_seed + chosen.seeds):
        for body in BODIES:
            case = drawn(seed, body=body, longest=LONGEST)
            yield _row(make(case), case)


def _row(recording: anisomap.Recording, case: Case) -> Row:
    made = anisomap.reconstruct(recording.complete("interpolate"), dimensions="auto")
    notes = " ".join(map(str, made.notes))
    answer = "line" if "along a line" in notes else str(made.dimensions)
    if "whether the skin is flat" in notes:
        answer = "not clear"
    true = spanned_dimensions(np.asarray(recording.positions))
    return Row(
        case.body, case.stimulation, case.transducer, case.seed, recording.n_sensors,
        recording.n_frames, true, answer,
    )  # fmt: skip


if __name__ == "__main__":
    raise SystemExit(main())
