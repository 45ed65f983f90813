"""Injection of faults: their forms, their log in the metadata, and requests written as text.

A fault is a function whose name, with hyphens, is its kind. A decorator names the ranges of its
parameters, and enters it in `FAULTS` or `FRAME_FAULTS`.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, wraps
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.numerics.ranges import Range
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.recording import Recording

Readings: TypeAlias = NDArray[np.floating]
Sensors: TypeAlias = Iterable[str | int]
Spans: TypeAlias = tuple[tuple[int, int], ...]
Injector: TypeAlias = Callable[..., Recording]
Effect: TypeAlias = Callable[..., Any]
Given: TypeAlias = dict[str, Any]

METADATA_KEY = "faults"
"""Key of the metadata that holds the log as JSON."""

ALL_SENSORS = "*"
"""Name that stands for all sensors."""

FAULTS: dict[str, Injector] = {}
"""Faults of sensors: functions ``fault(recording, sensors, *, rng=0, **parameters)``.

``sensors`` are names or indices, ``rng`` is a numpy Generator or a seed, and all further parameters
have defaults. They return a new recording with the fault in its log, and raise InputError if a
sensor does not exist, a parameter is outside its range, or the fault does not apply.
"""

FRAME_FAULTS: dict[str, Injector] = {}
"""Faults of whole frames: functions ``fault(recording, *, rng=0, **parameters)``."""

RANGES: dict[str, dict[str, Range]] = {}
"""Ranges of the numeric parameters of each fault."""


@dataclass(frozen=True)
class Fault:
    """A fault of a sensor or of frames.

    kind: A name in `FAULTS` or `FRAME_FAULTS`.
    sensor: Name of the sensor; `ALL_SENSORS` for all; empty if no reading is wrong, but only frames
        or times are affected.
    spans: Affected frames as half-open intervals (start, stop).
    """

    kind: str
    sensor: str
    spans: Spans


def injected_faults(recording: Recording) -> tuple[Fault, ...]:
    """Return the faults logged in the metadata of a recording.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    tuple of Fault
        In the order of injection; empty if there are none.

    Raises
    ------
    InputError
        If the log is damaged.
    """
    try:
        entries = json.loads(str(recording.metadata.get(METADATA_KEY, "[]")))
        return tuple(
            Fault(
                str(entry["kind"]),
                str(entry["sensor"]),
                tuple((int(start), int(stop)) for start, stop in entry["spans"]),
            )
            for entry in entries
        )
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(
            f"the metadata entry {METADATA_KEY!r} is not a valid log of faults; it must be the "
            "JSON written by anisomap.simulation.inject"
        ) from error


def fault_mask(recording: Recording, kinds: Sequence[str] = ()) -> NDArray[np.bool_]:
    """Mark the readings affected by injected faults.

    Parameters
    ----------
    recording : Recording
        With the same frames as after the injection. Sensors may have been removed since.
    kinds : sequence of str
        Kinds of faults to include. Defaults to all.

    Returns
    -------
    ndarray of bool, shape (T, N)

    Raises
    ------
    InputError
        If the log is damaged.
    """
    mask = np.zeros(recording.readings.shape, dtype=bool)
    columns: dict[str, Any] = {name: i for i, name in enumerate(recording.names)}
    columns[ALL_SENSORS] = slice(None)
    for fault in injected_faults(recording):
        if fault.sensor in columns and (not kinds or fault.kind in kinds):
            for span in fault.spans:
                mask[slice(*span), columns[fault.sensor]] = True
    return mask


def logged(
    recording: Recording, new: Iterable[Fault], earlier: Iterable[Fault] | None = None
) -> Recording:
    """Append faults to the log of a recording, or to `earlier` faults instead."""
    known = injected_faults(recording) if earlier is None else earlier
    text = json.dumps([asdict(fault) for fault in (*known, *new)], separators=(",", ":"))
    return replace(recording, metadata={**recording.metadata, METADATA_KEY: text})


@dataclass(frozen=True, eq=False)
class Channel:
    """Readings (T,) of one sensor, which a fault may overwrite; the range of those of all."""

    readings: Readings
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

    def overwritten(
        self, value: float, mean_gap: float, mean_span: float
    ) -> tuple[Readings, Spans]:
        """Set random spans, with geometrically distributed gaps and lengths, to a value."""
        n_frames = self.readings.size
        # A gap and a span take at least two frames together, so this number fills the recording.
        shape = (n_frames // 2 + 1, 2)
        edges = self.rng.geometric([1 / mean_gap, 1 / mean_span], shape).cumsum().reshape(shape)
        spans = np.minimum(edges[edges[:, 0] < n_frames], n_frames).tolist()
        for start, stop in spans:
            self.readings[start:stop] = value
        return self.readings, tuple((start, stop) for start, stop in spans)


@dataclass(frozen=True, eq=False)
class Group:
    """A recording before a fault, sensors of it as given, and a generator."""

    recording: Recording
    sensors: Sensors
    rng: np.random.Generator

    @cached_property
    def readings(self) -> Readings:
        """Readings of all sensors, shape (T, N), which a fault may overwrite."""
        return np.array(self.recording.readings)

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
        readings = self.recording.readings[:, self.chosen].astype(np.float64)
        known = np.isfinite(readings)
        seen = known.any(axis=0)
        deviations = readings[:, seen].std(axis=0, where=known[:, seen])
        varying = deviations[deviations > 0]
        return float(np.median(varying)) if varying.size else 1.0


def finite_range(readings: Readings) -> tuple[float, float]:
    """Return the lowest and the highest finite reading; 0 and 0 if there are none."""
    finite = readings[np.isfinite(readings)]
    return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)


def all_frames(recording: Recording) -> Spans:
    """Return the span of all frames."""
    return ((0, recording.n_frames),)


_RECORDING, _SENSORS = (
    inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    for name in ("recording", "sensors")
)
_RNG = inspect.Parameter("rng", inspect.Parameter.KEYWORD_ONLY, default=0)


def _change_channels(effect: Effect, kind: str, group: Group, parameters: Given) -> Recording:
    recording, readings = group.recording, group.readings
    limits, faults = finite_range(readings), []
    for i in group.chosen:
        found = effect(Channel(readings[:, i].copy(), *limits, group.rng), **parameters)
        changed, spans = found if isinstance(found, tuple) else (found, all_frames(recording))
        readings[:, i] = changed
        faults.append(Fault(kind, recording.names[i], spans))
    return logged(replace(recording, readings=readings), faults)


def _change_group(effect: Effect, kind: str, group: Group, parameters: Given) -> Recording:
    recording, affected = group.recording, effect(group, **parameters)
    chosen = group.chosen if affected is None else affected
    faults = [Fault(kind, recording.names[i], all_frames(recording)) for i in chosen]
    return logged(replace(recording, readings=group.readings), faults)


def _change_frames(effect: Effect, _: str, group: Group, parameters: Given) -> Recording:
    changed: Recording = effect(group.recording, group.rng, **parameters)
    return changed


def _form(
    change: Injector, registry: dict[str, Injector]
) -> Callable[..., Callable[[Effect], Injector]]:
    """Return a decorator that enters functions of one form, given the ranges of parameters."""

    def with_ranges(**ranges: Range) -> Callable[[Effect], Injector]:
        def enter(effect: Effect) -> Injector:
            kind = effect.__name__.replace("_", "-")
            parameters = inspect.signature(effect).parameters.values()
            own = [one for one in parameters if one.kind is one.KEYWORD_ONLY]
            leading = (_RECORDING, _SENSORS, _RNG) if registry is FAULTS else (_RECORDING, _RNG)
            signature = inspect.Signature([*leading, *own])

            @wraps(effect)
            def fault(*args: Any, **kwargs: Any) -> Recording:
                given = signature.bind(*args, **kwargs).arguments
                recording, sensors = given.pop("recording"), given.pop("sensors", ())
                group = Group(recording, sensors, np.random.default_rng(given.pop("rng", 0)))
                for name, value in given.items():
                    if name in ranges and value is not None:
                        ranges[name].check(name, value)
                return change(effect, kind, group, given)

            fault.__signature__ = signature  # type: ignore[attr-defined]
            registry[kind], RANGES[kind] = fault, ranges
            return fault

        return enter

    return with_ranges


sensor_fault = _form(_change_channels, FAULTS)
"""Enter a function of a `Channel` that returns its new readings, and the affected spans if any.

