"""Sources of live sessions: where the frames come from.

Recordings that are replayed and a simulated hand are here, the others in `connections`. To add a
source, add a function from an `Address` to a `Source`, both of `anisomap.live.batches`, and one
line to `SOURCES`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from threading import Event
from types import MappingProxyType
from typing import NamedTuple, TypeAlias
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray

from anisomap import io
from anisomap.errors import InputError
from anisomap.io.stream import Block
from anisomap.live.batches import Address, Batch, Item, Notice, Source
from anisomap.live.sources import connections
from anisomap.recording import default_names
from anisomap.sensor_map import SensorMap
from anisomap.simulation import Body
from anisomap.simulation.kinematic import GuidedHand, RubbingOptions
from anisomap.simulation.options import options_for


class Entry(NamedTuple):
    """A kind of source: an example of its addresses, and what opens the source at one."""

    example: str
    open: Callable[[Address], Source]


SOURCES: Mapping[str, Entry] = MappingProxyType(
    {
        "-": Entry("-", connections.standard_input),
        "tcp": Entry("tcp://HOST:PORT", connections.tcp),
        "tcp-listen": Entry("tcp-listen://HOST:PORT", connections.tcp_listen),
        "udp": Entry("udp://HOST:PORT", connections.udp),
        "serial": Entry("serial:///dev/ttyUSB0?baud=115200", connections.serial_port),
        "lsl": Entry("lsl://NAME", connections.lsl),
        "rosbridge": Entry("rosbridge://HOST:9090/TOPIC", connections.rosbridge),
        "zenoh": Entry("zenoh://KEY?connect=tcp/HOST:7447", connections.zenoh),
        "yarp": Entry("yarp://HOST:10000/PORT", connections.yarp),
    }
)
"""Kinds of sources by the scheme of their addresses."""


def open_source(text: str, *, speed: float = 1.0) -> Source:
    """Open a source."""
    scheme, colon, _ = text.partition("://")
    if text == "-" or (colon and scheme in SOURCES):
        try:
            return SOURCES[scheme].open(Address(urlsplit(text)))
        except InputError:
            raise
        except ValueError as error:
            raise InputError(f"{text} is not an address: {error}") from error
    if Path(text).exists():
        return replay(Path(text), speed)
    known = ", ".join(entry.example for entry in SOURCES.values())
    raise InputError(f"there is no file {text}, and it is no address: {known}")


DEFAULT_RATE_HZ = 50.0
"""Rate of recordings that state none; that of the iCub's skin."""

BOUT_FRAMES = 40
"""Frames for which the hand rubs one place: 2 s, in which a person looks at the page again."""

Advised: TypeAlias = tuple[Sequence[int], NDArray[np.intp] | None]

_BATCH_S = 0.05  # longest time between two batches, so that the page moves smoothly
_MAX_BATCH = 512


def replay(path: Path, speed: float) -> Source:
    """Return a recording that is replayed at its rate, or faster; it is read in blocks.

    speed: Multiple of the rate of the recording; 0 for as fast as possible.
    """
    with io.open_stream(path, frames=1) as stream:
        names, truth = stream.names or default_names(stream.n_sensors), None
        if stream.positions is not None:
            truth = SensorMap(stream.positions, names=names, units=stream.units)
        known_rate = stream.rate_hz

    def items(stop: Event) -> Iterator[Item]:
        started, clock = time.monotonic(), 0.0
        with io.open_stream(path, frames=_MAX_BATCH) as stream:
            step = 1 / (stream.rate_hz or known_rate or DEFAULT_RATE_HZ)
            for block in stream.blocks:
                times = _times(block, clock, step)
                clock = float(times[-1]) + step
                n_frames = len(times)
                if speed and n_frames > 1:
                    n_frames = max(1, int(_BATCH_S * speed / (times[1] - times[0])))
                for at in range(0, len(times), n_frames):
                    part = slice(at, at + n_frames)
                    if _stopped_before(started, times[part][-1], speed, stop):
                        return
                    yield Batch(np.asarray(block.readings[part], dtype=np.float64), times[part])
        yield Notice("the recording has ended")

    return Source(f"replay of {path.name}", items, names, truth, can_wait=True)


def _stopped_before(started: float, clock: float, speed: float, stop: Event) -> bool:
    """Wait until a recording that is replayed has reached a time; return whether it was stopped."""
    due = started + clock / speed if speed else started
    return stop.wait(max(0.0, due - time.monotonic()))


def _times(block: Block, begin: float, step: float) -> NDArray[np.float64]:
    """Return the times of a block from `begin` on; equal steps unless it has increasing times."""
    own = block.times
    if own is not None and np.isfinite(own).all() and (np.diff(own) > 0).all():
        return np.asarray(begin + (own - own[0]))
    return np.asarray(begin + step * np.arange(len(block.readings)), dtype=np.float64)


class SimulatedHand(Source):
    """A palm on a body. It asks before each bout where to rub.

    speed: Multiple of the speed of a human hand, about 20 frames per second; 0 for as fast as
        possible.
    where: Returns the sensors to rub next, by index, and the contacts of each sensor if they are
        known; no sensors for anywhere.
    """

    def __init__(self, body: Body, seed: int = 1, speed: float = 1.0) -> None:
        truth = SensorMap(body.positions, names=body.names, units=body.units)
        super().__init__(
            f"simulated hand on {body.name}, seed {seed}",
            self._rub,
            body.names,
            truth,
            can_wait=True,
        )
        self.where: Callable[[], Advised] = lambda: ((), None)
        self._options = options_for(RubbingOptions, body)
        self._hand = GuidedHand(body, self._options, np.random.default_rng(seed))
        self._speed = speed

    def _rub(self, stop: Event) -> Iterator[Item]:
        started, n_frames, interval = time.monotonic(), 0, self._options.frame_interval
        while not stop.is_set():
            for row in self._hand.rub(BOUT_FRAMES, *self.where()):
                if _stopped_before(started, n_frames * interval, self._speed, stop):
                    return
                times = np.array([n_frames * interval])
                yield Batch(row[None].astype(np.float64), times)
                n_frames += 1
