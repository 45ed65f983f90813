"""Faults as they are asked for in a line of text."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from anisomap.errors import InputError
from anisomap.recording import Recording
from anisomap.simulation.faults.log import ALL_SENSORS
from anisomap.simulation.faults.sensors import (
    Randomness,
    dead,
    drifting,
    gain_spread,
    hysteresis,
    nan_bursts,
    noisy,
    quantised,
    saturating,
    stuck,
    thresholded,
)
from anisomap.simulation.faults.timing import clock_jitter, dropped_frames, repeated_frames
from anisomap.simulation.faults.wiring import crosstalk, duplicated, mirrored, swapped

FAULTS: Mapping[str, Callable[..., Recording]] = MappingProxyType(
    {
        "dead": dead,
        "stuck": stuck,
        "saturating": saturating,
        "noisy": noisy,
        "drifting": drifting,
        "gain-spread": gain_spread,
        "hysteresis": hysteresis,
        "quantised": quantised,
        "thresholded": thresholded,
        "nan-bursts": nan_bursts,
        "crosstalk": crosstalk,
        "swapped": swapped,
        "mirrored": mirrored,
        "duplicated": duplicated,
    }
)
"""Each takes a recording, sensors, and ``rng``; its other parameters have defaults."""

FRAME_FAULTS: Mapping[str, Callable[..., Recording]] = MappingProxyType(
    {
        "dropped-frames": dropped_frames,
        "repeated-frames": repeated_frames,
        "clock-jitter": clock_jitter,
    }
)
"""Each takes a recording and ``rng``; it befalls all sensors."""


@dataclass(frozen=True)
class FaultRequest:
    """A fault to be inflicted.

    Attributes
    ----------
    kind : str
        A name in `FAULTS` or `FRAME_FAULTS`.
    sensors : tuple of str
        Names, indices, ``*`` for all, ``10%`` for as many at random; empty for frames.
    parameters : tuple of (str, float)
        Those that are not to have their defaults.
    """

    kind: str
    sensors: tuple[str, ...]
    parameters: tuple[tuple[str, float], ...] = ()

    def inject(self, recording: Recording, rng: Randomness) -> Recording:
        """Do it to a recording.

        Raises
        ------
        InputError
            If it cannot be done to this recording.
        """
        generator = np.random.default_rng(rng)
        parameters = dict(self.parameters)
        if self.kind in FRAME_FAULTS:
            return FRAME_FAULTS[self.kind](recording, rng=generator, **parameters)
        chosen = _resolve(self.sensors, recording, generator)
        return FAULTS[self.kind](recording, chosen, rng=generator, **parameters)


def parse_fault(text: str) -> FaultRequest:
    """Read a fault from a line such as ``saturating:s3,s7,level=1`` or ``dead:10%``.

    Parameters
    ----------
    text : str
        The kind; after a colon and between commas, sensors and parameters.

    Returns
    -------
    FaultRequest

    Raises
    ------
    InputError
        If there is no such fault or parameter, a value is no number, or sensors are missing.
    """
    kind, _, rest = text.partition(":")
    kind = kind.strip()
    known = {**FAULTS, **FRAME_FAULTS}
    if kind not in known:
        raise InputError(f"there is no fault {kind!r}; choose from {', '.join(known)}")
    items = [item.strip() for item in rest.split(",") if item.strip()]
    sensors = tuple(item for item in items if "=" not in item)
    parameters = tuple(_parameter(kind, known[kind], item) for item in items if "=" in item)
    if kind in FRAME_FAULTS and sensors:
        raise InputError(f"{kind} befalls all sensors; leave {', '.join(sensors)} out")
    if kind in FAULTS and not sensors:
        raise InputError(
            f"the fault {kind} needs sensors: {kind}:NAME,NAME or {kind}:10% or {kind}:*"
        )
    return FaultRequest(kind, sensors, parameters)


def inject(
    recording: Recording, requests: Iterable[FaultRequest], rng: Randomness = 0
) -> Recording:
    """Do several faults to a recording, one after the other.

    Parameters
    ----------
    recording : Recording
    requests : iterable of FaultRequest
    rng : numpy.random.Generator or int

    Returns
    -------
    Recording
    """
    generator = np.random.default_rng(rng)
    for request in requests:
        recording = request.inject(recording, generator)
    return recording


def _parameter(kind: str, function: Callable[..., Recording], item: str) -> tuple[str, float]:
    name, _, value = (part.strip() for part in item.partition("="))
    name = name.replace("-", "_")
    known = [
        other
        for other in inspect.signature(function).parameters
        if other not in ("recording", "sensors", "rng", "source")
    ]
    if name not in known:
        choices = f"choose from {', '.join(known)}" if known else "it has none"
        raise InputError(f"the fault {kind} has no parameter {name!r}; {choices}")
    try:
        return name, int(value) if value.lstrip("+-").isdecimal() else float(value)
    except ValueError as error:
        raise InputError(f"{name} of the fault {kind} is {value!r}, which is no number") from error


def _resolve(sensors: tuple[str, ...], recording: Recording, rng: np.random.Generator) -> list[str]:
    """Turn ``*`` and shares into names; a sensor that bears such a name comes first."""
    chosen: list[str] = []
    for text in sensors:
        if text in recording.names:
            chosen.append(text)
        elif text == ALL_SENSORS:
            chosen += recording.names
        elif text.endswith("%"):
            chosen += _at_random(text, recording, rng)
        else:
            chosen.append(text)
    return chosen


def _at_random(text: str, recording: Recording, rng: np.random.Generator) -> list[str]:
    try:
        share = float(text[:-1]) / 100
    except ValueError:
        share = float("nan")
    if not 0 < share <= 1:
        raise InputError(f"{text!r} is no share of the sensors; write 10% or the like")
    count = max(1, round(share * recording.n_sensors))
    picked = np.sort(rng.choice(recording.n_sensors, size=count, replace=False))
    return [recording.names[i] for i in picked]
