"""What was done to a recording, on the record, so that whatever looks for faults can be scored."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.recording import Recording

RECORD = "faults"
"""Key of the metadata that holds, as JSON, what was done."""

ALL_SENSORS = "*"
"""Stands for every sensor."""

Spans: TypeAlias = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Fault:
    """What was done to a sensor, or to frames.

    Attributes
    ----------
    kind : str
        A name in `FAULTS` or `FRAME_FAULTS`.
    sensor : str
        Its name; `ALL_SENSORS` for all of them; empty if no reading is wrong, but its time is.
    spans : tuple of (int, int)
        Frames that it may have changed: from the first number up to, not including, the second.
    """

    kind: str
    sensor: str
    spans: Spans


def injected_faults(recording: Recording) -> tuple[Fault, ...]:
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
    for fault in injected_faults(recording):
        if kinds and fault.kind not in kinds:
            continue
        for start, stop in fault.spans:
            if fault.sensor == ALL_SENSORS:
                mask[start:stop] = True
            elif fault.sensor in column:
                mask[start:stop, column[fault.sensor]] = True
    return mask


def spoilt(
    recording: Recording, readings: NDArray[np.floating], faults: Iterable[Fault]
) -> Recording:
    """Give a recording other readings, and put on the record what was done.

    Parameters
    ----------
    recording : Recording
    readings : ndarray of shape (T, N)
    faults : iterable of Fault
        What was done now; added to what was done before.

    Returns
    -------
    Recording
    """
    return on_record(replace(recording, readings=readings), [*injected_faults(recording), *faults])


def on_record(recording: Recording, faults: Iterable[Fault]) -> Recording:
    """Replace what is on a recording's record of faults."""
    text = json.dumps([asdict(fault) for fault in faults], separators=(",", ":"))
    return replace(recording, metadata={**recording.metadata, RECORD: text})


def random_spans(
    n_frames: int, mean_gap: float, mean_span: float, rng: np.random.Generator
) -> Spans:
    """Draw spans of frames with geometric gaps and lengths: a fault that forgets its age.

    Raises
    ------
    InputError
        If a mean is below 1 frame.
    """
    for name, frames in {"mean_gap": mean_gap, "mean_span": mean_span}.items():
        if not (np.isfinite(frames) and frames >= 1):
            raise InputError(f"{name} is {frames:g} frames; it must be at least 1")
    # A gap and a span last two frames or more, so that these are enough to fill the recording.
    shape = (n_frames // 2 + 1, 2)
    edges = rng.geometric([1 / mean_gap, 1 / mean_span], size=shape).cumsum().reshape(shape)
    return tuple(
        (int(start), int(min(stop, n_frames))) for start, stop in edges if start < n_frames
    )


def throughout(n_frames: int) -> Spans:
    """Give the span of all frames."""
    return ((0, n_frames),)


def value_range(recording: Recording) -> tuple[float, float]:
    """Give the lowest and the highest finite reading; 0 and 0 if there is none."""
    finite = np.isfinite(recording.readings)
    if not finite.any():
        return 0.0, 0.0
    lowest = recording.readings.min(where=finite, initial=np.inf)
    highest = recording.readings.max(where=finite, initial=-np.inf)
    return float(lowest), float(highest)
