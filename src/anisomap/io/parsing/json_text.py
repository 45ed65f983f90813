"""Read JSON files, which are parsed as a whole."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from anisomap.budget import size_on_disk
from anisomap.errors import FileError
from anisomap.io.parsing.source import check_json, open_text

MAX_RATIO = 100
"""Maximum ratio of characters to bytes on disk.

gzip reached 13 on a map of 440 sensors, and 31 where none had a position.
"""

FREE_CHARACTERS = 1 << 22
"""Text up to this length is accepted at any ratio; parsing took up to 24 bytes per character."""


def read_json(path: Path) -> Any:
    """Parse a JSON file, which may be gzipped.

    Parameters
    ----------
    path : pathlib.Path

    Returns
    -------
    object
        The document.

    Raises
    ------
    FileError
        If the file is not valid JSON, or unpacks to far more than its size.
    """
    limit = max(FREE_CHARACTERS, MAX_RATIO * size_on_disk(path))
    with open_text(path) as stream:
        content = stream.read(limit + 1)
    if len(content) > limit:
        raise FileError(
            f"{path} unpacks to more than {limit} characters, too many for its size on disk; it is "
            "damaged or a decompression bomb (if not, unpack it first)"
        )
    check_json(path, content)
    try:
        return json.loads(content)
    except json.JSONDecodeError as error:
        raise FileError(
            f"{path}, line {error.lineno}, column {error.colno}: not valid JSON ({error.msg})"
        ) from error
    except (ValueError, RecursionError) as error:
        raise FileError(f"{path}: not valid JSON ({error})") from error