Without spans, all frames are affected.
"""

group_fault = _form(_change_group, FAULTS)
"""Enter a function that overwrites readings of a `Group`; it returns the affected sensors.

Without sensors, all chosen ones are affected.
"""

frame_fault = _form(_change_frames, FRAME_FAULTS)
"""Enter a function of a recording and a generator that returns a recording with a log."""


@dataclass(frozen=True)
class FaultRequest:
    """A fault to inject, and parameters that replace their defaults.

    sensors: Names, indices, ``*`` for all, or ``10%`` for a random share; empty for frame faults.
    """

    kind: str
    sensors: tuple[str, ...]
    parameters: dict[str, float]


def parse_fault(text: str) -> FaultRequest:
    """Parse a fault such as ``saturating:s3,s7,level=1`` or ``dead:10%``.

    Parameters
    ----------
    text : str
        The kind, followed by a colon and a comma-separated list of sensors and parameters.

    Returns
    -------
    FaultRequest

    Raises
    ------
    InputError
        If the kind or a parameter is unknown, a value is not a number, or sensors are missing.
    """
    kind, _, rest = text.partition(":")
    kind = kind.strip()
    if kind not in RANGES:
        raise InputError(f"there is no fault {kind!r}; choose from {', '.join(RANGES)}")
    items = [item.strip() for item in rest.split(",") if item.strip()]
    chosen = tuple(item for item in items if "=" not in item)
    parameters = dict(_parse_parameter(kind, item) for item in items if "=" in item)
    if kind in FRAME_FAULTS and chosen:
        raise InputError(f"the fault {kind} affects all sensors; leave out {', '.join(chosen)}")
    if kind in FAULTS and not chosen:
        raise InputError(
            f"the fault {kind} needs sensors: {kind}:NAME,NAME or {kind}:10% or {kind}:*"
        )
    return FaultRequest(kind, chosen, parameters)


def inject(
    recording: Recording, requests: Iterable[FaultRequest], rng: np.random.Generator | int = 0
) -> Recording:
    """Inject faults into a recording, one after the other.

    Parameters
    ----------
    recording : Recording
    requests : iterable of FaultRequest
    rng : numpy.random.Generator or int

    Returns
    -------
    Recording
        With the faults logged in its metadata; see `injected_faults` and `fault_mask`.

    Raises
    ------
    InputError
        If a sensor does not exist, or a fault does not apply to this recording.
    """
    generator = np.random.default_rng(rng)
    for one in requests:
        if one.kind in FRAME_FAULTS:
            recording = FRAME_FAULTS[one.kind](recording, rng=generator, **one.parameters)
        else:
            chosen = [s for text in one.sensors for s in _resolved(text, recording, generator)]
            recording = FAULTS[one.kind](recording, chosen, rng=generator, **one.parameters)
    return recording


def _parse_parameter(kind: str, item: str) -> tuple[str, float]:
    name, _, value = (part.strip() for part in item.partition("="))
    name = name.replace("-", "_")
    if name not in RANGES[kind]:
        known = ", ".join(RANGES[kind])
        choices = f"choose from {known}" if known else "it has no parameters"
        raise InputError(f"the fault {kind} has no parameter {name!r}; {choices}")
    try:
        return name, int(value) if value.lstrip("+-").isdecimal() else float(value)
    except ValueError as error:
        raise InputError(
            f"parameter {name} of the fault {kind} must be a number, got {value!r}"
        ) from error


def _resolved(text: str, recording: Recording, rng: np.random.Generator) -> Sequence[str]:
    """Expand ``*`` and shares to names. A sensor with such a name takes precedence."""
    if text in recording.names or not (text == ALL_SENSORS or text.endswith("%")):
        return [text]
    if text == ALL_SENSORS:
        return recording.names
    try:
        share = float(text[:-1]) / 100
    except ValueError:
        share = float("nan")
    if not 0 < share <= 1:
        raise InputError(f"a share of the sensors must be above 0% and at most 100%, got {text!r}")
    count = max(1, round(share * recording.n_sensors))
    picked = np.sort(rng.choice(recording.n_sensors, size=count, replace=False))
    return [recording.names[i] for i in picked]
