"""NumPy archives and arrays: recordings and maps.

Nothing is unpickled. A recording has ``readings`` (T, N), which are read in blocks of rows, and
scalars as metadata; a map has ``positions`` instead.
"""

from __future__ import annotations

import json
import math
import os
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from anisomap.base.columns import frames_of
from anisomap.base.wording import join_items
from anisomap.errors import DamagedError, FileError, InputError, error_reason
from anisomap.files.budget import Budget
from anisomap.files.paths import open_regular
from anisomap.io.parsing.facts import properties_of, read_properties, to_python_scalar
from anisomap.io.parsing.names import distinct_names
from anisomap.io.parsing.refusals import FROM_EVENTS
from anisomap.io.parsing.source import warn
from anisomap.io.stream import Block, ReadOptions, Stream, increasing_times, read_in_blocks, salvage
from anisomap.map_verdict import ACCURACY, UNKNOWN
from anisomap.recording import Recording, Scalar
from anisomap.sensor_map import SensorMap

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
_MOMENTS = {"times", "time", "spike_times", "events", "event"}  # of events, without readings


@contextmanager
def _damage(what: str) -> Iterator[None]:
    """Convert errors of reading an array; NumPy evaluates its header, so any error is possible."""
    try:
        yield
    except (OSError, zipfile.BadZipFile):
        raise
    except Exception as error:
        raise InputError(f"{what} is damaged: {error_reason(error)}") from error


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open an archive; all arrays except readings may be read as a whole."""
    with zipfile.ZipFile(path) as archive:
        budget = Budget(path)
        for info in archive.infolist():
            if info.filename != f"readings{_SUFFIX}":
                budget.spend(info.file_size, info.filename)
        yield archive


def _names(archive: zipfile.ZipFile) -> list[str]:
    stored = archive.namelist()
    return [name.removesuffix(_SUFFIX) for name in stored if name.endswith(_SUFFIX)]


def _array(
    archive: zipfile.ZipFile, name: str, kinds: str = NUMBERS, *, listed: bool = False
) -> NDArray[Any] | None:
    """Read an array of one of `kinds`, with one axis if it is `listed`; None if it is missing."""
    if name not in _names(archive):
        return None
    with _damage(f"array {name}"), archive.open(name + _SUFFIX) as member:
        values: NDArray[Any] = np.lib.format.read_array(member, allow_pickle=False)
    if values.dtype.kind not in kinds:
        expected = _DESCRIPTIONS.get(kinds, "text")
        raise InputError(f"array {name} is of type {values.dtype}; it must be {expected}")
    if listed and values.ndim != 1:
        raise InputError(f"array {name} has shape {values.shape}; it must be 1-D")
    return values


def _shape(archive: zipfile.ZipFile, name: str) -> tuple[int, ...]:
    with suppress(InputError), archive.open(name + _SUFFIX) as member:
        return _header(member, name)[0]
    return ()


def _missing(archive: zipfile.ZipFile, name: str, what: str) -> InputError:
    found = f"arrays: {join_items(names)}" if (names := _names(archive)) else "it has no array"
    return InputError(f"it holds no {what}: array {name!r} is missing ({found})")


def _items(name: str, values: NDArray[Any]) -> list[Any]:
    """Convert an array to a list of Python strings or numbers."""
    with _damage(f"array {name}"):
        if values.dtype.kind == "S":
            values = np.char.decode(values, "utf-8", "replace")
        wide = values.dtype.kind == "f"
        found: list[Any] = (values.astype(np.float64) if wide else values).ravel().tolist()
        max("".join(map(str, found)), default="")  # NumPy accepts code points beyond Unicode
        return found


def _texts(archive: zipfile.ZipFile, name: str) -> tuple[str, ...]:
    values = _array(archive, name, TEXT + WHOLE, listed=True)
    return () if values is None else tuple(map(str, _items(name, values)))


def _single(archive: zipfile.ZipFile, name: str, kinds: str) -> Any:
    """Read a single value; None if it is missing."""
    values = _array(archive, name, kinds)
    if values is None:
        return None
    if values.size != 1:
        raise InputError(f"array {name} has shape {values.shape}; it must be one value")
    return _items(name, values)[0]


def _text(archive: zipfile.ZipFile, name: str, default: str = "") -> str:
    found = _single(archive, name, TEXT)
    return default if found is None else str(found)


def _mapping(archive: zipfile.ZipFile, name: str) -> dict[str, Scalar]:
    """Read a mapping stored as JSON; other text becomes the value of the key `name`."""
    packed = _text(archive, name)
    try:
        mapping = json.loads(packed) if packed else {}
    except (ValueError, RecursionError):
        mapping = None
    if not isinstance(mapping, dict):
        return {name: packed}
    return {key: value for key, value in mapping.items() if isinstance(value, Scalar)}


def _scalars(archive: zipfile.ZipFile) -> dict[str, Scalar]:
    """Read the scalars in addition to a recording; objects are skipped."""
    found: dict[str, Scalar] = {}
    for name in _names(archive):
        large = archive.getinfo(name + _SUFFIX).file_size > _MAX_SCALAR_BYTES
        if name in _RECORDING_KEYS or large:
            continue
        with suppress(InputError):
            values = _array(archive, name, NUMBERS + TEXT)
            if values is not None and values.ndim == 0:
                found[name] = _items(name, values)[0]
    return found


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a recording in an NPZ archive."""
    with _opened(path) as archive:
        names = _names(archive)
        if "readings" not in names:
            tables = [name for name in names if len(_shape(archive, name)) > 1]
            if tables:
                saved = f"numpy.savez('new.npz', readings=numpy.load(path)[{tables[0]!r}])"
                raise FileError(f"{path} names no array readings", f"in Python it is {saved}")
            if _MOMENTS.intersection(names):
                raise FileError(f"{path} holds events", FROM_EVENTS)
            raise _missing(archive, "readings", "recording")
        times, info = _array(archive, "times"), archive.getinfo(f"readings{_SUFFIX}")
        with archive.open(info) as member:
            stream = _stream(path, member, info.file_size, "readings", times)
            yield replace(
                stream,
                names=_texts(archive, "names") or stream.names,
                rate_hz=_single(archive, "rate_hz", NUMBERS),
                positions=_array(archive, "positions"),
                normals=_array(archive, "normals"),
                surface_distances=_array(archive, "surface_distances"),
                units=_text(archive, "units"),
                source=_text(archive, "source", path.name),
                metadata={**_scalars(archive), **_mapping(archive, "metadata")},
            )


