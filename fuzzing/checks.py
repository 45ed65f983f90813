"""What must hold of a file that is read, however it is damaged."""

from __future__ import annotations

import os
import re
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

from anisomap import io
from anisomap.cli.app import run
from anisomap.errors import AnisomapError, AnisomapWarning
from anisomap.files.meshes import read_mesh
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap
from fuzzing.subjects import map_suffixes, recording_suffixes

MAX_MESSAGE = 300
"""Maximum length of a message of an error, in characters, beyond the path of the file."""

MEMORY_FACTOR, MEMORY_BYTES = 4, 200_000_000
"""A reader may use this multiple of what it returns, and this many bytes besides."""

_FULL_FORMATS = (".csv", ".tsv", ".npz", ".json")  # formats of maps that hold all of a map
_PRESETS = ("icub", "icub-hand", "nothing")
_MAX_MAPPED = 100  # sensors
_ALLOWED = (0, 2)
_FINDING = ("check", "diff")  # end with 1 if they find something


@dataclass
class Findings:
    """What one case showed: whether a reader accepted the file, and all that must not happen.

    memory: Bytes by which a call of a reader, or a command, enlarged this process at most.
    """

    folder: Path
    accepted: bool = False
    problems: list[str] = field(default_factory=list)
    memory: int = 0

    def attempt(self, what: str, action: Callable[[], Any]) -> Any:
        """Call a function that may refuse with an AnisomapError; return None if it did."""
        before = _files(self.folder)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                warnings.simplefilter("ignore", AnisomapWarning)
                return action()
        except AnisomapError as error:
            self._check_message(what, str(error))
        except MemoryError:
            self.problems.append(f"{what}: MemoryError")
        except Exception as error:
            self.problems.append(f"{what}: {_signature(error)}")
        left = _files(self.folder) - before
        if left:
            self.problems.append(f"{what}: left {sorted(_kinds(left))} after a failure")
        return None

    def command(self, *arguments: str | Path) -> None:
        """Run a command, which ends as it documents; after 2 there is no output."""
        before, name = _files(self.folder), str(arguments[0])
        in_use = _reset_peak()
        try:
            code = run([str(argument) for argument in arguments])
        except MemoryError:
            code = 2
        except Exception as error:
            self.problems.append(f"command {name}: {_signature(error)}")
            return
        finally:
            self.memory = max(self.memory, _peak() - in_use)
        self.accepted |= code == 0
        if code not in _ALLOWED and not (code == 1 and name in _FINDING):
            self.problems.append(f"command {name}: exit code {code}")
        if code and _files(self.folder) - before:
            self.problems.append(f"command {name}: an output after exit code {code}")

    def check_printed(self, text: str, *, by_command: bool) -> None:
        """Check what a case printed on standard error: warnings and errors of one line each."""
        for line in text.split("\n"):
            if not line:
                continue
            if not by_command:
                self.problems.append(f"a library printed {_general(line)}")
            elif not line.startswith(("error: ", "warning: ")):
                self.problems.append(f"standard error: {_general(line)}")
            elif not line.isprintable():
                self.problems.append("standard error: control characters")
            elif len(line.replace(str(self.folder), "")) > MAX_MESSAGE + 40 and line[0] == "e":
                self.problems.append(f"standard error: {len(line)} characters: {_general(line)}")

    def _check_message(self, what: str, message: str) -> None:
        if "\n" in message or "\r" in message:
            self.problems.append(f"{what}: a message of several lines: {_general(message)}")
        own = message.replace(str(self.folder), "")
        if len(own) > MAX_MESSAGE:
            self.problems.append(
                f"{what}: a message of {len(own) // 100}00 characters: {_general(own)}"
            )


def check_file(path: Path, found: Findings, rng: Generator) -> None:
    """Read a recording and a map, write what was read in some format, and read it again."""
    use = rng.integers(8)
    options = io.ReadOptions()
    if use == 0:
        options = io.ReadOptions(
            select=str(rng.choice(["readings", "/skin", "x", "skin/readings", "/skin:data"])),
            grid=(1, 5) if rng.integers(2) else None,
            preset=str(rng.choice(_PRESETS)) if not rng.integers(3) else "",
        )
    if use <= 4:
        recording = _within_memory(
            found, "read", lambda: io.read(path, options=options, progress=lambda _: None)
        )
        if recording is not None:
            _check_recording(found, recording, rng)
    if use == 5:
        found.attempt("open_stream", lambda: _streamed(path, rng if rng.integers(2) else None))
        found.attempt("contents", lambda: io.contents(path))
    if use >= 5:
        sensor_map = _within_memory(found, "read_map", lambda: io.read_map(path))
        if sensor_map is not None:
            _check_map(found, sensor_map, rng)


def check_file_by_command(path: Path, found: Findings, rng: Generator) -> None:
    """Read a file by the commands."""
    suffixes = map_suffixes()
    suffix = suffixes[rng.integers(len(suffixes))]
    output = found.folder / f"output{suffix}"
    use = rng.integers(6)
    if use <= 1:
        scaled = ("--spacing", "5mm") if rng.integers(2) else ()
        found.command("convert", path, output, *scaled)
    elif use <= 3:
        found.command("info", path, *(["--all"] if rng.integers(2) else ["--json"]))
    elif use == 4:
        found.command("score", path, path, "--permutations", "0")
    else:
        quick = ("--no-verdict", "--permutations", "0")
        found.command("map", path, "-o", found.folder / "output.csv", "-m", "r-anisomap", *quick)


