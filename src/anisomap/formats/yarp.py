"""Recordings that ``yarpdatadumper`` made: ``data.log``, or the folder that holds it.

A line is ``sequence stamp value value ...``, or with two stamps (``--txTime --rxTime``) first the
sender's, then the receiver's; the values may stand in brackets.
"""

from __future__ import annotations

import functools
import itertools
import re
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, FileError
from anisomap.formats.frames import increasing, narrowed
from anisomap.formats.source import opened_text
from anisomap.formats.table import LineError, Table, is_skipped, line_of, read_table
from anisomap.recording import Recording

_FILE = "data.log"
_LINE = re.compile(rb"\s*(\d+)\s+(\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)\s+[-+.(\dni]")
_LOOKED_AT = 3
# Seconds since 1970 of any recording that there is; no reading of a skin is as large.
_EPOCH = 1e8
_SAME_CLOCK_S = 60.0
_BRACKETS = str.maketrans("()", "  ")


def recognises(path: Path, head: bytes) -> bool:
    """Tell a log by its first lines: a rising count, a stamp that does not fall, and values.

    Stamps of a simulator start near zero; a file with such is recognised by its name, too.
    """
    if path.is_dir():
        return (path / _FILE).is_file()
    lines = head.splitlines()
    whole = lines[:-1] or lines  # the last one may be cut
    found = [match for line in whole[:_LOOKED_AT] if (match := _LINE.match(line))]
    if not found or len(found) < len(whole[:_LOOKED_AT]):
        return False
    counts = [float(match[1]) for match in found]
    stamps = [float(match[2]) for match in found]
    rising = all(a < b for a, b in itertools.pairwise(counts))
    return rising and stamps == sorted(stamps) and (stamps[0] >= _EPOCH or path.name == _FILE)


def read_recording(path: Path) -> Recording:
    """Read a recording from a data.log.

    Parameters
    ----------
    path : pathlib.Path
        The file, or the folder that holds it.

    Returns
    -------
    Recording
        Its times are the sender's stamps from 0 on, or the receiver's where the sender's do not
        increase. If the last line was cut off, the frames before it, with a warning.

    Raises
    ------
    FileError
        With line and column of what cannot be read.
    """
    file = path / _FILE if path.is_dir() else path
    form = _table(file)
    values = _frames(form)
    n_stamps = 2 if _has_two_stamps(values) else 1
    if values.shape[1] <= 1 + n_stamps:
        raise FileError(f"{file} holds sequence numbers and stamps, but no values after them")
    return Recording(
        narrowed(values[:, 1 + n_stamps :]),
        times=_times(form, values[:, 1 : 1 + n_stamps]),
        source=f"{path.name}/{_FILE}" if path.is_dir() else path.name,
        metadata={"format": "YARP data.log", "stamps": n_stamps},
    )


def _table(path: Path) -> Table:
    with opened_text(path) as stream:
        numbered = enumerate(stream, start=1)
        number, line = next(((i, text) for i, text in numbered if not is_skipped(text)), (0, ""))
    if not number:
        raise FileError(f"{path} holds no frame")
    width = len(_without_brackets(line).split())
    return Table(path, None, width, f"line {number} has {width}", number, clean=_without_brackets)


def _frames(form: Table) -> NDArray[np.float64]:
    try:
        return read_table(form)
    except LineError as error:
        with opened_text(form.path) as stream:
            broken, *after = itertools.islice(stream, error.line - 1, None)
        if error.line == form.first_line or not all(map(is_skipped, after)):
            raise
        values = read_table(form, before_line=error.line)
        warnings.warn(
            f"{form.path}: the last line ({error.line}) was cut off in field "
            f"{len(broken.split())} of {form.n_columns}; its frame is lost, "
            f"the {len(values)} frames before it are whole",
            AnisomapWarning,
            stacklevel=2,
        )
        return values


def _without_brackets(line: str) -> str:
    """Take brackets away where they match up; a line cut inside them stays unreadable."""
    return line.translate(_BRACKETS) if line.count("(") == line.count(")") else line


def _has_two_stamps(values: NDArray[np.float64]) -> bool:
    if values.shape[1] < 4:
        return False
    first, second = values[:, 1], values[:, 2]
    if (second >= _EPOCH).all():
        return True
    with np.errstate(invalid="ignore"):
        rising = len(values) >= _LOOKED_AT and (np.diff(second) > 0).all()
        return bool(rising and (np.abs(second - first) <= _SAME_CLOCK_S).all())


def _times(form: Table, stamps: NDArray[np.float64]) -> NDArray[np.float64] | None:
    for stamp in stamps.T:
        with np.errstate(invalid="ignore"):
            if (np.diff(stamp) > 0).all() and np.isfinite(stamp).all():
                return np.asarray(stamp - stamp[0])
    return increasing(stamps[:, 0], form.path, functools.partial(line_of, form))
