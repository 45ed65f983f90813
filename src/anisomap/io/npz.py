"""NumPy archives: recordings, events and maps. Nothing is unpickled.

A recording has ``readings`` (T, N), and may have ``positions``, ``normals``,
``surface_distances``, ``names``, ``times``, ``rate_hz``, ``units``, ``source``. Scalars of other
names are its metadata, and other arrays are ignored. A recording of events has ``times`` and
``taxels``, ``channels`` or the like instead of readings. A map has ``positions`` instead of
``readings``. Arrays with impossible sizes are not decompressed.
"""

from __future__ import annotations

import json
import math
import sys
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.parsing.facts import properties_of, read_properties, to_python_scalar
from anisomap.io.parsing.naming import distinct_names
from anisomap.io.recordings.events import Events, stream_events
from anisomap.io.recordings.npy import Header, read_header
from anisomap.io.stream import BLOCK_BYTES, Block, ReadOptions, Stream, increasing_times
from anisomap.memory import DEFLATE_RATIO, Budget, bytes_kept
from anisomap.recording import Recording, Scalar
from anisomap.sensor_map import SensorMap
from anisomap.usability import ACCURACY, UNKNOWN
from anisomap.wording import join_items

SUFFIX = ".npy"
NUMBERS, WHOLE, TEXT = "biuf", "biu", "US"
"""Accepted values of `numpy.dtype.kind`."""
_DESCRIPTIONS = {NUMBERS: "numbers", WHOLE: "integers"}

_MAX_SCALAR_BYTES = 1 << 16
_MAX_TEXT_BYTES = 1 << 24
"""Of one text; numpy stores all texts of an array at the length of the longest."""
_BLOCK_BYTES = 1 << 22


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


def _whole(
    member: IO[bytes], shape: tuple[int, ...], fortran_order: bool, dtype: np.dtype[Any]
) -> NDArray[Any]:
    # Reading to the end makes zipfile verify the checksum.
    values = np.frombuffer(member.read(), dtype)
    return values.reshape(shape, order="F" if fortran_order else "C")


def _contents(member: IO[bytes], n_bytes: int) -> Iterator[bytes]:
    """Yield blocks; the final read, which returns nothing, makes zipfile verify the checksum."""
    while content := member.read(n_bytes):
        yield content


