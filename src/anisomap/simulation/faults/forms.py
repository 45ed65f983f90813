"""Forms of faults: decorators that check parameters, inject a fault, log it and enter it by name.

A fault is a function whose name, with hyphens, is its kind; a decorator names the ranges of its
parameters.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, wraps
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.recording import Recording
from anisomap.simulation.checks import Range
from anisomap.simulation.faults.log import Fault, Spans, all_frames, with_faults

Column: TypeAlias = NDArray[np.floating]
Readings: TypeAlias = NDArray[np.floating]
Sensors: TypeAlias = Iterable[str | int]
Randomness: TypeAlias = np.random.Generator | int
Rewritten: TypeAlias = tuple[Readings, Sequence[int]]
Injector: TypeAlias = Callable[..., Recording]

_OWN, _REST = inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.VAR_KEYWORD

_faults: dict[str, Injector] = {}
_frame_faults: dict[str, Injector] = {}
_ranges: dict[str, Mapping[str, Range]] = {}

FAULTS: Mapping[str, Injector] = MappingProxyType(_faults)
"""Faults of sensors: functions ``fault(recording, sensors, *, rng=0, **parameters)``.

``sensors`` are names or indices, ``rng`` is a numpy Generator or a seed, and all further parameters
have defaults. They return a new recording with the fault in its log, and raise InputError if a
sensor does not exist, a parameter is outside its range, or the fault does not apply.
"""

FRAME_FAULTS: Mapping[str, Injector] = MappingProxyType(_frame_faults)
"""Faults of whole frames: functions ``fault(recording, *, rng=0, **parameters)``."""

RANGES: Mapping[str, Mapping[str, Range]] = MappingProxyType(_ranges)
"""Ranges of the numeric parameters of each fault."""


@dataclass(frozen=True, eq=False)
class Channel:
    """Readings (T,) of one sensor before a fault, which it may overwrite, and a generator.

    lowest, highest: Range of the finite readings of all sensors.
    """

    readings: Column
    lowest: float
    highest: float
    rng: np.random.Generator

    @property
    def span(self) -> float:
        """Width of the range of the recording."""
        return self.highest - self.lowest

    @property
    def rest(self) -> float:
        """Estimated reading at rest. Missing readings are interpolated first."""
        complete = Recording(self.readings[:, None]).complete("interpolate")
        return float(estimate_rest(complete.readings).value[0])

    def draw_spans(self, mean_gap: float, mean_span: float) -> Spans:
        """Draw spans of frames with geometrically distributed gaps and lengths."""
        n_frames = self.readings.size
        # A gap and a span take at least two frames together, so this number fills the recording.
        shape = (n_frames // 2 + 1, 2)
        edges = self.rng.geometric([1 / mean_gap, 1 / mean_span], shape).cumsum().reshape(shape)
        return tuple(
            (int(start), int(min(stop, n_frames))) for start, stop in edges if start < n_frames
        )

    def overwritten(self, value: float, mean_gap: float, mean_span: float) -> tuple[Column, Spans]:
        """Set the readings of random spans to a value."""
        spans = self.draw_spans(mean_gap, mean_span)
        for start, stop in spans:
            self.readings[start:stop] = value
        return self.readings, spans


@dataclass(frozen=True, eq=False)
class Group:
    """A recording before a fault, sensors of it as given, and a generator."""

    recording: Recording
    sensors: Sensors
    rng: np.random.Generator

    @property
    def readings(self) -> Readings:
        """Readings of all sensors, shape (T, N)."""
        return self.recording.readings

    @cached_property
    def chosen(self) -> list[int]:
        """Sorted indices of the sensors."""
        return [int(i) for i in self.recording.indices(self.sensors)]

    def in_order(self) -> list[int]:
        """Look the sensors up in the given order; each must be listed once."""
        found = [int(self.recording.indices([sensor])[0]) for sensor in self.sensors]
        for i in found:
            if found.count(i) > 1:
                name = self.recording.names[i]
                raise InputError(f"sensor {name} is listed twice; list each sensor once")
        return found

    def boards(self, size: int) -> list[list[int]]:
        """Divide the chosen sensors into boards of a size; 0 makes one board of all."""
        step = size or max(1, len(self.chosen))
        return [self.chosen[start : start + step] for start in range(0, len(self.chosen), step)]

    @property
    def deviation(self) -> float:
        """Median standard deviation of the chosen sensors; 1 if none varies."""
        readings = self.readings[:, self.chosen].astype(np.float64)
        known = np.isfinite(readings)
        counts = np.maximum(known.sum(axis=0), 1)
        centred = np.where(known, readings, 0)
        centred -= centred.sum(axis=0) / counts
        deviations = np.sqrt(np.where(known, centred**2, 0).sum(axis=0) / counts)
        varying = deviations[deviations > 0]
        return float(np.median(varying)) if varying.size else 1.0


def finite_range(readings: Readings) -> tuple[float, float]:
    """Return the lowest and the highest finite reading; 0 and 0 if there are none."""
    finite = readings[np.isfinite(readings)]
    return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)


def sensor_fault(
    **ranges: Range,
) -> Callable[[Callable[..., Column | tuple[Column, Spans]]], Injector]:
    """Enter a function of a `Channel` that returns its new readings, and the affected spans if any.

    Without spans, all frames are affected.
    """

    def enter(effect: Callable[..., Column | tuple[Column, Spans]]) -> Injector:
        def fault(
            recording: Recording, sensors: Sensors, *, rng: Randomness = 0, **parameters: Any
        ) -> Recording:
            _check(parameters, ranges)
            generator = np.random.default_rng(rng)
            limits = finite_range(recording.readings)
            readings, faults = np.array(recording.readings), []
            for i in recording.indices(sensors):
                channel = Channel(readings[:, i].copy(), *limits, generator)
                found = effect(channel, **parameters)
                readings[:, i], spans = (
                    found if isinstance(found, tuple) else (found, all_frames(recording.n_frames))
                )
                faults.append(Fault(_kind(effect), recording.names[i], spans))
            return with_faults(recording, readings, faults)

        return _entered(_faults, effect, fault, ranges)

    return enter


def group_fault(
    **ranges: Range,
) -> Callable[[Callable[..., Rewritten]], Injector]:
    """Enter a function of a `Group` that returns readings (T, N) and the affected sensors."""

    def enter(effect: Callable[..., Rewritten]) -> Injector:
        def fault(
            recording: Recording, sensors: Sensors, *, rng: Randomness = 0, **parameters: Any
        ) -> Recording:
            _check(parameters, ranges)
            group = Group(recording, sensors, np.random.default_rng(rng))
            readings, affected = effect(group, **parameters)
            spans = all_frames(recording.n_frames)
            faults = [Fault(_kind(effect), recording.names[i], spans) for i in affected]
            return with_faults(recording, readings, faults)

        return _entered(_faults, effect, fault, ranges)

    return enter


def frame_fault(**ranges: Range) -> Callable[[Callable[..., Recording]], Injector]:
    """Enter a function of a recording and a generator that returns a recording with a log."""

    def enter(effect: Callable[..., Recording]) -> Injector:
        def fault(recording: Recording, *, rng: Randomness = 0, **parameters: Any) -> Recording:
            _check(parameters, ranges)
            return effect(recording, np.random.default_rng(rng), **parameters)

        return _entered(_frame_faults, effect, fault, ranges)

    return enter


def _entered(
    registry: dict[str, Injector],
    effect: Callable[..., Any],
    fault: Injector,
    ranges: Mapping[str, Range],
) -> Injector:
    """Enter a fault with the documentation and the parameters of its effect."""
    own = [one for one in inspect.signature(effect).parameters.values() if one.kind is _OWN]
    common = inspect.signature(fault)
    leading = [one for one in common.parameters.values() if one.kind is not _REST]
    wrapped = wraps(effect)(fault)
    wrapped.__signature__ = common.replace(  # type: ignore[attr-defined]
        parameters=[*leading, *own]
    )
    registry[_kind(effect)] = wrapped
    _ranges[_kind(effect)] = ranges
    return wrapped


def _kind(effect: Callable[..., Any]) -> str:
    return effect.__name__.replace("_", "-")


def _check(parameters: Mapping[str, Any], ranges: Mapping[str, Range]) -> None:
    for name, value in parameters.items():
        if name in ranges and value is not None:
            ranges[name].check(name, value)
