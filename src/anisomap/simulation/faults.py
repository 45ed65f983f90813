"""What goes wrong with real sensors, done to any recording: composable, seeded, and on the record.

To add a fault, add one function and one line to `FAULTS`. Each takes a recording and the sensors
to spoil, gives a new recording, and writes what it did into the metadata, so that whatever looks
for faults can be scored (`inflicted_faults`, `fault_mask`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.numerics.activity import estimate_rest
from anisomap.recording import Recording
from anisomap.simulation.checks import check_positive

RECORD = "faults"
"""Key of the metadata that holds, as JSON, what was done."""

Column: TypeAlias = NDArray[np.floating]
Spans: TypeAlias = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Fault:
    """What was done to one sensor.

    Attributes
    ----------
    kind : str
        A name in `FAULTS`.
    sensor : str
        Its name.
    spans : tuple of (int, int)
        Frames that it may have changed: from the first number up to, not including, the second.
    """

    kind: str
    sensor: str
    spans: Spans


def dead(
    recording: Recording, sensors: Iterable[str | int], *, rng: np.random.Generator | int = 0
) -> Recording:
    """Make sensors read their rest value always.

    Parameters
    ----------
    recording : Recording
    sensors : iterable of str or int
        Names or indices.
    rng : numpy.random.Generator or int
        Nothing here is random; taken so that all faults are called alike.

    Returns
    -------
    Recording
        Rest is each sensor's most frequent reading, see `anisomap.numerics.activity.Rest`.
    """

    def silence(column: Column) -> tuple[Column, Spans]:
        filled = Recording(column[:, None]).complete("interpolate").readings
        return np.full_like(column, estimate_rest(filled).value[0]), _throughout(column)

    return _inflict(recording, "dead", sensors, silence)


def saturating(
    recording: Recording,
    sensors: Iterable[str | int],
    *,
    rng: np.random.Generator | int = 0,
    level: float | None = None,
    mean_gap: float = 100.0,
    mean_span: float = 20.0,
) -> Recording:
    """Make sensors jump to full scale now and then, touched or not: the paper's sensor 30.

    Parameters
    ----------
    recording : Recording
    sensors : iterable of str or int
        Names or indices.
    rng : numpy.random.Generator or int
        Decides when, or the seed of what does.
    level : float, optional
        Full scale, in the unit of the readings; the recording's highest reading unless given.
    mean_gap, mean_span : float
        How many frames, at least 1, pass on average between two jumps, and how many each lasts.
        Both are geometric: a sensor forgets how long it has been well or unwell. The paper gives
        no numbers; these keep a sensor saturated a sixth of the time.

    Returns
    -------
    Recording
        One that is short beside `mean_gap` may be spared; its faults' spans are empty then.

    Notes
    -----
    McGregor et al. (2011), section "Prototyping Issues": "a tendency to saturate intermittently
    regardless of whether it was being physically stimulated or not".
    """
    for name, frames in {"mean_gap": mean_gap, "mean_span": mean_span}.items():
        if not (np.isfinite(frames) and frames >= 1):
            raise InputError(f"{name} is {frames:g} frames; it must be at least 1")
    generator = np.random.default_rng(rng)
    full_scale = _highest(recording) if level is None else level

    def jump(column: Column) -> tuple[Column, Spans]:
        spans = _random_spans(column.size, mean_gap, mean_span, generator)
        for start, stop in spans:
            column[start:stop] = full_scale
        return column, spans

    return _inflict(recording, "saturating", sensors, jump)


def noisy(
    recording: Recording,
    sensors: Iterable[str | int],
    *,
    rng: np.random.Generator | int = 0,
    level: float = 0.1,
) -> Recording:
    """Add white noise to sensors.

    Parameters
    ----------
    recording : Recording
    sensors : iterable of str or int
        Names or indices.
    rng : numpy.random.Generator or int
        Source of the noise, or its seed.
    level : float
        Standard deviation of the (normal) noise, as a share of the recording's range.

    Returns
    -------
    Recording
    """
    check_positive("level", level)
    generator = np.random.default_rng(rng)
    spread = level * (_highest(recording) + _highest(recording, sign=-1))

    def disturb(column: Column) -> tuple[Column, Spans]:
        return column + spread * generator.standard_normal(column.size), _throughout(column)

    return _inflict(recording, "noisy", sensors, disturb)


FAULTS: Mapping[str, Callable[..., Recording]] = MappingProxyType(
    {"dead": dead, "saturating": saturating, "noisy": noisy}
)


def inflicted_faults(recording: Recording) -> tuple[Fault, ...]:
    """Tell what was done to a recording by the faults of this module.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    tuple of Fault
        In the order in which they were done; empty if nothing was.

    Raises
    ------
    InputError
        If the metadata's record of it is damaged.
    """
    try:
        entries = json.loads(str(recording.metadata.get(RECORD, "[]")))
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
            f"the metadata {RECORD!r} do not say what was done to which sensor; "
            "they must be the JSON that the faults of anisomap.simulation write"
        ) from error


def fault_mask(recording: Recording, kinds: Sequence[str] = ()) -> NDArray[np.bool_]:
    """Tell which readings were spoilt.

    Parameters
    ----------
    recording : Recording
        With the frames that it had when it was spoilt; sensors may have been left out since.
    kinds : sequence of str
        Which faults to look at; all unless given.

    Returns
    -------
    ndarray of bool, shape (T, N)
    """
    mask = np.zeros(recording.readings.shape, dtype=bool)
    column = {name: i for i, name in enumerate(recording.names)}
    for fault in inflicted_faults(recording):
        if fault.sensor in column and (not kinds or fault.kind in kinds):
            for start, stop in fault.spans:
                mask[start:stop, column[fault.sensor]] = True
    return mask


def _inflict(
    recording: Recording,
    kind: str,
    sensors: Iterable[str | int],
    spoil: Callable[[Column], tuple[Column, Spans]],
) -> Recording:
    readings = np.array(recording.readings)
    done = list(inflicted_faults(recording))
    for i in recording.indices(sensors):
        readings[:, i], spans = spoil(readings[:, i].copy())
        done.append(Fault(kind, recording.names[i], spans))
    record = json.dumps([asdict(fault) for fault in done], separators=(",", ":"))
    return replace(recording, readings=readings, metadata={**recording.metadata, RECORD: record})


def _throughout(column: Column) -> Spans:
    return ((0, column.size),)


def _random_spans(
    n_frames: int, mean_gap: float, mean_span: float, rng: np.random.Generator
) -> Spans:
    # A gap and a span last two frames or more, so that these are enough to fill the recording.
    shape = (n_frames // 2 + 1, 2)
    edges = rng.geometric([1 / mean_gap, 1 / mean_span], size=shape).cumsum().reshape(shape)
    return tuple(
        (int(start), int(min(stop, n_frames))) for start, stop in edges if start < n_frames
    )


def _highest(recording: Recording, sign: int = 1) -> float:
    """Give the highest finite reading, or with `sign` -1 that of the negated readings."""
    readings = sign * recording.readings
    return float(readings.max(where=np.isfinite(readings), initial=-np.inf))
