"""A stream of the Lab Streaming Layer, with pylsl."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Event
from typing import Any

import numpy as np

from anisomap.errors import InputError, import_extra
from anisomap.live.batches import WAIT_S, Batch, Item, Names, Notice
from anisomap.sensor_map import SensorMap

EXTRA = "lsl"

_RESOLVE_S = 1.0  # for one search; it is repeated
_BUFFER_S = 60  # that the library keeps if we are slow


class LslStream:
    """A stream of numbers, found by its name. The library recovers lost connections itself."""

    def __init__(self, name: str) -> None:
        if not name:
            raise InputError("an LSL stream needs a name, as in lsl://NAME")
        self.description = f"LSL stream {name}"
        self.names: tuple[str, ...] = ()
        self.truth: SensorMap | None = None
        self._name = name
        self._lsl = import_extra("pylsl", "reading an LSL stream", EXTRA)

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames."""
        found = self._lsl.resolve_byprop("name", self._name, 1, 0.0)
        if not found:
            yield Notice(f"looking for {self.description}")
        while not found and not stop.is_set():
            found = self._lsl.resolve_byprop("name", self._name, 1, _RESOLVE_S)
        if stop.is_set():
            return
        if found[0].channel_format() == self._lsl.cf_string:
            raise InputError(f"{self.description} holds text; a stream of numbers is needed")
        inlet = self._lsl.StreamInlet(found[0], _BUFFER_S, recover=True)
        yield Notice(f"found {self.description}")
        yield from self._named(inlet)
        last = -np.inf
        while not stop.is_set():
            samples, stamps = inlet.pull_chunk(timeout=WAIT_S)
            if not len(stamps):
                continue
            times = np.asarray(stamps, dtype=np.float64)
            yield Batch(np.asarray(samples, dtype=np.float64), times if times[0] > last else None)
            last = times[-1]
        inlet.close_stream()

    def _named(self, inlet: Any) -> Iterator[Names]:
        info = inlet.info()
        labels = [str(label) for label in info.get_channel_labels() or () if label]
        if len(labels) == info.channel_count():
            yield Names(tuple(labels))
