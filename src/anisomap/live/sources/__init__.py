"""Sources of the frames of live sessions.

Replays of recordings and a simulated hand are here, all other sources in `connections`. To add a
source, add a subclass of `Source` that is made from an `Address`, both of `anisomap.live.batches`,
and one line to `SOURCES`.
"""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple, TypeAlias
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray

from anisomap import io
from anisomap.errors import InputError
from anisomap.io.presets import UNITS, grid_names, grid_positions
from anisomap.io.stream import Block
from anisomap.live.batches import WAIT_S, Address, Batch, Source
from anisomap.live.sources import connections
from anisomap.names import default_names
from anisomap.sensor_map import SensorMap
from anisomap.simulation import Body
from anisomap.simulation.kinematic import GuidedHand, RubbingOptions
from anisomap.simulation.options import options_for


class Entry(NamedTuple):
    """A kind of source: an example of an address, and the function that opens a source."""

    example: str
    open: Callable[[Address], Source]


SOURCES: Mapping[str, Entry] = MappingProxyType(
    {
        "-": Entry("-", connections.StandardInput),
        "tcp": Entry("tcp://HOST:PORT", connections.Tcp),
        "udp": Entry("udp://HOST:PORT", connections.Udp),
        "serial": Entry("serial:///dev/ttyUSB0?baud=115200", connections.SerialPort),
        "lsl": Entry("lsl://NAME", connections.Lsl),
    }
)
"""Kinds of sources by the scheme of their addresses."""


def open_source(text: str, *, speed: float = 1.0, grid: tuple[int, int] | None = None) -> Source:
    """Open a source; `grid` gives rows and columns of the sensors in lines or in a recording."""
    scheme, colon, _ = text.partition("://")
    if text == "-" or (colon and scheme in SOURCES):
        try:
            source = SOURCES[scheme].open(Address(urlsplit(text)))
        except InputError:
            raise
        except ValueError as error:
            raise InputError(f"{text} is not an address: {error}") from error
        if grid:
            names, places = grid_names(*grid), grid_positions(*grid)
            source.grid, source.truth = grid, SensorMap(places, names=names, units=UNITS)
        return source
    if Path(text).exists():
        return Replay(Path(text), speed, io.ReadOptions(grid=grid))
    known = ", ".join(entry.example for entry in SOURCES.values())
    raise InputError(f"there is no file {text}, and it is no address: {known}")


DEFAULT_RATE_HZ = 50.0
"""Default rate of recordings without a rate; the rate of the iCub's skin."""

BOUT_FRAMES = 40
"""Frames for which the hand rubs one place: 2 s, the time between two looks at the page."""

Advised: TypeAlias = tuple[Sequence[int], NDArray[np.intp] | None]

_BATCH_S = 0.05  # maximum time between two batches, for smooth animation
_MAX_BATCH = 512


class _Paced(Source):
    """Batches that are yielded at their times.

    speed: Multiple of real time; 0 for as fast as possible.
    """

    greeting = ""
    ends = can_wait = True

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._next: Batch | None = None

    @abstractmethod
    def batches(self) -> Iterator[Batch]:
        """Iterate over batches; times start at 0."""

    @contextmanager
    def open(self) -> Iterator[None]:
        self._started, self._batches = time.monotonic(), self.batches()
        yield

    def receive(self) -> Batch:
        batch = self._next = self._next or next(self._batches, None)
        if batch is None or batch.times is None:
            raise EOFError
        if self._speed:
            early = self._started + batch.times[-1] / self._speed - time.monotonic()
            time.sleep(min(max(early, 0.0), WAIT_S))
            if early > WAIT_S:
                raise TimeoutError
        self._next = None
        return batch

    def parse(self, content: Batch) -> Iterator[Batch]:
        yield content


class Replay(_Paced):
    """A replay of a recording at its rate, or faster; the recording is read in blocks."""

    def __init__(
        self, path: Path, speed: float = 1.0, options: io.ReadOptions | None = None
    ) -> None:
        super().__init__(speed)
        self._path, self._options, self.description = path, options, f"replay of {path.name}"
        with io.open_stream(path, frames=1, options=options) as stream:
            self.names = tuple(stream.names or default_names(stream.n_sensors))
            if stream.positions is not None:
                self.truth = SensorMap(stream.positions, names=self.names, units=stream.units)
            self._step = 1 / (stream.rate_hz or DEFAULT_RATE_HZ)

    def batches(self) -> Iterator[Batch]:
        clock = 0.0
        with io.open_stream(self._path, frames=_MAX_BATCH, options=self._options) as stream:
            step = 1 / stream.rate_hz if stream.rate_hz else self._step
            for block in stream.blocks:
                times = _times(block, clock, step)
                clock, n_frames = float(times[-1]) + step, len(times)
                if self._speed and n_frames > 1:
                    n_frames = max(1, int(_BATCH_S * self._speed / (times[1] - times[0])))
                for at in range(0, len(times), n_frames):
                    part = slice(at, at + n_frames)
                    yield Batch(np.asarray(block.readings[part], dtype=np.float64), times[part])


def _times(block: Block, begin: float, step: float) -> NDArray[np.float64]:
    """Return the times of a block from `begin`; equal steps unless it has increasing times."""
    own = block.times
    if own is not None and np.isfinite(own).all() and (np.diff(own) > 0).all():
        return np.asarray(begin + (own - own[0]))
    return np.asarray(begin + step * np.arange(len(block.readings)), dtype=np.float64)


class SimulatedHand(_Paced):
    """A palm on a body; it requests the place of each bout.

    speed: Multiple of the speed of a human hand, about 20 frames per second.
    where: Returns the indices of sensors to rub next, and the contacts of each sensor if known; no
        sensors for any place.
    """

    def __init__(self, body: Body, seed: int = 1, speed: float = 1.0) -> None:
        super().__init__(speed)
        self.description = f"simulated hand on {body.name}, seed {seed}"
        self.names = body.names
        self.truth = SensorMap(body.positions, names=body.names, units=body.units)
        self.where: Callable[[], Advised] = lambda: ((), None)
        self._options = options_for(RubbingOptions, body)
        self._hand = GuidedHand(body, self._options, np.random.default_rng(seed))

    def batches(self) -> Iterator[Batch]:
        n_frames = 0
        while True:
            for row in self._hand.rub(BOUT_FRAMES, *self.where()):
                times = np.array([n_frames * self._options.frame_interval])
                yield Batch(row[None].astype(np.float64), times)
                n_frames += 1
