"""The recording of a live session: delimited text that grows frame by frame.

The file is a recording that `anisomap.read` reads at any time, also after the process was killed:
whole lines are handed to the operating system, at most `FLUSH_S` after a frame has arrived.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.files import check_target
from anisomap.io.recordings.delimited_text import header_text
from anisomap.recording import Scalar

FLUSH_S = 0.1
"""Longest time in seconds for which frames are held before they are written; the promise is 1 s."""

_HELD_BYTES = 1 << 16  # written at once above this size, whatever the time


class JournalWriter:
    """Appends frames to a new file.

    Parameters
    ----------
    path : pathlib.Path
        Must not exist.
    names : sequence of str
        Names of the sensors.
    source : str
        Origin of the recording.
    metadata : mapping of str to scalar, optional

    Attributes
    ----------
    n_frames : int
        Number of frames added.
    header_bytes : int
        Size of the lines before the first frame.

    Raises
    ------
    FileError
        If the file exists or cannot be written.
    """

    def __init__(
        self,
        path: Path,
        names: Sequence[str],
        source: str,
        metadata: Mapping[str, Scalar] | None = None,
    ) -> None:
        check_target(path)
        header = header_text(names, source=source, metadata=metadata).encode("utf-8", "replace")
        self.path = path
        self.n_frames = 0
        self._held: list[str] = []
        self._held_bytes = 0
        self._written_at = time.monotonic()
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | getattr(os, "O_BINARY", 0)
        try:
            self._file = os.open(path, flags, 0o644)
        except FileExistsError:
            raise FileError(f"{path} exists; a live session writes a new recording") from None
        except OSError as error:
            raise FileError(f"cannot write {path}: {error.strerror or error}") from error
        self._size = 0
        self.header_bytes = len(header)
        self._write(header)

    def add(self, times: NDArray[np.float64], readings: NDArray[np.float64]) -> None:
        """Add frames.

        Parameters
        ----------
        times : ndarray of shape (t,)
            Seconds, strictly increasing.
        readings : ndarray of shape (t, N)

        Raises
        ------
        FileError
            If the disk is full; the file then ends with the last whole line.
        """
        for moment, row in zip(times.tolist(), readings.tolist(), strict=True):
            line = f"{moment:.6f},{','.join(map(repr, row))}\n"
            self._held.append(line)
            self._held_bytes += len(line)
            if self._held_bytes >= _HELD_BYTES:
                self.flush()
        self.n_frames += len(readings)
        if time.monotonic() - self._written_at >= FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Hand all frames to the operating system.

        Raises
        ------
        FileError
            See `add`.
        """
        self._written_at = time.monotonic()
        if self._held:
            content = "".join(self._held).encode()
            self._held, self._held_bytes = [], 0
            self._write(content)

    def close(self) -> None:
        """Write what is held, and close the file."""
        if self._file >= 0:
            try:
                self.flush()
            finally:
                os.close(self._file)
                self._file = -1

    def _write(self, content: bytes) -> None:
        done = 0
        try:
            while done < len(content):
                done += os.write(self._file, content[done:])
        except OSError as error:
            whole = content.rfind(b"\n", 0, done) + 1
            os.ftruncate(self._file, self._size + whole)
            self._size += whole
            raise FileError(f"cannot write {self.path}: {error.strerror or error}") from error
        self._size += len(content)


class JournalTail:
    """Reads the frames that a `JournalWriter` appends, while it appends them.

    Parameters
    ----------
    path : pathlib.Path
    n_sensors : int
        Number of readings per line.
    header_bytes : int
        `JournalWriter.header_bytes`.
    """

    def __init__(self, path: Path, n_sensors: int, header_bytes: int) -> None:
        self._stream = path.open("rb")
        self._width = n_sensors + 1
        self._rest = b""
        self._stream.seek(header_bytes)

    def read(self, n_bytes: int) -> tuple[NDArray[np.float64], bool]:
        """Read frames that were added since the last call.

        Parameters
        ----------
        n_bytes : int
            Maximum number of bytes to read.

        Returns
        -------
        readings : ndarray of shape (t, N)
            Without the times; t is 0 if there is nothing new.
        more : bool
            Whether there may be more frames to read at once.
        """
        content = self._stream.read(n_bytes)
        text, _, rest = (self._rest + content).rpartition(b"\n")
        self._rest = rest
        more = len(content) == n_bytes
        if not text:
            return np.empty((0, self._width - 1)), more
        values = np.fromstring(text.replace(b"\n", b",").decode(), sep=",")
        return values.reshape(-1, self._width)[:, 1:], more

    def close(self) -> None:
        """Close the file."""
        self._stream.close()
