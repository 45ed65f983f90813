"""Time every stage and whole maps against other libraries (``make bench``).

Results are checked before they are timed; the command fails if one is wrong.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import astuple
from pathlib import Path

from benchmarks.harness import columns, write_csv
from benchmarks.speed.measuring import Row, run
from benchmarks.speed.stages import STAGES
from benchmarks.speed.tables import draw, markdown, significant

SIZES = (256, 1000)
LARGE = (4000, 20_000)
FRAMES = 4000
LARGE_FRAMES = 20_000

TORSO = "icub_torso.npz"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the comparisons and write the results; return 1 if any result is wrong."""
    chosen = _parse(arguments)
    torso = _torso(chosen.recordings)
    sizes = chosen.sensors or SIZES + LARGE * chosen.large
    n_frames = chosen.frames or (LARGE_FRAMES if chosen.large else FRAMES)
    rows: list[Row] = []
    for n_sensors in sizes:
        for name in chosen.stages:
            family, compare = STAGES[name]
            for comparison in compare(n_sensors, n_frames, torso):
                for row in run(comparison, family, n_sensors):
                    rows.append(row)
                    _print(row)
            write(rows, chosen.output, n_frames)
    draw(rows, figure_folder(chosen.output) / "bench.png")
    print(f"wrote {chosen.output}")
    wrong = [row for row in rows if not row.same]
    for row in wrong:
        print(f"WRONG: {row.stage}, {row.dataset}, {row.n_sensors} sensors", file=sys.stderr)
    return 1 if wrong else 0


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    parser.add_argument(
        "--large", action="store_true",
        help="all inputs of 20,000 frames, also 4,000 and 20,000 sensors, which takes hours",
    )  # fmt: skip
    parser.add_argument(
        "--sensors", type=int, nargs="+", help="numbers of sensors, in increasing order"
    )
    parser.add_argument("--frames", type=int, help="number of frames")
    parser.add_argument("--stages", nargs="+", default=tuple(STAGES), choices=tuple(STAGES))
    parser.add_argument("--recordings", type=Path, help=f"folder with {TORSO}")
    parser.add_argument("-o", "--output", type=Path, default=Path("bench"), help="output folder")
    return parser.parse_args(arguments)


def _torso(folder: Path | None) -> Path | None:
    if folder is not None and (folder / TORSO).is_file():
        return folder / TORSO
    print(f"without real data: give a folder with {TORSO} by --recordings")
    return None


def _print(row: Row) -> None:
    verdict = "same" if row.same else "WRONG"
    ratio = f"{significant(row.ratio)} x {row.reference}, {verdict}"
    print(f"{row.n_sensors}: {row.stage}, {row.dataset}: {row.cpu:.3g} s, {ratio}", flush=True)


def write(rows: Sequence[Row], folder: Path, n_frames: int) -> None:
    """Write the results so far."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "bench-table.md").write_text(markdown(rows, n_frames), encoding="utf-8")
    cells = ((*astuple(row), row.ratio) for row in rows)
    write_csv(figure_folder(folder) / "bench.csv", [*columns(Row), "ratio"], cells)


def figure_folder(folder: Path) -> Path:
    """Return the folder for figures: ``_static`` in the documentation, else the folder itself."""
    return folder / "_static" if (folder / "_static").is_dir() else folder


if __name__ == "__main__":
    sys.exit(main())
