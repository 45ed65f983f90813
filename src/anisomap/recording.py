"""A recording: what every sensor of a skin read, frame by frame. Immutable."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.gaps import fill_gaps
from anisomap.wording import noun_and_items

Scalar: TypeAlias = str | int | float | bool
"""What provenance is made of: values that every file format can hold."""

MissingPolicy: TypeAlias = Literal["error", "drop-frames", "interpolate"]
"""What to do about readings that are NaN or infinite."""

_Array = TypeVar("_Array", bound=NDArray[np.generic])


@dataclass(frozen=True, eq=False)
class Recording:
    """Readings of N sensors over T frames, with what else is known of them.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        One row a frame, one column a sensor. Real numbers; NaN and infinities stand for readings
        that are missing (see `complete`). Kept as float32 where that loses nothing, else float64.
    names : sequence of str, optional
        One unique name a sensor; ``s0, s1, ...`` unless given.
    times : array_like of shape (T,), optional
        Seconds, strictly increasing.
    rate_hz : float, optional
        Frames a second; taken from `times` where those are given.
    positions : array_like of shape (N, 2) or (N, 3), optional
        Where the sensors truly are, if that is known: only scores and figures use it.
    normals : array_like of shape (N, 3), optional
        Unit vectors that point out of the skin, if known.
    surface_distances : array_like of shape (N, N), optional
        Distances along the skin (geodesic) in the unit of `positions`, if known; inf between parts
        that do not touch.
    units : str
        Unit of `positions`, such as ``"mm"``; empty if unknown.
    source : str
        Where the recording came from: a file name, a simulation.
    metadata : mapping of str to str, int, float or bool
        Whatever else is known: licence, scenario, seed.

    Raises
    ------
    InputError
        If shapes disagree, readings are not real numbers, names are not unique, or times do not
        increase.
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

    def __post_init__(self) -> None:
        readings = _as_readings(self.readings)
        n_frames, n_sensors = readings.shape
        names = tuple(str(name) for name in self.names) or default_names(n_sensors)
        check_names(names, n_sensors)
        times, rate_hz = self.times, self.rate_hz
        if times is not None:
            times = _frozen(np.array(times, dtype=np.float64))
            _check_times(times, n_frames)
            rate_hz = float(1 / np.median(np.diff(times))) if n_frames > 1 else rate_hz
        if rate_hz is not None and not (np.isfinite(rate_hz) and rate_hz > 0):
            raise InputError(
                f"rate_hz is {rate_hz}; it must be a positive number of frames a second"
            )
        truth = {
            "positions": ((n_sensors, 2), (n_sensors, 3)),
            "normals": ((n_sensors, 3),),
            "surface_distances": ((n_sensors, n_sensors),),
        }
        for name, shapes in truth.items():
            if getattr(self, name) is not None:
                array = _frozen(np.array(getattr(self, name), dtype=np.float64))
                _check_shape(name, array, shapes, n_sensors)
                object.__setattr__(self, name, array)
        for name, value in {
            "readings": readings,
            "names": names,
            "times": times,
            "rate_hz": rate_hz,
            "metadata": MappingProxyType(dict(self.metadata)),
        }.items():
            object.__setattr__(self, name, value)

    def __reduce__(self) -> tuple[Callable[..., Recording], tuple[dict[str, object]]]:
        # A read-only view of a mapping cannot be pickled (and so sent to another process) itself.
        return _rebuilt, ({**vars(self), "metadata": dict(self.metadata)},)

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
        """Seconds from the first frame to the last, if times or a rate are known."""
        if self.times is not None:
            return float(self.times[-1] - self.times[0])
        return None if self.rate_hz is None else (self.n_frames - 1) / self.rate_hz

    def varying(self) -> NDArray[np.bool_]:
        """Tell which sensors ever change.

        Returns
        -------
        ndarray of bool, shape (N,)
            False for a sensor whose finite readings are all the same, or that has none.
        """
        lowest, highest = self.readings.min(axis=0), self.readings.max(axis=0)
        known = np.isfinite(lowest) & np.isfinite(highest)
        if not known.all():  # NaN comes out of the one, infinities out of either
            missing = ~np.isfinite(self.readings)
            lowest = np.where(missing, np.inf, self.readings).min(axis=0)
            highest = np.where(missing, -np.inf, self.readings).max(axis=0)
        return np.asarray(highest > lowest)

    def indices(self, sensors: Iterable[str | int]) -> NDArray[np.intp]:
        """Find sensors by name, or else by index.

        Parameters
        ----------
        sensors : iterable of str or int
            Names; a number (or a text that is one and is no sensor's name) is an index from 0.

        Returns
        -------
        ndarray of int
            Sorted indices, each once.

        Raises
        ------
        InputError
            If one is neither a name nor an index of a sensor.
        """
        return find_sensors(self.names, sensors)

    def select(self, sensors: ArrayLike) -> Recording:
        """Keep only some sensors.

        Parameters
        ----------
        sensors : array_like
            Indices or a boolean mask, as numpy takes them.

        Returns
        -------
        Recording
            The same frames of those sensors.
        """
        chosen = np.arange(self.n_sensors)[np.asarray(sensors)]
        apart = self.surface_distances
        return replace(
            self,
            readings=self.readings[:, chosen],
            names=tuple(self.names[i] for i in chosen),
            positions=None if self.positions is None else self.positions[chosen],
            normals=None if self.normals is None else self.normals[chosen],
            surface_distances=None if apart is None else apart[np.ix_(chosen, chosen)],
        )

    def complete(self, policy: MissingPolicy = "error") -> Recording:
        """Settle what to do about readings that are NaN or infinite.

        Parameters
        ----------
        policy : {"error", "drop-frames", "interpolate"}
            Refuse; leave out every frame that misses a reading; or fill each sensor linearly
            between its neighbours in time (its ends with the nearest reading). A sensor with no
            finite reading at all becomes constant zero, so that it is treated as dead.

        Returns
        -------
        Recording
            One in which every reading is finite; this one if it already was.

        Raises
        ------
        InputError
            Under "error" if a reading is missing, naming sensors and frames; under "drop-frames"
            if no frame would be left.
        """
        missing = ~np.isfinite(self.readings)
        if not missing.any():
            return self
        if policy == "error":
            raise InputError(self._describe_missing(missing))
        if policy == "interpolate":
            return replace(self, readings=fill_gaps(self.readings))
        if policy != "drop-frames":
            raise InputError(f"unknown policy {policy!r}: use error, drop-frames or interpolate")
        silent = missing.all(axis=0)
        whole = ~missing[:, ~silent].any(axis=1)
        if not whole.any():
            raise InputError(
                "every frame misses a reading, so dropping such frames leaves none; "
                "interpolate instead (--nan interpolate), or drop the sensors that are to blame"
            )
        kept = np.where(missing, 0, self.readings)[whole]
        times = None if self.times is None else self.times[whole]
        return replace(self, readings=kept, times=times)

    def _describe_missing(self, missing: NDArray[np.bool_]) -> str:
        sensors = [self.names[i] for i in np.flatnonzero(missing.any(axis=0))]
        frames = np.flatnonzero(missing.any(axis=1))
        return (
            f"{int(missing.sum())} readings are NaN or infinite: "
            f"{noun_and_items('sensor', sensors)}, {noun_and_items('frame', frames.tolist())}; "
            "choose what to do about them: drop-frames or interpolate (--nan)"
        )


