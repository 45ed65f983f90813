"""Calls of the command line in this process, and the files that they read."""

import contextlib
import io
import json
import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anisomap.cli import console
from anisomap.cli.app import run


@dataclass(frozen=True)
class Outcome:
    """Output of a command."""

    out: str
    err: str

    @property
    def values(self) -> Any:
        """What ``--json`` printed."""
        return json.loads(self.out)


def call(folder: Path, *arguments: object, code: int = 0, width: int = 200) -> Outcome:
    """Run a command in a folder, and check its exit code; unexpected errors are raised.

    arguments: The command as it is typed, and further words.
    """
    typed, *words = arguments
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setenv("ANISOMAP_DEBUG", "1")
        for shown in (console.console, console.errors):
            patch.setattr(shown, "width", width)
        ended = run([*shlex.split(str(typed)), *map(str, words)])
    assert ended == code, err.getvalue()
    return Outcome(out.getvalue(), err.getvalue())


def write_layout(
    path: Path, positions: np.ndarray, names: Iterable[str], header: str = "name,x,y"
) -> None:
    """Write positions and names as a table."""
    rows = (",".join(map(str, row)) for row in zip(names, *positions.T.tolist(), strict=True))
    path.write_text("\n".join([header, *rows]) + "\n")


def contents(folder: Path) -> dict[Path, bytes | None]:
    """Return the content of every file of a folder, and None for what is no regular file."""
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}
