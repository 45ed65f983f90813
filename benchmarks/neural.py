"""What maps of electrodes are worth, by the length of the recording (part of ``make quality``).

Recordings of electrodes, whose names begin with eeg or retina, are cut to their first eighth,
quarter, half and whole. The table compares the default method with r-ANISOMAP and the best stock
method, and its verdict, which is made without the positions, with the true error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import anisomap
from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.comparison import RIVALS, compare_methods
from benchmarks.harness import files_in, markdown_table, measured, options, publish

NAMES = ("eeg", "retina")
SHARES = tuple(Fraction(1, part) for part in (8, 4, 2, 1))


@dataclass(frozen=True)
class Row:
    """Scores of the maps of the beginning of a recording.

    r, error, kept: Mantel r, RMS error in spacings and share of neighbours kept, by default.
    level, expected: The verdict, and the error in spacings that it expects.
    """

    recording: str
    frames: int
    dimensions: int
    scored: int
    r: float
    error: float
    kept: float
    level: str
    expected: float
    paper: float
    stock: str
    stock_r: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Map all recordings of electrodes and write the table."""
    chosen = options(__doc__, "quality", workers=True).parse_args(arguments)
    files = [path for path in files_in(chosen.recordings) if path.stem.startswith(NAMES)]
    rows = measured(rows_of, files, chosen.workers)
    publish(chosen.output, "neural", rows, table(rows))


def rows_of(path: Path) -> list[Row]:
    """Map the beginnings of a recording."""
    whole = anisomap.read(path)
    rows = []
    for share in SHARES:
        n_frames = int(whole.n_frames * share)
        part = anisomap.Recording(
            whole.readings[:n_frames], positions=whole.positions, rate_hz=whole.rate_hz
        )
        compared = compare_methods(part, (DEFAULT_METHOD, "r-anisomap", *RIVALS))
        own, paper, *_ = compared.scores
        stock = compared.best(stock=True)
        if own.sensor_map is None or stock is None:
            print(f"skipped {n_frames} frames of {path.stem}: {own.reason}")
            continue
        mapped = part.select([part.names.index(name) for name in own.sensor_map.names])
        verdict = anisomap.diagnose(own.sensor_map, mapped, rng=0).verdict
        kept = anisomap.score(own.sensor_map, mapped, permutations=0).neighbours_kept
        rows.append(
            Row(path.stem, n_frames, compared.dimensions, len(compared.sensors), own.mantel_r,
                own.rms_in_spacings, kept, verdict.level, verdict.expected_error, paper.mantel_r,
                stock.method, stock.mantel_r)
        )  # fmt: skip
    return rows


def table(rows: Sequence[Row]) -> str:
    """Format the rows as a table."""
    header = (
        "recording", "frames", "map", "scored", "default", "error", "neighbours kept", "verdict",
        "expected error", "r-anisomap", "best stock method",
    )  # fmt: skip
    cells = [
        (
            row.recording, f"{row.frames:,}", f"{row.dimensions}D", row.scored, f"{row.r:.3f}",
            f"{row.error:.2f}", f"{row.kept:.0%}", row.level, f"{row.expected:.2f}",
            f"{row.paper:.3f}", f"{row.stock_r:.3f} ({row.stock})",
        )
        for row in rows
    ]  # fmt: skip
    return "\n".join(markdown_table(header, cells)) + "\n"


if __name__ == "__main__":
    main()
