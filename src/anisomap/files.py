"""Writing files so that a failure leaves the old one whole and never half a new one."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from anisomap.errors import FileError


def check_target(path: str | os.PathLike[str]) -> Path:
    """Find out before the work whether a file could be written at all.

    Parameters
    ----------
    path : path-like
        Where the file should stand in the end.

    Returns
    -------
    pathlib.Path
        The same.

    Raises
    ------
    FileError
        If `path` is a folder, or the folder that it lies in is missing.
    """
    target = Path(path)
    if target.is_dir():
        raise FileError(f"cannot write {target}: it is a folder; give a file name")
    if not target.parent.is_dir():
        raise FileError(f"cannot write {target}: there is no folder {target.parent}")
    return target


def check_distinct(
    outputs: Iterable[str | os.PathLike[str]], inputs: Iterable[str | os.PathLike[str]]
) -> None:
    """Find out before the work whether a result would overwrite its source, or another result.

    Parameters
    ----------
    outputs, inputs : iterable of path-like
        What will be written, and what is read.

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
            raise FileError(f"{path} is what is read here: write the result to another file")
        if file in written:
            raise FileError(f"{path} is named for two results: give each a file of its own")
        written.add(file)


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a path to write to, and move it onto `path` only when the block ends without error.

    Parameters
    ----------
    path : path-like
        Where the file should stand in the end. Its folder must exist.

    Yields
    ------
    pathlib.Path
        A temporary file beside `path`, with the same suffix (writers look at suffixes).

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
    aside = Path(name)
    try:
        yield aside
        # mkstemp makes private files; what a user writes should follow the umask as usual.
        aside.chmod(0o666 & ~_umask())
        aside.replace(target)
    except OSError as error:
        raise FileError(f"cannot write {target}: {error.strerror or error}") from error
    finally:
        aside.unlink(missing_ok=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
