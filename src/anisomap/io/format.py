"""What a format is: how its files are told, and what can be done with them."""

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
    """A kind of file, and what can be done with it.

    Parameters
    ----------
    name : str
        Unique.
    suffixes : tuple of str
        Lower case, with the dot. Writers are chosen by them, readers where content does not tell.
    summary : str
        A line for lists of formats.
    recognises : callable
        Given a path and the first bytes of the file (gunzipped; none of a folder), tells whether
        the content is of this format. It must never raise an error.
    open_recording : callable, optional
        Given a path and `ReadOptions`, a context in which the file is open as a `Stream`.
    read_map : callable, optional
        Given a path, make a `SensorMap` of it.
    write_map, write_recording : callable, optional
        Given a `SensorMap` or a `Recording` and a path, write the one to the other.
    contents : callable, optional
        Given a path and `ReadOptions`, lists what a file holds that can hold several recordings.
    extra : str
        The extra that brings the library it needs; empty if it needs none.
    in_metres : bool
        Whether a map must have a scale to be written.
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
