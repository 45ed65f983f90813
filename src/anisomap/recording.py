"""A recording: the readings of all sensors of a skin in all frames. Immutable."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.base.immutable import Immutable
from anisomap.base.wording import join_items
from anisomap.errors import AnisomapWarning, InputError
from anisomap.intake import take, take_events, times_of
from anisomap.names import check_names, default_names, find_sensors, match_names
from anisomap.numerics.columns import fill_gaps
from anisomap.numerics.levelling import offsets, steps_of_rest
from anisomap.numerics.ranges import POSITIVE
from anisomap.numerics.signals import Signals

Scalar: TypeAlias = str | int | float | bool
"""Values of metadata and provenance: types that every file format can store."""

MAX_READING = 1e30
"""Maximum magnitude of a reading; greater readings are missing. Sums of readings are then finite in
float32, and sums of squares in float64."""

_FRAMES_AT_ONCE = 4096  # compared at a time; most recordings differ in the first ones

MissingPolicy: TypeAlias = Literal["error", "drop-frames", "interpolate"]
"""Handling of missing readings: see `Recording.complete`."""


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Immutable):
    """Readings of N sensors over T frames, with metadata.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        One row per frame, one column per sensor. Real numbers; NaN and infinities mark missing
        readings (see `complete`). Stored as float32 if that is lossless, else as float64. Frames
        may be matrices: the longest axis is time. Objects of pandas, xarray and mne also provide
        names and times.
    names : sequence of str, optional
        Unique names, one per sensor; by default the names in the object, or ``s0, s1, ...``.
    times : array_like of shape (T,), optional
        Seconds, or dates with a time; strictly increasing.
    rate_hz : float, optional
        Frames per second; computed from `times` if these are given.
    positions : array_like of shape (N, 2) or (N, 3), optional
        True positions, if known. Only scores and figures use them.
    normals : array_like of shape (N, 3), optional
        Outward unit normals of the skin, if known.
    surface_distances : array_like of shape (N, N), optional
        Geodesic distances along the skin in the unit of `positions`, if known; inf between
        disconnected parts.
    units : str
        Unit of `positions`, such as ``"mm"``; empty if unknown.
    source : str
        Origin of the recording: a file name, a simulation.
    metadata : mapping of str to str, int, float or bool
        Facts such as licence, scenario and seed.
    starts : tuple of int
        First frames of all joined recordings but the first, if some recordings lack sensors (whose
        readings are then NaN): see `join_runs`.

    Raises
    ------
    InputError
        If shapes disagree, readings are not real numbers, names are not unique, or times or starts
        do not increase.
    """

    readings: NDArray[np.floating]
    names: tuple[str, ...] = ()
    times: NDArray[np.float64] | None = None
    rate_hz: float | None = None
    positions: NDArray[np.float64] | None = None
    normals: NDArray[np.float64] | None = None
    surface_distances: NDArray[np.float64] | None = None
    units: str = ""
    source: str = ""
    metadata: Mapping[str, Scalar] = field(default_factory=dict)
    starts: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        taken = take(self.readings)
        readings = taken.readings
        n_frames, n_sensors = readings.shape
        names = tuple(map(str, self.names)) or taken.names or default_names(n_sensors)
        check_names(names, n_sensors)
        times = taken.times if self.times is None else self.times
        rate_hz = taken.rate_hz if self.rate_hz is None else self.rate_hz
        if times is not None:
            times = times_of(times, n_frames)
            rate_hz = float(1 / np.median(np.diff(times))) if n_frames > 1 else rate_hz
        if rate_hz is not None:
            POSITIVE.check("rate_hz", rate_hz)
        if not all(a < b for a, b in pairwise((0, *self.starts, n_frames))):
            raise InputError(f"starts must increase from 0 to {n_frames} frames: {self.starts}")
        _check_facts({"units": self.units, "source": self.source}, self.metadata)
        truth = {
            "positions": ((n_sensors, 2), (n_sensors, 3)),
            "normals": ((n_sensors, 3),),
            "surface_distances": ((n_sensors, n_sensors),),
        }
        known = {
            name: np.array(getattr(self, name), dtype=np.float64)
            for name in truth
            if getattr(self, name) is not None
        }
        for name, array in known.items():
            if array.shape not in truth[name]:
                shapes = " or ".join(map(str, truth[name]))
                raise InputError(f"{name} must be of shape {shapes}, got {array.shape}")
            if name != "surface_distances" and np.isinf(array).any():
                raise InputError(f"{name} must be finite, or NaN where they are unknown")
        told = {**taken.metadata, **self.metadata}
        self.set_fields(
            readings=readings, names=names, times=times, rate_hz=rate_hz, metadata=told, **known
        )

    @classmethod
    def from_events(
        cls,
        times: ArrayLike,
        sensors: ArrayLike,
        bin_width: float | None = None,
        names: Sequence[str] | None = None,
    ) -> Recording:
        """Make a recording of contacts or spikes.

        Parameters
        ----------
        times : array_like of shape (E,)
            Time of each event, in seconds.
        sensors : array_like of shape (E,)
            Name or index of the active sensor of each event.
        bin_width : float, optional
            Width in seconds of the bins in which events are counted, from the first event on. By
            default, events at the same time form a frame, in which active sensors read 1.
        names : sequence of str, optional
            Names of all sensors, including sensors that were never active. By default, the names of
            active sensors.

        Returns
        -------
        Recording

        Raises
        ------
        InputError
            If a sensor is not among the names, a time is not finite, or bins are far too narrow.

        Examples
        --------
        >>> names = ("palm", "wrist", "thumb")
        >>> touches = Recording.from_events([0, 0, 0.5], [2, 0, 2], names=names)
        >>> touches.readings.tolist()
        [[1.0, 0.0, 1.0], [0.0, 0.0, 1.0]]
        """
        taken = take_events(times, sensors, bin_width, names)
        return cls(taken.readings, taken.names, taken.times, taken.rate_hz)

    def __repr__(self) -> str:
        details = [f"frames={self.n_frames}", f"sensors={self.n_sensors}"]
        if self.rate_hz is not None:
            details.append(f"{self.rate_hz:g} Hz")
        if self.positions is not None:
            details.append("with positions")
        if self.source:
            details.append(f"source={self.source!r}")
        return f"<Recording: {', '.join(details)}>"

    @property
    def touched(self) -> bool:
        """Whether sensors are touched; electrodes of recordings read by MNE are not."""
        return self.metadata.get("format") != "mne"

    @property
    def n_frames(self) -> int:
        """Number of frames, T."""
        return int(self.readings.shape[0])

    @property
    def n_sensors(self) -> int:
        """Number of sensors, N."""
        return int(self.readings.shape[1])

    @property
    def duration(self) -> float | None:
        """Time from the first frame to the last in seconds, if times or a rate are known."""
        if self.times is not None:
            return float(self.times[-1] - self.times[0])
        return None if self.rate_hz is None else (self.n_frames - 1) / self.rate_hz

    @cached_property
    def extremes(self) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Lowest and highest reading of each sensor, shape (N,).

        At least one of them is NaN or infinite if readings of the sensor are missing.
        """
        found = self.readings.min(axis=0), self.readings.max(axis=0)
        for array in found:
            array.setflags(write=False)
        return found

    @cached_property
    def on_off(self) -> bool:
        """Whether every sensor takes at most two values; requires complete readings."""
        lowest, highest = self.extremes
        return all(
            bool(((part == lowest) | (part == highest)).all())
            for part in np.array_split(self.readings, max(1, self.n_frames // _FRAMES_AT_ONCE))
        )

    @cached_property
    def signals(self) -> Signals:
        """Levels, rest and contacts of the sensors; requires complete readings."""
        return Signals(self.readings)

    @cached_property
    def parts(self) -> tuple[Recording, ...]:
        """The joined recordings, if some of them lack sensors; otherwise this recording alone."""
        if not self.starts:
            return (self,)
        runs = np.split(self.readings, self.starts)
        known = np.stack([np.isfinite(run).any(axis=0) for run in runs])
        known |= ~known.any(axis=0)
        if known[known.any(axis=1)].all():  # runs lack all or none of the selected sensors
            whole = np.repeat(known.any(axis=1), [len(run) for run in runs])
            return (replace(self, readings=self.readings[whole], starts=()),)
        return tuple(
            replace(self, readings=run, starts=()).select(has)
            for run, has in zip(runs, known, strict=True)
            if has.any()
        )

    def varying(self) -> NDArray[np.bool_]:
        """Find the sensors that vary.

        Returns
        -------
        ndarray of bool, shape (N,)
            False for sensors without finite readings, or whose finite readings are equal.
        """
        lowest, highest = self.extremes
        known = np.isfinite(lowest) & np.isfinite(highest)
        if not known.all():  # minimum and maximum propagate NaN and infinities
            missing = ~np.isfinite(self.readings)
            lowest = np.where(missing, np.inf, self.readings).min(axis=0)
            highest = np.where(missing, -np.inf, self.readings).max(axis=0)
        return np.asarray(highest > lowest)

    @cached_property
    def levelled(self) -> Recording:
        """The recording with a constant level at rest: frames after a step are shifted.

        Warns if most sensors step, as in joined sessions with different zeros.
        """
        steps = steps_of_rest(self.readings)
        if not steps:
            return self
        warnings.warn(
            "the level at rest of most sensors jumps; the readings are taken relative to the level "
            f"of each part; frames of jumps: {join_items(steps, 5)}",
            AnisomapWarning,
            stacklevel=2,
        )
        every = np.arange(self.n_sensors)
        parts = np.split(self.readings, steps)
        shifts = offsets(parts, [every] * len(parts))
        shifted = [
            part if by is None else part - by for part, by in zip(parts, shifts, strict=True)
        ]
        return replace(self, readings=np.concatenate(shifted))

    def indices(self, sensors: Iterable[str | int]) -> NDArray[np.intp]:
        """Look sensors up by name or index.

        Parameters
        ----------
        sensors : iterable of str or int
            Names or zero-based indices. A decimal string that is not a name is read as an index.

        Returns
        -------
        ndarray of int
            Sorted unique indices.

        Raises
        ------
        InputError
            If there is no such sensor.
        """
        return find_sensors(self.names, sensors)

    def select(self, sensors: ArrayLike) -> Recording:
        """Keep some sensors.

        Parameters
        ----------
        sensors : array_like
            Indices or a boolean mask, as in numpy indexing.

        Returns
        -------
        Recording
            All frames of the selected sensors; this recording itself if all are selected in order.
        """
        every = np.arange(self.n_sensors)
        chosen = every[np.asarray(sensors)]
        if np.array_equal(chosen, every):
            return self
        distances = self.surface_distances
        return replace(
            self,
            readings=self.readings[:, chosen],
            names=tuple(self.names[i] for i in chosen),
            positions=None if self.positions is None else self.positions[chosen],
            normals=None if self.normals is None else self.normals[chosen],
            surface_distances=None if distances is None else distances[np.ix_(chosen, chosen)],
        )

    def complete(self, missing: MissingPolicy = "error") -> Recording:
        """Handle readings that are NaN, infinite or above `MAX_READING`.

        Parameters
        ----------
        missing : {"error", "drop-frames", "interpolate"}
            Raise; remove every frame with a missing reading; or interpolate each sensor linearly
            in time (at the ends, by the nearest reading). Readings of a sensor without any finite
            reading become zero, so that it is assessed as silent.

        Returns
        -------
        Recording
            All readings are finite, and at most `MAX_READING` in magnitude; this recording itself
            if nothing is missing.

        Raises
        ------
        InputError
            With "error", if a reading is missing; the message names sensors and frames. With
            "drop-frames", if no frame would be left.
        """
        if (np.abs(self.extremes).astype(np.float64) <= MAX_READING).all():
            return self
        if self.starts:
            complete = [part.complete(missing) for part in self.parts]
            changed = any(one is not part for one, part in zip(complete, self.parts, strict=True))
            return join_runs(complete) if changed else self
        absent = ~(np.abs(self.readings).astype(np.float64) <= MAX_READING)
        if missing == "error":
            hint = "handle them first, by Recording.complete with drop-frames or interpolate"
            raise InputError(self._describe_missing(absent), hint)
        if missing == "interpolate":
            return replace(self, readings=fill_gaps(np.where(absent, np.nan, self.readings)))
        if missing != "drop-frames":
            raise InputError(f"missing must be error, drop-frames or interpolate, got {missing!r}")
        silent = absent.all(axis=0)
        whole = ~absent[:, ~silent].any(axis=1)
        if not whole.any():
            raise InputError("every frame has a missing reading; interpolate, or drop sensors")
        kept = np.where(absent, 0, self.readings)[whole]
        times = None if self.times is None else self.times[whole]
        return replace(self, readings=kept, times=times)

    def _describe_missing(self, absent: NDArray[np.bool_]) -> str:
        sensors = [self.names[i] for i in np.flatnonzero(absent.any(axis=0))]
        frames = np.flatnonzero(absent.any(axis=1))
        return (
            f"readings that are NaN or infinite, or above {MAX_READING:g}: {absent.sum():,}; "
            f"sensors: {join_items(sensors, 5)}; frames: {join_items(frames.tolist(), 5)}"
        )


def _check_facts(texts: Mapping[str, object], metadata: Mapping[str, object]) -> None:
    """Check that every file format can store texts and metadata."""
    for name, text in texts.items():
        if not isinstance(text, str):
            raise InputError(f"{name} must be text, got {text!r}")
    for key, value in metadata.items():
        if not isinstance(key, str) or not isinstance(value, Scalar | np.generic):
            raise InputError(f"metadata must be text, numbers or booleans, got {key!r}: {value!r}")


_MAX_RATE_RATIO = 1.02  # of runs that count as having equal frame rates; chosen by hand


def join_runs(
    recording: Recording | ArrayLike | Sequence[Recording], missing: MissingPolicy | None = None
) -> Recording:
    """Join recordings of one skin in time.

    Parameters
    ----------
    recording : Recording, array_like of shape (T, N), or sequence of Recording
        Order and number of sensors may differ between recordings.
    missing : {"error", "drop-frames", "interpolate"}, optional
        Handling of missing readings before joining: see `Recording.complete`.

    Returns
    -------
    Recording
        All sensors, in order of appearance, without times; rate and metadata are kept where all
        recordings agree. Readings of sensors that a recording lacks are NaN; `parts` are then the
        recordings. If the level at rest differs between recordings or steps within one, readings
        are shifted to the first level, with a warning. The given recordings are not changed.

    Raises
    ------
    InputError
        If sensors cannot be matched: recordings share no name, or unnamed ones differ in size.
    """
    if isinstance(recording, str | Path):
        raise InputError(f"read the file first: anisomap.read({str(recording)!r})")
    given: Sequence[Any] = [recording]
    if isinstance(recording, Sequence) and any(isinstance(run, Recording) for run in recording):
        if not all(isinstance(run, Recording) for run in recording):
            raise InputError("a sequence of runs must consist of Recording objects only")
        given = recording
    runs = [run if isinstance(run, Recording) else Recording(run) for run in given]
    if missing is not None:
        runs = [run.complete(missing) for run in runs]
    if len(runs) == 1:
        return runs[0] if runs[0].starts else runs[0].levelled
    runs = _level([part for run in runs for part in run.parts])
    names = tuple(dict.fromkeys(name for run in runs for name in run.names))
    dtype = np.result_type(*(run.readings.dtype for run in runs))
    ends = np.cumsum([run.n_frames for run in runs]).tolist()
    readings = np.full((ends[-1], len(names)), np.nan, dtype)
    for run, end in zip(runs, ends, strict=True):
        readings[end - run.n_frames : end, match_names(run.names, names)] = run.readings
    readings.setflags(write=False)
    rates = [run.rate_hz for run in runs if run.rate_hz is not None]
    agree = len(rates) == len(runs) and max(rates) <= _MAX_RATE_RATIO * min(rates)
    positions, units = _positions(runs, names)
    return Recording(
        readings,
        names=names,
        rate_hz=float(np.median(rates)) if agree else None,
        positions=positions,
        units=units,
        source=" + ".join(dict.fromkeys(run.source for run in runs)),
        metadata={
            **{
                key: value
                for key, value in runs[0].metadata.items()
                if all(run.metadata.get(key) == value for run in runs)
            },
            "runs": len(runs),
        },
        starts=tuple(ends[:-1]) if any(run.n_sensors < len(names) for run in runs) else (),
    )


def _level(runs: Sequence[Recording]) -> list[Recording]:
    """Shift recordings of one skin to the level at rest of the first recording."""
    _check_matching(runs)
    runs = [run.levelled for run in runs]
    number: dict[str, int] = {}
    sensors = [
        np.array([number.setdefault(name, len(number)) for name in run.names]) for run in runs
    ]
    shifts = offsets([run.readings for run in runs], sensors)
    shifted = [i for i, shift in enumerate(shifts) if shift is not None]
    if not shifted:
        return runs
    listed = join_items([runs[i].source or str(i + 1) for i in shifted], 5)
    warnings.warn(
        "the level at rest differs between recordings; the readings are taken relative to the "
        f"level of each recording; recordings that differ from the first one: {listed}",
        AnisomapWarning,
        stacklevel=3,
    )
    return [
        run if shift is None else replace(run, readings=run.readings - shift)
        for run, shift in zip(runs, shifts, strict=True)
    ]


def _check_matching(runs: Sequence[Recording]) -> None:
    unnamed = [run for run in runs if run.names == default_names(run.n_sensors)]
    sizes = {run.n_sensors for run in unnamed}
    if len(sizes) > 1:
        listed = ", ".join(f"{run.source or 'one'} has {run.n_sensors}" for run in unnamed)
        raise InputError(
            "recordings without sensor names must have the same number of sensors, but "
            f"{listed}; give names"
        )
    joined = {*runs[0].names}
    for run in runs[1:]:
        if joined.isdisjoint(run.names):
            raise InputError(
                f"{run.source or 'a recording'} shares no sensor name with the recordings before "
                f"it ({run.names[0]} ... and {runs[0].names[0]} ...); use the same names"
            )
        joined |= {*run.names}


def _positions(
    runs: Sequence[Recording], names: tuple[str, ...]
) -> tuple[NDArray[np.float64] | None, str]:
    """Return true positions if all sensors have one and the runs agree."""
    known: dict[str, NDArray[np.float64]] = {}
    for run in runs:
        if run.positions is None:
            continue
        for name, position in zip(run.names, run.positions, strict=True):
            if not np.array_equal(known.setdefault(name, position), position, equal_nan=True):
                return None, ""
    units = {run.units for run in runs if run.positions is not None}
    if len(known) < len(names) or len(units) != 1:
        return None, ""
    return np.array([known[name] for name in names]), units.pop()
