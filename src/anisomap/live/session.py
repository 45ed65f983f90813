"""A live session: a source, its recording, and the maps that follow it."""

from __future__ import annotations

import shlex
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapError, InputError
from anisomap.health import SensorHealth
from anisomap.live.batches import Batch, Names, Notice, Source
from anisomap.live.coach import confirmed_faults
from anisomap.live.examination import Examination, ExaminationOptions
from anisomap.live.history import Arrivals, Note, Point
from anisomap.live.mapping import QuickMap
from anisomap.live.recorder import Recorder, Segment
from anisomap.live.workers import Changed, Examine, Failed, Ready, Worker
from anisomap.methods import DEFAULT_METHOD
from anisomap.placement import Anchors
from anisomap.usability import UNKNOWN
from anisomap.wording import printable

TICK_S = 0.04
"""Time between two states of the readings on the page: 25 per second."""

LAGS_S = 2.0
"""Age of the newest frame in the map above which the session lags."""

MAX_CURVE = 500
"""Points of the curves over time; when there are more, every other one is left out."""

_MAX_NOTICES = 100
_NOTICE_EVERY_S = 5.0  # for notices of one kind
_KIND = 20  # first characters of a notice that tell its kind
_MIN_NEW_FRAMES = 25  # for a first checked map; a second of a skin of usual rate
_GROWTH = 1.15  # of the number of frames between two checked maps
_STOP_S = 3.0  # for a source to end


