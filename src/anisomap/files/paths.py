"""Opening of regular files, atomic writing, and checks of paths before long computations."""

from __future__ import annotations

import io
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TypeAlias

from anisomap.errors import FileError

_MARK_BYTES = 8  # random bytes in the name of a temporary file, which make it unique
_STEM = 32  # characters of the output's name in this name; systems limit names to 255 bytes


def check_regular(path: str | os.PathLike[str]) -> None:
    """Check that a path is a regular file, before a library opens it.

    Opening a pipe waits for a writer, and some devices never end.
    """
    open_regular(path).close()


def open_regular(path: str | os.PathLike[str]) -> io.BufferedReader:
    """Open a regular file as bytes, without waiting for pipes."""
    # Do not wait for the writer of a pipe; keep line ends. Not all systems have these flags.
    flags = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    with named_errors(path, "read"):
        try:
            descriptor = os.open(path, os.O_RDONLY | flags)
        except FileNotFoundError:
            raise FileError(f"there is no file {path}") from None
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        # Unlike os.fdopen, open keeps the name of the file.
        return open(path, "rb", opener=lambda *_: descriptor)
    os.close(descriptor)
    if stat.S_ISDIR(mode):
        raise FileError(f"cannot read {path}: it is a folder; give a file")
    raise FileError(f"{path} is not a regular file; save its content to a regular file first")


def read_small(path: str | os.PathLike[str], limit: int, what: str) -> str:
    """Read a small text file."""
    with named_errors(path, "read"), open_regular(path) as stream:
        content = stream.read(limit + 1)
    if len(content) > limit:
        raise FileError(f"{path} is larger than {limit} bytes, the limit for {what}")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(f"{path} is not UTF-8 text; {what} must be") from error


def check_target(path: str | os.PathLike[str]) -> Path:
    """Check that a file can be written at a path."""
    target = Path(path)
    with named_errors(target):  # such as of a name that is too long
        if target.is_dir():
            raise FileError(f"cannot write {target}: it is a folder; give a file name")
        if target.exists() and not target.is_file():
            raise FileError(f"cannot write {target}: it is not a regular file; give a file name")
        if not target.parent.is_dir():
            raise FileError(f"cannot write {target}: the folder {target.parent} does not exist")
    return target


def check_distinct(
    outputs: Iterable[str | os.PathLike[str]], inputs: Iterable[str | os.PathLike[str]]
) -> None:
    """Check that no output would overwrite an input or another output."""
    read = {_real(path) for path in inputs}
    written: set[Path] = set()
    for path in outputs:
        file = _real(path)
        if file in read:
            raise FileError(f"{path} is also an input; write the result to another file")
        if file in written:
            raise FileError(f"{path} is given for two outputs; give each its own file")
        written.add(file)


def _real(path: str | os.PathLike[str]) -> Path:
    """Follow links; unlike Path.resolve in Python 3.11 and 3.12, also broken links."""
    with named_errors(path, "find"):  # if the working folder was removed
        return Path(os.path.realpath(path))


_Moves: TypeAlias = dict[Path, tuple[Path, Path]]
_moves: ContextVar[_Moves | None] = ContextVar("moves of files that are written together")


@contextmanager
def together() -> Iterator[_Moves]:
    """Replace all files written in the block at its end, if there is no error.

    Yields the temporary files, each with its target and the given path.
    """
    if (outer := _moves.get(None)) is not None:
        yield outer
        return
    moves: _Moves = {}
    token = _moves.set(moves)
    try:
        yield moves
        for temporary, (place, target) in moves.items():
            with named_errors(target):
                temporary.replace(place)
    finally:
        _moves.reset(token)
        for temporary in moves:
            temporary.unlink(missing_ok=True)


@contextmanager
def named_errors(path: str | os.PathLike[str], action: str = "write") -> Iterator[None]:
    """Say in errors of the operating system what could not be done with which file."""
    try:
        yield
    except OSError as error:
        raise FileError(f"cannot {action} {path}: {error.strerror or error}") from error


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Provide a temporary file that replaces `path` if the block ends without an error."""
    target = check_target(path)
    # The name is chosen before the file is created, so that an interruption leaves no file.
    mark = os.urandom(_MARK_BYTES).hex()
    place = _real(target)
    temporary = place.with_name(f".{target.stem[:_STEM]}-{mark}{target.suffix}")
    with together() as moves, named_errors(target):
        moves[temporary] = place, target
        try:
            temporary.touch(exist_ok=False)
            yield temporary
        except BaseException:
            del moves[temporary]
            temporary.unlink(missing_ok=True)
            raise
