"""The recording of a live session: delimited text that grows frame by frame.

`anisomap.read` can read the file at any time, even after the process was killed: whole lines are
passed to the operating system in every tick of the session.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.base.wording import join_items, printable
from anisomap.errors import FileError
from anisomap.files.paths import check_target
from anisomap.io.parsing.names import distinct_names
from anisomap.io.recordings.delimited_text import header_text
from anisomap.live.batches import Batch
from anisomap.names import default_names

MAX_WIDTH = 250_000
"""Maximum readings of a frame. Text files with lines of 2^23 characters or more cannot be read. A
reading has up to 25 characters, and the name of a sensor without a number up to 7."""

GAP = "no frame for"
"""Beginning of the notice of a gap."""

_HELD_BYTES = 1 << 16  # buffered bytes above which frames are written immediately
_SILENCE_S = 1.0  # minimum time without a frame for a gap
_STEP_S = 0.02  # between two entries of the arrivals
_RATE_S = 3.0  # period of the measured rate
_TICK = 1e-6  # seconds; the last digit of the times in the file


class JournalWriter:
    """Appends frames to a new file."""

    def __init__(self, path: Path, names: Sequence[str], source: str = "") -> None:
        check_target(path)
        header = header_text(names, source=source).encode("utf-8", "replace")
        self.path, self._held = path, bytearray()
        try:
            self._file = path.open("xb", buffering=0)
        except FileExistsError:
            raise FileError(f"{path} exists; a live session writes a new recording") from None
        except OSError as error:
            raise FileError(f"cannot write {path}: {error.strerror or error}") from error
        self._size = 0
        self.header_bytes = len(header)
        self._write(header)

    def add(self, times: NDArray[np.float64], readings: NDArray[np.float64]) -> None:
        """Add frames. times (t,), readings (t, N)."""
        for moment, row in zip(times.tolist(), readings.tolist(), strict=True):
            self._held += f"{moment:.6f},{','.join(map(repr, row))}\n".encode()
            if len(self._held) >= _HELD_BYTES:
                self.flush()

    def flush(self) -> None:
        """Pass all frames to the operating system."""
        content, self._held = bytes(self._held), bytearray()
        self._write(content)

    def close(self) -> None:
        """Write buffered frames, and close the file."""
        if not self._file.closed:
            with self._file:
                self.flush()

    def _write(self, content: bytes) -> None:
        done = 0
        try:
            while done < len(content):
                done += self._file.write(content[done:])
        except OSError as error:
            self._size += content.rfind(b"\n", 0, done) + 1
            self._file.truncate(self._size)
            self._file.seek(self._size)
            raise FileError(f"cannot write {self.path}: {error.strerror or error}") from error
        self._size += len(content)


class JournalTail:
    """Reads the frames that a `JournalWriter` appends, while it appends them."""

    def __init__(self, path: Path, n_sensors: int, header_bytes: int) -> None:
        self._stream = path.open("rb")
        self._width, self._rest = n_sensors + 1, b""
        self._stream.seek(header_bytes)

    def read(self, n_bytes: int) -> tuple[NDArray[np.float64], bool]:
        """Read frames that were added since the last call. Returns readings (t, N), more."""
        content = self._stream.read(n_bytes)
        text, _, self._rest = (self._rest + content).rpartition(b"\n")
        more = len(content) == n_bytes
        if not text:
            return np.empty((0, self._width - 1)), more
        values = np.fromstring(text.replace(b"\n", b",").decode(), sep=",")
        return values.reshape(-1, self._width)[:, 1:], more

    def close(self) -> None:
        """Close the file."""
        self._stream.close()


@dataclass(frozen=True)
class Segment:
    """A file of a session, numbered from 1, with the size of its lines before the first frame."""

    path: Path
    names: tuple[str, ...]
    header_bytes: int
    number: int
    source: str = ""


class Recorder:
    """Writes frames to a file, and after `close` to another file.

    path: The first file; later ones are numbered, as in ``skin-2.csv``. Numbers of files that exist
        are left out: they belong to earlier sessions.
    notify, begin: Take sentences for the user, and each `Segment` when its file has been created.
    """

    def __init__(
        self,
        path: Path,
        source: str,
        notify: Callable[[str], None],
        begin: Callable[[Segment], None],
    ) -> None:
        self.names: tuple[str, ...] = ()
        self.segments: list[Segment] = []
        self.n_frames, self.seconds = 0, 0.0
        self.arrived_at: float | None = None
        self._path, self._source, self._notify, self._begin = path, source, notify, begin
        self._writer: JournalWriter | None = None
        self._lock = Lock()
        self._recent: list[NDArray[np.float64]] = []
        self._missing = np.zeros(0, dtype=bool)
        self._offset: float | None = None
        self._began = 0.0

    @property
    def width(self) -> int:
        """Number of sensors of the current file; 0 before the first frame."""
        return len(self.segments[-1].names) if self._writer is not None else 0

    @property
    def has_gaps(self) -> bool:
        """Whether a reading of the current file is missing."""
        return bool(self._missing.any())

    def put(self, batch: Batch) -> None:
        """Record frames, unless they are wider than `MAX_WIDTH`."""
        if not batch.readings.size:
            return
        width = batch.readings.shape[1]
        if width > MAX_WIDTH:
            self._notify(f"ignored a frame of {width} readings; at most {MAX_WIDTH} are recorded")
            return
        if self.width not in (0, width):
            self._notify(f"{width} readings instead of {self.width}: a new recording begins")
            self.close()
        with self._lock:
            now = time.monotonic()
            if self.arrived_at is not None and now - self.arrived_at > _SILENCE_S:
                self._notify(f"{GAP} {now - self.arrived_at:.1f} s")
            self.arrived_at = now
            self._record(self._writer or self._started(width), batch, now)

    def rename(self, names: tuple[str, ...]) -> None:
        """Name the sensors; if others are recorded, a new recording begins."""
        if self.width and names != self.names:
            self.close()
            self._notify("the sensors have other names: a new recording begins")
        self.names = names

    def flush(self) -> int:
        """Pass recorded frames to the operating system; return the number that can be read."""
        with self._lock:
            if self._writer is not None:
                self._writer.flush()
            return self.n_frames

    def close(self) -> None:
        """Write all frames and close the file; the next frame begins a new file."""
        with self._lock:
            writer, self._writer = self._writer, None
            if writer is not None:
                writer.close()

    def recent(self) -> NDArray[np.float64] | None:
        """Return the readings recorded since the last call, (t, N); None without readings."""
        with self._lock:
            found, self._recent = self._recent, []
        return np.concatenate(found) if found else None

    def _started(self, width: int) -> JournalWriter:
        number = len(self.segments) + 1
        path = self._path
        if number > 1:
            later = (path.with_stem(f"{path.stem}-{at}") for at in count(number))
            path = next(path for path in later if not os.path.lexists(path))  # also broken links
        names = self.names if len(self.names) == width else default_names(width)
        names = distinct_names(path, [printable(name) for name in names])
        self._writer = writer = JournalWriter(path, names, self._source)
        self.n_frames, self.seconds, self._offset = 0, 0.0, None
        self._missing = np.zeros(width, dtype=bool)
        self._recent = []
        self.segments.append(Segment(path, names, writer.header_bytes, number, self._source))
        self._begin(self.segments[-1])
        return writer

    def _record(self, writer: JournalWriter, batch: Batch, now: float) -> None:
        writer.add(self._times(batch, now), batch.readings)
        self.n_frames += len(batch.readings)
        self._recent.append(batch.readings)
        absent = ~np.isfinite(batch.readings)
        if absent.any():
            fresh = np.flatnonzero(absent.any(axis=0) & ~self._missing)
            self._missing[fresh] = True
            if names := [self.segments[-1].names[i] for i in fresh]:
                self._notify(f"{join_items(names, 3)} sent no number; maps use interpolation")

    def _times(self, batch: Batch, now: float) -> NDArray[np.float64]:
        """Return increasing times of frames in seconds since the first one."""
        n_frames, last = len(batch.readings), self.seconds
        times: NDArray[Any]
        if batch.times is not None:
            times = np.asarray(batch.times, dtype=np.float64)
            if self._offset is None:
                self._offset = -float(times[0])
            times = times + self._offset
            first = self.n_frames == 0
            if (first or times[0] > last + _TICK) and (np.diff(times) > _TICK).all():
                self._began = now - float(times[-1])
                self.seconds = float(times[-1])
                return times
            if not first and times[0] <= last - _SILENCE_S:
                self._notify("the clock of the source went back; later times are shifted")
        if self.n_frames == 0:
            self._began = now
            times = np.asarray(_TICK * np.arange(n_frames))
        else:
            until = max(now - self._began, last + 2 * _TICK * n_frames)
            times = np.asarray(last + (until - last) / n_frames * np.arange(1.0, n_frames + 1))
        if batch.times is not None:
            self._offset = float(times[-1] - batch.times[-1])
        self.seconds = float(times[-1])
        return times


class Arrivals:
    """Times of arrival of frames, for the age of a map with a given number of frames."""

    def __init__(self) -> None:
        self._counts: deque[tuple[int, float]] = deque(maxlen=20_000)

    def add(self, n_frames: int, now: float) -> None:
        """Record that there are `n_frames` frames at a time."""
        if self._counts and now - self._counts[-1][1] < _STEP_S:
            now = self._counts.pop()[1]
        self._counts.append((n_frames, now))

    def rate(self, now: float) -> float:
        """Return the number of frames per second in the last seconds."""
        recent = [entry for entry in list(self._counts) if now - entry[1] < _RATE_S]
        if len(recent) < 2:
            return 0.0
        (before, begin), (after, end) = recent[0], recent[-1]
        return (after - before) / (end - begin)

    def time_of(self, n_frames: int) -> float | None:
        """Return the time of arrival of the first frame after the first `n_frames`."""
        return next((moment for count, moment in list(self._counts) if count > n_frames), None)