class LiveSession:
    """Records a source and maps it while it runs.

    Use it as a context manager: frames are recorded from its beginning, and everything is on disk
    at its end.

    Parameters
    ----------
    source : Source
    recording : pathlib.Path
        File for the recording; must not exist.
    options : ExaminationOptions, optional
        What maps are made with.

    Attributes
    ----------
    source : Source
    recorder : Recorder
    quick : QuickMap or None
        The last quick map.
    checked : Examination or None
        The last checked map.
    notices : sequence of Note
    curve : list of Point
        Errors of the checked maps over time.
    touched : list of (float, float)
        Share of the sensors touched over time in seconds.
    examining : bool
        Whether a checked map is being made.
    anchors : Anchors or None
        Known positions of some sensors, by which saved maps are placed.
    ended, wanted_end : threading.Event
        Set when the source has ended, and when the user has asked for the end.
    failure : AnisomapError or None
        Why the recording ended, if it could not go on.
    """

    def __init__(
        self, source: Source, recording: Path, options: ExaminationOptions | None = None
    ) -> None:
        self.source = source
        self.options = options or ExaminationOptions()
        if self.options.truth is None and source.truth is not None:
            self.options = replace(self.options, truth=source.truth)
        self.recorder = Recorder(recording, source.description, self.notify, self._begin_segment)
        self.recorder.names = source.names
        self.quick: QuickMap | None = None
        self.checked: Examination | None = None
        self.notices: deque[Note] = deque(maxlen=_MAX_NOTICES)
        self.curve: list[Point] = []
        self.touched: list[tuple[float, float]] = []
        self.failure: AnisomapError | None = None
        self.paused = False
        self.ended = threading.Event()
        self.wanted_end = threading.Event()
        self.anchors: Anchors | None = None
        self.finishing = False
        self.changed = threading.Condition()
        self.tick = 0
        self.map_number = 0
        self.levels: NDArray[np.float64] = np.empty(0)
        self._told: dict[str, float] = {}
        self._stop = threading.Event()
        self._ready = threading.Event()
        self._arrivals = Arrivals()
        self.examining = False
        self._final: Examination | None = None
        self._finished = threading.Event()
        self._examined_frames = 0
        self._examined_at = 0.0
        self._first_row: NDArray[np.float64] | None = None
        self._began = time.monotonic()
        self._threads: list[threading.Thread] = []

    def __enter__(self) -> LiveSession:
        self._began = time.monotonic()
        self._quick = Worker("quick", self._receive_quick)
        self._examiner = Worker("checked", self._receive_checked)
        for worker in (self._quick, self._examiner):
            worker.send(Changed(options=self.options))
        for task in (self._acquire, self._keep_time):
            thread = threading.Thread(target=task, daemon=True)
            thread.start()
            self._threads.append(thread)
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.stop()
        finally:
            self._finished.set()
            self._quick.close()
            self._examiner.close()

    @property
    def seconds(self) -> float:
        """Time since the start in seconds."""
        return time.monotonic() - self._began

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
        if self.quick is None:
            return 0.0 if self.recorder.n_frames == 0 else self.seconds
        waiting = self._arrivals.time_of(self.quick.n_frames)
        return 0.0 if waiting is None else time.monotonic() - waiting

    @property
    def lags(self) -> bool:
        """Whether frames arrive faster than they are mapped."""
        return self.quick is not None and self.map_age > LAGS_S + 2 * self.quick.seconds

    @property
    def level(self) -> str:
        """Level of the checked map."""
        return UNKNOWN if self.checked is None else self.checked.verdict.level

    @property
    def share_touched(self) -> float:
        """Share of the sensors that were touched at least once, in [0, 1]."""
        if self.quick is None:
            return 0.0
        wanted = np.ones(len(self.quick.contacts), dtype=bool)
        wanted[list(self.quick.left_out)] = False
        return float((self.quick.contacts[wanted] > 0).mean()) if wanted.any() else 0.0

    @property
    def faults(self) -> tuple[SensorHealth, ...]:
        """The sensors that are faulty; those that were hardly touched so far are left out."""
        quick = self.quick
        if self.checked is None or quick is None:
            return ()
        untouched = {quick.names[i] for i in quick.advice.untouched}
        kept = [one for one in self.checked.health if one.name not in self.options.drop]
        return confirmed_faults(kept, untouched, self.share_touched)

    @property
    def command(self) -> str:
        """The command that makes the final map again."""
        segment, options = self.segment, self.options
        if segment is None:
            return ""
        words = ["anisomap", "map", str(segment.path), "-d", str(options.dimensions)]
        if options.method != DEFAULT_METHOD:
            words += ["-m", options.method]
        if options.preset:
            words += ["--preset", options.preset]
        for name in options.drop:
            words += ["--drop", name]
        if self.recorder.n_missing:
            words += ["--missing", "interpolate"]
        return shlex.join(words)

    def reached(self, level: str) -> bool:
        """Return whether the checked map has a level, or a better one."""
        return self.checked is not None and self.checked.verdict.is_at_least(level)

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
        self.paused = paused
        self.notify("paused: nothing is recorded" if paused else "recording again")

    def restart(self) -> None:
        """Begin a new recording and a new map; the recording so far is kept."""
        self.recorder.restart()
        self.notify("a new recording begins")

    def drop(self, names: Sequence[str]) -> None:
        """Leave sensors out of the maps, or take back those that were left out.

        Parameters
        ----------
        names : sequence of str
            All sensors to leave out from now on.

        Raises
        ------
        InputError
            If there is no such sensor.
        """
        known = set(self.sensor_names)
        if unknown := [name for name in names if name not in known]:
            raise InputError(f"there is no sensor {printable(unknown[0])}")
        self._change(replace(self.options, drop=tuple(names)))

    def declare_truth(self, truth: Any) -> None:
        """Compare checked maps with true positions from now on, given as a SensorMap."""
        self._change(replace(self.options, truth=truth))
        self.notify(f"maps are compared with the {truth.n_sensors} positions that were declared")

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Names of the sensors; empty before the first frame."""
        if self.quick is not None:
            return self.quick.names
        return () if self.segment is None else self.segment.names

    @property
    def n_sensors(self) -> int:
        """Number of sensors that maps are to place."""
        left_out = () if self.quick is None else self.quick.left_out
        return len(self.sensor_names) - len(left_out)

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
        self.ended.set()

    def finish(self, timeout_s: float | None = None) -> Examination | None:
        """End the acquisition and make the final map, of all frames.

        Parameters
        ----------
        timeout_s : float, optional
            Longest time to wait for it.

        Returns
        -------
        Examination or None
            None if nothing was recorded, or it was not made in time.
        """
        self.stop()
        segment = self.segment
        if segment is None:
            return None
        self._finished.clear()
        self.finishing = True
        self._examiner.send(Examine(segment, self.recorder.n_frames, final=True))
        try:
            self._finished.wait(timeout_s)
        finally:
            self.finishing = False
        self._announce()
        return self._final

    def _acquire(self) -> None:
        if getattr(self.source, "can_wait", False):
            while not (self._ready.is_set() or self._stop.wait(TICK_S)):
                pass
        try:
            for item in self.source.items(self._stop):
                if isinstance(item, Notice):
                    self.notify(item.text)
                elif isinstance(item, Names):
                    self.recorder.names = item.names
                elif not self.paused:
                    self._record(item)
                if self._stop.is_set():
                    break
        except AnisomapError as error:
            self.failure = error
            self.notify(str(error))
        except Exception as error:  # a defect of a source must not lose what was recorded
            self.failure = AnisomapError(
                f"{self.source.description} failed: {type(error).__name__}: {error}"
            )
            self.notify(str(self.failure))
        finally:
            self.ended.set()

    def _record(self, batch: Batch) -> None:
        self.recorder.put(batch)
        self._arrivals.add(self.recorder.n_frames, time.monotonic())

    def _begin_segment(self, segment: Segment) -> None:
        self.quick = self.checked = None
        self._arrivals = Arrivals()
        self._examined_frames = 0
        self._first_row = None
        self._quick.send(Changed(segment=segment))

    def _change(self, options: ExaminationOptions) -> None:
        self.options = options
        for worker in (self._quick, self._examiner):
            worker.send(Changed(options=options))
        self._examined_frames = 0

    def _keep_time(self) -> None:
        """Write what is held, prepare the readings for the page, and ask for checked maps."""
        while not self._stop.wait(TICK_S):
            try:
                self.recorder.flush()
            except AnisomapError as error:
                self.failure = error
                self.notify(str(error))
                self._stop.set()
            self._show(self.recorder.recent())
            self._ask()
            self._follow_share()
            with self.changed:
                self.tick += 1
                self.changed.notify_all()

    def _follow_share(self) -> None:
        now = self.seconds
        if not self.touched or now - self.touched[-1][0] >= 1.0:
            kept = self.touched[::2] if len(self.touched) >= MAX_CURVE else self.touched
            self.touched = [*kept, (now, self.share_touched)]

    def _show(self, recent: Sequence[NDArray[np.float64]]) -> None:
        """Compute the deepest reading of each sensor since the last tick, from 0 to 1."""
        width = self.recorder.width
        recent = [part for part in recent if part.shape[1] == width]
        if not recent:
            return
        readings = np.concatenate(recent)
        if self._first_row is None or len(self._first_row) != width:
            self._first_row = readings[0]
        quick = self.quick
        if quick is not None and len(quick.names) == width:
            depth, full = quick.rest.depth(readings), quick.highest_depth
        else:
            depth = np.abs(readings - self._first_row)
            full = np.nanmax(np.append(depth, 0.0))
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.fmax.reduce(depth, axis=0) / np.where(full > 0, full, 1.0)
        self.levels = np.clip(np.nan_to_num(share), 0, 1)

    def _ask(self) -> None:
        segment, n_frames = self.segment, self.recorder.n_frames
        if self.examining or segment is None or self.paused:
            return
        if n_frames < max(_MIN_NEW_FRAMES, _GROWTH * self._examined_frames):
            return
        # Half of the time is left to other processes.
        took = 0.0 if self.checked is None else self.checked.seconds
        if time.monotonic() - self._examined_at < took:
            return
        self.examining, self._examined_frames = True, n_frames
        self._examiner.send(Examine(segment, n_frames, final=False))

    def _receive_quick(self, answer: Any) -> None:
        self._ready.set()
        if isinstance(answer, Ready):
            return
        if isinstance(answer, Failed):
            self.notify(answer.text)
            return
        number, found = answer
        segment = self.segment
        if segment is not None and number == segment.number:
            self.quick = found
            self._announce()

    def _receive_checked(self, answer: Any) -> None:
        if isinstance(answer, Ready):
            return
        self.examining, self._examined_at = False, time.monotonic()
        if isinstance(answer, Failed):
            self.notify(answer.text)
            self._finished.set()
            return
        number, found = answer
        segment = self.segment
        if segment is None or number != segment.number:
            return
        self.checked = found
        self.curve.append(
            Point(
                self.seconds,
                found.n_frames,
                found.verdict.expected_error,
                found.error_against_truth,
                found.verdict.level,
            )
        )
        if len(self.curve) > MAX_CURVE:
            self.curve = self.curve[::2]
        self._announce()
        if found.final:
            self._final = found
            self._finished.set()

    def _announce(self) -> None:
        with self.changed:
            self.map_number += 1
            self.changed.notify_all()
