"""A live session: a source, its recording, and the maps that follow it."""

from __future__ import annotations

import math
import shlex
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from anisomap import io
from anisomap.base import DEFAULT_METHOD
from anisomap.base.wording import join_items, printable
from anisomap.drawing import report
from anisomap.errors import AnisomapError, InputError
from anisomap.health import SensorHealth
from anisomap.live.batches import Names, Notice, Source
from anisomap.live.quick_map import QuickMap, confirmed_faults, read_levels
from anisomap.live.recorder import GAP, Arrivals, Recorder, Segment
from anisomap.live.workers import Answer, Examination, ExaminationOptions, Task, Worker
from anisomap.map_verdict import LEVELS, Verdict
from anisomap.method.dimensions import AUTO, SPATIAL
from anisomap.notes import scaled_note
from anisomap.placement import parse_length, scaled_to_spacing
from anisomap.route import find_dropped
from anisomap.sensor_map import SensorMap
from anisomap.verdict.chance import MIN_FRAMES

MAX_CURVE = 500
"""Maximum points of a curve over time; above it, every other point is removed."""

_GROWTH = 1.15  # of the number of frames between two checked maps
_NEARLY_ALL = 0.9  # share of touched sensors for which one checked map suffices; chosen by hand
_REASONS = {2: "the skin looks flat", 3: "the skin does not look flat"}
_MAX_NAMED = 3  # sensors in one sentence
_SHARE_S = 1.0  # between two points of the share of sensors touched

_Point = TypeVar("_Point")


