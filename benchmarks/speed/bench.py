"""What users wait for, against ``numpy.corrcoef`` with scikit-learn's Isomap (``make bench``).

Recordings are noisy caps on a sphere: contacts at random places, noise in every reading. The CPU
times, on one thread, are of the default map; of all that ``anisomap map`` does, the search for
faults, the health of sensors, the map and its verdict; and of r-ANISOMAP with the health of
sensors. The errors are those of the default map and of Isomap's, on the same readings. Commands
from the shell are processes of their own.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import astuple, dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import anisomap
from anisomap import Recording, SensorMap
from anisomap.errors import InputError
from anisomap.method.pipeline import reconstruct_with_stages
from anisomap.numerics.compiled.parallel import MIN_COMPILED_ROWS
from benchmarks.accuracy.rivals import map_by_rival
from benchmarks.harness import frame, machine, markdown_table, options, quietly, write_rows
from benchmarks.skins.inputs import directions, sphere

SIZES = ((60, 4000), (256, 10_000), (400, 4000), (700, 6000))
LARGE = ((1000, 10_000), (2000, 20_000))
"""Numbers of sensors and frames; the large ones take minutes, and are also placed at random."""

GOALS = {"map": 8, "journey": 16}
"""Most times the CPU time of corrcoef and Isomap."""

RUNS = 3
"""Of each journey and command, of which the fastest counts: disturbances only add time."""

_DIMENSIONS = 3
_REACH = 2.2  # of contacts, in spacings
_NOISE = 0.05  # of a deep contact
_SETTINGS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def caps(
    n_sensors: int, n_frames: int, rng: np.random.Generator, *, even: bool = True
) -> Recording:
    """Touch a sphere at random places, each for some frames, with noise in every reading.

    even: Whether sensors are evenly spaced, or at random places.
    """
    places = sphere(n_sensors, rng) if even else directions(n_sensors, rng)
    reach = _REACH * np.sqrt(4 * np.pi / n_sensors) * rng.uniform(0.7, 1.3, (n_frames, 1))
    centres = np.repeat(directions(n_frames // 10 + 1, rng), 10, axis=0)[:n_frames]
    course = np.sin(np.pi * (np.arange(n_frames) % 10 + 0.5) / 10)[:, None]
    square = np.maximum(0, 2 - 2 * centres @ places.T)
    readings = course * np.maximum(0, 1 - square / reach**2)
    readings += _NOISE * rng.normal(size=readings.shape)
    return Recording(readings.astype(np.float32), positions=places)


@dataclass(frozen=True)
class Row:
    """CPU seconds of what is done with one recording, and what is made of it.

    isomap: With ``numpy.corrcoef``. r, error: Mantel r, and the RMS error in spacings, of the
    default map; isomap_r, isomap_error: of Isomap's. level: Of the verdict.
    """

    n_sensors: int
    n_frames: int
    even: bool
    seed: int
    level: str
    r: float
    error: float
    isomap_r: float
    isomap_error: float
    isomap: float
    map: float
    journey: float
    paper: float


def journey(recording: Recording) -> SensorMap:
    """Do what ``anisomap map`` does."""
    findings, health = anisomap.find_faults(recording), anisomap.assess(recording)
    made, stages = reconstruct_with_stages(recording, dimensions=_DIMENSIONS)
    return anisomap.diagnose(made, recording, health=health, findings=findings, stages=stages)


def as_published(recording: Recording) -> SensorMap:
    """Assess the sensors, and map them by the paper's method."""
    anisomap.assess(recording)
    return anisomap.reconstruct(recording, "r-anisomap", _DIMENSIONS)


TIMED: Mapping[str, Callable[[Recording], SensorMap]] = {
    "isomap": lambda recording: map_by_rival(recording, "isomap-on-r", _DIMENSIONS),
    "map": lambda recording: anisomap.reconstruct(recording, dimensions=_DIMENSIONS),
    "journey": journey,
    "paper": as_published,
}


def timed(
    run: Callable[[Recording], SensorMap], readings: NDArray[np.floating]
) -> tuple[float, SensorMap | None]:
    """Return the CPU seconds of the fastest of some runs, each on a fresh recording, and the map.

    Recordings of many sensors run once.
    """
    seconds, made = [], None
    for _ in range(RUNS if readings.shape[1] < LARGE[0][0] else 1):
        recording = Recording(readings)  # without statistics that another run has left in it
        begun = time.process_time()
        with suppress(InputError):
            made = run(recording)
        seconds.append(time.process_time() - begun)
    return min(seconds), made


def rows_of(sizes: Sequence[tuple[int, int]], seeds: Sequence[int]) -> Iterator[Row]:
    """Time everything on recordings of some sizes and seeds."""
    for run, n_sensors in product(TIMED.values(), (30, MIN_COMPILED_ROWS)):
        # Compile, or load what was compiled.
        timed(run, caps(n_sensors, 400, np.random.default_rng(0)).readings)
    for (n_sensors, n_frames), even, seed in product(sizes, (True, False), seeds):
        if not even and n_sensors < LARGE[0][0]:
            continue
        recording = caps(n_sensors, n_frames, np.random.default_rng(seed), even=even)
        found = {name: timed(run, recording.readings) for name, run in TIMED.items()}
        (r, error), others = (_accuracy(found[name][1], recording) for name in ("map", "isomap"))
        judged = found["journey"][1]
        level = "" if judged is None else judged.verdict.level
        times = {name: cpu for name, (cpu, _) in found.items()}
        yield Row(n_sensors, n_frames, even, seed, level, r, error, *others, **times)


