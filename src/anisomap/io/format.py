"""Description of a file format: how it is recognised, and its readers and writers."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from anisomap.io.choice import Content
from anisomap.io.stream import ReadOptions, Stream
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap


@dataclass(frozen=True)
class Format:
    """A file format with its readers and writers.

    Readers raise FileError for damaged files and files without the requested content, and
    MissingExtraError if a required library is not installed. Writers raise InputError for things
    that the format cannot represent.

    Parameters
    ----------
    name : str
        Unique identifier.
    suffixes : tuple of str
        In lower case, with the dot. They select the writer, and the reader of files that no
        format recognises by content.
    summary : str
        One-line description for listings.
    recognises : callable
        ``recognises(path, head)`` returns whether the content is of this format. `head` holds the
        first bytes of the file, decompressed, and is empty for a folder. It must not raise.
    open_recording : callable, optional
        ``open_recording(path, options)`` is a context manager that yields a `Stream`.
    read_map : callable, optional
        ``read_map(path)`` returns a `SensorMap`.
    write_map, write_recording : callable, optional
        ``write_map(sensor_map, path)`` and ``write_recording(recording, path)``. Equal input
        gives equal bytes.
    contents : callable, optional
        ``contents(path, options)`` lists the possible recordings in a file.
    extra : str
        Extra that installs the required library; empty if none is required.
    in_metres : bool
        Whether the format stores metres, so that a map needs a scale.
    signature : bytes
        First bytes of the files that anisomap writes, if no other format's files start with them.
        They decide before `recognises`, since names and notes may contain the marks of others.
    """

    name: str
    suffixes: tuple[str, ...]
    summary: str
    recognises: Callable[[Path, bytes], bool]
    open_recording: Callable[[Path, ReadOptions], AbstractContextManager[Stream]] | None = None
    read_map: Callable[[Path], SensorMap] | None = None
    write_map: Callable[[SensorMap, Path], None] | None = None
    write_recording: Callable[[Recording, Path], None] | None = None
    contents: Callable[[Path, ReadOptions], tuple[Content, ...]] | None = None
    extra: str = ""
    in_metres: bool = False
    signature: bytes = b""
