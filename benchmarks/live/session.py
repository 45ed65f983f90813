"""What a session keeps up with: ``python -m benchmarks.live.session --sensors 1000 --rate 100``.

Another process sends frames of a simulated skin over TCP, at a rate in Hz or as fast as they are
taken (``--rate 0``). Printed are the frames that were recorded, the states of the readings that a
page receives per second, the age of the map, the seconds from the first frame to the first verdict,
and the memory of all processes of the session.
``--memory live-memory`` writes the memory of each process over time as CSV and as a figure.
"""

from __future__ import annotations

import argparse
import http.client
import json
import math
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness import write_csv

_SETTLING_S = 5.0  # after the first map, before measurements begin
_KIB = 1024
ROLES = ("session", "quick_maps", "checked_maps")
MEMORY_COLUMNS = ("seconds", "frames", *(f"{role}_mib" for role in ROLES))
_N_TIMES = 60  # rows of the table of memory


def skin(n_sensors: int, n_frames: int = 2000) -> list[str]:
    """Return the frames of a square skin under a contact that wanders, as lines of text."""
    rng = np.random.default_rng(0)
    places = rng.uniform(0, 1, (n_sensors, 2))
    walk = np.cumsum(rng.normal(0, 0.03, (n_frames, 2)), axis=0)
    touch = np.abs(walk % 2 - 1)
    reach = 2.5 / np.sqrt(n_sensors)
    depth = np.maximum(0, reach - np.linalg.norm(touch[:, None] - places, axis=2)) / reach
    return [",".join(map(repr, row)) for row in np.round(depth, 3).tolist()]


def send(port: int, n_sensors: int, rate: float, seconds: float) -> None:
    """Send frames to a port; print how many."""
    lines = [f"{line}\n".encode() for line in skin(n_sensors)]
    count = 0
    with socket.create_server(("127.0.0.1", port)) as server:
        connection, _ = server.accept()
        begun = time.monotonic()
        while (now := time.monotonic() - begun) < seconds:
            due = count + 50 if not rate else int(now * rate)
            while count < due:
                connection.sendall(lines[count % len(lines)])
                count += 1
            if rate:
                time.sleep(0.002)
    print(count, flush=True)


@dataclass
class Watcher:
    """A page of the session: counts the states of the readings, and notes the age of the map.

    readings: When the states of the readings came.
    ages: Time, and age of the map in seconds.
    first_frame, first_verdict: When they were known to the page; NaN before.
    """

    url: str
    readings: list[float] = field(default_factory=list)
    ages: list[tuple[float, float]] = field(default_factory=list)
    frames: list[int] = field(default_factory=lambda: [0])
    lagged: bool = False
    first_frame: float = math.nan
    first_verdict: float = math.nan

    def watch(self) -> None:
        """Read events until the session ends."""
        address = urlsplit(self.url)
        connection = http.client.HTTPConnection(str(address.hostname), address.port)
        connection.request("GET", "/events")
        answer = connection.getresponse()
        while line := answer.readline():
            kind, data = line.decode().strip(), answer.readline().decode()
            answer.readline()
            if kind == "event: readings":
                self.readings.append(time.monotonic())
            elif kind == "event: status":
                status, now = json.loads(data.removeprefix("data: ")), time.monotonic()
                if status["frames"] and math.isnan(self.first_frame):
                    self.first_frame = now
                if status["error"] and math.isnan(self.first_verdict):
                    self.first_verdict = now
                self.frames.append(status["frames"])
                self.lagged |= status["lags"]
                if status["share_touched"] > 0:
                    self.ages.append((now, status["map_age"]))


def memory_mib(pid: int) -> float:
    """Return the proportional set size of a process in MiB (Linux)."""
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
        if line.startswith("Pss:"):
            return int(line.split()[1]) / _KIB
    return 0.0


