"""Worker processes of a session: one makes quick maps, one makes checked maps.

The workers read frames from the growing recording on disk: the acquisition never waits for a map, a
backlog takes no memory, and maps of the session are maps of the recording. A checked map is exactly
the map of ``anisomap map``, with its verdict.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from anisomap import io, route
from anisomap.base import DEFAULT_METHOD
from anisomap.errors import AnisomapError, InputError
from anisomap.evaluation import score
from anisomap.health import RecordingSummary, SensorHealth
from anisomap.live.quick_map import QuickMap, QuickMapper
from anisomap.live.recorder import JournalTail, Segment
from anisomap.map_verdict import COMPACT, Verdict
from anisomap.method.dimensions import AUTO, SPATIAL, Dimensions
from anisomap.numerics.precision import check_pair_memory
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

MAX_INTERIM_READINGS = 1 << 22
"""Maximum readings of a checked map while the session runs; more are sampled evenly."""


@dataclass(frozen=True, eq=False)
class Examination:
    """A checked map.

    sensor_map: None if there is no map yet; the verdict contains the reason.
    error_against_truth: RMS error in spacings, if the truth is known; else NaN.
    n_frames: Number of frames of the recording when it was read.
    final: Whether all frames of the session are in the map.
    """

    sensor_map: SensorMap | None
    health: tuple[SensorHealth, ...]
    summary: RecordingSummary | None
    verdict: Verdict
    error_against_truth: float
    n_frames: int
    seconds: float
    final: bool


@dataclass(frozen=True)
class ExaminationOptions:
    """Options of a checked map.

    dimensions: Number of coordinates; "auto" chooses it for each checked map.
    preset: See `ReadOptions`.
    drop: Sensors to leave out, as in `map --drop`; unknown names are ignored.
    truth: Positions to compare with.
    spacing_mm: Distance between neighbouring sensors; 0 if unknown.
    contacts: Shape of all contacts: see `diagnose`. The page asks users to touch with a fingertip.
    """

    dimensions: Dimensions = AUTO
    method: str = DEFAULT_METHOD
    preset: str = ""
    drop: tuple[str, ...] = ()
    truth: SensorMap | None = None
    spacing_mm: float = 0.0
    contacts: str = COMPACT


def examine(
    path: Path, n_frames: int, options: ExaminationOptions, *, final: bool = False
) -> Examination:
    """Map the recording of a session, and judge the map."""
    begun = time.monotonic()
    made: SensorMap | None = None
    examined: route.Examined | None = None
    verdict, error = Verdict(), float("nan")
    with warnings.catch_warnings(action="ignore"):
        try:
            recording = _read(path, options, final)
            drop, _ = route.find_dropped(options.drop, recording.names)
            examined = route.examine(recording, drop=drop)
            made, stages = route.make_map(examined, options.method, options.dimensions)
            made = route.judge(examined, made, stages, contacts=options.contacts)
            if options.truth is not None:
                error = score(made, options.truth, permutations=0).rms_in_spacings
        except AnisomapError as problem:
            verdict = Verdict(reasons=(str(problem),))
    return Examination(
        sensor_map=made,
        health=() if examined is None else tuple(examined.health),
        summary=None if examined is None else examined.summary,
        verdict=verdict if made is None else made.verdict,
        error_against_truth=error,
        n_frames=n_frames,
        seconds=time.monotonic() - begun,
        final=final,
    )


def _read(path: Path, options: ExaminationOptions, final: bool) -> Recording:
    """Read a recording as `anisomap map` does; fewer frames while it still grows."""
    how = io.ReadOptions(preset=options.preset)
    limit = route.MAX_READINGS if final else MAX_INTERIM_READINGS
    return route.complete(route.read_runs([path], how, max_readings=limit), "interpolate")


_POLL_S = 0.03  # between two checks for growth of the recording
_READ_BYTES = 1 << 22  # read at a time, so that maps are also made during a backlog
_MAX_BEHIND_S = 1.0  # maximum time of reading a backlog without a map
_IDLE_SHARE = 1.0  # pause after a quick map, as a share of its time, for other processes
_NICENESS = 5  # of the process of checked maps
_FAILED_S = 1.0  # pause after a map that failed
_MAX_RESTARTS = 3
_JOIN_S = 0.5  # for a process to end by itself


@dataclass(frozen=True)
class Task:
    """A task of a worker: what to map from now on, or once.

    dimensions: Dimensions of quick maps, if the options do not specify them.
    """

    segment: Segment
    options: ExaminationOptions
    dimensions: int = SPATIAL
    n_frames: int = 0
    final: bool = False


@dataclass(frozen=True)
class Answer:
    """An answer of a worker; the first answer, sent at its start, is empty.

    number: Number of the mapped file.
    final: Whether no final map follows.
    """

    number: int = 0
    found: QuickMap | Examination | None = None
    problem: str = ""
    final: bool = False


class Worker:
    """A process that performs the latest task, and is restarted if it dies.

    receive: Receives each answer, in a thread.
    gone: Whether the process died too often to be restarted.
    """

    def __init__(self, role: str, receive: Callable[[Answer], None]) -> None:
        self._role, self._receive = role, receive
        self._context = get_context("spawn")
        self._lock = threading.Lock()
        self.gone = False
        self._closing = False
        self._restarts = 0
        self._task: Task | None = None
        self._start()
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def send(self, task: Task | None) -> None:
        """Send a task; a dead process receives it after a restart. None ends the process."""
        with self._lock, suppress(OSError, ValueError):
            self._task, self._closing = task, task is None
            self._connection.send(task)

    def close(self) -> None:
        """End the process."""
        self.send(None)
        self._process.join(_JOIN_S)
        self._process.kill()  # while it makes a map, or if it was stopped
        self._process.join()
        self._listener.join()
        self._connection.close()

    def _start(self) -> None:
        self._connection, theirs = self._context.Pipe()
        process = self._context.Process(
            name=f"{self._role} maps", target=_run, args=(self._role, theirs), daemon=True
        )
        try:
            with _signals_held():
                process.start()
        finally:
            theirs.close()  # `recv` then ends with the process
        self._process = process

    def _listen(self) -> None:
        while True:
            with suppress(EOFError, OSError):
                while True:
                    self._receive(self._connection.recv())
            if self._closing:
                return
            self._restarts += 1
            ended = f"the process of {self._role} maps ended"
            if self._restarts > _MAX_RESTARTS:
                self.gone = True
                self._receive(Answer(problem=f"{ended}, too often to restart it", final=True))
                return
            self._receive(Answer(problem=f"{ended} and is started again"))
            with self._lock, suppress(OSError):
                if self._closing:
                    return
                self._connection.close()
                self._start()
                if self._task is not None:
                    self._connection.send(self._task)


@contextmanager
def _signals_held() -> Iterator[None]:
    """Block signals to the process group while processes start, which inherit the mask."""
    if sys.platform == "win32":
        yield
        return
    resource_tracker.ensure_running()  # its start would unblock the signals
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _checked_map(task: Task) -> Answer:
    found = examine(task.segment.path, task.n_frames, task.options, final=task.final)
    return Answer(task.segment.number, found)


class _QuickMaps:
    """Reads the recording of a session as it grows, and maps it repeatedly."""

    def __init__(self) -> None:
        self._task: Task | None = None
        self._tail: JournalTail | None = None
        self._problem = self._told = ""  # why there is no map, or the preset does not fit
        self._next_map = 0.0
        self._mapped_frames = 0

    def __call__(self, task: Task) -> Answer | None:
        if task is not self._task:
            self._begin(task)
        found = None if self._tail is None else self._follow(task, self._tail)
        problem, self._told = "" if self._problem == self._told else self._problem, self._problem
        return Answer(task.segment.number, found, problem) if found or problem else None

    def _begin(self, task: Task) -> None:
        """Change the options, or map another recording, from now on."""
        before, self._task, self._mapped_frames = self._task, task, 0
        if before is not None and before.segment == task.segment:
            return
        if self._tail is not None:
            self._tail.close()
        self._tail = None
        segment, n_sensors = task.segment, len(task.segment.names)
        try:
            check_pair_memory(n_sensors, refined=False)
        except InputError as error:
            self._problem = str(error)
            return
        self._tail = JournalTail(segment.path, n_sensors, segment.header_bytes)
        self._mapper = QuickMapper(segment.names, task.dimensions)

    def _follow(self, task: Task, tail: JournalTail) -> QuickMap | None:
        """Read new frames, and return a map if one is due."""
        begun, more = time.monotonic(), True
        while more and time.monotonic() - begun < _MAX_BEHIND_S:
            readings, more = tail.read(_READ_BYTES)
            self._mapper.add(readings)
        if self._mapper.sample.n_frames <= self._mapped_frames or time.monotonic() < self._next_map:
            return None
        given = task.options.dimensions
        self._mapper.dimensions = task.dimensions if given == AUTO else int(given)
        self._mapper.names, self._mapper.drop = self._sensors(task)
        found = self._mapper.make()
        self._mapped_frames = found.n_frames
        self._next_map = time.monotonic() + _IDLE_SHARE * found.seconds
        return found

    def _sensors(self, task: Task) -> tuple[tuple[str, ...], set[int]]:
        """Return the names of all channels, and channels that are dropped or not sensors."""
        given, options = task.segment.names, task.options
        kept = dict(enumerate(given))
        if options.preset:
            # Presets depend on varying values, and on the port of the values.
            readings = np.nan_to_num(self._mapper.sample.readings)
            probe = Recording(readings, names=given, source=task.segment.source)
            self._problem = ""
            try:
                kept = io.numbering(probe, options.preset)
            except InputError as error:
                self._problem = str(error)
        names = tuple(kept.get(i, name) for i, name in enumerate(given))
        dropped, _ = route.find_dropped(options.drop, [names[i] for i in kept])
        return names, {i for i, name in enumerate(names) if i not in kept or name in dropped}


def _run(role: str, connection: Connection) -> None:
    """Work until the session closes the connection, or its process ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the session ends its workers
    is_quick = role == "quick"
    make: Callable[[Task], Answer | None] = _QuickMaps() if is_quick else _checked_map
    with suppress(OSError, AttributeError):
        os.nice(0 if is_quick else _NICENESS)
    with suppress(EOFError, OSError):
        connection.send(Answer())
        wait_s = None  # for another task
        while True:
            if connection.poll(wait_s):
                task, wait_s = connection.recv(), 0.0
                if task is None:
                    return
                continue
            wait_s = _POLL_S if is_quick else None
            try:
                answer = make(task)
            except Exception as error:  # a defect must not end the recording
                problem = f"a {role} map failed: {type(error).__name__}: {error}"
                connection.send(Answer(problem=problem, final=task.final))
                connection.poll(_FAILED_S)
                continue
            if answer is not None:
                connection.send(answer)
