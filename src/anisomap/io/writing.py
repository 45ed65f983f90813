"""Write maps and recordings in the formats of the registry."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TypeVar

from anisomap.errors import FileError, InputError
from anisomap.files import atomic_write, check_distinct, check_target, together
from anisomap.io.parsing.facts import check_encodable, texts_of
from anisomap.io.registry import FORMATS
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

Writer = TypeVar("Writer")


def write(data: SensorMap | Recording, path: str | os.PathLike[str]) -> None:
    """Write a map or a recording in the format of the suffix.

    Parameters
    ----------
    data : SensorMap or Recording
    path : path-like
        Maps: ``.csv``, ``.tsv``, ``.npz``, ``.json``, ``.ply``, ``.pcd``; with a scale also
        ``.urdf``, ``.xacro``, ``.mjcf``, ``.xml``, ``.launch.xml``, ``.icub.txt``, ``.elc``,
        ``.sfp``. Recordings: ``.csv``, ``.tsv``, ``.npz``. An existing file is replaced after
        writing has succeeded.

    Raises
    ------
    FileError
        If the suffix is unknown or the file cannot be written.
    InputError
        If `data` is neither a map nor a recording, or the format cannot represent it.
    """
    file = Path(path)
    if isinstance(data, SensorMap):
        facts = (data.frame, data.method, data.units, *data.notes, *texts_of(data.provenance))
        check_encodable((*data.names, *data.health, *facts), file)
        write_map = _by_suffix(file, {s: f.write_map for f in FORMATS for s in f.suffixes})
        with atomic_write(file) as temporary:
            write_map(data, temporary)
    elif isinstance(data, Recording):
        facts = (data.source, data.units, *texts_of(data.metadata))
        check_encodable((*data.names, *facts), file)
        write_recording = _by_suffix(
            file, {s: f.write_recording for f in FORMATS for s in f.suffixes}
        )
        with atomic_write(file) as temporary:
            write_recording(data, temporary)
    else:
        raise InputError(f"write needs a SensorMap or a Recording, got {type(data).__name__}")


def write_components(
    sensor_map: SensorMap,
    path: str | os.PathLike[str],
    *,
    inputs: Iterable[str | os.PathLike[str]] = (),
) -> tuple[Path, ...]:
    """Write each connected component of a map to a separate file.

    Parameters
    ----------
    sensor_map : SensorMap
        Sensors without a position are not written.
    path : path-like
        Template of the file names: ``skin.urdf`` gives ``skin-1.urdf``, ``skin-2.urdf``, ..., in
        order of decreasing component size. Existing files are replaced.
    inputs : iterable of path-like
        Files that must not be replaced.

    Returns
    -------
    tuple of pathlib.Path
        The files written.

    Raises
    ------
    FileError, InputError
        As `write`, or if the map has no placed sensor.
    """
    check_writable(path)
    components = sensor_map.split()
    if not components:
        raise InputError("the map has no placed sensor, so there is no component to write")
    template = Path(path)
    suffixes = [s for f in FORMATS for s in f.suffixes if template.name.lower().endswith(s)]
    length = max(map(len, suffixes))
    stem, suffix = template.name[:-length], template.name[-length:]
    files = tuple(template.with_name(f"{stem}-{i + 1}{suffix}") for i in range(len(components)))
    check_distinct(files, inputs)
    with together():
        for component, file in zip(components, files, strict=True):
            write(component, file)
    return files


def check_writable(path: str | os.PathLike[str]) -> None:
    """Check, before a long computation, that a map can be written to a file."""
    file = check_target(path)
    _by_suffix(file, {s: f.write_map for f in FORMATS for s in f.suffixes})


def needs_scale(path: str | os.PathLike[str]) -> bool:
    """Return whether the format of a file stores metres, so that a map needs a scale."""
    return _by_suffix(
        Path(path), {s: f for f in FORMATS if f.write_map for s in f.suffixes}
    ).in_metres


def _by_suffix(file: Path, writers: Mapping[str, Writer | None]) -> Writer:
    # Use the longest match, because .launch.xml also ends in .xml.
    matching = [suffix for suffix in writers if file.name.lower().endswith(suffix)]
    writer = writers[max(matching, key=len)] if matching else None
    if writer is None:
        known = ", ".join(suffix for suffix, able in writers.items() if able)
        problem = f"unknown suffix {file.suffix!r}" if file.suffix else "the name has no suffix"
        raise FileError(f"cannot write {file}: {problem}; known suffixes: {known}")
    return writer
