"""Spike times in delimited text, one line or one column of times per channel.

For example, with and without names, times in seconds::

    A1,0.012,0.85,2.33          A1,A2
    A2,0.020                    0.012,0.020
    A3,0.015,0.86               0.85,
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from anisomap.errors import FileError
from anisomap.io.events.event_frames import Events, stream_events
from anisomap.io.parsing import delimited
from anisomap.io.parsing.source import read_lines
from anisomap.io.parsing.table import is_number, parse_number
from anisomap.io.stream import Stream

Trains = list[tuple[str, list[float]]]


def stream_table(path: Path, bin_s: float) -> Stream:
    """Create a stream of the counts of spikes whose times are in lines or columns.

    Times increase along each channel and have fractions, so that readings are not taken for times.

    Parameters
    ----------
    path : pathlib.Path
    bin_s : float
        Width of the bins in seconds.

    Returns
    -------
    Stream

    Raises
    ------
    FileError
        If the numbers do not increase along all lines or all columns.
    """
    lines = read_lines(path)
    delimiter = delimited.find_delimiter(lines[:1000])
    try:
        rows = [fields for _, fields in delimited.records(lines, delimiter)]
    except csv.Error as error:
        raise FileError(f"{path}: unbalanced quotation marks ({error})") from error
    trains = _by_line(rows) or _by_column(rows)
    if not trains:
        raise FileError(
            f"{path} (delimited text) holds readings, not events: its numbers do not increase "
            "along all lines or all columns, as the times of spikes do; leave out --bin"
        )
    lengths = [len(times) for _, times in trains]
    return stream_events(
        path,
        Events(
            np.array([time for _, times in trains for time in times], dtype=np.float64),
            np.repeat(np.arange(len(trains)), lengths),
            tuple(name for name, _ in trains),
        ),
        bin_s=bin_s,
        spikes=True,
        metadata={"format": "spike trains"},
    )


def _by_line(rows: Sequence[Sequence[str]]) -> Trains | None:
    """Return one train per line; each begins with a name, or none does."""
    named = [bool(row) and not is_number(row[0], ",") for row in rows]
    if not rows or len(set(named)) > 1 or len(set(map(len, rows))) < 2:
        return None
    start = int(named[0])
    names = (
        [row[0].strip() for row in rows] if start else [f"channel{i + 1}" for i in range(len(rows))]
    )
    return _trains(names, [row[start:] for row in rows])


def _by_column(rows: Sequence[Sequence[str]]) -> Trains | None:
    """Return one train per column; names are in a header, if there is one."""
    if not rows:
        return None
    header = not all(is_number(field, ",") for field in rows[0])
    width = max(map(len, rows))
    names = [field.strip() for field in rows[0]] if header else []
    names += [f"channel{i + 1}" for i in range(len(names), width)]
    body = rows[1:] if header else rows
    return _trains(names, list(itertools.zip_longest(*body, fillvalue="")))


def _trains(names: Sequence[str], columns: Sequence[Sequence[str]]) -> Trains | None:
    trains: Trains = []
    fractions = False
    for name, fields in zip(names, columns, strict=False):
        try:
            times = [parse_number(field) for field in fields]
        except ValueError:
            return None
        known = [time for time in times if not np.isnan(time)]
        # Gaps inside a train are missing readings of a table.
        if any(not np.isnan(time) for time in times[len(known) :]) or known != sorted(known):
            return None
        fractions = fractions or any(time % 1 for time in known)
        trains.append((name, known))
    return trains if fractions and any(times for _, times in trains) else None
