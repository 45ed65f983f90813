"""What users wait for: faults, health, map and verdict of a family of recordings.

``python -m benchmarks.speed.journeys`` times them on one thread beside ``numpy.corrcoef`` with
scikit-learn's Isomap on the same recordings, and commands from the shell; ``make bench`` runs it.
The members of the family differ in what makes recordings plain or awkward: contacts are smooth
pulses at random places of a sphere. Each member is drawn from a seed.
"""

from __future__ import annotations

import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap import Recording, diagnose
from anisomap.errors import InputError
from anisomap.evaluation.rivals import map_by_rival
from anisomap.health import assess, find_faults
from anisomap.method.reconstruction import reconstruct_with_stages
from benchmarks.harness import markdown_table, options, quietly, write_rows
from benchmarks.skins.inputs import Press, directions
from benchmarks.speed.measuring import MAX_REPEATED_SECONDS, measure, threads
from benchmarks.speed.tables import growth_exponent, machine, seconds, significant

SIZES = ((60, 4000), (256, 4000), (256, 30_000), (1000, 4000), (1000, 30))
LARGE = ((1000, 30_000), (4000, 4000), (5000, 3))
"""Numbers of sensors and frames: of all members of the family; those that take minutes."""

SHELL_SENSORS, SHELL_FRAMES = 60, 4000
"""Size of the recording that is mapped from the shell."""

MEDIAN_GOALS = {"map": 8, "journey": 16, "paper": 1}
"""Most times the CPU time of corrcoef and Isomap, for the median member."""

SLOWEST_GOAL = 4
"""Most times the median, for the slowest member."""

_SETTINGS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "PYTHONDONTWRITEBYTECODE",
)
_WARM_UPS = (30, 600)  # sensors: without compiled loops, and with them
_WARM_UP_FRAMES = 400
RUNS = 3  # of a command, of which the fastest counts
_DIMENSIONS = 3
_MEGABYTE = 1e6

Readings = NDArray[np.float32]

_SPACINGS = 2.2  # radius of the touched caps, in spacings of the sensors
_WIDE = 0.6  # radius of the caps that touch a tenth of the skin
_PULSE = Press(width=20, length=1.0, profile=0)  # contacts may begin before the first frame
_FRAMES_PER_CONTACT = 10
_NOISE = 0.01  # standard deviation; peaks of contacts are .5 to 1.5
_PARTS = 8  # separate skins
_MISSING = 0.3


