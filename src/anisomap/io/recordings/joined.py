"""Parts of one skin that were recorded at the same time, joined while they are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anisomap.base.wording import join_items
from anisomap.errors import FileError
from anisomap.io.stream import Block, Stream
from anisomap.recording import default_names


def join_streams(streams: Mapping[str, Stream]) -> Stream:
    """Join the sensors of several streams, sampled at the times of the first; one is unchanged."""
    (_, leader), *followers = streams.items()
    if not followers:
        return leader
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
    overlap = False
    for block in leader.blocks:
        if block.times is None:
            raise FileError(f"{leader.path} has no times; joining recordings requires them")
        rows, covered = [block.readings], np.ones(len(block.readings), dtype=bool)
        for follower in followers:
            readings, known = follower.at(block.times)
            rows.append(readings)
            covered &= known
        if covered.any():
            overlap = True
            yield Block(np.hstack(rows)[covered], block.fraction, block.times[covered])
    if not overlap:
        raise FileError(f"{leader.path}: the recordings {join_items(parts)} do not overlap in time")


class _Follower:
    """Look up the latest frame of a stream at increasing times, with bounded memory."""

    def __init__(self, name: str, stream: Stream) -> None:
        self._name, self._stream = name, stream
        self._times: NDArray[np.float64] = np.empty(0)
        self._readings = np.empty((0, stream.n_sensors), np.float32)

    def at(self, times: NDArray[np.float64]) -> tuple[NDArray[np.floating], NDArray[np.bool_]]:
        """Return the latest readings at each time, and whether the stream covers that time."""
        end = times.max(initial=-np.inf)
        while not (self._times.size and self._times[-1] >= end):
            block = next(self._stream.blocks, None)
            if block is None:
                break
            if block.times is None:
                problem = f"{self._name} has no times; joining recordings requires them"
                raise FileError(f"{self._stream.path}: {problem}")
            # searchsorted needs non-decreasing times, so a clock that steps back is held constant.
            self._times = np.fmax.accumulate(np.append(self._times, block.times))
            self._readings = np.concatenate([self._readings, block.readings])
        if not self._times.size:
            raise FileError(f"{self._stream.path}: {self._name} has no frame")
        last = np.searchsorted(self._times, times, side="right") - 1
        known = (last >= 0) & (times <= self._times[-1])
        readings = self._readings[last.clip(0)]
        unused = max(int(last.min(initial=0)), 0)
        self._times, self._readings = self._times[unused:], self._readings[unused:]
        return readings, known
