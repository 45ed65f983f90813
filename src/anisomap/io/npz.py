"""NumPy archives: recordings and maps.

A recording has ``readings`` (T, N), and may have ``positions``, ``normals``,
``surface_distances``, ``names``, ``times``, ``rate_hz``, ``units``, ``source``. Scalars of other
names are its metadata, and other arrays are ignored. A recording of events has ``times`` and
``taxels``, ``channels`` or the like instead of readings. A map has ``positions`` instead of
``readings``. Nothing is unpickled.
"""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.events.archived_events import holds_events, stream_archived
from anisomap.io.parsing.archive import NUMBERS, SUFFIX, Archive, open_archive
from anisomap.io.parsing.comments import to_python_scalar
from anisomap.io.parsing.frames import increasing_times
from anisomap.io.parsing.map_facts import from_provenance, to_provenance
from anisomap.io.parsing.naming import distinct_names
from anisomap.io.stream import BLOCK_BYTES, Block, ReadOptions, Stream
from anisomap.recording import Recording, Scalar
from anisomap.sensor_map import SensorMap
from anisomap.usability import ERRORS, Verdict

_MAGICS = (b"PK\x03\x04", b"PK\x05\x06")
_RECORDING_KEYS = {
    *("readings", "positions", "normals", "surface_distances"),
    *("names", "times", "rate_hz", "units", "source", "metadata"),
}


def recognises(path: Path, head: bytes) -> bool:
    """Recognise a zip archive by its magic number."""
    return head.startswith(_MAGICS)


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
        stress = archive.number("stress")
        return SensorMap(
            positions,
            names=names,
            component=archive.integers("component", np.dtype(np.intp)),
            health=archive.texts("health"),
            errors=_or_empty(archive.array("errors", NUMBERS)),
            covariances=archive.array("covariances", NUMBERS),
            normals=archive.array("normals", NUMBERS) if "component" in archive.names else None,
            units=units,
            method=archive.text("method"),
            stress=math.nan if stress is None else stress,
            verdict=_read_verdict(archive),
            notes=archive.texts("notes"),
            **from_provenance(archive.mapping("provenance")),
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
    verdict = sensor_map.verdict
    arrays: dict[str, Any] = {
        "positions": sensor_map.positions,
        "names": np.array(sensor_map.names, dtype=str),
        "component": sensor_map.component.astype(np.int64),
        "health": np.array(sensor_map.health, dtype=str),
        "errors": None if np.isnan(sensor_map.errors).all() else sensor_map.errors,
        "covariances": sensor_map.covariances,
        "normals": sensor_map.normals,
        "units": sensor_map.units,
        **sensor_map.reference,
        "method": sensor_map.method,
        "stress": sensor_map.stress,
        "verdict": verdict.level,
        "expected_error": verdict.expected_error,
        "repeatability": verdict.repeatability,
        "systematic": verdict.systematic,
        "reasons": np.array(verdict.reasons, dtype=str),
        "notes": np.array(sensor_map.notes, dtype=str),
        "provenance": to_json(to_provenance(sensor_map)),
    }
    write_arrays(arrays, path)


def _read_verdict(archive: Archive) -> Verdict:
    if "verdict" not in archive.names:
        return Verdict()
    errors = {name: archive.number(name) for name in ERRORS}
    return Verdict(
        archive.text("verdict"),
        **{name: math.nan if value is None else value for name, value in errors.items()},
        reasons=archive.texts("reasons"),
    )


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
