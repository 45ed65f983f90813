"""NumPy archives and arrays: recordings, events and maps.

Nothing is unpickled, and arrays of impossible sizes are not decompressed. A recording has
``readings`` (T, N), or ``times`` and ``taxels`` or the like, and scalars as metadata; a map has
``positions`` instead.
"""

from __future__ import annotations

import json
import math
import os
import sys
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anisomap.base.axes import Frames, frames_of
from anisomap.base.wording import join_items
from anisomap.errors import DamagedError, FileError, InputError, error_reason
from anisomap.files.budget import DEFLATE_RATIO, Budget, bytes_kept
from anisomap.files.paths import open_regular
from anisomap.io.parsing.facts import properties_of, read_properties, to_python_scalar
from anisomap.io.parsing.names import distinct_names
from anisomap.io.parsing.source import warn
from anisomap.io.recordings.events import NOUNS, Events, noun_of, stream_events
from anisomap.io.stream import (
    Block,
    ReadOptions,
    Stream,
    increasing_times,
    read_in_blocks,
    salvage,
)
from anisomap.recording import Recording, Scalar
from anisomap.sensor_map import SensorMap
from anisomap.usability import ACCURACY, UNKNOWN

MAGICS, ARRAY_MAGIC = (b"PK\x03\x04", b"PK\x05\x06"), b"\x93NUMPY"
NUMBERS, WHOLE, TEXT = "biuf", "biu", "US"
"""Accepted values of `numpy.dtype.kind`."""

_SUFFIX = ".npy"
_DESCRIPTIONS = {NUMBERS: "numbers", WHOLE: "integers"}
_MAX_SCALAR_BYTES = 1 << 16

_RECORDING_KEYS = {
    *("readings", "positions", "normals", "surface_distances"),
    *("names", "times", "rate_hz", "units", "source", "metadata"),
}
_TIMES, _NUMBERED = ("times", "time", "spike_times"), ("events", "event")
_SENSORS = (*NOUNS, "spike_clusters")


class Header(NamedTuple):
    """Shape, order and type of a stored array."""

    shape: tuple[int, ...]
    fortran_order: bool
    dtype: np.dtype[Any]


