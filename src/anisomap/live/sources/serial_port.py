"""Lines of text from a serial port, with pyserial."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from threading import Event
from typing import Any

from anisomap.errors import InputError
from anisomap.extras import import_extra
from anisomap.live.batches import WAIT_S, Item, Notice
from anisomap.live.sources.text_lines import LineParser
from anisomap.sensor_map import SensorMap

EXTRA = "serial"

_BAUD = 115_200
_RETRY_S = 1.0  # between two attempts to open a port that was unplugged
_READ_BYTES = 1 << 16


class SerialPort:
    """A serial port, which is opened again when it was unplugged.

    Parameters
    ----------
    device : str
        Such as ``/dev/ttyUSB0``; on Windows ``COM3``.
    query : mapping of str to str
        ``baud``: symbols per second, 115200 by default.
    """

    def __init__(self, device: str, query: Mapping[str, str]) -> None:
        self.description = f"serial port {device}"
        self.names: tuple[str, ...] = ()
        self.truth: SensorMap | None = None
        self._serial = import_extra("serial", "reading a serial port", EXTRA)
        self._device, baud = device, query.get("baud", str(_BAUD))
        if not baud.isdecimal() or int(baud) < 1:
            raise InputError(f"baud must be a number of symbols per second, got {baud!r}")
        self._baud = int(baud)
        try:
            self._port = self._open()
        except (OSError, ValueError) as error:  # SerialException is an OSError
            raise InputError(f"cannot open {self.description}: {error}") from error

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames."""
        port, parser = self._port, LineParser()
        while not stop.is_set():
            try:
                if port is None:
                    port = self._open()
                    parser = LineParser()
                    yield Notice(f"{self.description} is open again")
                content = port.read(max(1, min(port.in_waiting, _READ_BYTES)))
            except (OSError, TypeError):  # TypeError: pyserial, if the port is closed meanwhile
                if port is not None:
                    port.close()
                    port = None
                    yield Notice(f"lost {self.description}; opening it again")
                stop.wait(_RETRY_S)
                continue
            yield from parser.feed(content)
        if port is not None:
            port.close()

    def _open(self) -> Any:
        return self._serial.Serial(self._device, self._baud, timeout=WAIT_S)
