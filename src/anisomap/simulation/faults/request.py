"""Requests for faults written as text."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from anisomap.errors import InputError
from anisomap.recording import Recording
from anisomap.simulation.faults.forms import FAULTS, FRAME_FAULTS, RANGES, Randomness
from anisomap.simulation.faults.log import ALL_SENSORS


@dataclass(frozen=True)
class FaultRequest:
    """A fault to inject.

    Attributes
    ----------
    kind : str
        A name in `FAULTS` or `FRAME_FAULTS`.
    sensors : tuple of str
        Names, indices, ``*`` for all, or ``10%`` for a random share; empty for frame faults.
    parameters : tuple of (str, float)
        Parameters that replace their defaults.
    """

    kind: str
    sensors: tuple[str, ...]
    parameters: tuple[tuple[str, float], ...] = ()

    def inject(self, recording: Recording, rng: Randomness) -> Recording:
        """Inject the fault into a recording."""
        generator = np.random.default_rng(rng)
        parameters = dict(self.parameters)
        if self.kind in FRAME_FAULTS:
            return FRAME_FAULTS[self.kind](recording, rng=generator, **parameters)
        chosen = _resolve(self.sensors, recording, generator)
        return FAULTS[self.kind](recording, chosen, rng=generator, **parameters)


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
    parameters = tuple(_parse_parameter(kind, item) for item in items if "=" in item)
    if kind in FRAME_FAULTS and chosen:
        raise InputError(f"the fault {kind} affects all sensors; leave out {', '.join(chosen)}")
    if kind in FAULTS and not chosen:
        raise InputError(
            f"the fault {kind} needs sensors: {kind}:NAME,NAME or {kind}:10% or {kind}:*"
        )
    return FaultRequest(kind, chosen, parameters)


def inject(
    recording: Recording, requests: Iterable[FaultRequest], rng: Randomness = 0
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
    for request in requests:
        recording = request.inject(recording, generator)
    return recording


def _parse_parameter(kind: str, item: str) -> tuple[str, float]:
    name, _, value = (part.strip() for part in item.partition("="))
    name = name.replace("-", "_")
    if name not in RANGES[kind]:
        choices = (
            f"choose from {', '.join(RANGES[kind])}" if RANGES[kind] else "it has no parameters"
        )
        raise InputError(f"the fault {kind} has no parameter {name!r}; {choices}")
    try:
        return name, int(value) if value.lstrip("+-").isdecimal() else float(value)
    except ValueError as error:
        raise InputError(
            f"parameter {name} of the fault {kind} must be a number, got {value!r}"
        ) from error


def _resolve(chosen: tuple[str, ...], recording: Recording, rng: np.random.Generator) -> list[str]:
    """Expand ``*`` and shares to names. A sensor with such a name takes precedence."""
    names: list[str] = []
    for text in chosen:
        if text in recording.names:
            names.append(text)
        elif text == ALL_SENSORS:
            names += recording.names
        elif text.endswith("%"):
            names += _draw_share(text, recording, rng)
        else:
            names.append(text)
    return names


def _draw_share(text: str, recording: Recording, rng: np.random.Generator) -> list[str]:
    try:
        share = float(text[:-1]) / 100
    except ValueError:
        share = float("nan")
    if not 0 < share <= 1:
        raise InputError(f"a share of the sensors must be above 0% and at most 100%, got {text!r}")
    count = max(1, round(share * recording.n_sensors))
    picked = np.sort(rng.choice(recording.n_sensors, size=count, replace=False))
    return [recording.names[i] for i in picked]