def cpu_s(pid: int) -> float:
    """Return the processor time that a process has used in seconds (Linux)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def children(pid: int) -> list[int]:
    """Return the processes that a process has started."""
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a session and print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sensors", type=int, default=1000)
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--memory", type=Path, help="name of a table and a figure, without suffix")
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        found, memory = measured(Path(folder), given.sensors, given.rate, given.seconds)
    print(json.dumps(found))
    if given.memory is not None:
        write_memory(memory, given.memory)
        draw_memory(memory, given.memory.with_suffix(".png"))


@dataclass(frozen=True)
class Memory:
    """Memory of the processes of a session at one time.

    seconds: Since the first frame.
    n_frames: Frames that the page knew of.
    mib: Proportional set size of each of `ROLES`, in MiB.
    """

    seconds: float
    n_frames: int
    mib: tuple[float, ...]


def measured(
    folder: Path, n_sensors: int, rate: float, seconds: float
) -> tuple[dict[str, object], list[Memory]]:
    """Measure a session in a folder."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "anisomap", "live", f"tcp://127.0.0.1:{port}"]
    command += ["-d", "2", "--port", "0", "--no-browser", "--json", "--recording", "r.csv"]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)  # noqa: S603
    if process.stdout is None:
        raise RuntimeError("the session has no output")
    watcher = Watcher(json.loads(process.stdout.readline())["url"])
    threading.Thread(target=watcher.watch, daemon=True).start()
    sender = get_context("spawn").Process(target=send, args=(port, n_sensors, rate, seconds))
    sender.start()
    memory: list[Memory] = []
    begun = time.monotonic()
    while sender.is_alive():
        sender.join(1.0)
        pids = processes(process.pid)
        sizes = tuple(memory_mib(pid) for pid in pids)
        memory.append(Memory(time.monotonic() - begun, watcher.frames[-1], sizes))
    last = -1
    while watcher.frames[-1] != last:  # what is still in the buffers of the system
        last = watcher.frames[-1]
        time.sleep(2.0)
    used = [cpu_s(pid) for pid in processes(process.pid)]
    process.kill()
    process.wait()
    with (folder / "r.csv").open("rb") as stream:
        lines = sum(not line.startswith((b"#", b'"')) for line in stream)
    start = watcher.ages[0][0] + _SETTLING_S if watcher.ages else 0.0
    ages = [age for moment, age in watcher.ages if moment > start] or [float("nan")]
    moments = np.array([moment for moment in watcher.readings if moment > start])
    totals = [sum(one.mib) for one in memory]
    found: dict[str, object] = {
        "sensors": n_sensors,
        "rate_hz": rate,
        "seconds": seconds,
        "frames_recorded": lines,
        "frames_received": last,
        "states_per_second": round(len(moments) / (moments[-1] - moments[0]), 1),
        "map_age_median_s": round(float(np.median(ages)), 2),
        "map_age_95_s": round(float(np.quantile(ages, 0.95)), 2),
        "map_age_max_s": round(max(ages), 2),
        "first_verdict_s": round(watcher.first_verdict - watcher.first_frame, 1),
        "lags": watcher.lagged,
        **{
            f"memory_mib_quarter_{i + 1}": round(float(np.median(part)))
            for i, part in enumerate(np.array_split(totals, 4))
        },
        **{f"cpu_s_{role}": one for role, one in zip(ROLES, used, strict=True)},
        "load": os.getloadavg()[0],
    }
    return found, memory


def processes(pid: int) -> list[int]:
    """Return the session and its workers, in the order of `ROLES`."""
    return [pid, *(child for child in children(pid) if b"spawn_main" in _command(child))]


def write_memory(memory: Sequence[Memory], path: Path) -> None:
    """Write the memory over time as CSV, in equal steps."""
    rows = (
        [round(one.seconds), one.n_frames, *(round(size, 1) for size in one.mib)]
        for one in memory[:: max(1, len(memory) // _N_TIMES)]
    )
    write_csv(path.with_suffix(".csv"), MEMORY_COLUMNS, rows)


def draw_memory(memory: Sequence[Memory], path: Path) -> None:
    """Draw the memory of each process over time."""
    figure = Figure(figsize=(6, 3), layout="constrained")
    ax = figure.subplots()
    looks = (("#0b5394", "-"), ("#b35000", "--"), ("#4d5b69", ":"))
    minutes = [one.seconds / 60 for one in memory]
    for i, (role, (colour, line)) in enumerate(zip(ROLES, looks, strict=True)):
        sizes = [one.mib[i] for one in memory]
        ax.plot(minutes, sizes, line, color=colour, label=role.replace("_", " "))
    ax.set(xlabel="time (min)", ylabel="memory (MiB)", ylim=(0, None))
    ax.legend()
    figure.savefig(path, dpi=110)


def _command(pid: int) -> bytes:
    return Path(f"/proc/{pid}/cmdline").read_bytes()


if __name__ == "__main__":
    main()