def _accuracy(made: SensorMap | None, truth: Recording) -> tuple[float, float]:
    """Return Mantel r and the RMS error of a map, in spacings; NaN without one."""
    if made is None:
        return math.nan, math.nan
    found = anisomap.score(made, truth, permutations=0)
    return found.mantel.r, found.rms_in_spacings


def from_shell(seed: int) -> Iterator[tuple[str, str, str]]:
    """Time commands, with nothing set in the environment: CPU time and time by the clock."""
    environment = {key: value for key, value in os.environ.items() if key not in _SETTINGS}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.npz"
        anisomap.write(caps(*SIZES[0], np.random.default_rng(seed)), path)
        mapped = ["-m", "anisomap", "map", str(path), "-o", f"{folder}/map.csv"]
        size = "{} sensors x {:,} frames".format(*SIZES[0])
        commands = {
            "import numpy, scipy.optimize, scipy.spatial": [
                "-c", "import numpy, scipy.optimize, scipy.spatial",
            ],
            "anisomap --help": ["-m", "anisomap", "--help"],
            f"anisomap map -m r-anisomap, {size}": [*mapped, "-m", "r-anisomap"],
            f"anisomap map, {size}": mapped,
        }  # fmt: skip
        for name, arguments in commands.items():
            costs = []
            for _ in range(RUNS):
                before, clock = os.times(), time.perf_counter()
                subprocess.run(  # noqa: S603
                    [sys.executable, *arguments], env=environment, check=False, capture_output=True
                )
                after, clock = os.times(), time.perf_counter() - clock
                cpu = after.children_user - before.children_user
                costs.append((cpu + after.children_system - before.children_system, clock))
            cpu, clock = map(min, zip(*costs, strict=True))
            yield name, f"{cpu:.2f}", f"{clock:.2f}"


def markdown(rows: Sequence[Row]) -> str:
    """Return the medians of each size, in Markdown: of times, and of errors."""
    times, errors = [], []
    sizes = ["n_sensors", "n_frames", "even"]
    for (n_sensors, n_frames, even), group in frame(rows).groupby(sizes, sort=False):
        size = [f"{n_sensors:,}", f"{n_frames:,}", "evenly" if even else "at random"]
        cells = [*size, f"{group.isomap.median():.4f}"]
        for what in ("map", "journey", "paper"):
            ratio = float((group[what] / group.isomap).median())
            missed = ratio > GOALS.get(what, np.inf)
            cells += [
                f"{group[what].median():.3f}",
                f"**{ratio:.1f}**" if missed else f"{ratio:.1f}",
            ]
        times.append(cells)
        apart = [f"{1 - group[one].mean():.4f}" for one in ("r", "isomap_r")]
        apart += [f"{group[one].mean():.2f}" for one in ("error", "isomap_error")]
        usable = np.count_nonzero(group.level == "usable")
        errors.append([*size, *apart, f"{usable} of {len(group)}"])
    names = ("sensors", "frames", "placed")
    of_times = ("corrcoef + Isomap, s", "map, s", "ratio", "map + verdict, s",
             "ratio", "r-ANISOMAP + health, s", "ratio")  # fmt: skip
    of_errors = ("1 - r", "1 - r of Isomap", "error", "error of Isomap", "usable")
    tables = (markdown_table((*names, *of_times), times, ()),
              markdown_table((*names, *of_errors), errors, ()))  # fmt: skip
    return "\n\n".join("\n".join(lines) for lines in tables) + "\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Time everything and write the tables."""
    parser = options(__doc__, "bench", seeds=3, recordings=False)
    parser.add_argument("--first-seed", type=int, help="default: a fresh one")
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--sizes", nargs="+", help="such as 60x4000; default: four")
    chosen = parser.parse_args(arguments)
    sizes = SIZES + LARGE * chosen.large
    if chosen.sizes:
        sizes = tuple((int(n), int(t)) for n, t in (size.split("x") for size in chosen.sizes))
    first = chosen.first_seed
    if first is None:
        first = int(np.random.default_rng().integers(1_000_000))
    rows = []
    with quietly():
        for row in rows_of(sizes, range(first, first + chosen.seeds)):
            rows.append(row)
            print(*astuple(row), flush=True)
    shell = [*markdown_table(("from the shell", "CPU, s", "clock, s"), from_shell(first))]
    text = "\n".join([machine(f"seeds {first} to {first + chosen.seeds - 1}"), "", markdown(rows)])
    write_rows(chosen.output / "bench.csv", rows, digits=4)
    path = chosen.output / "bench-table.md"
    path.write_text(text + "\n" + "\n".join(shell) + "\n", encoding="utf-8")
    print(path.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
