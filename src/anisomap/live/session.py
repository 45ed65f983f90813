"""A live session: a source, its recording, and the maps that follow it."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapError, InputError
from anisomap.live.batches import Names, Notice, Source
from anisomap.live.examination import Examination, ExaminationOptions
from anisomap.live.quick_map import QuickMap
from anisomap.live.recorder import Recorder, Segment
from anisomap.live.saving import command_for
from anisomap.live.session_maps import SessionMaps
from anisomap.placement import Anchors
from anisomap.sensor_map import SensorMap
from anisomap.wording import printable

TICK_S = 0.04
"""Time between two states of the readings on the page: 25 per second."""

LAGS_S = 2.0
"""Age of the newest frame in the map above which the session lags."""

_MAX_NOTICES = 100
_NOTICE_EVERY_S = 5.0  # for notices of one kind
_KIND = 20  # first characters of a notice that tell its kind
_STOP_S = 3.0  # for a source to end
_STEP_S = 0.02  # between two entries of the arrivals
_RATE_S = 3.0  # over which the rate is measured


class Note(NamedTuple):
    """A sentence for the user, and the time since the start of the session in seconds."""

    seconds: float
    text: str


class Arrivals:
    """When frames arrived, to tell the age of a map from its number of frames."""

    def __init__(self) -> None:
        self._counts: deque[tuple[int, float]] = deque(maxlen=20_000)

    def add(self, n_frames: int, now: float) -> None:
        """Note that there are `n_frames` frames at a time."""
        if self._counts and now - self._counts[-1][1] < _STEP_S:
            now = self._counts.pop()[1]
        self._counts.append((n_frames, now))

    def rate(self, now: float) -> float:
        """Return the number of frames per second in the last seconds."""
        recent = [entry for entry in list(self._counts) if now - entry[1] < _RATE_S]
        if len(recent) < 2:
            return 0.0
        (before, begin), (after, end) = recent[0], recent[-1]
        return (after - before) / (end - begin)

    def time_of(self, n_frames: int) -> float | None:
        """Return when the first frame arrived that is not among the first `n_frames`."""
        return next((moment for count, moment in list(self._counts) if count > n_frames), None)


def read_levels(
    readings: NDArray[np.float64], first: NDArray[np.float64], quick: QuickMap | None
) -> NDArray[np.float64]:
    """Return the deepest reading (N,) of each sensor, from 0 (rest) to 1 (its strongest so far).

    Without a quick map, depths are relative to the first frame, and to the deepest reading of all.
    """
    if quick is not None and len(quick.names) == len(first):
        depth, full = quick.rest.depth(readings), quick.highest_depth
    else:
        depth = np.abs(readings - first)
        full = np.nanmax(np.append(depth, 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.fmax.reduce(depth, axis=0) / np.where(full > 0, full, 1.0)
    return np.asarray(np.clip(np.nan_to_num(share), 0, 1))


class LiveSession:
    """Records a source and maps it while it runs.

    Use it as a context manager: frames are recorded from its beginning, and everything is on disk
    at its end.

    recording: File for the recording; must not exist.
    levels (N,): What the sensors read now, from 0 to 1: see `read_levels`.
    anchors: Known positions of some sensors, by which saved maps are placed.
    ended, wanted_end: Set when the source has ended, and when the user has asked for the end.
    changed: Notified when `tick`, the number of states of the readings, or `map_number`, that of
        maps, has grown.
    failure: Why the recording ended, if it could not go on.
    """

    def __init__(
        self, source: Source, recording: Path, options: ExaminationOptions | None = None
    ) -> None:
        self.source = source
        options = options or ExaminationOptions()
        if options.truth is None and source.truth is not None:
            options = replace(options, truth=source.truth)
        self.recorder = Recorder(recording, source.description, self.notify, self._begin_segment)
        self.recorder.names = source.names
        self.maps = SessionMaps(options, self.notify, self._announce, lambda: self.seconds)
        self.levels = np.empty(0)
        self._first: NDArray[np.float64] | None = None
        self.notices: deque[Note] = deque(maxlen=_MAX_NOTICES)
        self.failure: AnisomapError | None = None
        self.paused = False
        self.ended = threading.Event()
        self.wanted_end = threading.Event()
        self.anchors: Anchors | None = None
        self.finishing = False
        self.changed = threading.Condition()
        self.tick = 0
        self.map_number = 0
        self._told: dict[str, float] = {}
        self._stop = threading.Event()
        self._arrivals = Arrivals()
        self._began = time.monotonic()
        self._ended_at = 0.0  # 0 before
        self._threads: list[threading.Thread] = []

    def __enter__(self) -> LiveSession:
        self._began = time.monotonic()
        self.maps.start()
        tasks = (self._acquire, self._keep_time)
        self._threads = [threading.Thread(target=task, daemon=True) for task in tasks]
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.stop()
        finally:
            self.maps.close()

    @property
    def seconds(self) -> float:
        """Time since the start in seconds, until the source has ended."""
        return (self._ended_at or time.monotonic()) - self._began

    @property
    def segment(self) -> Segment | None:
        """The current file of the recording."""
        return self.recorder.segments[-1] if self.recorder.segments else None

    @property
    def state(self) -> str:
        """``"running"``, ``"paused"``, ``"finishing"`` or ``"ended"``."""
        if self.finishing:
            return "finishing"
        if self.ended.is_set():
            return "ended"
        return "paused" if self.paused else "running"

    @property
    def rate_hz(self) -> float:
        """Frames per second of the last seconds; NaN before."""
        return self._arrivals.rate(time.monotonic())

    @property
    def map_age(self) -> float:
        """Time in seconds for which the oldest frame that is not in the quick map has waited."""
        quick = self.maps.quick
        if quick is None:
            return 0.0 if self.recorder.n_frames == 0 else self.seconds
        waiting = self._arrivals.time_of(quick.n_frames)
        return 0.0 if waiting is None else (self._ended_at or time.monotonic()) - waiting

    @property
    def lags(self) -> bool:
        """Whether frames arrive faster than they are mapped."""
        quick = self.maps.quick
        return quick is not None and self.map_age > LAGS_S + 2 * quick.seconds

    @property
    def command(self) -> str:
        """The command that makes the final map again; empty before the first frame."""
        if self.segment is None:
            return ""
        return command_for(self.segment.path, self.maps.options, gaps=self.recorder.has_gaps)

    def notify(self, text: str) -> None:
        """Add a sentence for the user; of one kind, only one in some seconds."""
        text, now = printable(text), self.seconds
        kind = text[:_KIND]
        if now - self._told.get(kind, -_NOTICE_EVERY_S) < _NOTICE_EVERY_S:
            return
        if len(self._told) > _MAX_NOTICES:
            self._told.clear()
        self._told[kind] = now
        self.notices.append(Note(now, text))

    def pause(self, paused: bool) -> None:
        """Record nothing for a while, or go on."""
        self.recorder.arrived_at = None  # a pause is no silence of the source
        self.paused = paused
        self.notify("paused: nothing is recorded" if paused else "recording again")

    def restart(self) -> None:
        """Begin a new recording and a new map; the recording so far is kept."""
        self.recorder.restart()
        self.notify("a new recording begins")

    def drop(self, names: Sequence[str]) -> None:
        """Leave sensors out of the maps, or take back those that were left out."""
        known = set(self.maps.names)
        if unknown := [name for name in names if name not in known]:
            raise InputError(f"there is no sensor {printable(unknown[0])}")
        self.maps.change(replace(self.maps.options, drop=tuple(names)))

    def declare_truth(self, truth: SensorMap) -> None:
        """Compare checked maps with true positions from now on."""
        self.maps.change(replace(self.maps.options, truth=truth))
        self.notify(f"maps are compared with the {truth.n_sensors} positions that were declared")

    def stop(self) -> None:
        """End the acquisition; everything that arrived is on disk afterwards."""
        self._stop.set()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(_STOP_S)
        try:
            self.recorder.close()
        except AnisomapError as error:
            self.failure = self.failure or error
        self._end()

    def finish(self, timeout_s: float | None = None) -> Examination | None:
        """End the acquisition and make the final map, of all frames."""
        self.stop()
        self.finishing = True
        try:
            return self.maps.finish(self.recorder.n_frames, timeout_s)
        finally:
            self.finishing = False
            self._announce()

    def _acquire(self) -> None:
        if self.source.can_wait:
            while not (self.maps.ready.is_set() or self._stop.wait(TICK_S)):
                pass
        try:
            for item in self.source.items(self._stop):
                if isinstance(item, Notice):
                    self.notify(item.text)
                elif isinstance(item, Names):
                    self.recorder.names = item.names
                elif not self.paused:
                    self.recorder.put(item)
                    self._arrivals.add(self.recorder.n_frames, time.monotonic())
                if self._stop.is_set():
                    break
        except AnisomapError as error:
            self._fail(error)
        except Exception as error:  # a defect of a source must not lose what was recorded
            why = f"{type(error).__name__}: {error}"
            self._fail(AnisomapError(f"{self.source.description} failed: {why}"))
        finally:
            self._end()

    def _fail(self, error: AnisomapError) -> None:
        self.failure = error
        self.notify(str(error))

    def _end(self) -> None:
        self._ended_at = self._ended_at or time.monotonic()
        self.ended.set()

    def _begin_segment(self, segment: Segment) -> None:
        self._arrivals = Arrivals()
        self._first = None
        self.maps.begin(segment)

    def _keep_time(self) -> None:
        """Write what is held, prepare the readings for the page, and ask for checked maps."""
        while not self._stop.wait(TICK_S):
            try:
                self.recorder.flush()
            except AnisomapError as error:
                self._fail(error)
                self._stop.set()
            recent = self.recorder.recent()
            if recent is not None:
                if self._first is None or len(self._first) != recent.shape[1]:
                    self._first = recent[0]
                self.levels = read_levels(recent, self._first, self.maps.quick)
            if not self.paused:
                self.maps.follow(self.recorder.n_frames)
            with self.changed:
                self.tick += 1
                self.changed.notify_all()

    def _announce(self) -> None:
        with self.changed:
            self.map_number += 1
            self.changed.notify_all()
