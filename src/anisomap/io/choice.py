"""Select the recording in files that hold several datasets, topics or ports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from anisomap.errors import FileError
from anisomap.wording import join_items

_MAX_LISTED = 12


class ChoiceError(FileError):
    """The file holds several possible recordings, and none was selected."""


@dataclass(frozen=True)
class Content:
    """One item in a file: a dataset, column, topic or port.

    Parameters
    ----------
    name : str
        Name to select it by.
    summary : str
        Type and size, for display.
    usable : bool
        Whether it can be a recording.
    """

    name: str
    summary: str
    usable: bool = True


def choose(path: Path, contents: Sequence[Content], select: str, noun: str) -> Content:
    """Select the recording by name, or the only usable item.

    Parameters
    ----------
    path : pathlib.Path
        The file, for messages.
    contents : sequence of Content
        All items in the file.
    select : str
        Name of an item, or whole components of its name (``b/c`` of ``a/b/c``); empty for the only
        usable item.
    noun : str
        Noun for an item in messages, such as ``"dataset"``.

    Returns
    -------
    Content

    Raises
    ------
    ChoiceError
        If several items are usable and `select` is empty.
    FileError
        If no item is usable, or `select` does not match exactly one.
    """
    usable = [content for content in contents if content.usable]
    if select:
        named = [content for content in contents if content.name == select] or [
            content for content in usable if f"/{select.strip('/')}/" in f"/{content.name}/"
        ]
        if len(named) != 1:
            problem = f"several {noun}s match" if named else f"there is no {noun}"
            raise FileError(
                f"{path}: {problem} {select!r}; the file holds {_listed(named or contents)}"
            )
        return named[0]
    if len(usable) > 1:
        raise ChoiceError(
            f"{path} holds {len(usable)} possible recordings ({noun}s): {_listed(usable)}; "
            "choose one with --select"
        )
    if not usable:
        listing = f"; it holds {_listed(contents)}" if contents else ""
        raise FileError(f"{path} holds no {noun} that can be a recording{listing}")
    return usable[0]


def _listed(contents: Sequence[Content]) -> str:
    return join_items([f"{content.name} ({content.summary})" for content in contents], _MAX_LISTED)
