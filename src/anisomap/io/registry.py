"""What can be read and written: one line a format, and the three calls that choose from them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from anisomap.errors import FileError, InputError
from anisomap.files import atomic_write, check_target
from anisomap.io import npz
from anisomap.io.choice import Content
from anisomap.io.format import Format
from anisomap.io.maps import csv, icub_positions, json, launch, mjcf, pcd, ply, urdf
from anisomap.io.parsing import xml_files
from anisomap.io.parsing.grids import with_grid
from anisomap.io.parsing.source import blaming, head
from anisomap.io.recordings import arrow, hdf5, images, mat, pressure_mats, text, yarp
from anisomap.io.recordings.presets import apply_preset
from anisomap.io.ros import bags, repair
from anisomap.io.stream import (
    BLOCK_FRAMES,
    Block,
    ReadOptions,
    Stream,
    assemble,
    recut,
)
from anisomap.recording import Recording
from anisomap.sensor_map import UNPLACED, SensorMap

Writer = TypeVar("Writer")

# MATLAB comes before HDF5, since its files may be that, too; delimited text stays last, since it
# takes any text that none before it claims.
# fmt: off
FORMATS = (
    Format("npz", (".npz",), "NumPy archive", npz.recognises,
           npz.open_recording, npz.read_map, npz.write_map, npz.write_recording),
    Format("json", (".json",), "JSON", json.recognises,
           read_map=json.read_map, write_map=json.write_map),
    Format("ply", (".ply",), "PLY point cloud (ASCII)", ply.recognises,
           read_map=ply.read_map, write_map=ply.write_map),
    Format("pcd", (".pcd",), "PCD point cloud with normals (ASCII)", pcd.recognises,
           read_map=pcd.read_map, write_map=pcd.write_map),
    Format("urdf", (".urdf", ".xacro"), "URDF: fixed frames and the tactile element",
           urdf.recognises, read_map=urdf.read_map, write_map=urdf.write_map,
           extra=xml_files.EXTRA, in_metres=True),
    Format("mjcf", (".mjcf", ".xml"), "MuJoCo model: sites", mjcf.recognises,
           read_map=mjcf.read_map, write_map=mjcf.write_map, extra=xml_files.EXTRA,
           in_metres=True),
    Format("transforms", (".launch.xml",), "ROS 2 launch file of static transforms",
           launch.recognises, write_map=launch.write_map, in_metres=True),
    Format("icub", (".icub.txt",), "iCub file of taxel positions", icub_positions.recognises,
           read_map=icub_positions.read_map, write_map=icub_positions.write_map,
           in_metres=True),
    Format("yarp", (), "YARP data.log, its folder or session", yarp.recognises, yarp.open_recording,
           contents=yarp.contents),
    Format("mat", (".mat",), "MATLAB (7.3: with the extra)", mat.recognises, mat.open_recording,
           contents=mat.contents, extra=mat.EXTRA),
    Format("hdf5", (".h5", ".hdf5", ".hdf"), "HDF5", hdf5.recognises, hdf5.open_recording,
           contents=hdf5.contents, extra=hdf5.EXTRA),
    Format("parquet", (".parquet", ".arrow", ".feather"), "Parquet, Arrow, Feather",
           arrow.recognises, arrow.open_recording, contents=arrow.contents, extra=arrow.EXTRA),
    Format("ros", (".bag", ".mcap", ".db3"), "ROS 1 and 2 bags, MCAP", bags.recognises,
           bags.open_recording, contents=bags.contents, extra=repair.EXTRA),
    Format("mat-export", (".asf",), "export of a pressure mat, a block of rows a frame",
           pressure_mats.recognises, pressure_mats.open_recording),
    Format("images", (".gif", ".tif", ".tiff"), "folder of images; TIFF or GIF of several pages",
           images.recognises, images.open_recording, extra=images.EXTRA),
    Format("text", (".csv", ".tsv", ".txt", ".dat", ".log"), "delimited text, also gzipped",
           text.recognises,
           text.open_recording, csv.read_map, csv.write_map, text.write_recording),
)
# fmt: on
"""Every format; where several recognise a file, the first has it."""


def read(
    path: str | os.PathLike[str],
    *,
    options: ReadOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> Recording:
    """Read a recording.

    Parameters
    ----------
    path : path-like
        A file or folder of any format in `FORMATS` that holds recordings; text may be gzipped.
        The format is told by the content, and by the suffix where the content does not tell.
    options : ReadOptions, optional
        What the reader cannot find out by itself.
    progress : callable, optional
        Called now and then with the share of the file that has been read, from 0 to 1.

    Returns
    -------
    Recording
        Reading takes hardly more memory than this itself.

    Raises
    ------
    FileError
        If there is no such file, or it is damaged, or holds no recording.
    MissingExtraError
        If the format needs a library that is not installed.

    Warns
    -----
    AnisomapWarning
        If the end of the file is damaged: what was whole is read.
    """
    how = options or ReadOptions()
    with _opened(Path(path), how) as stream, blaming(stream.path):
        return apply_preset(with_grid(assemble(stream, progress), how.grid), how.preset)


@contextmanager
def open_stream(
    path: str | os.PathLike[str],
    *,
    frames: int = BLOCK_FRAMES,
    options: ReadOptions | None = None,
) -> Iterator[Stream]:
    """Open a recording to take it block by block, without ever holding the whole.

    Parameters
    ----------
    path : path-like
        As for `read`.
    frames : int
        Frames in every block but the last, at least 1.
    options : ReadOptions, optional
        What the reader cannot find out by itself; a preset and a grid are for `read`.

    Yields
    ------
    Stream
        Its `blocks` can be gone through once, and only within the context.

    Raises
    ------
    FileError
        If there is no such file, or it is damaged, or holds no recording.
    InputError
        If `frames` is less than 1.
    MissingExtraError
        If the format needs a library that is not installed.
    """
    if frames < 1:
        raise InputError(f"blocks of {frames} frames hold nothing; use 1 or more")
    with _opened(Path(path), options or ReadOptions()) as stream:
        yield replace(stream, blocks=recut(stream.blocks, frames))


def contents(
    path: str | os.PathLike[str], *, options: ReadOptions | None = None
) -> tuple[Content, ...]:
    """List what a file holds that can hold several recordings: topics, datasets, ports.

    Parameters
    ----------
    path : path-like
    options : ReadOptions, optional

    Returns
    -------
    tuple of Content
        Empty where a file is one recording.

    Raises
    ------
    FileError
        If there is no such file, or it is damaged.
    MissingExtraError
        If the format needs a library that is not installed.
    """
    file = Path(path)
    with blaming(file):
        chosen = _recognise(file)
        return chosen.contents(file, options or ReadOptions()) if chosen.contents else ()


def read_map(path: str | os.PathLike[str]) -> SensorMap:
    """Read a map, or the true positions of sensors.

    Parameters
    ----------
    path : path-like
        A map that `write` made; a text file of positions, with names or without; or an NPZ
        recording that has positions.

    Returns
    -------
    SensorMap
        Its units are empty where the file does not tell them.

    Raises
    ------
    FileError
        If there is no such file, or it is damaged, or holds no positions.
    """
    file = Path(path)
    with blaming(file):
        chosen = _recognise(file)
        if chosen.read_map is None:
            raise FileError(
                f"{file} is of the format {chosen.summary}, which holds no positions; "
                f"positions are read from {_summaries(f for f in FORMATS if f.read_map)}"
            )
        found = chosen.read_map(file)
        if found.component.min() < UNPLACED or found.component.max() >= found.n_sensors:
            raise FileError(f"{file}: components must count from 0, or be -1 for no position")
        return found


def write(thing: SensorMap | Recording, path: str | os.PathLike[str]) -> None:
    """Write a map or a recording; the suffix says in which format.

    Parameters
    ----------
    thing : SensorMap or Recording
        What to write.
    path : path-like
        ``.csv``, ``.tsv``, ``.npz``, ``.json``, ``.ply``, ``.pcd``, and for maps with a scale
        ``.urdf``, ``.xacro``, ``.mjcf``, ``.xml``, ``.launch.xml``, ``.icub.txt``; ``.csv``,
        ``.tsv``, ``.npz`` for recordings. A file that stands there is replaced, but only once all
        is written.

    Raises
    ------
    FileError
        If the suffix is unknown or the file cannot be written.
    InputError
        If `thing` is neither a map nor a recording.
    """
    file = Path(path)
    if isinstance(thing, SensorMap):
        _check_encodable((*thing.names, *thing.health), file)
        write_map = _by_suffix(file, {s: f.write_map for f in FORMATS for s in f.suffixes})
        with atomic_write(file) as aside:
            write_map(thing, aside)
    elif isinstance(thing, Recording):
        _check_encodable(thing.names, file)
        write_recording = _by_suffix(
            file, {s: f.write_recording for f in FORMATS for s in f.suffixes}
        )
        with atomic_write(file) as aside:
            write_recording(thing, aside)
    else:
        raise InputError(f"a {type(thing).__name__} cannot be written; give a map or a recording")


def check_writable(path: str | os.PathLike[str]) -> None:
    """Find out before the work whether a map could be written to a file.

    Parameters
    ----------
    path : path-like
        As for `write`.

    Raises
    ------
    FileError
        If no map can be written with this suffix, or there is no such folder.
    """
    file = check_target(path)
    _by_suffix(file, {s: f.write_map for f in FORMATS for s in f.suffixes})


def needs_scale(path: str | os.PathLike[str]) -> bool:
    """Tell whether a map must have a scale to be written to a file: if that is in metres.

    Parameters
    ----------
    path : path-like
        As for `write`.
    """
    return _by_suffix(
        Path(path), {s: f for f in FORMATS if f.write_map for s in f.suffixes}
    ).in_metres


@contextmanager
def _opened(file: Path, options: ReadOptions) -> Iterator[Stream]:
    with ExitStack() as stack:
        with blaming(file):
            chosen = _recognise(file)
            if chosen.open_recording is None:
                raise FileError(
                    f"{file} is of the format {chosen.summary}, which holds no recordings; "
                    f"recordings are read from {_summaries(f for f in FORMATS if f.open_recording)}"
                )
            stream = stack.enter_context(chosen.open_recording(file, options))
        yield replace(stream, blocks=_blamed(stream.blocks, file))


def _blamed(blocks: Iterator[Block], file: Path) -> Iterator[Block]:
    """Give blocks on; what goes wrong in reading them, and only that, is blamed on the file."""
    with blaming(file):
        yield from blocks


def _recognise(file: Path) -> Format:
    start = head(file)
    *marked, text_format = FORMATS
    suffixes = [s.lower() for s in file.suffixes if s.lower() != ".gz"]
    for chosen in marked:
        if chosen.recognises(file, start):
            return chosen
    if file.is_dir():
        raise FileError(
            f"{file} is a folder of no known kind: it holds no data.log, no bag and no images; "
            "give a file"
        )
    for chosen in FORMATS:
        if suffixes and suffixes[-1] in chosen.suffixes:
            return chosen
    if text_format.recognises(file, start):
        return text_format
    raise FileError(f"{file} is of no known kind; known are {_summaries(FORMATS)}")


def _summaries(formats: Iterable[Format]) -> str:
    return "; ".join(
        f"{f.summary} ({', '.join(f.suffixes)})" if f.suffixes else f.summary for f in formats
    )


def _by_suffix(file: Path, writers: Mapping[str, Writer | None]) -> Writer:
    # The longest that fits: .launch.xml is not .xml.
    fitting = [suffix for suffix in writers if file.name.lower().endswith(suffix)]
    writer = writers[max(fitting, key=len)] if fitting else None
    if writer is None:
        known = ", ".join(suffix for suffix, able in writers.items() if able)
        problem = f"the suffix {file.suffix!r} is unknown" if file.suffix else "it has no suffix"
        raise FileError(f"cannot write {file}: {problem}; known are {known}")
    return writer


def _check_encodable(words: Iterable[str], file: Path) -> None:
    """Refuse text that UTF-8 or numpy cannot hold, before anything is written."""
    for word in words:
        if "\0" in word or any("\ud800" <= character <= "\udfff" for character in word):
            raise FileError(f"cannot write {file}: {word!r} holds a character that is no text")