def read_header(stream: IO[bytes], what: str) -> Header:
    """Read the header of an array, and leave the stream at its first value."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read = np.lib.format.read_array_header_1_0
            if np.lib.format.read_magic(stream) != (1, 0):
                read = np.lib.format.read_array_header_2_0
            shape, fortran_order, dtype = read(stream)
    except (OSError, EOFError, zlib.error, zipfile.BadZipFile):  # of what holds the array
        raise
    except Exception as error:  # numpy evaluates a literal; any error may result
        raise InputError(f"the header of {what} is damaged: {error_reason(error)}") from error
    # numpy accepts True for 1.
    return Header(tuple(int(length) for length in shape), fortran_order, dtype)


@contextmanager
def open_archive(path: Path) -> Iterator[Archive]:
    """Open an NPZ file."""
    try:
        with zipfile.ZipFile(path) as archive:
            yield Archive(path, archive, Budget(path))
    except zipfile.BadZipFile as error:
        raise FileError(f"{path} is damaged or not a NumPy archive: {error}") from error
    except (zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise FileError(f"{path} is damaged: {error}") from error


@dataclass(frozen=True)
class Archive:
    """An open NPZ file; arrays that are missing are None or empty, unless they are required."""

    path: Path
    zip: zipfile.ZipFile
    budget: Budget

    @property
    def names(self) -> list[str]:
        """Names of all arrays."""
        members = self.zip.namelist()
        return [name.removesuffix(_SUFFIX) for name in members if name.endswith(_SUFFIX)]

    def require(self, name: str, what: str) -> None:
        """Raise FileError if an array is missing; `what` describes it in the message."""
        if name not in self.names:
            found = f"arrays: {join_items(self.names)}" if self.names else "it has no array"
            raise FileError(f"{self.path} holds no {what}: array {name!r} is missing ({found})")

    def required(self, name: str, kinds: str) -> NDArray[Any]:
        """Read an existing array, which must be of one of `kinds`."""
        with self._member(name, kinds) as (member, header):
            # Numbers other than readings are converted to float64.
            item_bytes = max(header.dtype.itemsize, np.dtype(np.float64).itemsize)
            self.budget.spend(math.prod(header.shape) * item_bytes, f"array {name}")
            return _whole(member, header)

    def array(
        self, name: str, kinds: str = NUMBERS, *, listed: bool = False
    ) -> NDArray[Any] | None:
        """Read an array, with one dimension if it is `listed`."""
        values = self.required(name, kinds) if name in self.names else None
        if listed and values is not None and values.ndim != 1:
            raise FileError(f"{self.path}: {name} has shape {values.shape}; it must be 1-D")
        return values

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an existing array of readings."""
        with self._member(name, NUMBERS) as (_, header):
            n_bytes = math.prod(header.shape) * bytes_kept(header.dtype)
            self.budget.check(n_bytes, f"array {name}")
            return header.shape

    def blocks(self, name: str, times: NDArray[np.float64] | None) -> Iterator[Block]:
        """Yield the rows of a 2-D array in blocks; an array in Fortran order is read as a whole."""
        with self._member(name, NUMBERS) as (member, header):
            (n_rows, n_columns), fortran_order, dtype = header
            if fortran_order:
                yield Block(_whole(member, header), 1.0, times)
                return

            def read(start: int, stop: int) -> NDArray[Any]:
                values = _values(self.path, member, dtype, (stop - start) * n_columns)
                return values.reshape(-1, n_columns)

            yield from read_in_blocks(read, n_rows, n_columns * dtype.itemsize, times=times)

    def texts(self, name: str) -> tuple[str, ...]:
        """Read a 1-D array of strings."""
        values = self.array(name, TEXT + WHOLE, listed=True)
        return () if values is None else tuple(map(str, self._python(name, values)))

    def text(self, name: str, default: str = "") -> str:
        """Read a single string."""
        return str(self._single(name, TEXT)) if name in self.names else default

    def number(self, name: str) -> float | None:
        """Read a single number."""
        return float(self._single(name, NUMBERS)) if name in self.names else None

    def mapping(self, name: str) -> dict[str, Scalar]:
        """Read a mapping stored as JSON; other text becomes the value of the key `name`."""
        packed = self.text(name)
        try:
            mapping = json.loads(packed) if packed else {}
        except (ValueError, RecursionError):
            mapping = None
        if not isinstance(mapping, dict):
            return {name: packed}
        return {key: value for key, value in mapping.items() if isinstance(value, Scalar)}

    def scalars(self, exclude: set[str]) -> dict[str, Scalar]:
        """Read all scalar arrays except those named in `exclude`; objects are skipped."""
        found = {}
        for name in dict.fromkeys(self.names):
            small = self.zip.getinfo(name + _SUFFIX).file_size <= _MAX_SCALAR_BYTES
            if name not in exclude and small:
                with self._open(name) as (_, header):
                    scalar = header.shape == () and header.dtype.kind in NUMBERS + TEXT
                if scalar:
                    found[name] = self._single(name, NUMBERS + TEXT)
        return found

    def _single(self, name: str, kinds: str) -> Any:
        values = self.required(name, kinds)
        if values.size != 1:
            raise FileError(f"{self.path}: {name} has shape {values.shape}; it must be one value")
        return self._python(name, values.reshape(1))[0]

    def _python(self, name: str, values: NDArray[Any]) -> list[Any]:
        """Convert an array to a list of Python strings or numbers."""
        if values.dtype.kind == "f":
            values = values.astype(np.float64)
        if values.dtype.kind == "S":
            return [text.decode("utf-8", "replace") for text in values.tolist()]
        if values.dtype.kind == "U":
            # numpy accepts code points beyond Unicode, on which Python fails later.
            characters = values.view(np.dtype(np.uint32).newbyteorder(values.dtype.byteorder))
            if characters.max(initial=0) > sys.maxunicode:
                raise FileError(f"{self.path}: {name} holds invalid Unicode characters")
        found: list[Any] = values.tolist()
        return found

    @contextmanager
    def _member(self, name: str, kinds: str) -> Iterator[tuple[IO[bytes], Header]]:
        """Open an array at its first value, after validating its header."""
        with self._open(name) as (member, header):
            shape, _, dtype = header
            if dtype.kind not in kinds:
                expected = _DESCRIPTIONS.get(kinds, "text")
                kind = "pickled objects" if dtype.hasobject else f"of type {dtype}"
                raise FileError(f"{self.path}: {name} is {kind}; it must be {expected}")
            n_bytes = math.prod(shape) * dtype.itemsize
            held = self.zip.getinfo(name + _SUFFIX).file_size - member.tell()
            if n_bytes != held or min(shape, default=0) < 0 or not dtype.itemsize:
                raise FileError(
                    f"{self.path}: {name} is damaged: "
                    f"shape {shape} needs {n_bytes} bytes, but the array has {held}"
                )
            yield member, header

    @contextmanager
    def _open(self, name: str) -> Iterator[tuple[IO[bytes], Header]]:
        """Open an array unless its compressed bytes cannot reach the size that it declares."""
        info = self.zip.getinfo(name + _SUFFIX)
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            problem = "uses a compression method that NumPy never writes"
            raise FileError(f"{self.path}: {info.filename} {problem}")
        ratio = 1 if info.compress_type == zipfile.ZIP_STORED else DEFLATE_RATIO
        packed = min(info.compress_size, self.budget.size)
        self.budget.check(info.file_size, info.filename, reachable=ratio * packed)
        with self.zip.open(info) as member:
            yield member, read_header(member, f"the array {name}")


