"""Processes beside the session: one makes quick maps, one makes checked maps.

Frames reach them through the recording on disk, which they read as it grows: the acquisition never
waits for a map, a backlog takes no memory, and a map of the session is one of the recording.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from anisomap.dimensions import AUTO, SPATIAL
from anisomap.errors import InputError
from anisomap.io import numbering
from anisomap.live.examination import ExaminationOptions, examine
from anisomap.live.quick_map import QuickMapper, TouchStatistics
from anisomap.live.recorder import JournalTail, Segment
from anisomap.memory import check_pair_memory
from anisomap.recording import Recording

_POLL_S = 0.03  # between two looks at a recording that has not grown
_READ_BYTES = 1 << 22  # at a time, so that a map of a backlog is made now and then
_MAX_BEHIND_S = 1.0  # of reading a backlog without a map
_IDLE_SHARE = 0.5  # pause after a quick map, as a share of its time: others need the processor too
_NICENESS = {"quick": 0, "checked": 5}
_MAX_RESTARTS = 3
_JOIN_S = 0.5  # for a process to end by itself


@dataclass(frozen=True)
class Changed:
    """A message to the workers: what they map from now on.

    dimensions: Of quick maps, if the options leave it open.
    """

    segment: Segment | None = None
    options: ExaminationOptions | None = None
    dimensions: int | None = None

    def updated(self, other: Changed) -> Changed:
        """Return both changes in one."""
        return Changed(
            other.segment or self.segment,
            other.options or self.options,
            other.dimensions or self.dimensions,
        )


@dataclass(frozen=True)
class Examine:
    """A message to the worker of checked maps: examine the recording."""

    segment: Segment
    n_frames: int
    final: bool


@dataclass(frozen=True)
class Failed:
    """A message from a worker: something unexpected went wrong.

    final: Whether no final map follows.
    """

    text: str
    final: bool = False


@dataclass(frozen=True)
class Ready:
    """A message from a worker: it has started."""


class Worker:
    """A process that answers messages, and is started again if it dies.

    receive: Receives each answer, in a thread.
    gone: Whether the process died too often to be started again.
    """

    def __init__(self, role: str, receive: Callable[[Any], None]) -> None:
        self._role, self._receive = role, receive
        self._context = get_context("spawn")
        self._lock = threading.Lock()
        self.gone = False
        self._closing = False
        self._restarts = 0
        self._state = Changed()
        self._request: Examine | None = None
        self._start()

    def send(self, message: Any) -> None:
        """Send a message; a dead process gets it when it is started again."""
        with self._lock:
            if isinstance(message, Changed):
                self._state = self._state.updated(message)
            else:
                self._request = message
            with suppress(OSError, ValueError):
                self._connection.send(message)

    def close(self) -> None:
        """End the process."""
        with suppress(OSError, ValueError), self._lock:
            self._closing = True
            self._connection.send(None)
        self._process.join(_JOIN_S)
        if self._process.is_alive():  # it is making a map
            self._process.terminate()
            self._process.join()
        self._listener.join()
        self._connection.close()

    def _start(self) -> None:
        ours, theirs = self._context.Pipe()
        self._connection = ours
        self._process = self._context.Process(target=_run, args=(self._role, theirs), daemon=True)
        self._process.start()
        theirs.close()
        self._listener = threading.Thread(target=self._listen, args=(ours,), daemon=True)
        self._listener.start()

    def _listen(self, connection: Connection) -> None:
        while True:
            try:
                answer = connection.recv()
            except (EOFError, OSError):
                break
            self._receive(answer)
        if self._closing:
            return
        connection.close()
        self._restarts += 1
        if self._restarts > _MAX_RESTARTS:
            self.gone = True
            text = f"the process of {self._role} maps ended; there are no more"
            self._receive(Failed(text, final=True))
            return
        self._receive(Failed(f"the process of {self._role} maps ended and is started again"))
        with self._lock:
            if self._closing:  # meanwhile
                return
            self._start()
            for message in (self._state, self._request):
                if message is not None:
                    with suppress(OSError):
                        self._connection.send(message)


def _run(role: str, connection: Connection) -> None:
    """Work until the session closes the connection, or its process ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the session ends its workers itself
    with suppress(OSError, AttributeError):
        os.nice(_NICENESS[role])
    with suppress(EOFError, OSError, KeyboardInterrupt):
        connection.send(Ready())
        if role == "quick":
            _make_quick_maps(connection)
        else:
            _make_checked_maps(connection)