def touched(
    n_sensors: int,
    n_frames: int,
    rng: np.random.Generator,
    *,
    radius: float | None = None,
    contacts: int | None = None,
) -> Readings:
    """Simulate a sphere touched at random places; readings are 0 at rest, shape (T, N)."""
    sensors = directions(n_sensors, rng)
    count = contacts or max(5, n_frames // _FRAMES_PER_CONTACT)
    typical = _SPACINGS * np.sqrt(4 * np.pi / n_sensors) if radius is None else radius
    readings = np.zeros((n_frames, n_sensors), np.float32)
    for place, at, height, reach in zip(
        directions(count, rng),
        rng.integers(n_frames, size=count).tolist(),
        rng.uniform(0.5, 1.5, count),
        typical * rng.uniform(0.7, 1.3, count),
        strict=True,
    ):
        _PULSE.onto(readings, sensors - place, at, height, reach)
    return readings


def _noise(n: int, t: int, rng: np.random.Generator) -> Readings:
    return rng.standard_normal((t, n), np.float32) * np.float32(_NOISE)


def _noisy(n: int, t: int, rng: np.random.Generator, **contacts: Any) -> Readings:
    return touched(n, t, rng, **contacts) + _noise(n, t, rng)


def _drifting(n: int, t: int, rng: np.random.Generator) -> Readings:
    slow = np.sin(np.linspace(0, 3, t)[:, None] + rng.uniform(0, 6, n)) * rng.uniform(0, 0.5, n)
    return _noisy(n, t, rng) + slow.astype(np.float32)


def _components(n: int, t: int, rng: np.random.Generator) -> Readings:
    sizes = [len(part) for part in np.array_split(np.arange(n), _PARTS)]
    return np.hstack([touched(size, t, rng) for size in sizes]) + _noise(n, t, rng)


def _incomplete(n: int, t: int, rng: np.random.Generator) -> Readings:
    readings = _noisy(n, t, rng)
    readings[rng.uniform(size=readings.shape) < _MISSING] = np.nan
    return Recording(readings).complete("interpolate").readings.astype(np.float32)


def _ramps(n: int, t: int, rng: np.random.Generator) -> Readings:
    return np.outer(np.arange(t), rng.uniform(0.1, 1, n)).astype(np.float32) + _noisy(n, t, rng)


MEMBERS: Mapping[str, Callable[[int, int, np.random.Generator], Readings]] = {
    "noise in every reading": _noisy,
    "8 bits, exact rest": lambda n, t, rng: np.round(255 / 1.5 * touched(n, t, rng)),
    "binary": lambda n, t, rng: (touched(n, t, rng) > 0).astype(np.float32),
    "100,000 levels": lambda n, t, rng: np.round(1e5 * _noisy(n, t, rng)),
    "wide contacts": partial(_noisy, radius=_WIDE),
    "rare contacts": lambda n, t, rng: _noisy(n, t, rng, contacts=max(20, n // 2)),
    "drifting rest": _drifting,
    "eight skins": _components,
    "30 % missing, interpolated": _incomplete,
    "every sensor twice": lambda n, t, rng: np.repeat(_noisy(-(-n // 2), t, rng), 2, axis=1)[:, :n],
    "pure noise": _noise,
    "ramps": _ramps,
}
"""Function of each member: takes numbers of sensors and frames and a generator, returns (T, N)."""


def draw(name: str, n_sensors: int, n_frames: int, seed: int) -> Recording:
    """Draw a member of the family."""
    rng = np.random.default_rng([seed, list(MEMBERS).index(name), n_sensors, n_frames])
    return Recording(MEMBERS[name](n_sensors, n_frames, rng))


@dataclass(frozen=True)
class Journey:
    """CPU seconds of what is done with a recording.

    map: Of the default map.
    journey: Of the search for faults, the health of sensors, the default map and its verdict.
    paper: Of the health of sensors and the map by r-ANISOMAP.
    isomap: Of ``numpy.corrcoef`` and Isomap; NaN if it fails.
    memory: Of the journey, in megabytes.
    """

    member: str
    n_sensors: int
    n_frames: int
    faults: float
    health: float
    map: float
    verdict: float
    paper: float
    isomap: float
    memory: float

    @property
    def journey(self) -> float:
        """CPU seconds of everything that ``anisomap map`` does."""
        return self.faults + self.health + self.map + self.verdict

    @property
    def size(self) -> tuple[int, int]:
        """Numbers of sensors and frames."""
        return self.n_sensors, self.n_frames


@dataclass(frozen=True)
class Command:
    """Seconds of a command from the shell: CPU time of all threads, and wall-clock time."""

    command: str
    cpu: float
    clock: float


def travel(recording: Recording) -> list[float]:
    """Find faults, assess, map and judge, as ``anisomap map``; return the CPU seconds of each."""
    laps = [time.process_time()]
    findings = find_faults(recording)
    laps.append(time.process_time())
    health = assess(recording)
    laps.append(time.process_time())
    stages = None
    with suppress(InputError):  # noise alone is not mapped
        made, stages = reconstruct_with_stages(recording, dimensions=_DIMENSIONS)
    laps.append(time.process_time())
    if stages is not None:
        diagnose(made, recording, health=health, findings=findings, stages=stages)
    laps.append(time.process_time())
    return [float(lap) for lap in np.diff(laps)]


def time_member(member: str, n_sensors: int, n_frames: int, seed: int) -> Journey:
    """Draw a member of the family and time what is done with it."""

    def fresh() -> Recording:
        """Return the recording without the statistics that another run has left in it."""
        return Recording(recording.readings)

    recording = draw(member, n_sensors, n_frames, seed)
    with quietly(), threads(1):
        cost, laps = measure(lambda: travel(fresh()))
        laps = min([laps, *([travel(fresh())] if cost.cpu < MAX_REPEATED_SECONDS else [])], key=sum)
        paper = min(measure(lambda: _map_as_published(fresh()))[0].cpu for _ in range(2))
        isomap = math.nan
        try:
            rival = [measure(lambda: map_by_rival(fresh(), "isomap-on-r", _DIMENSIONS))[0].cpu
                     for _ in range(2)]  # fmt: skip
            isomap = min(rival)
        except InputError:
            print(f"Isomap fails: {member}")
    faults, health, mapping, judging = laps
    return Journey(
        member, n_sensors, n_frames, faults, health, mapping, judging, paper, isomap, cost.memory
    )


def _map_as_published(recording: Recording) -> None:
    assess(recording)
    with suppress(InputError):
        reconstruct_with_stages(recording, "r-anisomap", _DIMENSIONS)


def shell_commands(recording: Path, folder: Path) -> dict[str, list[str]]:
    """Return what is timed from the shell."""
    to_map = ["-m", "anisomap", "map", str(recording), "-q"]
    written = ["-o", str(folder / "map.csv")]
    return {
        "import numpy, scipy.optimize, scipy.spatial": [
            "-c", "import numpy, scipy.optimize, scipy.spatial",
        ],
        "anisomap --help": ["-m", "anisomap", "--help"],
        "anisomap map, of a file that is not there": [
            "-m", "anisomap", "map", str(folder / "none.npz"),
        ],
        f"anisomap map -m r-anisomap, {SHELL_SENSORS} sensors": [
            *to_map, "-m", "r-anisomap", *written,
        ],
        f"anisomap map, {SHELL_SENSORS} sensors": [*to_map, *written],
    }  # fmt: skip


def from_shell(seed: int) -> Iterator[Command]:
    """Time commands as processes of their own, with nothing set in the environment."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / "recording.npz"
        recording = draw("noise in every reading", SHELL_SENSORS, SHELL_FRAMES, seed)
        np.savez(path, readings=recording.readings)
        for command, arguments in shell_commands(path, folder).items():
            yield _best_of_runs(command, arguments)
        with busy_neighbours(os.cpu_count() or 1):
            yield _best_of_runs(f"{command}, every core busy", arguments)


def _best_of_runs(command: str, arguments: Sequence[str]) -> Command:
    """Time the fastest of some runs; the first may compile the package to byte code."""
    environment = {key: value for key, value in os.environ.items() if key not in _SETTINGS}
    costs = []
    for _ in range(RUNS):
        before, clock = os.times(), time.perf_counter()
        subprocess.run(  # noqa: S603
            [sys.executable, *arguments],
            env=environment,
            check=False,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        clock, after = time.perf_counter() - clock, os.times()
        cpu = after.children_user - before.children_user
        costs.append((cpu + after.children_system - before.children_system, clock))
    return Command(command, *map(min, zip(*costs, strict=True)))


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


def exponents(made: Sequence[Journey]) -> dict[str, tuple[float, float]]:
    """Return the exponents of each member's time in sensors and in frames; NaN if unknown.

    Between the smallest and the largest size that differ in one number alone.
    """
    found = {}
    for member in dict.fromkeys(one.member for one in made):
        times = {one.size: one.journey for one in made if one.member == member}
        found[member] = (_exponent(times, 0), _exponent(times, 1))
    return found


def _exponent(times: dict[tuple[int, int], float], varied: int) -> float:
    """Return the exponent in one number of the sizes, for the widest range of it."""
    pairs = [
        (large[varied] / small[varied], small, large)
        for small in times
        for large in times
        if small[1 - varied] == large[1 - varied] and small[varied] < large[varied]
    ]
    if not pairs:
        return math.nan
    _, small, large = max(pairs)
    return growth_exponent([small[varied], large[varied]], [times[small], times[large]])


def markdown(made: Sequence[Journey], commands: Sequence[Command], seed: int) -> str:
    """Write the tables: medians of each size, members, and commands."""
    lines = [machine(f"seed {seed}"), "", *_of_sizes(made), "", *_of_members(made)]
    if commands:
        names = ("from the shell", "CPU, s", "clock, s")
        rows = [(one.command, seconds(one.cpu), seconds(one.clock)) for one in commands]
        lines += ["", *markdown_table(names, rows, names[:1])]
    return "\n".join(lines) + "\n"


def _of_sizes(made: Sequence[Journey]) -> list[str]:
    names = (
        "sensors", "frames", "corrcoef + Isomap, s", "map, s", "ratio", "map + verdict, s", "ratio",
        "r-ANISOMAP + health, s", "ratio", "slowest / median", "slowest", "memory / needed",
    )  # fmt: skip
    rows = []
    for size in dict.fromkeys(one.size for one in made):
        same = [one for one in made if one.size == size]
        isomap = _median([one.isomap for one in same])
        cells = [f"{size[0]:,}", f"{size[1]:,}", seconds(isomap)]
        for what, goal in MEDIAN_GOALS.items():
            typical = _median([getattr(one, what) for one in same])
            cells += [seconds(typical), _judged(typical / isomap, goal)]
        slowest = max(same, key=lambda one: one.journey)
        typical = _median([one.journey for one in same])
        needed = 4 * (3 * size[0] * size[1] + 8 * size[0] ** 2) / _MEGABYTE
        cells += [
            _judged(slowest.journey / typical, SLOWEST_GOAL),
            slowest.member,
            significant(_median([one.memory for one in same]) / needed),
        ]
        rows.append(cells)
    return [*markdown_table(names, rows, ("slowest",))]


def _judged(ratio: float, goal: float) -> str:
    return significant(ratio) if ratio <= goal else f"**{significant(ratio)}**"


def _median(values: Sequence[float]) -> float:
    known = [value for value in values if not math.isnan(value)]
    return statistics.median(known) if known else math.nan


def _of_members(made: Sequence[Journey]) -> list[str]:
    sizes = list(dict.fromkeys(one.size for one in made))
    names = ["map + verdict, s", *(f"{n:,} x {t:,}" for n, t in sizes)]
    times = {(one.member, one.size): one.journey for one in made}
    rows = [
        (
            member,
            *(seconds(times.get((member, size), math.nan)) for size in sizes),
            *("" if math.isnan(value) else f"{value:.2f}" for value in of_member),
        )
        for member, of_member in exponents(made).items()
    ]
    return [*markdown_table([*names, "exponent of N", "of T"], rows, names[:1])]


def main(arguments: Sequence[str] | None = None) -> int:
    """Time the family and the commands; write ``journeys-table.md`` and ``journeys.csv``."""
    parser = options(__doc__, "bench", recordings=False)
    parser.add_argument("--seed", type=int, default=0, help="of the recordings")
    parser.add_argument("--large", action="store_true", help="also sizes that take minutes")
    parser.add_argument(
        "--sizes", nargs="+", metavar="NxT", help="other sizes: sensors x frames, as 60x4000"
    )
    parser.add_argument("--members", nargs="+", choices=list(MEMBERS), default=list(MEMBERS))
    chosen = parser.parse_args(arguments)
    sizes = SIZES + LARGE * chosen.large
    if chosen.sizes:
        sizes = tuple(tuple(map(int, size.split("x"))) for size in chosen.sizes)
    for n_sensors in _WARM_UPS:
        if n_sensors <= max(sizes)[0]:
            time_member("noise in every reading", n_sensors, _WARM_UP_FRAMES, chosen.seed)
    made = []
    for n_sensors, n_frames in sizes:
        for member in chosen.members:
            made.append(time_member(member, n_sensors, n_frames, chosen.seed))
            parts = ", ".join(
                f"{part} {seconds(getattr(made[-1], part))}"
                for part in ("faults", "health", "map", "verdict", "paper", "isomap")
            )
            print(f"{n_sensors} x {n_frames}, {member}: {parts}", flush=True)
    commands = list(from_shell(chosen.seed))
    write_rows(chosen.output / "journeys.csv", made)
    path = chosen.output / "journeys-table.md"
    path.write_text(markdown(made, commands, chosen.seed), encoding="utf-8")
    print(f"wrote {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