class SessionMaps:
    """Quick and checked maps of a growing recording, made by two processes.

    notify, announce: Callbacks for sentences for the user, and for new maps.
    clock: Returns the time since the start of the session in seconds.
    curve: Times in seconds, expected and true errors of checked maps in spacings, or NaN.
    touched: Share of the sensors touched over time in seconds.
    ready: Set when the process of quick maps has started.
    """

    def __init__(
        self,
        options: ExaminationOptions,
        notify: Callable[[str], None],
        announce: Callable[[], None],
        clock: Callable[[], float],
    ) -> None:
        self.options = options
        self.quick: QuickMap | None = None
        self.checked: Examination | None = None
        self._previous: Examination | None = None
        self.curve: list[tuple[float, float, float]] = []
        self.touched: list[tuple[float, float]] = []
        self.examining = False
        self.ready = threading.Event()
        self._notify, self._announce, self._clock = notify, announce, clock
        self._segment: Segment | None = None
        self._dimensions = SPATIAL  # of quick maps, if the options do not specify them
        self._has_changed = False
        self._finished = threading.Event()
        self._examined_frames = 0
        self._examined_at = 0.0

    def start(self) -> None:
        """Start the processes."""
        self._quick = Worker("quick", self._receive_quick)
        self._examiner = Worker("checked", self._receive_checked)

    def close(self) -> None:
        """End the processes."""
        self._finished.set()
        self._quick.close()
        self._examiner.close()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sensors; empty before the first frame."""
        known = self.quick or self._segment
        return () if known is None else known.names

    @property
    def n_sensors(self) -> int:
        """Number of sensors to be mapped."""
        return len(self.names) - (0 if self.quick is None else len(self.quick.left_out))

    @property
    def share_touched(self) -> float:
        """Share of the sensors that were touched at least once, in [0, 1]."""
        if self.quick is None:
            return 0.0
        wanted = np.delete(self.quick.contacts, list(self.quick.left_out))
        return float((wanted > 0).mean()) if wanted.size else 0.0

    @property
    def faults(self) -> tuple[SensorHealth, ...]:
        """Faulty sensors, except sensors that were hardly touched so far."""
        if self.checked is None:
            return ()
        dead = () if self.quick is None else self.quick.advice.dead
        kept = (one for one in self.checked.health if one.name not in self.dropped)
        return confirmed_faults(kept, [self.names[i] for i in dead])

    @property
    def dropped(self) -> tuple[str, ...]:
        """Names of the sensors left out by the user."""
        return find_dropped(self.options.drop, self.names)[0]

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names to be left out that are not sensors."""
        return find_dropped(self.options.drop, self.names)[1]

    @property
    def guidance(self) -> tuple[str, bool]:
        """Advice in one sentence, and whether the map is good.

        The advice does not describe the last checked map, which the panel shows.
        """
        if self.quick is None:
            return "Touch the skin", False
        advice = self.quick.advice
        if advice.untouched:
            names = join_items([self.names[i] for i in advice.untouched], _MAX_NAMED)
            return f"Touch {names}: not touched yet", False
        if advice.places:
            return f"Touch {advice.places[0].in_words(self.names)}", False
        dead = join_items([self.names[i] for i in advice.dead], _MAX_NAMED)
        told = f"{dead} never responded: dead? " if dead else ""
        if not self.is_good:
            return f"{told}Touch the whole skin again, each place in new directions", False
        return f"{told}Good: {self.error_told}. End the session, or go on", True

    @property
    def made(self) -> SensorMap:
        """The checked map; it must exist."""
        if self.checked is None or self.checked.sensor_map is None:
            reason = "" if self.checked is None else f": {self.checked.verdict.reasons[0]}"
            raise InputError(f"there is no checked map yet{reason}")
        return self.checked.sensor_map

    @property
    def is_good(self) -> bool:
        """Whether the checked map is usable."""
        return self.checked is not None and self.checked.verdict.level == list(LEVELS)[-1]

    @property
    def outcome(self) -> str:
        """Sentence on the use of the final map; empty before the map is made."""
        if self.checked is None or not self.checked.final:
            return ""
        if self.checked.sensor_map is None:
            return "There is no map."
        return self.checked.verdict.told(*self.spacing)[0]

    @property
    def error_told(self) -> str:
        """Text about the error of the checked map; empty if the error is unknown."""
        verdict = Verdict() if self.checked is None else self.checked.verdict
        return verdict.headline(*self.spacing).partition(": ")[2]

    @property
    def reason(self) -> str:
        """The worst reason of the verdict on the checked map; empty without a map."""
        reasons = () if self.checked is None else self.checked.verdict.reasons
        return scaled_note(reasons[0], *self.spacing) if reasons else ""

    @property
    def spacing(self) -> tuple[float, str]:
        """The distance between neighbouring sensors and its unit; 1 and "spacings" if unknown."""
        known = self.options.spacing_mm
        return (known, "mm") if known else (1.0, "spacings")

    def reached(self, level: str) -> bool:
        """Return whether the last two checked maps have a level, or a better one.

        Verdicts on few frames vary from one checked map to the next.
        """
        last = (self._previous, self.checked)
        return all(found is not None and found.verdict.is_at_least(level) for found in last)

    def begin(self, segment: Segment) -> None:
        """Map a new recording from now on."""
        self._segment = segment
        self.quick = self.checked = self._previous = None
        self._examined_frames = 0
        self._map_quickly()

    def change(self, options: ExaminationOptions) -> None:
        """Make maps with other options from now on."""
        self.options = options
        self._examined_frames = 0
        self._map_quickly()

    def follow(self, segment: Segment | None, n_frames: int) -> None:
        """Request a checked map if one is due, and record the share of touched sensors."""
        now = self._clock()
        if not self.touched or now - self.touched[-1][0] >= _SHARE_S:
            self.touched = [*_thinned(self.touched), (now, self.share_touched)]
        few = n_frames < max(MIN_FRAMES, _GROWTH * self._examined_frames)
        if self.examining or few or segment is None or segment is not self._segment:
            return
        # Half of the time is left to other processes.
        took = 0.0 if self.checked is None else self.checked.seconds
        if time.monotonic() - self._examined_at < took:
            return
        self.examining, self._examined_frames = True, n_frames
        self._examiner.send(Task(segment, self.options, n_frames=n_frames))

    def finish(self, n_frames: int, gives_up: Callable[[], bool]) -> Examination | None:
        """Make the map of all frames; see `LiveSession.finish`."""
        if self._segment is None:
            return None
        self._finished.clear()
        self._examiner.send(Task(self._segment, self.options, n_frames=n_frames, final=True))
        while not (self._examiner.gone or self._finished.wait(TICK_S) or gives_up()):
            pass
        return self.checked if self.checked is not None and self.checked.final else None

    def _map_quickly(self) -> None:
        """Send the current task to the worker."""
        if self._segment is not None:
            self._quick.send(Task(self._segment, self.options, self._dimensions))

    def _receive_quick(self, answer: Answer) -> None:
        self.ready.set()
        if answer.problem:
            self._notify(answer.problem)
        if isinstance(answer.found, QuickMap) and self._is_current(answer.number):
            before, self.quick = self.quick, answer.found
            if before is None and self.unknown:
                self._notify(f"there is no sensor {join_items(self.unknown)} to leave out")
            self._choose_dimensions()  # the checked map may be earlier
            self._announce()

    def _receive_checked(self, answer: Answer) -> None:
        if answer == Answer():
            return
        self.examining, self._examined_at = False, time.monotonic()
        if answer.problem:
            self._notify(answer.problem)
            if answer.final:
                self._finished.set()
        elif isinstance(answer.found, Examination) and self._is_current(answer.number):
            self._show(answer.found)

    def _show(self, found: Examination) -> None:
        self._previous, self.checked = self.checked, found
        errors = (self._clock(), found.verdict.expected_error, found.error_against_truth)
        self.curve = [*_thinned(self.curve), errors]
        self._choose_dimensions()
        self._announce()
        if found.final:
            self._finished.set()

    def _choose_dimensions(self) -> None:
        """Show quick maps in the number of dimensions chosen by checked maps.

        The number changes when two successive checked maps agree; the first time, one suffices if
        nearly all sensors were touched.
        """
        made = None if self.checked is None else self.checked.sensor_map
        if self.options.dimensions != AUTO or self.quick is None or made is None:
            return
        dimensions = made.dimensions
        before = None if self._previous is None else self._previous.sensor_map
        agree = before is not None and before.dimensions == dimensions
        first = not self._has_changed and self.share_touched >= _NEARLY_ALL
        if dimensions != self._dimensions and (agree or first):
            self._has_changed, self._dimensions = True, dimensions
            self._notify(f"{_REASONS[dimensions]}: maps have {dimensions} dimensions from now on")
            self._map_quickly()

    def _is_current(self, number: int) -> bool:
        return self._segment is not None and number == self._segment.number


