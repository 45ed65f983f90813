"""The maps of a session: when they are made, and what they show so far."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from anisomap.diagnosis.chance import MIN_FRAMES
from anisomap.dimensions import AUTO, SPATIAL
from anisomap.health import SensorHealth
from anisomap.live.examination import Examination, ExaminationOptions
from anisomap.live.quick_map import QuickMap, confirmed_faults
from anisomap.live.recorder import Segment
from anisomap.live.workers import Answer, Task, Worker
from anisomap.usability import LEVELS, UNKNOWN

MAX_CURVE = 500
"""Points of a curve over time; when there are more, every other one is left out."""

_GROWTH = 1.15  # of the number of frames between two checked maps
_NEARLY_ALL = 0.9  # of the sensors touched, for one checked map to suffice; chosen by hand
_REASONS = {2: "the skin looks flat", 3: "the skin does not look flat"}
_SHARE_S = 1.0  # between two points of the share of sensors touched

_Point = TypeVar("_Point")


class Errors(NamedTuple):
    """Errors of a checked map in spacings, NaN if unknown, and the time since the start in s."""

    seconds: float
    expected: float
    against_truth: float


class SessionMaps:
    """Quick and checked maps of a recording that grows, made by two processes.

    notify, announce: Take sentences for the user; are called when there is a new map.
    clock: Returns the time since the start of the session in seconds.
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
        self.curve: list[Errors] = []
        self.touched: list[tuple[float, float]] = []
        self.examining = False
        self.ready = threading.Event()
        self._notify, self._announce, self._clock = notify, announce, clock
        self._segment: Segment | None = None
        self._dimensions = SPATIAL  # of quick maps, if the options leave it open
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
        """Number of sensors that maps are to place."""
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
        """The sensors that are faulty; those that were hardly touched so far are left out."""
        if self.checked is None:
            return ()
        return confirmed_faults(
            one for one in self.checked.health if one.name not in self.options.drop
        )

    @property
    def guidance(self) -> tuple[str, bool]:
        """What to do next, in words, and whether nothing is left to do.

        Where contacts suffice, the verdict decides: more touches would not mend its reasons.
        """
        if self.quick is None:
            return "", False
        advice, checked = self.quick.advice, self.checked
        if not advice.enough or checked is None:
            return advice.text, advice.enough
        level = checked.verdict.level
        if level == UNKNOWN:
            return f"enough touches: {UNKNOWN} yet how far the map can be used", False
        words = f"enough touches: the map of {checked.n_frames} frames is {level}"
        return words, level == list(LEVELS)[-1]

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

    def follow(self, n_frames: int) -> None:
        """Ask for a checked map if it is time for one, and note the share of sensors touched."""
        now = self._clock()
        if not self.touched or now - self.touched[-1][0] >= _SHARE_S:
            self.touched = [*_thinned(self.touched), (now, self.share_touched)]
        few = n_frames < max(MIN_FRAMES, _GROWTH * self._examined_frames)
        if self.examining or few or self._segment is None:
            return
        # Half of the time is left to other processes.
        took = 0.0 if self.checked is None else self.checked.seconds
        if time.monotonic() - self._examined_at < took:
            return
        self.examining, self._examined_frames = True, n_frames
        self._examiner.send(Task(self._segment, self.options, n_frames=n_frames))

    def finish(self, n_frames: int, timeout_s: float | None) -> Examination | None:
        """Make the map of all frames; see `LiveSession.finish`."""
        if self._segment is None:
            return None
        self._finished.clear()
        self._examiner.send(Task(self._segment, self.options, n_frames=n_frames, final=True))
        if not self._examiner.gone:
            self._finished.wait(timeout_s)
        return self.checked if self.checked is not None and self.checked.final else None

    def _map_quickly(self) -> None:
        """Tell the worker what to map from now on."""
        if self._segment is not None:
            self._quick.send(Task(self._segment, self.options, self._dimensions))

    def _receive_quick(self, answer: Answer) -> None:
        self.ready.set()
        if answer.problem:
            self._notify(answer.problem)
        if isinstance(answer.found, QuickMap) and self._is_current(answer.number):
            self.quick = answer.found
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
        errors = Errors(self._clock(), found.verdict.expected_error, found.error_against_truth)
        self.curve = [*_thinned(self.curve), errors]
        if self.options.dimensions == AUTO and found.sensor_map is not None:
            self._choose(found.sensor_map.dimensions)
        self._announce()
        if found.final:
            self._finished.set()

    def _choose(self, dimensions: int) -> None:
        """Show quick maps in the number of dimensions that checked maps choose.

        It is changed when two checked maps in a row agree; the first time, one suffices if nearly
        all sensors were touched.
        """
        before = None if self._previous is None else self._previous.sensor_map
        agree = before is not None and before.dimensions == dimensions
        first = not self._has_changed and self.share_touched >= _NEARLY_ALL
        if self.quick is None or dimensions == self.quick.positions.shape[1]:
            return
        if agree or first:
            self._has_changed = True
            self._notify(f"{_REASONS[dimensions]}: maps have {dimensions} dimensions from now on")
            self._dimensions = dimensions
            self._map_quickly()

    def _is_current(self, number: int) -> bool:
        return self._segment is not None and number == self._segment.number


def _thinned(curve: Sequence[_Point]) -> list[_Point]:
    """Return the points of a curve, every other one if there are `MAX_CURVE` or more."""
    return list(curve[::2] if len(curve) >= MAX_CURVE else curve)
