"""Files that hold several things: what they hold, and which of it is the recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from anisomap.errors import FileError
from anisomap.wording import join_items

_MOST_LISTED = 12


class ChoiceError(FileError):
    """Several things in a file could be the recording, and none was chosen."""


@dataclass(frozen=True)
class Content:
    """One of the things that a file holds.

    Parameters
    ----------
    name : str
        What to choose it by.
    summary : str
        What it is: type and size.
    usable : bool
        Whether it could be a recording.
    """

    name: str
    summary: str
    usable: bool = True


def choose(path: Path, contents: Sequence[Content], select: str, what: str) -> Content:
    """Choose the recording: the only one that could be it, or the one that is named.

    Parameters
    ----------
    path : pathlib.Path
        The file, for messages.
    contents : sequence of Content
        What it holds.
    select : str
        The name of one, or a part of its name between ``/``; empty if none was chosen.
    what : str
        What such things are called: ``"dataset"``.

    Returns
    -------
    Content

    Raises
    ------
    ChoiceError
        If several could be the recording.
    FileError
        If none could, or none has that name.
    """
    usable = [content for content in contents if content.usable]
    if select:
        named = [content for content in contents if content.name == select] or [
            content for content in usable if f"/{select.strip('/')}/" in f"/{content.name}/"
        ]
        if len(named) != 1:
            problem = "several things go by" if named else f"there is no {what}"
            raise FileError(f"{path}: {problem} {select!r}; it holds {_listed(named or contents)}")
        return named[0]
    if len(usable) > 1:
        raise ChoiceError(
            f"{path} holds {len(usable)} {what}s that could be the recording: {_listed(usable)}; "
            "choose one with --select"
        )
    if not usable:
        held = f"; it holds {_listed(contents)}" if contents else ""
        raise FileError(f"{path} holds no {what} that could be a recording{held}")
    return usable[0]


def _listed(contents: Sequence[Content]) -> str:
    return join_items([f"{content.name} ({content.summary})" for content in contents], _MOST_LISTED)
