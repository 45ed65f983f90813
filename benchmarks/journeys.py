"""Whole journeys as users make them: faults, sensor health, map and verdict of a recording.

``python -m benchmarks.journeys`` times the parts of each journey on one thread, journeys beside
busy processes, and the growth with sensors and frames; ``make bench`` runs it.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from anisomap import AnisomapWarning, Recording, diagnose
from anisomap.health import assess, find_faults
from anisomap.reconstruction import reconstruct_with_stages
from benchmarks.harness import markdown_table, options, write_rows
from benchmarks.inputs import rubbed_skin
from benchmarks.measuring import threads
from benchmarks.tables import growth_exponent, significant

SENSORS = (250, 1000, 4000)
MORE_SENSORS = (250, 500, 1000, 2000, 4000)
FRAMES = (1000, 10_000, 30_000, 100_000)
FEW_FRAMES, FEW_SENSORS = 4000, 250
"""Frames of the journeys of many sensors, and sensors of those of many frames."""

RUBBED = ((256, 30_000), (1000, 30_000))
LARGE = ((4000, 30_000),)
"""Sizes of ten minutes of rubbing at 50 frames per second, and those that take a minute."""

BUSY_SENSORS, BUSY_FRAMES = 220, 3170
"""Size of the journeys beside busy processes: that of a recording of a robot's torso."""

SHELL_SENSORS, SHELL_FRAMES = 60, 2000
"""Size of the recording that is mapped from the shell: that of ``anisomap demo``."""

HEADER = (
    "journey", "sensors", "frames", "faults, s", "health, s", "map, s", "verdict, s", "CPU, s",
    "clock, s",
)  # fmt: skip

_LEVELS = 255  # of readings of 8 bits
_SETTINGS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "PYTHONDONTWRITEBYTECODE",
)
_WARM_UPS = (30, 600)  # sensors: without compiled loops, and with them
_WARM_UP_FRAMES = 400
_DIMENSIONS = 3


@dataclass(frozen=True)
class Journey:
    """CPU seconds of the parts of a journey.

    cpu, clock: Seconds of the whole: CPU time of all threads, and wall-clock time.
    faults, health, map, verdict: CPU seconds of the parts; NaN if they were not timed separately.
    """

    journey: str
    n_sensors: int
    n_frames: int
    cpu: float
    clock: float
    faults: float = math.nan
    health: float = math.nan
    map: float = math.nan
    verdict: float = math.nan


def readings_of_8_bits(n_sensors: int, n_frames: int) -> Recording:
    """Simulate a rubbed skin whose readings are whole numbers from 0 to 255."""
    readings, _ = rubbed_skin(n_sensors, n_frames)
    whole = np.round(readings * (_LEVELS / readings.max())).astype(np.uint8)
    return Recording(whole[:, np.ptp(whole, axis=0) > 0])


def travel(name: str, recording: Recording, method: str = "covariogram") -> Journey:
    """Make a journey in this process as ``anisomap map`` does, and time its parts."""
    laps, clock = [time.process_time()], time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)
        findings = find_faults(recording)
        laps.append(time.process_time())
        health = assess(recording)
        laps.append(time.process_time())
        made, stages = reconstruct_with_stages(recording, method, _DIMENSIONS)
        laps.append(time.process_time())
        diagnose(made, recording, health=health, findings=findings, stages=stages)
        laps.append(time.process_time())
    faults, assessing, mapping, judging = np.diff(laps).tolist()
    return Journey(
        name,
        recording.n_sensors,
        recording.n_frames,
        faults=faults,
        health=assessing,
        map=mapping,
        verdict=judging,
        cpu=laps[-1] - laps[0],
        clock=time.perf_counter() - clock,
    )


def travel_from_shell(name: str, recording: Recording) -> Journey:
    """Time ``anisomap map`` as a process of its own, with nothing set in the environment.

    The second of two runs is timed, since the first may compile the package to byte code.
    """
    environment = {key: value for key, value in os.environ.items() if key not in _SETTINGS}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.npz"
        np.savez(path, readings=recording.readings)
        output = Path(folder) / "map.csv"
        command = [sys.executable, "-m", "anisomap", "map", str(path), "-o", str(output), "-q"]
        for _ in range(2):
            before, clock = os.times(), time.perf_counter()
            subprocess.run(command, env=environment, check=True, stderr=subprocess.DEVNULL)  # noqa: S603
            clock, after = time.perf_counter() - clock, os.times()
    cpu = after.children_user - before.children_user
    cpu += after.children_system - before.children_system
    return Journey(name, recording.n_sensors, recording.n_frames, cpu=cpu, clock=clock)


