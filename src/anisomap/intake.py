"""Conversion of objects of other libraries to readings, names, times and a rate.

pandas: columns are sensors, except for a column of times; an index of dates gives times. xarray:
the names of dimensions and their coordinates give times and names. mne: the channels of a raw
recording, without triggers and channels marked as bad.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.base.clocks import is_time, seconds
from anisomap.base.columns import examine, frames_of, names_of_frame
from anisomap.base.wording import join_items
from anisomap.errors import AnisomapWarning, InputError
from anisomap.numerics.ranges import POSITIVE

_CHANNELS = ("eeg", "mag", "grad", "seeg", "ecog", "dbs", "emg", "hbo", "hbr", "csd")
"""Types of mne channels that are sensors."""

# Chosen by hand: times or the bin width are wrong if fewer than one bin in a thousand contains an
# event. Short recordings may have more empty bins.
_MAX_BINS_PER_EVENT, _MIN_REFUSED_BINS = 1000, 1 << 16
_EDGE_DECIMALS = 6  # in widths of a bin: decimal times on its edge are not exact in binary


@dataclass(frozen=True, eq=False)
class Taken:
    """Readings, (T, N), and names, times in seconds and a rate, if the object contains them."""

    readings: NDArray[np.floating]
    names: tuple[str, ...] = ()
    times: NDArray[np.float64] | None = None
    rate_hz: float | None = None
    metadata: Mapping[str, str] = field(default_factory=dict)  # as from a file of the same content


def take(values: Any) -> Taken:
    """Convert an object of another library; all other objects are converted to arrays first."""
    if hasattr(values, "positions"):  # coordinates of a map would be read as three sensors
        raise InputError(f"a recording is required here, got a map ({type(values).__name__})")
    if hasattr(values, "get_data") and hasattr(values, "ch_names"):
        return _of_mne(values)
    if hasattr(values, "dims") and hasattr(values, "coords"):
        return _of_xarray(values)
    if hasattr(values, "columns") and hasattr(values, "iloc"):
        return _of_frame(values)
    return _of_array(as_array(values))


def take_events(
    times: ArrayLike, sensors: ArrayLike, bin_width: float | None, names: Sequence[str] | None
) -> Taken:
    """Make frames from times, (E,), and active sensors: see `Recording.from_events`."""
    at, active = np.asarray(times, dtype=np.float64), np.asarray(sensors)
    if at.ndim != 1 or at.shape != active.shape or not at.size or active.dtype.kind not in "iuU":
        raise InputError(
            "times must be a list of numbers, and sensors a list of as many names or indices, got "
            f"the shapes {at.shape} and {active.shape}, and sensors of type {active.dtype}"
        )
    if not np.isfinite(at).all():
        raise InputError(f"the time of event {int(np.argmin(np.isfinite(at)))} is not finite")
    found, columns = np.unique(active, return_inverse=True)
    indexed = active.dtype.kind != "U"
    listed = tuple(f"s{each}" if indexed else str(each) for each in found.tolist())
    if names is not None:
        listed = tuple(map(str, names))
        place = {each: i for i, each in enumerate(range(len(listed)) if indexed else listed)}
        unknown = [each for each in found.tolist() if each not in place]
        if unknown:
            raise InputError(f"there is no sensor {unknown[0]!r} among the {len(listed)} names")
        columns = np.array([place[each] for each in found.tolist()])[columns]
    if bin_width is None:
        moments, frames = np.unique(at, return_inverse=True)
        readings = np.zeros((len(moments), len(listed)), np.float32)
        readings[frames, columns] = 1
        return Taken(readings, listed, moments)
    POSITIVE.check("bin_width", bin_width, "s")
    places = np.round((at - at.min()) / bin_width, _EDGE_DECIMALS)
    n_bins = np.floor(places.max()) + 1
    if n_bins > max(_MIN_REFUSED_BINS, _MAX_BINS_PER_EVENT * len(at)):
        raise InputError(f"{len(at)} events would fill {n_bins:g} bins; choose wider bins")
    readings = np.zeros((int(n_bins), len(listed)), np.float32)
    np.add.at(readings, (places.astype(np.intp), columns), 1)
    return Taken(readings, listed, rate_hz=1 / bin_width)


def as_array(values: Any) -> NDArray[Any]:
    """Convert to an array of real numbers; masked values become NaN."""
    if np.ma.is_masked(values) and values.dtype.kind in "biuf":
        values = values.astype(np.result_type(values.dtype, np.float16)).filled(np.nan)
    try:
        array = np.asarray(values)
    except ValueError:
        raise InputError("readings must be (T, N), got rows of different lengths") from None
    if array.dtype.kind not in "biuf":
        raise InputError(f"readings must be real numbers, got {array.dtype}")
    return array


def _of_array(array: NDArray[Any]) -> Taken:
    """Convert an array to frames; with more than two axes, the longest axis is time."""
    if array.ndim == 2:
        return Taken(_floats(array))
    frames = frames_of(array.shape)
    if frames is None:
        expected = "(T, N) (frames x sensors), or have time, its longest axis, first or last"
        raise InputError(f"readings must be of shape {expected}; got shape {array.shape}")
    _say(f"readings of shape {array.shape}: {frames.said}")
    rows = np.moveaxis(array, frames.time, 0).reshape(-1, frames.n_sensors)
    return _sensors(rows, frames.names)


def _sensors(readings: NDArray[Any], names: Sequence[str]) -> Taken:
    """Leave out columns that are no sensors, and take z of taxels with three axes."""
    names, others, taxels, said = examine(names, readings[:1000])
    for text in said.values():
        _say(text)
    kept = [i for i in range(readings.shape[1]) if i not in others]
    own = tuple(names[i] for i in kept) if names else ()
    if taxels:
        kept, own = taxels.kept(names, others)
    whole = len(kept) == readings.shape[1]
    return Taken(_floats(readings if whole else readings[:, kept]), own)


def _of_frame(frame: Any) -> Taken:
    names = [str(name) for name in frame.columns]
    clock = next((i for i, name in enumerate(names) if is_time(name, i)), None)
    times, doubt = None, ""
    index = np.asarray(frame.index)
    if clock is not None:
        times, doubt = seconds(frame.iloc[:, clock], names[clock])
    elif index.dtype.kind in "mM" or is_time(str(getattr(frame.index, "name", None) or "")):
        times, doubt = seconds(index, str(frame.index.name))
    if doubt:
        _say(f"{'index' if clock is None else 'column ' + names[clock]}: {doubt}")
    columns = [i for i in range(len(names)) if i != clock]
    if texts := [names[i] for i in columns if frame.dtypes.iloc[i].kind not in "biuf"]:
        raise InputError(
            f"these columns hold no numbers: {join_items(texts)}", f"use .drop(columns={texts[:9]})"
        )
    chosen = frame.iloc[:, columns]
    mixed = len({dtype.kind for dtype in chosen.dtypes}) > 1  # NumPy would make objects of them
    values = as_array(chosen.astype(np.float64) if mixed else chosen)
    taken = _sensors(values, [names[i] for i in columns])
    return Taken(taken.readings, taken.names, times)


def _of_xarray(array: Any) -> Taken:
    dims = [str(dim) for dim in array.dims]
    clock = next((i for i, dim in enumerate(dims) if is_time(dim) or dim == "frame"), None)
    if clock is None or len(dims) == 1:
        return _of_array(as_array(array.values))
    if clock != 0:
        others = ", ".join(repr(dim) for i, dim in enumerate(dims) if i != clock)
        raise InputError(
            f"the dimensions are {tuple(dims)}, but time must be first: use "
            f".transpose({dims[clock]!r}, {others})"
        )
    times, doubt = None, ""
    if dims[0] in array.coords:
        times, doubt = seconds(np.asarray(array.coords[dims[0]]), dims[0])
    if doubt:
        _say(doubt)
    values = as_array(array.values)
    if len(dims) == 2:
        labels = array.coords.get(dims[1], ())
        names: Sequence[str] = [str(label) for label in np.asarray(labels)]
    else:
        names = names_of_frame(values.shape[1:])
    taken = _sensors(values.reshape(len(values), -1), names)
    return Taken(taken.readings, taken.names, times)


def _of_mne(raw: Any) -> Taken:
    counts = Counter(kind for kind in raw.get_channel_types() if kind in _CHANNELS)
    if len(counts) != 1:
        raise InputError(
            f"the recording has channels of {join_items(list(counts)) or 'no sensor'}; choose one "
            "type, as in raw.copy().pick('eeg')"
        )
    (kind,) = counts
    of_kind = [i for i, own in enumerate(raw.get_channel_types()) if own == kind]
    picked = [i for i in of_kind if raw.ch_names[i] not in raw.info["bads"]]
    left_out = [raw.ch_names[i] for i in of_kind if i not in picked]
    if not picked:
        raise InputError(f"all channels of type {kind} are marked as bad")
    if left_out:
        _say(f"channels marked as bad are left out: {join_items(left_out)}")
    readings = np.ascontiguousarray(raw.get_data(picks=picked, verbose="ERROR").T)
    names = tuple(raw.ch_names[i] for i in picked)
    told = {"format": "mne", "channels": kind}
    return Taken(readings, names, rate_hz=float(raw.info["sfreq"]), metadata=told)


def _floats(array: NDArray[Any]) -> NDArray[np.floating]:
    """Return read-only readings, as float32 if this is exact for their type."""
    if 0 in array.shape:
        raise InputError(f"readings must not be empty, got shape {array.shape}")
    fits_float32 = array.dtype in (np.float16, np.float32) or (
        array.dtype.kind in "biu" and array.dtype.itemsize <= 2
    )
    dtype = np.float32 if fits_float32 else np.float64
    if array.dtype == dtype and array.base is None and not array.flags.writeable:
        return array  # already immutable: do not copy a large recording
    return np.array(array, dtype=dtype)


def times_of(times: ArrayLike, n_frames: int) -> NDArray[np.float64]:
    """Return increasing times in seconds, (T,); dates start at 0."""
    try:
        values, _ = seconds(times)
    except (TypeError, ValueError):
        raise InputError("times must be seconds, or dates with a time") from None
    values = np.array(values)
    if values.shape != (n_frames,):
        raise InputError(f"times must be of shape ({n_frames},), got {values.shape}")
    if not np.isfinite(values).all():
        raise InputError(f"the time of frame {int(np.argmin(np.isfinite(values)))} is not finite")
    steps = np.diff(values)
    if (steps <= 0).any():
        frame = int(np.argmax(steps <= 0)) + 1
        raise InputError(f"times must increase, but do not at frame {frame}, {values[frame]:g} s")
    return values


def _say(text: str) -> None:
    warnings.warn(text, AnisomapWarning, stacklevel=6)