def _whole(member: IO[bytes], header: Header) -> NDArray[Any]:
    # Reading to the end makes zipfile verify the checksum.
    values = np.frombuffer(member.read(), header.dtype)
    return values.reshape(header.shape, order="F" if header.fortran_order else "C")


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a recording in an NPZ archive: readings, or events."""
    with open_archive(path) as archive:
        # The unit of the positions has the name of an array of units.
        sensors = [name for name in _SENSORS if name != "units" or "positions" not in archive.names]
        moments = [name for name in (*_TIMES, *_NUMBERED) if name in archive.names]
        sensors = [name for name in sensors if name in archive.names]
        if "readings" not in archive.names and moments and sensors:
            yield _stream_events(archive, moments[0], sensors[0], options.bin_s)
            return
        archive.require("readings", "recording")
        shape = archive.shape("readings")
        if 0 in shape:
            raise FileError(f"{path}: readings are empty (shape {shape})")
        frames = _frames_of(path, shape, "readings")
        names = archive.texts("names") or frames.names
        if len(shape) == 2:
            blocks = archive.blocks("readings", _times(archive, shape[0]))
        else:
            rows = np.moveaxis(archive.required("readings", NUMBERS), frames.time, 0)
            rows = rows.reshape(-1, frames.n_sensors)
            blocks = iter([Block(rows, 1.0, _times(archive, len(rows)))])
        yield Stream(
            path,
            frames.n_sensors,
            blocks,
            names=names,
            rate_hz=archive.number("rate_hz"),
            positions=archive.array("positions"),
            normals=archive.array("normals"),
            surface_distances=archive.array("surface_distances"),
            units=archive.text("units"),
            source=archive.text("source", path.name),
            metadata={**archive.scalars(exclude=_RECORDING_KEYS), **archive.mapping("metadata")},
        )


def _times(archive: Archive, n_frames: int) -> NDArray[np.float64] | None:
    stored = archive.array("times")
    times = None if stored is None else increasing_times(stored, archive.path)
    if times is not None and len(times) != n_frames:
        raise FileError(f"{archive.path}: times must have shape ({n_frames},), got {times.shape}")
    return times


def _stream_events(archive: Archive, at: str, which: str, bin_s: float | None) -> Stream:
    """Create a stream of the events in an archive."""
    path, noun = archive.path, noun_of(which)
    moments = archive.required(at, NUMBERS).astype(np.float64)
    sensors = archive.required(which, WHOLE).astype(np.int64)
    if moments.ndim != 1 or moments.shape != sensors.shape:
        shapes = f"got shapes {moments.shape} and {sensors.shape}"
        raise FileError(f"{path}: {at} and {which} must be lists of equal length, {shapes}")
    if sensors.min(initial=0) < 0:
        raise FileError(f"{path}: {which} must be numbers of sensors from 0")
    names = distinct_names(path, archive.texts("names"))
    positions = archive.array("positions")
    n_known = len(names) or (0 if positions is None else len(positions))
    if n_known:
        if (most := sensors.max(initial=0)) >= n_known:
            raise FileError(f"{path}: {which} holds {most}, but there are {n_known} sensors")
        names = names or tuple(f"{noun}{i}" for i in range(n_known))
    else:
        numbers, sensors = np.unique(sensors, return_inverse=True)
        names = tuple(f"{noun}{number}" for number in numbers.tolist())
    return stream_events(
        path,
        Events(moments, sensors.astype(np.intp), names, timed=at in _TIMES),
        bin_s=bin_s,
        spikes=(noun in ("channel", "electrode", "unit", "neuron") and at in _TIMES) or None,
        positions=positions,
        units="" if positions is None else archive.text("units"),
        metadata={"format": "NumPy archive of events"},
    )


@contextmanager
def open_array(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open an array, (T, N), not mapped into memory: a file that is cut would end the process."""
    with open_regular(path) as stream:
        shape, fortran_order, dtype = read_header(stream, "the array")
        if dtype.kind not in NUMBERS:
            raise FileError(f"{path}: the array must hold numbers, got dtype {dtype}")
        if 0 in shape:
            raise FileError(f"{path}: the array is empty, got shape {shape}")
        frames = _frames_of(path, shape, "the array")
        n_frames, n_sensors = shape[frames.time], frames.n_sensors
        needed = n_frames * n_sensors * dtype.itemsize
        held = os.fstat(stream.fileno()).st_size - stream.tell()
        if needed > held:
            raise DamagedError(
                f"{path} is cut short: its array needs {needed} bytes, but {held} follow the header"
            )
        first = stream.tell()
        if len(shape) > 2 and (fortran_order or frames.time):
            Budget(path).check(needed, "the array")
            values = _values(path, stream, dtype, n_frames * n_sensors)
            whole = values.reshape(shape, order="F" if fortran_order else "C")
            rows = np.moveaxis(whole, frames.time, 0).reshape(n_frames, n_sensors)
            once = iter([Block(rows, 1.0)])
            yield Stream(
                path, n_sensors, once, names=frames.names, source=path.name, raw_columns=True
            )
            return

        def read(start: int, stop: int) -> NDArray[Any]:
            if not fortran_order:
                rows = _values(path, stream, dtype, (stop - start) * n_sensors)
                return rows.reshape(-1, n_sensors)
            columns = np.empty((n_sensors, stop - start), dtype)
            for sensor, column in enumerate(columns):
                stream.seek(first + (sensor * n_frames + start) * dtype.itemsize)
                column[:] = _values(path, stream, dtype, stop - start)
            return columns.T

        # In Fortran order, a block takes one read per sensor, so blocks are larger.
        frame_bytes = n_sensors * dtype.itemsize >> (2 if fortran_order else 0)
        blocks = salvage(read_in_blocks(read, n_frames, max(frame_bytes, 1)), path)
        yield Stream(
            path, n_sensors, blocks, names=frames.names, source=path.name, raw_columns=True
        )