def _make_checked_maps(connection: Connection) -> None:
    options, request = ExaminationOptions(), None
    while True:
        message = connection.recv()
        if message is None:
            return
        if isinstance(message, Changed):
            options = message.options or options
        else:
            request = message
        if request is None or connection.poll():  # only the latest request is answered
            continue
        try:
            found = examine(request.segment.path, request.n_frames, options, final=request.final)
            connection.send((request.segment.number, found))
        except Exception as error:  # a defect must not end the recording
            text = f"a checked map failed: {type(error).__name__}: {error}"
            connection.send(Failed(text, final=request.final))
        request = None


def _make_quick_maps(connection: Connection) -> None:
    state, told = _Follower(), ""
    while True:
        wait = _POLL_S if state.segment is not None else None
        if connection.poll(0) if state.busy else connection.poll(wait):
            message = connection.recv()
            if message is None:
                return
            state.change(message)
            continue
        try:
            found = state.follow()
        except Exception as error:  # a defect must not end the recording
            connection.send(Failed(f"a quick map failed: {type(error).__name__}: {error}"))
            state.pause(1.0)
            continue
        if state.problem != told:
            told = state.problem
            if told:
                connection.send(Failed(told))
        if found is not None:
            connection.send((state.number, found))


class _Follower:
    """Follows the recording of a session and maps it."""

    def __init__(self) -> None:
        self.segment: Segment | None = None
        self.busy = False
        self.problem = ""  # why the preset does not fit
        self._options = ExaminationOptions()
        self._chosen = SPATIAL
        self._tail: JournalTail | None = None
        self._next_map = 0.0
        self._mapped_frames = 0

    @property
    def number(self) -> int:
        """Number of the segment."""
        return 0 if self.segment is None else self.segment.number

    def change(self, message: Changed) -> None:
        """Follow another recording, or map it otherwise."""
        if message.options is not None:
            self._options = message.options
            self._mapped_frames = 0
        if message.dimensions is not None:
            self._chosen = message.dimensions
            self._mapped_frames = 0
        if message.segment is not None:
            if self._tail is not None:
                self._tail.close()
            segment = message.segment
            self.segment, self._mapped_frames, self._tail = segment, 0, None
            try:
                check_pair_memory(len(segment.names), refined=False)
            except InputError as error:
                self.problem = str(error)
                return
            self._tail = JournalTail(segment.path, len(segment.names), segment.header_bytes)
            self._statistics = TouchStatistics(len(segment.names))
            self._mapper = QuickMapper(segment.names, self._dimensions)

    def pause(self, seconds: float) -> None:
        """Make no map for some seconds."""
        self._next_map = time.monotonic() + seconds
        self.busy = False

    def follow(self) -> Any:
        """Read what is new, and return a map if it is time for one."""
        if self._tail is None or self.segment is None:
            return None
        begun, more = time.monotonic(), True
        while more and time.monotonic() - begun < _MAX_BEHIND_S:
            readings, more = self._tail.read(_READ_BYTES)
            self._statistics.add(readings)
        self.busy = more
        now = time.monotonic()
        if self._statistics.n_frames <= self._mapped_frames or now < self._next_map:
            return None
        names, left_out = self._left_out(self.segment)
        self._mapper.names, self._mapper.drop = names, left_out
        self._mapper.dimensions = self._dimensions
        found = self._mapper.make(self._statistics)
        self._mapped_frames = found.n_frames
        self._next_map = time.monotonic() + _IDLE_SHARE * found.seconds
        return found

    @property
    def _dimensions(self) -> int:
        given = self._options.dimensions
        return self._chosen if given == AUTO else int(given)

    def _left_out(self, segment: Segment) -> tuple[tuple[str, ...], set[int]]:
        """Return the names of all channels, and those that are dropped or are no sensors."""
        names = list(segment.names)
        left_out: set[int] = set()
        if self._options.preset:
            statistics = self._statistics
            low = np.where(np.isfinite(statistics.lowest), statistics.lowest, 0)
            high = np.where(np.isfinite(statistics.highest), statistics.highest, 0)
            # Presets depend on which values vary, and on the port that the values come from.
            probe = Recording(
                np.array([low, low, high]), names=segment.names, source=segment.source
            )
            self.problem = ""
            try:
                kept = numbering(probe, self._options.preset)
            except InputError as error:
                self.problem = str(error)
                kept = dict(enumerate(names))
            left_out = set(range(len(names))) - set(kept)
            for i, name in kept.items():
                names[i] = name
        dropped = set(self._options.drop)
        left_out |= {i for i, name in enumerate(names) if name in dropped}
        left_out |= {i for i, name in enumerate(segment.names) if name in dropped}
        return tuple(names), left_out
