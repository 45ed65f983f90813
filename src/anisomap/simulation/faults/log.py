"""Log of injected faults in the metadata of a recording: ground truth for fault detection."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.recording import Recording

METADATA_KEY = "faults"
"""Key of the metadata that holds the log as JSON."""

ALL_SENSORS = "*"
"""Name that stands for all sensors."""

Spans: TypeAlias = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Fault:
    """A fault of a sensor or of frames.

    Attributes
    ----------
    kind : str
        A name in `FAULTS` or `FRAME_FAULTS`.
    sensor : str
        Name of the sensor; `ALL_SENSORS` for all; empty if only frames or times are affected, so
        that no reading is wrong.
    spans : tuple of (int, int)
        Affected frames as half-open intervals (start, stop).
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
    column = {name: i for i, name in enumerate(recording.names)}
    for fault in injected_faults(recording):
        if kinds and fault.kind not in kinds:
            continue
        for start, stop in fault.spans:
            if fault.sensor == ALL_SENSORS:
                mask[start:stop] = True
            elif fault.sensor in column:
                mask[start:stop, column[fault.sensor]] = True
    return mask


def with_faults(
    recording: Recording, readings: NDArray[np.floating], faults: Iterable[Fault]
) -> Recording:
    """Replace the readings of a recording and append faults to its log."""
    faulty = replace(recording, readings=readings)
    return with_log(faulty, [*injected_faults(recording), *faults])


def with_log(recording: Recording, faults: Iterable[Fault]) -> Recording:
    """Replace the log of a recording."""
    text = json.dumps([asdict(fault) for fault in faults], separators=(",", ":"))
    return replace(recording, metadata={**recording.metadata, METADATA_KEY: text})


def all_frames(n_frames: int) -> Spans:
    """Return the span of all frames."""
    return ((0, n_frames),)
