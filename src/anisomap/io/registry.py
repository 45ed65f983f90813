"""The registry of formats, and the functions that read and write files with it."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from anisomap.base.wording import as_text, join_items
from anisomap.errors import FileError, InputError
from anisomap.files.budget import SENSOR_BYTES, Budget, bytes_kept
from anisomap.files.paths import atomic_write, check_target
from anisomap.io import npz
from anisomap.io.columns import sensors_of
from anisomap.io.maps import point_files, robot_models, skin_displays, text_files
from anisomap.io.maps.edits import LineEdit, edited
from anisomap.io.parsing.facts import check_encodable, texts_of
from anisomap.io.parsing.names import distinct_names, match_names, natural_key
from anisomap.io.parsing.refusals import refuse_foreign, remedy_of
from anisomap.io.parsing.source import file_errors, read_head, said_here, warn
from anisomap.io.presets import apply_preset, in_grid, with_grid
from anisomap.io.recordings import bags, delimited_text, grids, named_arrays, robot_logs
from anisomap.io.stream import (
    BLOCK_FRAMES,
    Block,
    Content,
    ReadOptions,
    Stream,
    assemble,
    contents_isolated,
    open_isolated,
    rechunk,
    refuse_selection,
)
from anisomap.names import default_names
from anisomap.recording import Recording, join_runs
from anisomap.sensor_map import UNPLACED, SensorMap


@dataclass(frozen=True)
class Format:
    """A file format with its readers and writers, which raise as `read` and `write` do.

    suffixes: Suffixes select the writer, and the reader if no format recognises the content.
    recognises: ``recognises(path, head)`` returns whether a file that begins with none of `magics`
        is of this format, by its first bytes, decompressed; none for a folder. It must not raise.
    edit_map: Returns the lines of a file that change if places of sensors change.
    contents: Lists the possible recordings in a file.
    extra: Extra that installs the library for recordings, which is used in another process.
    in_metres: Whether the format stores metres, so that a map requires a scale.
    signature: First bytes of files by anisomap. They take precedence over `recognises`, since names
        and notes may contain marks of other formats.
    """

    name: str
    suffixes: tuple[str, ...]
    summary: str
    recognises: Callable[[Path, bytes], bool] | None = None
    open_recording: Callable[[Path, ReadOptions], AbstractContextManager[Stream]] | None = None
    read_map: Callable[[Path], SensorMap] | None = None
    write_map: Callable[[SensorMap, Path], None] | None = None
    write_recording: Callable[[Recording, Path], None] | None = None
    contents: Callable[[Path, ReadOptions], tuple[Content, ...]] | None = None
    extra: str = ""
    in_metres: bool = False
    signature: bytes = b""
    magics: tuple[bytes, ...] = ()
    edit_map: Callable[[Path, SensorMap, SensorMap], list[LineEdit] | None] | None = None

    def matches(self, path: Path, head: bytes) -> bool:
        """Return whether a file is of this format, by its first bytes."""
        return head.startswith(self.magics) or bool(self.recognises and self.recognises(path, head))


_MAX_LISTED = 3
_MIN_FRAMES, _MAX_ROWS = 4, 64  # number of files that may be single frames, and rows of a frame

# MATLAB comes before HDF5, because version 7.3 files are HDF5. Delimited text is last, because it
# accepts any text.
# fmt: off
FORMATS = (
    Format("npz", (".npz",), "NumPy archive", None,
           npz.open_recording, npz.read_map, npz.write_map, npz.write_recording,
           magics=npz.MAGICS),
    Format("npy", (".npy",), "NumPy array, frames x sensors", None, npz.open_array,
           magics=(npz.ARRAY_MAGIC,)),
    Format("cyskin-calibration", (), "CySkin calibration (JSON)", text_files.is_calibration,
           read_map=text_files.read_calibration),
    Format("json-lines", (".jsonl",), "one JSON object per frame", delimited_text.is_json_lines,
           delimited_text.open_recording),
    Format("json", (".json",), "JSON", text_files.is_json,
           read_map=text_files.read_json_map, write_map=text_files.write_json,
           signature=text_files.SIGNATURE),
    Format("ply", (".ply",), "PLY point cloud (ASCII)", point_files.is_ply,
           read_map=point_files.read_ply, write_map=point_files.write_ply),
    Format("urdf", (".urdf", ".xacro"), "URDF: fixed frames and the tactile element",
           robot_models.has_root("robot"), read_map=robot_models.read_urdf,
           write_map=robot_models.write_urdf, extra=robot_models.EXTRA, in_metres=True),
    Format("mjcf", (".mjcf", ".xml"), "MuJoCo model: sites", robot_models.has_root("mujoco"),
           read_map=robot_models.read_mjcf, write_map=robot_models.write_mjcf,
           extra=robot_models.EXTRA, in_metres=True),
    Format("icub", (".icub.txt",), "iCub file of taxel positions", point_files.is_icub,
           read_map=point_files.read_icub, write_map=point_files.write_icub,
           edit_map=point_files.edit_icub, in_metres=True),
    Format("icub-display", (".ini",), "iCub display of a skin: flat triangles (skinGui)",
           skin_displays.is_display, read_map=skin_displays.read_display,
           write_map=skin_displays.write_display, edit_map=skin_displays.edit_display,
           in_metres=True),
    Format("yarp", (), "YARP data.log, its folder or session", robot_logs.is_yarp,
           robot_logs.open_yarp, contents=robot_logs.contents),
    Format("cyskin", (), "CySkin recording (text)", robot_logs.is_cyskin,
           robot_logs.open_cyskin),
    Format("mat", (".mat",), "MATLAB; the extra is for 7.3", None, named_arrays.open_recording,
           contents=named_arrays.contents, extra=named_arrays.MAT_EXTRA,
           magics=named_arrays.MAT_MAGICS),
    Format("hdf5", (".h5", ".hdf5", ".hdf"), "HDF5", named_arrays.is_hdf5,
           named_arrays.open_recording, contents=named_arrays.contents,
           extra=named_arrays.HDF5_EXTRA),
    Format("ros", (".bag", ".mcap", ".db3"), "ROS 1 and 2 bags, MCAP", bags.recognises,
           bags.open_recording, contents=bags.contents, extra=bags.EXTRA,
           magics=tuple(bags.MAGICS)),
    Format("mat-export", (".asf",), "pressure mat export: one block of rows per frame",
           grids.is_mat_export, grids.open_mat_export),
    Format("text", (".csv", ".tsv", ".txt", ".dat", ".log"), "delimited text, also gzipped",
           delimited_text.recognises,
           delimited_text.open_recording, text_files.read_text, text_files.write_text,
           delimited_text.write_recording,
           edit_map=text_files.edit_text,
           signature=delimited_text.SIGNATURE),
)
# fmt: on
"""All formats; the first one that recognises a file reads it."""


def read(
    path: str | os.PathLike[str],
    *,
    options: ReadOptions | None = None,
    max_readings: float = math.inf,
    progress: Callable[[float], None] | None = None,
) -> Recording:
    """Read a recording.

    Parameters
    ----------
    path : path-like
        A file or folder of any recording format in `FORMATS`; text may be gzipped. The format is
        determined by content, and by suffix if the content is ambiguous.
    options : ReadOptions, optional
        Information that the file lacks.
    max_readings : float
        Maximum number of readings (frames times sensors) to keep. Of a longer recording, every k-th
        frame is kept, where k is the least power of 2 that suffices; other frames take no memory.
    progress : callable, optional
        Called repeatedly with the fraction of the file read so far, from 0 to 1.

    Returns
    -------
    Recording
        Reading takes little more memory than its arrays. If frames were left out, its metadata
        contain k as ``frames_sampled_every``.

    Raises
    ------
    FileError
        If the file is missing or damaged, or does not contain a recording.
    InputError
        If the preset is unknown, or the preset or grid does not fit the recording.
    MissingExtraError
        If the format needs a library that is not installed.

    Warns
    -----
    AnisomapWarning
        If the end of the file is damaged; the frames before the damage are returned.
    """
    options = options or ReadOptions()
    files = files_of(path)
    if files != (Path(path),):
        with _said_once():
            runs = [read(file, options=options, max_readings=max_readings) for file in files]
        check_no_frames(files, runs, options)
        return replace(join_runs(runs), source=as_text(Path(path).name))
    with _open(Path(path), options) as stream, file_errors(stream.path):
        recording = assemble(stream, progress, max_readings)
        found = apply_preset(with_grid(recording, options.grid), options.preset)
        # A preset renames the sensors, so positions are attached after it.
        return attach_positions(found, options.positions) if options.preset else found


@contextmanager
def _said_once() -> Iterator[None]:
    """Issue equal warnings about several files once, for the first file."""
    with said_here() as caught:
        yield
    said: dict[tuple[str, str], list[str]] = {}
    for file, text, remedy in caught:
        said.setdefault((text, remedy), []).append(file)
    for (text, remedy), files in said.items():
        others = f" (also of other files: {len(files) - 1})" if len(files) > 1 else ""
        warn(files[0], f"{text}{others}", remedy)


@contextmanager
def open_stream(
    path: str | os.PathLike[str], *, frames: int = BLOCK_FRAMES, options: ReadOptions | None = None
) -> Iterator[Stream]:
    """Open a recording in blocks of `frames` frames; the last block may have fewer."""
    with _open(Path(path), options or ReadOptions()) as stream:
        yield replace(stream, blocks=rechunk(stream.blocks, frames))


def contents(
    path: str | os.PathLike[str], *, options: ReadOptions | None = None
) -> tuple[Content, ...]:
    """List the datasets, topics or ports in a file.

    Parameters
    ----------
    path : path-like
        As for `read`.
    options : ReadOptions, optional
        As for `read`; only `definitions` is used.

    Returns
    -------
    tuple of Content
        Empty for formats that hold a single recording, and for folders of recordings.

    Raises
    ------
    FileError
        If the file is missing or damaged.
    MissingExtraError
        If the format needs a library that is not installed.
    """
    if files_of(path) != (file := Path(path),):
        return ()
    with file_errors(file):
        chosen = _recognise(file)
        if chosen.contents is None:
            return ()
        listed = partial(contents_isolated, chosen.contents) if chosen.extra else chosen.contents
        return listed(file, options or ReadOptions())


def read_map(path: str | os.PathLike[str]) -> SensorMap:
    """Read a map, or true sensor positions.

    Parameters
    ----------
    path : path-like
        A map written by `write`; a text file of positions, with or without names; or an NPZ
        recording with positions.

    Returns
    -------
    SensorMap
        The units are empty if the file does not contain them.

    Raises
    ------
    FileError
        If the file is missing or damaged, or does not contain positions.
    MissingExtraError
        If the format needs a library that is not installed.
    """
    file = Path(path)
    with file_errors(file):
        _, read_it = _find_reader(file, "read_map", "positions")
        found: SensorMap = read_it(file)
        if found.component.min() < UNPLACED or found.component.max() >= found.n_sensors:
            raise FileError(f"{file}: components must be numbered from 0, with -1 for unplaced")
        return found


def check_no_frames(files: Sequence[Path], runs: Sequence[Recording], options: ReadOptions) -> None:
    """Refuse many files of small tables without names: each may be a frame or a run."""
    shapes = {run.readings.shape for run in runs}
    unnamed = all(run.names == default_names(run.n_sensors) for run in runs)
    if len(runs) < _MIN_FRAMES or len(shapes) != 1 or not unnamed or options.grid:
        return
    rows, columns = shapes.pop()
    if 1 < rows <= max(2 * columns, _MAX_ROWS) and columns > 1:
        size = f"tables of {rows} x {columns} without names"
        remedy = f"give --grid {rows}x{columns} if each is a frame, or name the columns of runs"
        raise FileError(f"{files[0]} and {len(runs) - 1} others are {size}: {remedy}")


def attach_positions(recording: Recording, positions: Path | None) -> Recording:
    """Add true positions in a file to a recording.

    Parameters
    ----------
    recording : Recording
    positions : pathlib.Path or None
        As `ReadOptions.positions`; None returns the recording unchanged.

    Returns
    -------
    Recording
        Positions are NaN for sensors that the file lacks.

    Raises
    ------
    FileError
        If the file does not contain positions of sensors of the recording.
    """
    if positions is None:
        return recording
    return replace(recording, **_places(recording.names, recording.source, positions))


def _places(names: Sequence[str], path: object, file: Path) -> dict[str, Any]:
    """Return positions in a map for the names of a recording, NaN if missing, and units."""
    truth = read_map(file)
    rows = match_names(names, truth.names)
    if all(row is None or not truth.placed[row] for row in rows):
        both = f"it names {truth.names[0]} ..., and the recording {names[0]} ..."
        raise FileError(f"{file} has no position for any sensor of {path}: {both}")
    unknown = np.full(truth.dimensions, np.nan)
    places = np.array([unknown if row is None else truth.positions[row] for row in rows])
    return {"positions": places, "units": truth.units}


@contextmanager
def _open(file: Path, options: ReadOptions) -> Iterator[Stream]:
    with ExitStack() as stack:
        with file_errors(file):
            chosen, opened = _find_reader(file, "open_recording", "recordings")
            described = f"{file} ({chosen.summary})"
            if chosen.contents is None:
                refuse_selection(described, options.select)
            if chosen.extra:
                opened = partial(open_isolated, opened)
            stream = stack.enter_context(opened(file, options))
            budget = Budget(stream.path)  # of several files, the one with the readings
            budget.spend(SENSOR_BYTES * stream.n_sensors, "its list of sensors")
            stream = replace(stream, names=distinct_names(file, stream.names))
            stream = in_grid(sensors_of(stream, options), options.grid)
            if options.positions is not None and not options.preset:
                names = stream.names or default_names(stream.n_sensors)
                stream = replace(stream, **_places(names, stream.path, options.positions))

        def blocks() -> Iterator[Block]:
            with file_errors(file):  # not those of the caller's loop body
                for block in stream.blocks:
                    readings = block.readings
                    budget.spend(
                        readings.size * bytes_kept(readings.dtype), "its table of readings"
                    )
                    yield block

        yield replace(stream, source=as_text(stream.source), blocks=blocks())


def _find_reader(file: Path, kind: str, what: str) -> tuple[Format, Callable[..., Any]]:
    """Return the format of a file, and the function that reads the requested contents."""
    chosen = _recognise(file)
    reader = getattr(chosen, kind)
    if reader is None:
        able = [", ".join(f.suffixes) or f.summary for f in FORMATS if getattr(f, kind)]
        if chosen.name == "json" and what == "recordings":
            able = ["lines with an object or a list per frame (.jsonl)", ".csv", ".npz"]
            able.append("for events, anisomap.Recording.from_events(times, sensors)")
        said = f"holds no {what}; formats with {what}: {'; '.join(able)}"
        raise FileError(f"{file} ({chosen.summary}) {said}")
    return chosen, reader


def _recognise(file: Path) -> Format:
    start = read_head(file)
    *marked, text_format = FORMATS
    suffix = next((s.lower() for s in reversed(file.suffixes) if s.lower() != ".gz"), None)
    refuse_foreign(file, suffix or "", start)
    own = (f for f in FORMATS if f.signature and start.startswith(f.signature))
    by_content = (f for f in marked if f.matches(file, start))
    if chosen := next(itertools.chain(own, by_content), None):
        return chosen
    if file.is_dir():
        names = join_items([path.name for path in files_of(file)], _MAX_LISTED)
        raise FileError(f"{file} is a folder of runs, or with --grid of frames: {names}")
    by_suffix = (f for f in FORMATS if suffix in f.suffixes)
    if chosen := next(by_suffix, text_format if text_format.matches(file, start) else None):
        return chosen
    raise FileError(f"{file} has an unknown format; 'anisomap list formats' lists the known ones")


def files_of(path: str | os.PathLike[str]) -> tuple[Path, ...]:
    """List the recordings in a folder in numeric order, unless the folder itself is a recording.

    The path itself is returned if it is a file, or a folder with a single recording.
    """
    if not isinstance(path, str | os.PathLike):
        raise InputError(
            f"the path of a file is required here, got a {type(path).__name__}",
            "anisomap.Recording takes arrays, and objects of pandas, xarray and mne",
        )
    folder = Path(path)
    if not folder.is_dir() or any(f.matches(folder, b"") for f in FORMATS):
        return (folder,)
    known = tuple(suffix for f in FORMATS if f.open_recording for suffix in f.suffixes)
    with file_errors(folder):
        paths = sorted(folder.iterdir(), key=lambda each: natural_key(each.name))
    files = [each for each in paths if each.name.lower().removesuffix(".gz").endswith(known)]
    if not files:
        for each in paths:
            refuse_foreign(each, each.suffix.lower())
        raise FileError(f"{folder} is a folder without a data.log, bag or table; give a file")
    return tuple(files)


def write(data: SensorMap | Recording, path: str | os.PathLike[str]) -> None:
    """Write a map or a recording in the format of the suffix.

    Parameters
    ----------
    data : SensorMap or Recording
    path : path-like
        Maps: ``.csv``, ``.tsv``, ``.npz``, ``.json``, ``.ply``; with a scale also ``.urdf``,
        ``.xacro``, ``.mjcf``, ``.xml``, ``.icub.txt``. Recordings: ``.npz``,
        ``.csv``, ``.tsv``, ``.txt``. An existing file is replaced only after successful writing.

    Raises
    ------
    FileError
        If the suffix is unknown or the file cannot be written.
    InputError
        If `data` is neither a map nor a recording, or the format cannot represent it.
    """
    file = Path(path)
    facts: tuple[str, ...]
    if isinstance(data, SensorMap):
        writer = "write_map"
        facts = (data.frame, data.method, *data.health, *data.notes, *texts_of(data.provenance))
    elif isinstance(data, Recording):
        writer, facts = "write_recording", (data.source, *texts_of(data.metadata))
    else:
        raise InputError(f"write needs a SensorMap or a Recording, got {type(data).__name__}")
    check_encodable((*data.names, data.units, *facts), file)
    write_data = getattr(_format_of(file, writer), writer)
    with atomic_write(file) as temporary:
        write_data(data, temporary)


def check_writable(path: str | os.PathLike[str], *, recording: bool = False) -> None:
    """Check, before a long computation, that a map or a recording can be written to a file."""
    _format_of(check_target(path), "write_recording" if recording else "write_map")


def corrections(
    path: str | os.PathLike[str], stated: SensorMap, corrected: SensorMap
) -> list[LineEdit] | None:
    """Return the lines of a file of positions that a correction changes.

    Parameters
    ----------
    path : path-like
        A file of a format with lines of numbers: delimited text, taxel positions of an iCub, or the
        display of its skin.
    stated, corrected : SensorMap
        The map in this file, and a map with other positions.

    Returns
    -------
    list of LineEdit or None
        None for files of other formats.

    Raises
    ------
    InputError
        If the format cannot represent the positions.
    """
    file = Path(path)
    kind = _recognise(file)
    if kind.edit_map is None or file.suffix.lower() == ".gz" or file.is_dir():
        return None
    return kind.edit_map(file, stated, corrected)


def write_corrected(
    source: str | os.PathLike[str],
    stated: SensorMap,
    corrected: SensorMap,
    path: str | os.PathLike[str],
) -> None:
    """Write a corrected layout; in the format of the source, only incorrect lines change.

    Parameters
    ----------
    source : path-like
        The file of the stated layout.
    stated, corrected : SensorMap
    path : path-like
        With the suffix of the source, lines that are not in `corrections` are equal in each byte;
        otherwise, see `write`.

    Raises
    ------
    FileError, InputError
        See `write`.
    """
    file = Path(path)
    own = file.suffix.lower() == Path(source).suffix.lower()
    edits = corrections(source, stated, corrected) if own else None
    if edits is None:
        write(corrected, file)
        return
    changed = edited(Path(source), edits)
    with atomic_write(file) as partial_file:
        partial_file.write_bytes(changed)


def needs_scale(path: str | os.PathLike[str]) -> bool:
    """Return whether the format of a file stores metres, so that a map requires a scale."""
    return _format_of(Path(path)).in_metres


def _format_of(file: Path, writer: str = "write_map") -> Format:
    """Return the format for writing a file."""
    able = {s: f for f in FORMATS if getattr(f, writer) for s in f.suffixes}
    matching = [suffix for suffix in able if file.name.lower().endswith(suffix)]
    remedy = remedy_of(file.name.lower())
    if remedy or not matching:
        problem = f"unknown suffix {file.suffix!r}" if file.suffix else "the name has no suffix"
        known = remedy or f"known suffixes: {', '.join(able)}"
        raise FileError(f"cannot write {file}: {problem}; {known}")
    # Use the longest match, because .icub.txt also ends in .txt.
    return able[max(matching, key=len)]