def _frames_of(path: Path, shape: tuple[int, ...], what: str) -> Frames:
    """Return how an array holds frames; more than two axes are said."""
    frames = frames_of(shape)
    if frames is None:
        expected = "be frames x sensors (T, N), or have time, its longest axis, first or last"
        raise FileError(f"{path}: {what} must {expected}, got shape {shape}")
    if len(shape) > 2:
        warn(path, f"{what} has {len(shape)} axes: {frames.said}")
    return frames


def _values(path: Path, stream: IO[bytes], dtype: np.dtype[Any], count: int) -> NDArray[Any]:
    """Read the next values of an array."""
    content = stream.read(count * dtype.itemsize)
    if len(content) < count * dtype.itemsize:
        raise DamagedError(f"{path} was cut while it was read")
    return np.frombuffer(content, dtype)


def read_map(path: Path) -> SensorMap:
    """Read a map, or the true positions of a recording, without its readings."""
    with open_archive(path) as archive:
        archive.require("positions", "positions")
        positions = archive.required("positions", NUMBERS)
        names = distinct_names(path, archive.texts("names"))
        if "readings" in archive.names:
            return SensorMap(positions, names=names, units=archive.text("units"))
        stored: dict[str, Any] = {
            **{name: archive.text(name) for name in ("units", "method")},
            "verdict": archive.text("verdict", UNKNOWN),
            **{name: archive.number(name) for name in ("stress", *ACCURACY)},
            **{name: archive.texts(name) for name in ("reasons", "notes")},
            "provenance": archive.mapping("provenance"),
        }
        component = archive.array("component", WHOLE, listed=True)
        errors = archive.array("errors")
        return SensorMap(
            positions,
            names=names,
            component=np.empty(0, np.intp) if component is None else component.astype(np.intp),
            health=archive.texts("health"),
            errors=np.empty(0) if errors is None else errors,
            covariances=archive.array("covariances"),
            normals=None if component is None else archive.array("normals"),
            **read_properties(stored),
        )