@contextmanager
def busy_neighbours(count: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Keep some other processes busy meanwhile, each with one core."""
    # They end with this process, even if it is killed.
    busy = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: sum(range(10**5))"
    processes = [subprocess.Popen([sys.executable, "-c", busy]) for _ in range(count)]  # noqa: S603
    try:
        yield processes
    finally:
        for process in processes:
            process.kill()
            process.wait()


def journeys(
    sensors: Sequence[int], frames: Sequence[int], rubbed: Sequence[tuple[int, int]]
) -> Iterator[Journey]:
    """Make all journeys.

    sensors: Numbers of sensors, of 4,000 frames each.
    frames: Numbers of frames, of 250 sensors each.
    rubbed: Numbers of sensors and frames of further recordings.
    """
    with threads(1):
        for n_sensors in _WARM_UPS:
            if n_sensors <= max(sensors):
                travel("warm-up", readings_of_8_bits(n_sensors, _WARM_UP_FRAMES))
        for n_sensors in sensors:
            yield travel("more sensors", readings_of_8_bits(n_sensors, FEW_FRAMES))
        for n_frames in frames:
            yield travel("more frames", readings_of_8_bits(FEW_SENSORS, n_frames))
        for size in rubbed:
            yield travel("long rubbing", readings_of_8_bits(*size))
            yield travel("long rubbing, r-anisomap", readings_of_8_bits(*size), "r-anisomap")
    few = readings_of_8_bits(BUSY_SENSORS, BUSY_FRAMES)
    yield travel("nothing limited", few)
    with busy_neighbours(os.cpu_count() or 1):
        yield travel("nothing limited, every core busy", few)
    small = readings_of_8_bits(SHELL_SENSORS, SHELL_FRAMES)
    yield travel_from_shell("from the shell", small)
    with busy_neighbours(os.cpu_count() or 1):
        yield travel_from_shell("from the shell, every core busy", small)


def slopes(made: Sequence[Journey]) -> dict[str, float]:
    """Return the exponent with which the CPU time grows with sensors and with frames."""
    sizes = {"more sensors": "n_sensors", "more frames": "n_frames"}
    found = {}
    for name, size in sizes.items():
        same = [journey for journey in made if journey.journey == name]
        if len(same) > 1:
            found[name] = growth_exponent(
                [getattr(journey, size) for journey in same], [journey.cpu for journey in same]
            )
    return found


def markdown(made: Sequence[Journey]) -> str:
    """Write the table of journeys, and their growth."""
    parts = ("faults", "health", "map", "verdict", "cpu", "clock")
    rows = [
        (one.journey, f"{one.n_sensors:,}", f"{one.n_frames:,}",
         *(significant(getattr(one, part)) for part in parts))
        for one in made
    ]  # fmt: skip
    lines = markdown_table(HEADER, rows, HEADER[:1])
    growth = [f"{name}: exponent {value:.2f}" for name, value in slopes(made).items()]
    return "\n".join([*lines, "", "Growth of the CPU time: " + "; ".join(growth) + ".", ""])


def main(arguments: Sequence[str] | None = None) -> int:
    """Make all journeys, and write ``journeys-table.md`` and ``journeys.csv``."""
    parser = options(__doc__, "bench", recordings=False)
    parser.add_argument(
        "--large", action="store_true", help="more sizes, also 4,000 sensors x 30,000 frames"
    )
    parser.add_argument("--sensors", type=int, nargs="+", help="numbers of sensors, increasing")
    parser.add_argument("--frames", type=int, nargs="+", help="numbers of frames, increasing")
    chosen = parser.parse_args(arguments)
    sensors = chosen.sensors or (MORE_SENSORS if chosen.large else SENSORS)
    frames = chosen.frames or FRAMES
    made: list[Journey] = []
    for journey in journeys(sensors, frames, RUBBED + LARGE if chosen.large else RUBBED):
        made.append(journey)
        print(
            f"{journey.journey}, {journey.n_sensors} x {journey.n_frames}: {journey.cpu:.3g} s "
            f"of CPU, {journey.clock:.3g} s",
            flush=True,
        )
    write_rows(chosen.output / "journeys.csv", made)
    (chosen.output / "journeys-table.md").write_text(markdown(made), encoding="utf-8")
    print(f"wrote {chosen.output / 'journeys-table.md'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
