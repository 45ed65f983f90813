"""Several parts of one skin that were recorded side by side, each with a clock of its own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.stream import Block, Stream
from anisomap.recording import default_names
from anisomap.wording import join_items


def joined(streams: Mapping[str, Stream]) -> Stream:
    """Join streams into one on the clock of the first.

    Parameters
    ----------
    streams : mapping of str to Stream
        By the name of the part, which is put before the names of its sensors. All have times, and
        these are of clocks that agree.

    Returns
    -------
    Stream
        Frames of the first stream, with what the others read last before each; only those
        frames at which all were running.
    """
    (_, leader), *followers = streams.items()
    names = tuple(
        f"{part}/{name}"
        for part, stream in streams.items()
        for name in stream.names or default_names(stream.n_sensors)
    )
    return replace(
        leader,
        n_sensors=len(names),
        blocks=_blocks(leader, [_Follower(name, stream) for name, stream in followers], [*streams]),
        names=names,
        positions=None,
        normals=None,
        surface_distances=None,
        locate=None,
    )


def _blocks(leader: Stream, followers: list[_Follower], parts: list[str]) -> Iterator[Block]:
    together = False
    for block in leader.blocks:
        if block.times is None:
            raise FileError(f"{leader.path} has no times, so nothing can be joined to it")
        rows, running = [block.readings], np.ones(len(block.readings), dtype=bool)
        for follower in followers:
            readings, known = follower.at(block.times)
            rows.append(readings)
            running &= known
        if running.any():
            together = True
            yield Block(np.hstack(rows)[running], block.share, block.times[running])
    if not together:
        raise FileError(f"{leader.path}: {join_items(parts)} never ran at the same time")


class _Follower:
    """A stream of which we know what it read last at any time, asked for in order."""

    def __init__(self, name: str, stream: Stream) -> None:
        self._name, self._stream = name, stream
        self._times: NDArray[np.float64] = np.empty(0)
        self._readings = np.empty((0, stream.n_sensors), np.float32)
        self._ended = False

    def at(self, times: NDArray[np.float64]) -> tuple[NDArray[np.floating], NDArray[np.bool_]]:
        """Give what was read last at each time, and whether the stream was running then."""
        self._read_until(times.max(initial=-np.inf))
        if not self._times.size:
            raise FileError(f"{self._stream.path}: {self._name} holds no frame")
        last = np.searchsorted(self._times, times, side="right") - 1
        known = (last >= 0) & (times <= self._times[-1])
        readings = self._readings[last.clip(0)]
        done = max(int(last.min(initial=0)), 0)
        self._times, self._readings = self._times[done:], self._readings[done:]
        return readings, known

    def _read_until(self, time: float) -> None:
        while not self._ended and not (self._times.size and self._times[-1] >= time):
            block = next(self._stream.blocks, None)
            if block is None:
                self._ended = True
                return
            if block.times is None:
                raise FileError(f"{self._stream.path}: {self._name} has no times to join it by")
            # A clock that falls back is held, so that it can be searched.
            self._times = np.fmax.accumulate(np.append(self._times, block.times))
            self._readings = np.concatenate([self._readings, block.readings])
