"""Atomic writing of files, and checks of their paths before long computations."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from anisomap.errors import FileError


def check_target(path: str | os.PathLike[str]) -> Path:
    """Check that a file could be written at a path.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    pathlib.Path
        The same path.

    Raises
    ------
    FileError
        If `path` is a folder, or its parent folder is missing.
    """
    target = Path(path)
    if target.is_dir():
        raise FileError(f"cannot write {target}: it is a folder; give a file name")
    if not target.parent.is_dir():
        raise FileError(f"cannot write {target}: the folder {target.parent} does not exist")
    return target


def check_distinct(
    outputs: Iterable[str | os.PathLike[str]], inputs: Iterable[str | os.PathLike[str]]
) -> None:
    """Check that no output would overwrite an input or another output.

    Parameters
    ----------
    outputs, inputs : iterable of path-like

    Raises
    ------
    FileError
        If a file is written twice, or both read and written.
    """
    read = {Path(path).resolve() for path in inputs}
    written: set[Path] = set()
    for path in outputs:
        file = Path(path).resolve()
        if file in read:
            raise FileError(f"{path} is also an input; write the result to another file")
        if file in written:
            raise FileError(f"{path} is given for two outputs; give each its own file")
        written.add(file)


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Provide a temporary file that replaces `path` if the block ends without an error.

    Parameters
    ----------
    path : path-like
        Final path of the file, in an existing folder.

    Yields
    ------
    pathlib.Path
        A temporary file in the same folder with the same suffix, since some writers choose the
        format by the suffix.

    Raises
    ------
    FileError
        If the folder is missing, `path` is a folder, or the file cannot be written.
    """
    target = check_target(path)
    try:
        handle, name = tempfile.mkstemp(
            prefix=f".{target.stem}-", suffix=target.suffix, dir=target.parent
        )
    except OSError as error:
        raise FileError(f"cannot write {target}: {error.strerror}") from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp creates private files; set the default permissions instead.
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(target)
    except OSError as error:
        raise FileError(f"cannot write {target}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