def write_recording(recording: Recording, path: Path) -> None:
    """Write a recording as an NPZ archive; every field is read back equal."""
    fields = ("readings", "names", "positions", "normals", "surface_distances", "times", "rate_hz")
    arrays = {name: getattr(recording, name) for name in (*fields, "units", "source")}
    write_arrays({**arrays, "metadata": to_json(recording.metadata)}, path)


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write a map as an NPZ archive; every field is read back equal."""
    known = properties_of(sensor_map)
    arrays: dict[str, Any] = {
        "positions": sensor_map.positions,
        "names": sensor_map.names,
        "component": sensor_map.component.astype(np.int64),
        "health": sensor_map.health,
        "errors": None if np.isnan(sensor_map.errors).all() else sensor_map.errors,
        "covariances": sensor_map.covariances,
        "normals": sensor_map.normals,
        "units": sensor_map.units,
        **sensor_map.reference,
        **known,
        "provenance": to_json(known["provenance"]),
    }
    write_arrays(arrays, path)


def to_json(mapping: Mapping[str, Scalar]) -> str:
    """Return a mapping as the text that `Archive.mapping` reads."""
    return json.dumps({key: to_python_scalar(value) for key, value in mapping.items()})


def write_arrays(arrays: Mapping[str, Any], path: Path) -> None:
    """Write arrays, texts and tuples of texts as an archive; those that are None are left out."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            if array is None:
                continue
            values = np.array(array, dtype=str) if isinstance(array, tuple) else np.asarray(array)
            # An explicit ZipInfo omits the time and the operating system: equal input, equal bytes.
            info = zipfile.ZipInfo(name + _SUFFIX)
            info.compress_type, info.create_system = zipfile.ZIP_DEFLATED, 0
            with archive.open(info, "w", force_zip64=True) as member:
                np.lib.format.write_array(member, values, allow_pickle=False)
