"""Contacts of the iCub: a log of the port ``skin_events`` of its skin manager.

A line is ``sequence stamp contact contact ...``, without contacts if nothing touches the skin. A
contact is a list, in brackets, of: a list of its number, body part, link and skin part; centre of
pressure, force, moment, geometric centre and normal, of three numbers each; the list of the active
taxels; and the mean pressure. Later versions append a list of the names of link and frame.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from anisomap.errors import AnisomapWarning
from anisomap.io.choice import Content
from anisomap.io.events.event_frames import EventList, Events, stream_events
from anisomap.io.parsing.libraries import error_reason
from anisomap.io.parsing.source import GZIP_ERRORS, open_text, quote
from anisomap.io.parsing.table import LineError, Lines, is_skipped
from anisomap.io.stream import Stream

PARTS = (
    "unknown",
    *("l_hand", "l_forearm", "l_upper_arm", "r_hand", "r_forearm", "r_upper_arm", "chest"),
    *("l_upper_leg", "l_lower_leg", "l_foot", "r_upper_leg", "r_lower_leg", "r_foot"),
)
"""Names of skin parts by number, as the library of the robot defines them."""

_STAMPS = re.compile(r"\s*+(\d++)((?:\s++\d[\d.eE+-]*+){1,2})\s*+")
_START = re.compile(r"\s*+\d++(?:\s++\d[\d.eE+-]*+){1,2}\s*+\(\(")
_INTEGERS = re.compile(r"(?:\s*+[0-9]{1,9}(?![0-9]))*+\s*+")
_STAMPED_ONLY = re.compile(r"[\d.eE+\-\s]*+(?:\(\s*+\)\s*+)?")
_MAX_STAMPED = 3
_FIELDS, _WITH_NAMES = 8, 9
_TAXELS_AT, _PART_AT = 6, 3


@dataclass(frozen=True)
class _Frame:
    """The stamps of a line, and its active taxels by skin part."""

    stamps: tuple[float, ...]
    taxels: tuple[tuple[str, tuple[int, ...]], ...]


def is_contact_log(path: Path) -> bool:
    """Return whether the first line of a log with any value holds contacts."""
    try:
        with open_text(path) as stream:
            for line in stream:
                if is_skipped(line) or _has_no_value(line):
                    continue
                return bool(_START.match(line))
    except GZIP_ERRORS:
        pass
    return False


def _has_no_value(line: str) -> bool:
    """Return whether a line holds at most a sequence number, two stamps and an empty list."""
    n_numbers = len(line.partition("(")[0].split())
    return bool(_STAMPED_ONLY.fullmatch(line)) and n_numbers <= _MAX_STAMPED


def contents_of_log(path: Path) -> tuple[Content, ...]:
    """List the skin parts that were touched."""
    counts: dict[str, set[int]] = {}
    for frame in _frames(path):
        for part, taxels in frame.taxels:
            counts.setdefault(part, set()).update(taxels)
    return tuple(
        Content(part, f"contacts of {len(taxels)} taxels") for part, taxels in counts.items()
    )


def stream_contacts(path: Path, parts: Sequence[str], bin_s: float | None) -> Stream:
    """Create a stream of the contacts of some skin parts.

    Parameters
    ----------
    path : pathlib.Path
    parts : sequence of str
        Taxels are named ``taxel17`` in a single part, and ``l_hand/taxel17`` in several.
    bin_s : float or None
        Width of bins; by default, each line is a frame.

    Returns
    -------
    Stream
        A reading is 1 where a contact lists the taxel.
    """
    found = EventList[tuple[str, int]](path)
    wanted = set(parts)
    for frame in _frames(path):
        active = [
            (part, taxel) for part, taxels in frame.taxels if part in wanted for taxel in taxels
        ]
        # A line without contact is a frame too.
        found.add(frame.stamps[0], active, frame.stamps[-1])
    order = {part: i for i, part in enumerate(parts)}
    sensors = sorted(found.sensors, key=lambda s: (order[s[0]], s[1]))
    index = {sensor: i for i, sensor in enumerate(sensors)}
    one = len(parts) == 1
    sent, received = np.array(found.moments), np.array(found.values)
    events = Events(
        sent if (np.diff(sent) >= 0).all() else received,
        found.indices(index),
        tuple(f"taxel{taxel}" if one else f"{part}/taxel{taxel}" for part, taxel in sensors),
    )
    metadata = {"format": "YARP skin_events", "skin_parts": ", ".join(parts)}
    return stream_events(path, events, bin_s=bin_s, contacts=True, metadata=metadata)


def _frames(path: Path) -> Iterator[_Frame]:
    """Yield the frames of a log, up to damage of a gzipped file or a truncated last line."""
    n_read = 0
    try:
        with open_text(path) as stream:
            lines = Lines(path, stream)
            number = 0
            try:
                for number, line in enumerate(lines, start=1):
                    if is_skipped(line):
                        continue
                    yield _parsed(path, number, line)
                    n_read += 1
            except LineError as error:
                lines.end_early(error, n_read, "frames")
    except GZIP_ERRORS as error:
        if not n_read:
            raise
        warnings.warn(
            f"{path} is damaged or cut short ({error_reason(error)}): read the {n_read} frames "
            "before the damage, lost the rest",
            AnisomapWarning,
            stacklevel=2,
        )


def _parsed(path: Path, number: int, line: str) -> _Frame:
    match = _STAMPS.match(line)
    if not match:
        raise LineError(path, number, ": must start with a sequence number and a stamp")
    try:
        stamps = tuple(float(word) for word in match[2].split())
    except ValueError:
        raise LineError(path, number, f": {quote(match[2].strip())} must be stamps") from None
    rest = line[match.end() :].strip()
    contacts = _lists(rest)
    # An empty list may be written as such.
    if contacts is None or any(len(contact) and _part(contact) is None for contact in contacts):
        raise LineError(
            path, number, ": must hold contacts, each of 8 lists and numbers in brackets"
        )
    found = [(_part(contact), _taxels(contact)) for contact in contacts if contact]
    return _Frame(stamps, tuple((part, taxels) for part, taxels in found if part is not None))


def _lists(text: str) -> list[list[str]] | None:
    """Split ``((1 2) (3) 4) (...)`` into the items of each list; None if brackets do not match.

    Items keep the text inside their own brackets, of one level.
    """
    found: list[list[str]] = []
    depth, start = 0, 0
    for i, character in enumerate(text):
        if character == "(":
            depth += 1
            if depth == 1:
                found.append([])
            start = i + 1
        elif character == ")":
            depth -= 1
            if depth == 1:
                found[-1].append(text[start:i])
            elif depth == 0:
                found[-1] += text[start:i].split()
            else:
                return None
            start = i + 1
        elif character.isspace() and depth == 1:
            found[-1] += text[start:i].split()
            start = i + 1
        if depth > 2 or (depth == 0 and character not in ") \t\r\n"):
            return None
    return found if depth == 0 else None


def _part(contact: Sequence[str]) -> str | None:
    """Return the name of the skin part of a contact; None if it is not one."""
    if len(contact) not in (_FIELDS, _WITH_NAMES) or not _INTEGERS.fullmatch(contact[_TAXELS_AT]):
        return None
    numbers = contact[0].split()
    if len(numbers) != 4 or not all(text.isascii() and text.isdecimal() for text in numbers):
        return None
    part = numbers[_PART_AT]
    return PARTS[int(part)] if len(part) < 3 and int(part) < len(PARTS) else f"part{part}"


def _taxels(contact: Sequence[str]) -> tuple[int, ...]:
    return tuple(int(word) for word in contact[_TAXELS_AT].split())