def _thinned(curve: Sequence[_Point]) -> list[_Point]:
    """Return the points of a curve, or every other point if there are `MAX_CURVE` or more."""
    return list(curve[::2] if len(curve) >= MAX_CURVE else curve)


TICK_S = 0.04
"""Time between two updates of the readings on the page: 25 per second."""

LAGS_S = 2.0
"""Maximum age of the newest frame in the map of a session that does not lag."""

_MAX_NOTICES = 100
_NOTICE_EVERY_S = 5.0  # for notices of one kind
_KIND = 20  # first characters of a notice, which determine its kind
_STOP_S = 3.0  # for a source to end


class Note(NamedTuple):
    """A sentence for the user, and the time since the start of the session in seconds."""

    seconds: float
    text: str


class LiveSession:
    """Records a source and maps it while it runs.

    Use it as a context manager: frames are recorded from the start of the context, and all frames
    are on disk at its end.

    recording: File for the recording; must not exist.
    levels (N,): Current readings, from 0 to 1: see `read_levels`.
    ended, wanted_end: Set when the source has ended, and when the user has requested the end.
    changed: Notified of every map, and of every update of the readings, which `tick` counts.
    first_frame_at: Time of the first frame by the monotonic clock; infinite before it.
    page: File to which the page is written at the end, if any.
    failure: Reason why the recording ended, if it could not be continued.
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
        self.first_frame_at = math.inf
        self.page: Path | None = None
        self.notices: deque[Note] = deque(maxlen=_MAX_NOTICES)
        self.failure: AnisomapError | None = None
        self.paused = False
        self.ended = threading.Event()
        self.wanted_end = threading.Event()
        self.finishing = False
        self.changed = threading.Condition()
        self.tick = 0
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
    def gaps(self) -> list[float]:
        """End of each gap in the readings, in seconds since the start."""
        return [note.seconds for note in list(self.notices) if note.text.startswith(GAP)]

    @property
    def state(self) -> str:
        """``"running"``, ``"lost"``, ``"paused"``, ``"finishing"`` or ``"ended"``."""
        if self.finishing:
            return "finishing"
        if self.ended.is_set():
            return "ended"
        if self.paused:
            return "paused"
        return "running" if self.source.is_open or not self.recorder.n_frames else "lost"

    @property
    def rate_hz(self) -> float:
        """Frames per second in the last seconds; NaN before the first frames."""
        return self._arrivals.rate(time.monotonic())

    @property
    def map_age(self) -> float:
        """Waiting time in seconds of the oldest frame that is not in the quick map."""
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
    def guidance(self) -> tuple[str, bool]:
        """Advice in one sentence, and whether the map is good."""
        state = self.state
        if state == "ended":
            return f"The session is over. {self.maps.outcome}".rstrip(), self.maps.is_good
        waits = {
            "finishing": "Making the final map",
            "paused": "Paused: nothing is recorded. Press P to go on",
            "lost": f"No connection to {printable(self.source.description)}: trying again",
        }
        if state in waits:
            return waits[state], False
        if self.recorder.n_frames == 0:
            return "Waiting for the first frame", False
        if self.lags:
            return f"Wait: the map does not yet include the last {self.map_age:.0f} s", False
        return self.maps.guidance

    @property
    def command(self) -> str:
        """The command that reproduces the final map; empty before the first frame."""
        if self.segment is None:
            return ""
        options, unknown = self.maps.options, self.maps.unknown
        given = [
            ("-d", "" if options.dimensions == AUTO else str(options.dimensions)),
            ("-m", "" if options.method == DEFAULT_METHOD else options.method),
            ("--preset", options.preset),
            *(("--drop", name) for name in options.drop if name not in unknown),
            ("--contacts", options.contacts),
            ("--missing", "interpolate" if self.recorder.has_gaps else ""),
            ("--spacing", f"{options.spacing_mm:g}mm" if options.spacing_mm else ""),
        ]
        words = [word for name, value in given if value for word in (name, value)]
        return shlex.join(["anisomap", "map", str(self.segment.path), *words])

    def notify(self, text: str) -> None:
        """Add a sentence for the user; it replaces a recent sentence of the same kind."""
        text, now = printable(text), self.seconds
        kind = text[:_KIND]
        if now - self._told.get(kind, -_NOTICE_EVERY_S) < _NOTICE_EVERY_S:
            if self.notices and self.notices[-1].text.startswith(kind):
                self.notices[-1] = self.notices[-1]._replace(text=text)
            return
        if len(self._told) > _MAX_NOTICES:
            self._told.clear()
        self._told[kind] = now
        self.notices.append(Note(now, text))

    def pause(self, paused: bool) -> None:
        """Pause or continue recording."""
        self.recorder.arrived_at = None  # a pause is not a gap of the source
        self.paused = paused
        self.notify("paused: nothing is recorded" if paused else "recording again")

    def restart(self) -> None:
        """Begin a new recording and a new map; the recording so far is kept."""
        self.recorder.close()
        self.notify("a new recording begins")

    def drop(self, names: Sequence[str]) -> None:
        """Leave sensors out of the maps, or restore sensors that were left out."""
        known = set(self.maps.names)
        if unknown := [name for name in names if name not in known]:
            raise InputError(f"there is no sensor {printable(unknown[0])}")
        self.maps.change(replace(self.maps.options, drop=tuple(names)))

    def save(self, path: Path, spacing: str = "") -> Path:
        """Write the checked map."""
        sensor_map = self.maps.made
        if spacing:
            sensor_map = scaled_to_spacing(sensor_map, *parse_length(spacing))
        elif io.needs_scale(path):
            raise InputError(f"{path.name} is in metres: give a spacing, such as 6.5mm")
        io.write(sensor_map, path)
        return path

    def save_report(self, path: Path) -> Path:
        """Write the report on the checked map."""
        sensor_map, checked = self.maps.made, self.maps.checked
        report.check_writable(path)
        health = () if checked is None else checked.health
        summary = None if checked is None else checked.summary
        report.write_report(path, sensor_map, health=health, summary=summary)
        return path

    def stop(self) -> None:
        """End the acquisition; all received frames are then on disk."""
        self._stop.set()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(_STOP_S)
        try:
            self.recorder.close()
        except AnisomapError as error:
            self.failure = self.failure or error
        self._end()

    def finish(self, gives_up: Callable[[], bool] = lambda: False) -> Examination | None:
        """End the acquisition, and make the final map of all frames unless `gives_up`."""
        self.stop()
        self.finishing = True
        try:
            return self.maps.finish(self.recorder.n_frames, gives_up)
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
                    self.recorder.rename(item.names)
                elif not self.paused:
                    self.recorder.put(item)
                    self.first_frame_at = min(self.first_frame_at, time.monotonic())
                    self._arrivals.add(self.recorder.n_frames, time.monotonic())
                if self._stop.is_set():
                    break
        except AnisomapError as error:
            self._fail(error)
        except Exception as error:  # a defect of a source must not lose the recording
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
        """Write buffered frames, prepare readings for the page, and request checked maps."""
        readable = 0
        while not self._stop.wait(TICK_S):
            segment = self.segment  # before the number of its frames: another may begin
            try:
                readable = self.recorder.flush()
            except AnisomapError as error:
                self._fail(error)
                self._stop.set()
            recent = self.recorder.recent()
            if recent is not None:
                if self._first is None or len(self._first) != recent.shape[1]:
                    self._first = recent[0]
                self.levels = read_levels(recent, self._first, self.maps.quick)
            if not self.paused:
                self.maps.follow(segment, readable)
            self.tick += 1
            self._announce()

    def _announce(self) -> None:
        with self.changed:
            self.changed.notify_all()
