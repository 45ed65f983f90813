"""Time every stage and whole maps beside what a user would pick instead: ``make bench``.

Results are compared before they are timed: a fast wrong answer is no answer, and the command fails.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.picture import draw
from benchmarks.race import Row, Setting, run
from benchmarks.stages import STAGES
from benchmarks.tables import figures, markdown, write_csv

SIZES = (256, 1000, 4000)
LARGE = 20_000
QUICK = (256, 1000)
FRAMES = 30_000
QUICK_FRAMES = 4000

TORSO = "icub_torso.npz"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the races, write what came out, and give 1 if any result was wrong."""
    chosen = _parse(arguments)
    torso = _torso(chosen.recordings)
    sizes = chosen.sensors or [*(QUICK if chosen.quick else SIZES), *([LARGE] * chosen.large)]
    n_frames = chosen.frames or (QUICK_FRAMES if chosen.quick else FRAMES)
    patience = 4000 if chosen.large else QUICK[0] if chosen.quick else 1000
    rows: list[Row] = []
    for n_sensors in sizes:
        setting = Setting(n_sensors, n_frames, torso, patience)
        for name in chosen.stages:
            family, races = STAGES[name]
            for race in races(setting):
                for row in run(race, family, n_sensors):
                    rows.append(row)
                    _tell(row)
            write(rows, chosen.output, n_frames)
    draw(rows, pictures(chosen.output) / "bench.png")
    print(f"written: {chosen.output}")
    wrong = [row for row in rows if row.same is False]
    for row in wrong:
        print(f"WRONG: {row.stage}, {row.given}, {row.n_sensors} sensors", file=sys.stderr)
    return 1 if wrong else 0


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few frames, up to 1,000 sensors")
    parser.add_argument("--large", action="store_true", help="20,000 sensors too: takes hours")
    parser.add_argument("--sensors", type=int, nargs="+", help="other sizes, smallest first")
    parser.add_argument("--frames", type=int, help="other lengths of recordings")
    parser.add_argument("--stages", nargs="+", default=tuple(STAGES), choices=tuple(STAGES))
    parser.add_argument("--recordings", type=Path, help=f"folder that holds {TORSO}")
    parser.add_argument("-o", "--output", type=Path, default=Path("bench"), help="folder")
    return parser.parse_args(arguments)


def _torso(folder: Path | None) -> Path | None:
    if folder is not None and (folder / TORSO).is_file():
        return folder / TORSO
    print(f"no real skin: name a folder that holds {TORSO} with --recordings")
    return None


def _tell(row: Row) -> None:
    verdict = row.same if isinstance(row.same, str) else ("same" if row.same else "WRONG")
    versus = f", {figures(row.ratio)} x {row.against}, {verdict}" if row.against else ""
    print(f"{row.n_sensors}: {row.stage}, {row.given}: {row.cpu:.3g} s{versus}", flush=True)


def write(rows: Sequence[Row], folder: Path, n_frames: int) -> None:
    """Write what has come out so far."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "bench-table.md").write_text(markdown(rows, n_frames), encoding="utf-8")
    write_csv(rows, pictures(folder) / "bench.csv")


def pictures(folder: Path) -> Path:
    """Give the folder itself, or that of the pictures if it is that of the documentation."""
    return folder / "_static" if (folder / "_static").is_dir() else folder


if __name__ == "__main__":
    sys.exit(main())
