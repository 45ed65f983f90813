"""EDF, BDF, FIF and BrainVision recordings, which the library mne reads.

The channels of one type are a recording; triggers and annotations are not sensors. Positions are
those that the file holds, in metres.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.base.wording import counted, join_items
from anisomap.errors import FileError, import_extra
from anisomap.files.paths import check_regular, read_small
from anisomap.intake import CHANNELS, good_channels
from anisomap.io.parsing.source import is_gzipped, open_binary, quote, read_head, warn
from anisomap.io.stream import (
    Content,
    ReadOptions,
    Stream,
    choose,
    read_in_blocks,
    to_float32_if_exact,
)

EXTRA = "mne"

_FIF = bytes((0, 0, 0, 100, 0, 0, 0, 31))  # kind and type of the first tag, the id of the file
_BRAINVISION = (b"Brain Vision Data Exchange Header", b"BrainVision Data Exchange Header")
_MARKS = {_FIF: (".fif", "fif"), b"\xffBIOSEMI": (".bdf", "bdf"), b"0       ": (".edf", "edf")}
_MARKS |= dict.fromkeys(_BRAINVISION, (".vhdr", "brainvision"))
MAGICS = tuple(_MARKS)
"""First bytes of the files."""

_NAMED = re.compile(r"^[ \t]*+(?:DataFile|MarkerFile)[ \t]*+=[ \t]*+(.*?)[ \t\r]*$", re.M | re.I)
_FACT = re.compile(
    r"^[ \t]*+(DataFile|BinaryFormat|NumberOfChannels(?==\d{1,6}\b)|DataPoints(?==\d{1,12}\b))"
    r"=[ \t]*+(\S*)",
    re.M | re.I,
)
_VALUE_BYTES = {"INT_16": 2, "UINT_16": 2, "INT_32": 4, "IEEE_FLOAT_32": 4}
_MAX_HEADER = 1 << 20
_EDF_HEADER = 256  # bytes, before those of the signals
_N_LOC = 3  # of the numbers about the place of a channel, the first are its position


def contents(path: Path, options: ReadOptions) -> tuple[Content, ...]:
    """List the types of channels."""
    with _open(path) as raw:
        return _contents(raw)


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open the channels of type `options.select`, or of the only type of sensors."""
    with _open(path) as raw:
        chosen = choose(path, _contents(raw), options.select, "type of channels").name
        picked, left_out = good_channels(raw, chosen)
        if not picked:
            raise FileError(f"{path}: all channels of type {chosen} are marked as bad")
        if left_out:
            warn(path, f"channels marked as bad are left out: {join_items(left_out)}")
        places = np.array([raw.info["chs"][i]["loc"][:_N_LOC] for i in picked])
        known = np.isfinite(places).all(axis=1) & places.any(axis=1)

        def read(start: int, stop: int) -> NDArray[Any]:
            readings = raw.get_data(picks=picked, start=start, stop=stop, verbose="ERROR").T
            return to_float32_if_exact(np.ascontiguousarray(readings))

        yield Stream(
            Path(raw.filenames[0] or path),
            len(picked),
            read_in_blocks(read, int(raw.n_times), 8 * len(picked)),
            names=tuple(raw.ch_names[i] for i in picked),
            rate_hz=float(raw.info["sfreq"]),
            positions=np.where(known[:, None], places, np.nan) if known.any() else None,
            units="m" if known.any() else "",
            source=path.name,
            metadata={"format": "mne", "channels": chosen},
        )


@contextmanager
def _open(path: Path) -> Iterator[Any]:
    """Open a file, by a link with the suffix that mne requires if it has another one."""
    head = read_head(path)
    suffix, kind = next(
        (found for mark, found in _MARKS.items() if head.startswith(mark)), ("", "")
    )
    if not suffix:
        raise FileError(f"{path} is not EDF, BDF, FIF or BrainVision, whatever its suffix")
    io = import_extra("mne.io", "reading EDF, BDF, FIF and BrainVision", EXTRA)
    with tempfile.TemporaryDirectory() as folder:
        named = path
        suffix += ".gz" if is_gzipped(path) else ""
        if not path.name.lower().endswith(suffix):
            named = Path(folder) / f"recording_raw{suffix}"
            named.symlink_to(path.resolve())
        if kind == "brainvision":
            _check_named(path)
        if kind in ("edf", "bdf"):
            _warn_if_cut(path, 3 if kind == "bdf" else 2)
        read = getattr(io, f"read_raw_{kind}")
        with read(os.fspath(named), preload=False, verbose="ERROR") as raw:
            yield raw


def _warn_if_cut(path: Path, n_bytes: int) -> None:
    """Warn if the file is shorter than the records that its header announces."""
    with open_binary(path) as stream:
        head = stream.read(_EDF_HEADER)
        fields = [head[start:stop].strip() for start, stop in ((184, 192), (236, 244), (252, 256))]
        if not all(field.isdigit() for field in fields):  # -1 records are not known
            return
        n_header, n_records, n_signals = map(int, fields)
        # Labels, transducers, units, ranges and filters of all signals come first.
        counts = stream.read(n_signals * 256)[n_signals * 216 : n_signals * 224]
        samples = [counts[8 * i : 8 * i + 8].strip() for i in range(n_signals)]
        if not n_signals or not all(each.isdigit() for each in samples):
            return
        per_record = n_bytes * sum(map(int, samples))
        if is_gzipped(path) or not per_record:
            return
        held = max(0, path.stat().st_size - n_header) // per_record
    if held < n_records:
        announced = counted(n_records, "record")
        warn(path, f"it is cut short: its header announces {announced}, but it has {held}")


def _check_named(path: Path) -> None:
    """Check that the header of a BrainVision recording names regular files beside it only."""
    text = read_small(path, _MAX_HEADER, "a header of BrainVision", encoding="latin-1")
    for name in _NAMED.findall(text):
        file = path.parent / name.replace("$b", path.stem)
        inside = name == "$b" or Path(name.replace("\\", "/")).name == name
        if not inside or (name and file.resolve().parent != path.parent.resolve()):
            raise FileError(f"{path} names the file {quote(name)}; it must be in the same folder")
        if name and file.exists():
            check_regular(file)
    facts = {key.lower(): value for key, value in _FACT.findall(text)}
    sizes = [int(facts.get(key, 0)) for key in ("numberofchannels", "datapoints")]
    frame = sizes[0] * _VALUE_BYTES.get(facts.get("binaryformat", "").upper(), 0)
    data = path.parent / facts.get("datafile", "").replace("$b", path.stem)
    if frame and data.is_file():
        held, rest = divmod(data.stat().st_size, frame)
        if rest or held < sizes[1]:
            warn(path, f"it is cut short: {data.name} ends after {held} samples")


def _contents(raw: Any) -> tuple[Content, ...]:
    counts = Counter(raw.get_channel_types())
    return tuple(
        Content(
            kind,
            f"{counted(count, 'channel')} x {counted(raw.n_times, 'sample')}",
            usable=kind in CHANNELS,
        )
        for kind, count in counts.items()
    )