@dataclass(frozen=True)
class Archive:
    """An open NPZ file."""

    path: Path
    zip: zipfile.ZipFile
    budget: Budget

    @property
    def names(self) -> list[str]:
        """Names of all arrays."""
        members = self.zip.namelist()
        return [name.removesuffix(SUFFIX) for name in members if name.endswith(SUFFIX)]

    def require(self, name: str, what: str) -> None:
        """Raise FileError if an array is missing; `what` describes it in the message."""
        if name not in self.names:
            found = f"arrays: {join_items(self.names)}" if self.names else "it has no array"
            raise FileError(f"{self.path} holds no {what}: array {name!r} is missing ({found})")

    def required(self, name: str, kinds: str) -> NDArray[Any]:
        """Read an existing array, which must be of one of `kinds`."""
        with self._member(name, kinds) as (member, shape, fortran_order, dtype):
            # Numbers other than readings are converted to float64.
            item_bytes = max(dtype.itemsize, np.dtype(np.float64).itemsize)
            self.budget.spend(math.prod(shape) * item_bytes, f"array {name}")
            return _whole(member, shape, fortran_order, dtype)

    def shape(self, name: str, kinds: str) -> tuple[int, ...]:
        """Return the shape of an existing array of readings."""
        with self._member(name, kinds) as (_, shape, _, dtype):
            self.budget.check(math.prod(shape) * bytes_kept(dtype), f"array {name}")
            return shape

    def rows(self, name: str, kinds: str, n_bytes: int) -> Iterator[NDArray[Any]]:
        """Yield the rows of a 2-D array in blocks of about `n_bytes`.

        An array in Fortran order is read as a whole.
        """
        with self._member(name, kinds) as (member, shape, fortran_order, dtype):
            row_bytes = shape[1] * dtype.itemsize
            if fortran_order:
                yield _whole(member, shape, fortran_order, dtype)
                return
            n_rows = max(1, n_bytes // max(row_bytes, 1))
            for content in _contents(member, n_rows * row_bytes):
                yield np.frombuffer(content, dtype).reshape(-1, shape[1])

    @contextmanager
    def _member(
        self, name: str, kinds: str
    ) -> Iterator[tuple[IO[bytes], tuple[int, ...], bool, np.dtype[Any]]]:
        """Open an array at its first value, after validating its header."""
        info = self.zip.getinfo(name + SUFFIX)
        self._check_size(info)
        with self.zip.open(info) as member:
            shape, fortran_order, dtype = self._header(member, name)
            if dtype.kind not in kinds:
                expected = _DESCRIPTIONS.get(kinds, "text")
                kind = "pickled objects" if dtype.hasobject else f"of type {dtype}"
                raise FileError(f"{self.path}: {name} is {kind}; it must be {expected}")
            if dtype.kind in TEXT and dtype.itemsize > _MAX_TEXT_BYTES:
                raise FileError(
                    f"{self.path}: the texts in {name} have up to {dtype.itemsize} bytes; at most "
                    f"{_MAX_TEXT_BYTES} are supported"
                )
            n_bytes = math.prod(shape) * dtype.itemsize
            held = info.file_size - member.tell()
            if n_bytes != held or min(shape, default=0) < 0 or not dtype.itemsize:
                raise FileError(
                    f"{self.path}: {name} is damaged: "
                    f"shape {shape} needs {n_bytes} bytes, but the array has {held}"
                )
            yield member, shape, fortran_order, dtype

    def array(self, name: str, kinds: str) -> NDArray[Any] | None:
        """Read an array, or return None if it is missing."""
        return self.required(name, kinds) if name in self.names else None

    def integers(self, name: str, dtype: np.dtype[Any]) -> NDArray[Any]:
        """Read a 1-D array of integers; empty if it is missing."""
        values = self.array(name, WHOLE)
        if values is None:
            return np.empty(0, dtype)
        self._check_list(name, values)
        return values.astype(dtype)

    def texts(self, name: str) -> tuple[str, ...]:
        """Read a 1-D array of strings; empty if it is missing."""
        if name not in self.names:
            return ()
        with self._member(name, TEXT + WHOLE) as (member, shape, _, dtype):
            if len(shape) != 1:
                raise FileError(f"{self.path}: {name} has shape {shape}; it must be 1-D")
            found: list[str] = []
            # In blocks, because numpy stores short texts at the length of the longest.
            n_bytes = max(1, _BLOCK_BYTES // dtype.itemsize) * dtype.itemsize
            for content in _contents(member, n_bytes):
                more = [str(value) for value in self._python(name, np.frombuffer(content, dtype))]
                self.budget.spend(sum(map(sys.getsizeof, more)), f"array {name}")
                found += more
        return tuple(found)

    def text(self, name: str, default: str = "") -> str:
        """Read a single string."""
        values = self.array(name, TEXT)
        return default if values is None else str(self._single(name, values))

    def number(self, name: str) -> float | None:
        """Read a single number, or return None if it is missing."""
        values = self.array(name, NUMBERS)
        return None if values is None else float(self._single(name, values))

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
            info = self.zip.getinfo(name + SUFFIX)
            if name in exclude or info.file_size > _MAX_SCALAR_BYTES:
                continue
            self._check_size(info)
            with self.zip.open(info) as member:
                shape, _, dtype = self._header(member, name)
            if shape == () and dtype.kind in NUMBERS + TEXT:
                found[name] = self._single(name, self.required(name, NUMBERS + TEXT))
        return found

    def _check_list(self, name: str, values: NDArray[Any]) -> None:
        if values.ndim != 1:
            raise FileError(f"{self.path}: {name} has shape {values.shape}; it must be 1-D")

    def _single(self, name: str, values: NDArray[Any]) -> Any:
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

    def _header(self, member: IO[bytes], name: str) -> Header:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                return read_header(member)
        except zipfile.BadZipFile:
            raise
        except Exception as error:  # numpy evaluates the header as a literal; any error may result
            raise FileError(f"{self.path}: the header of the array {name} is damaged") from error

    def _check_size(self, info: zipfile.ZipInfo) -> None:
        """Reject an array with a declared size that its compressed bytes cannot reach."""
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise FileError(
                f"{self.path}: {info.filename} uses a compression method that NumPy never writes"
            )
        ratio = 1 if info.compress_type == zipfile.ZIP_STORED else DEFLATE_RATIO
        packed = min(info.compress_size, self.budget.size)
        self.budget.check(info.file_size, info.filename, reachable=ratio * packed)


_TIMES, _NUMBERED = ("times", "time", "spike_times"), ("events", "event")
_SENSORS = {
    **dict.fromkeys(("ids", "taxels", "contacts"), "taxel"),
    **dict.fromkeys(("sensors", "sensor"), "sensor"),
    **dict.fromkeys(("channels", "channel"), "channel"),
    **dict.fromkeys(("electrodes", "electrode"), "electrode"),
    **dict.fromkeys(("units", "unit", "spike_clusters"), "unit"),
}


def _first(archive: Archive, names: tuple[str, ...]) -> str:
    return next((name for name in names if name in archive.names), "")


def holds_events(archive: Archive) -> bool:
    """Return whether an archive has an array of times or numbers, and one of sensors."""
    return bool(_first(archive, (*_TIMES, *_NUMBERED)) and _sensors_of(archive))


def _sensors_of(archive: Archive) -> str:
    # The unit of the positions has the name of an array of units.
    return _first(
        archive,
        tuple(name for name in _SENSORS if name != "units" or "positions" not in archive.names),
    )


def stream_archived(archive: Archive, bin_s: float | None) -> Stream:
    """Create a stream of the events in an archive."""
    path = archive.path
    at, which = _first(archive, (*_TIMES, *_NUMBERED)), _sensors_of(archive)
    moments = archive.required(at, NUMBERS).astype(np.float64)
    sensors = archive.required(which, WHOLE).astype(np.int64)
    if moments.ndim != 1 or moments.shape != sensors.shape:
        raise FileError(
            f"{path}: {at} and {which} must be lists of equal length, got shapes {moments.shape} "
            f"and {sensors.shape}"
        )
    if sensors.min(initial=0) < 0:
        raise FileError(f"{path}: {which} must be numbers of sensors from 0")
    names = distinct_names(path, archive.texts("names"))
    positions: NDArray[np.float64] | None = archive.array("positions", NUMBERS)
    noun = _SENSORS[which]
    n_known = len(names) or (0 if positions is None else len(positions))
    if n_known:
        if sensors.max(initial=0) >= n_known:
            raise FileError(
                f"{path}: {which} holds {sensors.max()}, but there are {n_known} sensors"
            )
        names = names or tuple(f"{noun}{i}" for i in range(n_known))
    else:
        numbers, sensors = np.unique(sensors, return_inverse=True)
        names = tuple(f"{noun}{number}" for number in numbers.tolist())
    return stream_events(
        path,
        Events(moments, sensors.astype(np.intp), names, timed=at in _TIMES),
        bin_s=bin_s,
        spikes=noun in ("channel", "electrode", "unit") and at in _TIMES,
        positions=positions,
        metadata={"format": "NumPy archive of events"},
    )


MAGICS = (b"PK\x03\x04", b"PK\x05\x06")
_RECORDING_KEYS = {
    *("readings", "positions", "normals", "surface_distances"),
    *("names", "times", "rate_hz", "units", "source", "metadata"),
}


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a recording in an NPZ archive: readings, or events."""
    with open_archive(path) as archive:
        if "readings" not in archive.names and holds_events(archive):
            yield replace(
                stream_archived(archive, options.bin_s),
                units=archive.text("units") if "positions" in archive.names else "",
            )
            return
        archive.require("readings", "recording")
        shape = archive.shape("readings", NUMBERS)
        if len(shape) != 2:
            raise FileError(
                f"{path}: readings must be frames x sensors (T, N), got {len(shape)} dimensions"
            )
        times = archive.array("times", NUMBERS)
        yield Stream(
            path,
            shape[1],
            _blocks(archive, shape, None if times is None else increasing_times(times, path)),
            names=archive.texts("names"),
            rate_hz=archive.number("rate_hz"),
            positions=archive.array("positions", NUMBERS),
            normals=archive.array("normals", NUMBERS),
            surface_distances=archive.array("surface_distances", NUMBERS),
            units=archive.text("units"),
            source=archive.text("source", path.name),
            metadata={**archive.scalars(exclude=_RECORDING_KEYS), **archive.mapping("metadata")},
        )


def _blocks(
    archive: Archive, shape: tuple[int, ...], times: NDArray[np.float64] | None
) -> Iterator[Block]:
    if 0 in shape:
        raise FileError(f"{archive.path}: readings are empty (shape {shape})")
    if times is not None and len(times) != shape[0]:
        raise FileError(f"{archive.path}: times must have shape ({shape[0]},), got {times.shape}")
    stop = 0
    for rows in archive.rows("readings", NUMBERS, BLOCK_BYTES):
        start, stop = stop, stop + len(rows)
        yield Block(rows, stop / shape[0], None if times is None else times[start:stop])


def read_map(path: Path) -> SensorMap:
    """Read a map, or the true positions of a recording, without its readings."""
    with open_archive(path) as archive:
        archive.require("positions", "positions")
        positions = archive.required("positions", NUMBERS)
        names, units = distinct_names(path, archive.texts("names")), archive.text("units")
        if "readings" in archive.names:
            return SensorMap(positions, names=names, units=units)
        stored: dict[str, Any] = {
            **{name: archive.text(name) for name in ("units", "method")},
            "verdict": archive.text("verdict", UNKNOWN),
            **{name: archive.number(name) for name in ("stress", *ACCURACY)},
            **{name: archive.texts(name) for name in ("reasons", "notes")},
            "provenance": archive.mapping("provenance"),
        }
        return SensorMap(
            positions,
            names=names,
            component=archive.integers("component", np.dtype(np.intp)),
            health=archive.texts("health"),
            errors=_or_empty(archive.array("errors", NUMBERS)),
            covariances=archive.array("covariances", NUMBERS),
            normals=archive.array("normals", NUMBERS) if "component" in archive.names else None,
            **read_properties(stored),
        )


def write_recording(recording: Recording, path: Path) -> None:
    """Write a recording as an NPZ archive; every field is read back equal."""
    arrays: dict[str, Any] = {
        "readings": recording.readings,
        "names": np.array(recording.names, dtype=str),
        "positions": recording.positions,
        "normals": recording.normals,
        "surface_distances": recording.surface_distances,
        "times": recording.times,
        "rate_hz": recording.rate_hz,
        "units": recording.units,
        "source": recording.source,
        "metadata": to_json(recording.metadata),
    }
    write_arrays(arrays, path)


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write a map as an NPZ archive; every field is read back equal."""
    known = properties_of(sensor_map)
    arrays: dict[str, Any] = {
        "positions": sensor_map.positions,
        "names": np.array(sensor_map.names, dtype=str),
        "component": sensor_map.component.astype(np.int64),
        "health": np.array(sensor_map.health, dtype=str),
        "errors": None if np.isnan(sensor_map.errors).all() else sensor_map.errors,
        "covariances": sensor_map.covariances,
        "normals": sensor_map.normals,
        **known,
        "reasons": np.array(known["reasons"], dtype=str),
        "notes": np.array(known["notes"], dtype=str),
        "provenance": to_json(known["provenance"]),
    }
    write_arrays(arrays, path)


def _or_empty(array: NDArray[np.float64] | None) -> NDArray[np.float64]:
    return np.empty(0) if array is None else array


def to_json(mapping: Mapping[str, Scalar]) -> str:
    """Return a mapping as the text that `Archive.mapping` reads."""
    return json.dumps({key: to_python_scalar(value) for key, value in mapping.items()})


def write_arrays(arrays: Mapping[str, Any], path: Path) -> None:
    """Write arrays as an archive; those that are None are left out."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            if array is None:
                continue
            # An explicit ZipInfo omits the time and the operating system: equal input, equal bytes.
            info = zipfile.ZipInfo(name + SUFFIX)
            info.compress_type, info.create_system = zipfile.ZIP_DEFLATED, 0
            with archive.open(info, "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)