def check_mesh(path: Path, found: Findings, _: Generator) -> None:
    """Read a mesh."""
    _within_memory(found, "read_mesh", lambda: read_mesh(path))


def _within_memory(
    found: Findings, what: str, action: Callable[[], Any], base: int = MEMORY_BYTES
) -> Any:
    before = _reset_peak()
    result = found.attempt(what, action)
    used = _peak() - before
    found.memory = max(found.memory, used)
    found.accepted |= result is not None
    allowed = MEMORY_FACTOR * _size(result) + base
    if used > allowed:
        found.problems.append(f"{what}: memory {used / 1e6:.0f} of {allowed / 1e6:.0f} MB")
    return result


def _check_recording(found: Findings, recording: Recording, rng: Generator) -> None:
    suffixes = recording_suffixes()
    path = found.folder / f"output{suffixes[rng.integers(len(suffixes))]}"
    if recording.readings.size > 1 << 16:
        return
    found.attempt("write", lambda: io.write(recording, path))
    if path.exists():
        again = found.attempt("read what was written", lambda: io.read(path))
        if again is None:
            found.problems.append(f"{path.suffix}: a written recording is refused")
        elif again.names != recording.names or not np.array_equal(
            again.readings, recording.readings, equal_nan=True
        ):
            found.problems.append(f"{path.suffix}: a recording is read back changed")
        path.unlink()


def _check_map(found: Findings, sensor_map: SensorMap, rng: Generator) -> None:
    suffixes = map_suffixes()
    suffix = suffixes[rng.integers(len(suffixes))]
    path = found.folder / f"output{suffix}"
    if sensor_map.n_sensors > 1 << 12:
        return
    if io.needs_scale(path):
        flat = np.minimum(sensor_map.component, 0)
        sensor_map = replace(sensor_map, units="m", component=flat)
    found.attempt("write", lambda: io.write(sensor_map, path))
    if not path.exists():
        return
    known = next(f for f in io.FORMATS if suffix in f.suffixes)
    if known.read_map is None or suffix == ".xacro":  # a macro is not a robot
        path.unlink()
        return
    again = found.attempt("read what was written", lambda: io.read_map(path))
    if again is None:
        found.problems.append(f"{suffix}: a written map is refused")
    elif suffix in _FULL_FORMATS and (
        again.names != sensor_map.names
        or not np.array_equal(again.positions, sensor_map.positions, equal_nan=True)
    ):
        found.problems.append(f"{suffix}: a map is read back changed")
    path.unlink()


def _streamed(path: Path, rng: Generator | None = None) -> int:
    """Count the frames of a file; change it after the first block, if there is a generator."""
    n_frames = 0
    with io.open_stream(path, frames=7) as stream:
        for block in stream.blocks:
            if rng is not None and not n_frames and path.is_file():
                _change(path, rng)
            n_frames += len(block.readings)
    return n_frames


def _change(path: Path, rng: Generator) -> None:
    content, kind = path.read_bytes(), rng.integers(4)
    if kind == 0:
        os.truncate(path, int(rng.integers(len(content) + 1)))
    elif kind == 1:
        path.write_bytes(rng.bytes(len(content)))
    elif kind == 2:
        with path.open("ab") as stream:
            stream.write(content)
    else:
        path.unlink()


def _size(result: Any) -> int:
    if isinstance(result, Recording):
        return int(result.readings.nbytes)
    if isinstance(result, SensorMap):
        return int(result.positions.nbytes)
    return 0


def _files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()} | {f"./{path}" for path in Path().iterdir()}


def _kinds(names: set[str]) -> set[str]:
    return {Path(name).suffix or name for name in names}


def _reset_peak() -> int:
    """Reset the peak memory of this process; return its present memory in bytes."""
    Path("/proc/self/clear_refs").write_text("5")
    return status("VmRSS")


def _peak() -> int:
    return status("VmHWM")


def processor_time() -> float:
    """Return the seconds of this process, and of those that read files for it."""
    ticks = 0
    for child in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split():
        fields = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])
    return time.process_time() + ticks / os.sysconf("SC_CLK_TCK")


def status(name: str) -> int:
    """Read a size in bytes from the status of this process."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name):
            return 1024 * int(line.split()[1])
    return 0


def _signature(error: Exception) -> str:
    """Return the type of an error and the last place in the package from which it came."""
    frames = traceback.extract_tb(sys.exc_info()[2])
    own = [
        frame
        for frame in frames
        if "anisomap" in frame.filename and "fuzzing" not in frame.filename
    ]
    place = f"{Path(own[-1].filename).name}:{own[-1].name}" if own else "outside"
    return f"{type(error).__name__} in {place}: {_general(str(error))}"


def _general(text: str) -> str:
    """Shorten a text, with its numbers replaced, so that similar ones are counted together."""
    text = re.sub(r"/\S*anisomap-fuzz-\S*?/case-[^/\s:']*", "", " ".join(text.split()))
    return re.sub(r"\d+", "#", text)[:90]