@contextmanager
def open_array(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open an array, (T, N), without memory mapping: a truncated file would end the process."""
    with open_regular(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        yield replace(_stream(path, stream, size, "the array"), raw_columns=True)


def _stream(
    path: Path, stream: IO[bytes], size: int, what: str, times: NDArray[Any] | None = None
) -> Stream:
    """Open an array of readings of `size` bytes, including its header, in blocks of rows.

    An array in Fortran order, or with time as last axis, is read as a whole.
    """
    shape, fortran_order, dtype = _header(stream, what)
    frames = frames_of(shape) if min(shape, default=0) > 0 else None
    if frames is None:
        expected = "be frames x sensors (T, N), or have time, its longest axis, first or last"
        raise InputError(f"{what} must {expected}, got shape {shape}")
    if len(shape) > 2:
        warn(path, f"{what} has {len(shape)} axes: {frames.said}")
    n_frames, n_sensors = shape[frames.time], frames.n_sensors
    n_bytes, held = math.prod(shape) * dtype.itemsize, size - stream.tell()
    if n_bytes > held:
        raise DamagedError(f"{path} is cut short: {what} has {held} of {n_bytes} bytes")
    if times is not None and times.shape != (n_frames,):
        raise InputError(f"times must have shape ({n_frames},), got {times.shape}")
    times = None if times is None else increasing_times(times, path)

    def rows(start: int, stop: int) -> NDArray[Any]:
        content = stream.read((stop - start) * n_sensors * dtype.itemsize)
        if len(content) < (stop - start) * n_sensors * dtype.itemsize:
            raise DamagedError(f"{path} was cut while it was read")
        return np.frombuffer(content, dtype).reshape(-1, n_sensors)

    blocks = read_in_blocks(rows, n_frames, n_sensors * dtype.itemsize, times=times)
    if fortran_order or frames.time:
        Budget(path).check(n_bytes, what)
        whole = rows(0, n_frames).reshape(-1).reshape(shape, order="F" if fortran_order else "C")
        readings = np.moveaxis(whole, frames.time, 0).reshape(n_frames, n_sensors)
        blocks = iter([Block(readings, 1.0, times)])
    return Stream(path, n_sensors, salvage(blocks, path), names=frames.names, source=path.name)


def _header(stream: IO[bytes], what: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Read the shape, the order and the type of an array of numbers."""
    form = np.lib.format
    with _damage(what), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        first = form.read_magic(stream) == (1, 0)
        read = form.read_array_header_1_0 if first else form.read_array_header_2_0
        shape, fortran_order, dtype = read(stream)
    if dtype.kind not in NUMBERS:
        raise InputError(f"{what} must hold numbers, got dtype {dtype}")
    return tuple(map(int, shape)), fortran_order, dtype  # NumPy accepts True for a length of 1


def read_map(path: Path) -> SensorMap:
    """Read a map, or the true positions of a recording, without its readings."""
    with _opened(path) as archive:
        positions = _array(archive, "positions")
        if positions is None:
            raise _missing(archive, "positions", "positions")
        names = distinct_names(path, _texts(archive, "names"))
        if "readings" in _names(archive):
            return SensorMap(positions, names=names, units=_text(archive, "units"))
        stored: dict[str, Any] = {
            **{name: _text(archive, name) for name in ("units", "method")},
            "verdict": _text(archive, "verdict", UNKNOWN),
            **{name: _single(archive, name, NUMBERS) for name in ("stress", *ACCURACY)},
            **{name: _texts(archive, name) for name in ("reasons", "notes")},
            "provenance": _mapping(archive, "provenance"),
        }
        component = _array(archive, "component", WHOLE, listed=True)
        errors = _array(archive, "errors")
        return SensorMap(
            positions,
            names=names,
            component=np.empty(0, np.intp) if component is None else component.astype(np.intp),
            health=_texts(archive, "health"),
            errors=np.empty(0) if errors is None else errors,
            covariances=_array(archive, "covariances"),
            normals=None if component is None else _array(archive, "normals"),
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
        **known,
        "provenance": to_json(known["provenance"]),
    }
    write_arrays(arrays, path)


def to_json(mapping: Mapping[str, Scalar]) -> str:
    """Return a mapping as the text that `_mapping` reads."""
    return json.dumps({key: to_python_scalar(value) for key, value in mapping.items()})


def write_arrays(arrays: Mapping[str, Any], path: Path) -> None:
    """Write arrays, texts and tuples of texts as an archive; None is omitted."""
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