def default_names(n_sensors: int) -> tuple[str, ...]:
    """Name sensors that came without names: ``s0, s1, ...``."""
    return tuple(f"s{i}" for i in range(n_sensors))


def check_names(names: Sequence[str], n_sensors: int) -> None:
    """Refuse names that do not tell N sensors apart.

    Raises
    ------
    InputError
        If there are not `n_sensors` of them, or one stands twice.
    """
    if len(names) != n_sensors:
        raise InputError(f"{len(names)} names for {n_sensors} sensors; give one name a sensor")
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise InputError(
            "names must be unique, but more than one sensor has the "
            f"{noun_and_items('name', repeated)}"
        )


def find_sensors(names: Sequence[str], sensors: Iterable[str | int]) -> NDArray[np.intp]:
    """Find sensors by name, or else by index; see `Recording.indices`."""
    by_name = {name: i for i, name in enumerate(names)}
    found = set()
    for sensor in sensors:
        text = str(sensor)
        if isinstance(sensor, str) and text in by_name:
            found.add(by_name[text])
        elif text.isdecimal() and int(text) < len(names):
            found.add(int(text))
        else:
            raise InputError(
                f"there is no sensor {text!r}; the {len(names)} sensors are named "
                f"{names[0]} ... {names[-1]}, or count from 0 to {len(names) - 1}"
            )
    return np.array(sorted(found), dtype=np.intp)


def _as_readings(values: ArrayLike) -> NDArray[np.floating]:
    array = np.asarray(values)
    if array.dtype.kind not in "biuf":
        raise InputError(f"readings are of type {array.dtype}; they must be real numbers")
    if array.ndim != 2:
        raise InputError(
            f"readings have {array.ndim} dimensions; they must be frames x sensors, shape (T, N)"
        )
    if 0 in array.shape:
        raise InputError(f"readings have shape {array.shape}: there is nothing in them")
    fits_float32 = array.dtype in (np.float16, np.float32) or (
        array.dtype.kind in "biu" and array.dtype.itemsize <= 2
    )
    dtype = np.float32 if fits_float32 else np.float64
    if array.dtype == dtype and array.base is None and not array.flags.writeable:
        return (
            array  # it was handed over for good, and large recordings should not stand here twice
        )
    return _frozen(np.array(array, dtype=dtype))


def _frozen(array: _Array) -> _Array:
    array.setflags(write=False)
    return array


def _check_shape(
    name: str, array: NDArray[np.float64], shapes: tuple[tuple[int, int], ...], n_sensors: int
) -> None:
    if array.shape not in shapes:
        raise InputError(
            f"{name} have shape {array.shape}; "
            f"{n_sensors} sensors need {' or '.join(map(str, shapes))}"
        )


def _check_times(times: NDArray[np.float64], n_frames: int) -> None:
    if times.shape != (n_frames,):
        raise InputError(f"times have shape {times.shape}; {n_frames} frames need ({n_frames},)")
    if not np.isfinite(times).all():
        raise InputError(f"the time of frame {int(np.argmin(np.isfinite(times)))} is not finite")
    steps = np.diff(times)
    if (steps <= 0).any():
        frame = int(np.argmax(steps <= 0)) + 1
        raise InputError(
            f"times must increase, but frame {frame} ({times[frame]:g} s) "
            f"does not come after frame {frame - 1} ({times[frame - 1]:g} s)"
        )


def _rebuilt(fields: dict[str, Any]) -> Recording:
    return Recording(**fields)
