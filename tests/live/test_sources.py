"""Sources, each with a real peer on this computer."""

import itertools
import os
import socket
import sys
import threading
import uuid
from contextlib import contextmanager

import numpy as np
import pytest

import anisomap
from anisomap.errors import InputError, MissingExtraError
from anisomap.live.batches import Batch, Names, Notice
from anisomap.live.sources import BOUT_FRAMES, SimulatedHand, open_source
from anisomap.simulation import find_body
from live_processes import LONGEST_S

ROWS = np.round(np.random.default_rng(0).random((20, 4)), 3)


def text(rows):
    return "".join(",".join(map(repr, row)) + "\n" for row in rows.tolist()).encode()


class Collected:
    """What a source yields, collected in a thread until the end of the block."""

    def __init__(self, source):
        self.items, self.stop, self.error = [], threading.Event(), None
        self.arrived = threading.Condition()
        self.thread = threading.Thread(target=self._collect, args=(source,), daemon=True)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.stop.set()
        self.thread.join(LONGEST_S)
        assert not self.thread.is_alive()

    def _collect(self, source):
        try:
            for item in source.items(self.stop):
                with self.arrived:
                    self.items.append(item)
                    self.arrived.notify_all()
        except Exception as error:
            with self.arrived:
                self.error = error
                self.arrived.notify_all()

    def wait(self, condition):
        with self.arrived:
            assert self.arrived.wait_for(lambda: self.error or condition(self), LONGEST_S)
        assert self.error is None, self.error

    def wait_for_rows(self):
        """Wait until all rows have arrived, and nothing else."""
        self.wait(lambda found: len(found.rows) >= len(ROWS))
        np.testing.assert_array_equal(self.rows, ROWS)

    @property
    def rows(self):
        return [row for item in self.items if isinstance(item, Batch) for row in item.readings]

    @property
    def times(self):
        return np.concatenate([item.times for item in self.items if isinstance(item, Batch)])

    def told(self, words):
        return any(isinstance(item, Notice) and words in item.text for item in self.items)


def collected(address):
    return Collected(open_source(address))


@contextmanager
def listening():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        server.settimeout(LONGEST_S)
        yield server, server.getsockname()[1]


def test_a_lost_tcp_connection_is_made_again():
    with listening() as (server, port), collected(f"tcp://127.0.0.1:{port}") as found:
        for part in (ROWS[:5], ROWS[5:]):
            connection, _ = server.accept()
            with connection:
                connection.sendall(text(part) + b"1,2")
        found.wait_for_rows()
        found.wait(lambda f: f.told("lost the connection"))


def test_datagrams_that_are_sent_to_us():
    source = open_source("udp://127.0.0.1:0")
    with pytest.raises(InputError, match="cannot listen"):
        open_source(f"udp://127.0.0.1:{source.port}")
    with Collected(source) as found:
        found.wait(lambda f: f.told(f"port {source.port}"))
        for part in (ROWS[:5], ROWS[5:]):
            with socket.socket(type=socket.SOCK_DGRAM) as peer:
                peer.connect(("127.0.0.1", source.port))
                peer.sendall(text(part).rstrip())  # the last line ends with its datagram
        found.wait_for_rows()


def test_a_peer_that_is_not_there_yet_is_waited_for():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with collected(f"tcp://127.0.0.1:{port}") as found:
        found.wait(lambda f: f.told("still trying"))


def test_standard_input_is_read_to_its_last_line(monkeypatch):
    ours, theirs = os.pipe()
    with os.fdopen(ours) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        os.write(theirs, text(ROWS).rstrip())
        os.close(theirs)
        with collected("-") as found:
            found.wait_for_rows()
            found.wait(lambda f: f.told("standard input has ended"))


@pytest.mark.parametrize("speed", [0, 1000])
def test_a_recording_is_replayed_whole(tmp_path, speed):
    path = tmp_path / "r.npz"
    recording = anisomap.Recording(
        ROWS, names=["a", "b", "c", "d"], rate_hz=10, positions=np.eye(4, 2), units="mm"
    )
    anisomap.write(recording, path)
    source = open_source(str(path), speed=speed)
    assert source.names == ("a", "b", "c", "d")
    assert source.truth.units == "mm"
    with Collected(source) as found:
        found.wait_for_rows()
        found.wait(lambda f: f.told("has ended"))
    np.testing.assert_allclose(found.times, np.arange(20) / 10)


def test_a_simulated_hand_rubs_where_it_is_told():
    body = find_body("sphere")
    source, asked = SimulatedHand(body, speed=0), []
    source.where = lambda: asked.append(7) or ((7,), None)
    batches = list(itertools.islice(source.items(threading.Event()), 60))
    assert [batch.readings.shape for batch in batches] == [(1, body.n_sensors)] * 60
    assert len(asked) == -(-60 // BOUT_FRAMES)
    assert (np.diff([batch.times[0] for batch in batches]) > 0).all()
    np.testing.assert_array_equal(source.truth.positions, body.positions)


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are those of Unix")
def test_a_serial_port():
    pytest.importorskip("serial", reason="needs the extra 'serial'")
    ours, theirs = os.openpty()
    try:
        with collected(f"serial://{os.ttyname(theirs)}?baud=9600") as found:
            os.write(ours, text(ROWS[:3]) + b"\xff\x00garbage\n")
            os.write(ours, text(ROWS[3:]))
            found.wait_for_rows()
        assert found.told("without a frame")
    finally:
        os.close(ours)
        os.close(theirs)


def test_an_lsl_stream():
    lsl = pytest.importorskip("pylsl", reason="needs the extra 'lsl'", exc_type=ImportError)
    name = f"skin-{uuid.uuid4().hex[:8]}"
    info = lsl.StreamInfo(name, "tactile", 4, 100, lsl.cf_double64, name)
    info.set_channel_labels(["a", "b", "c", "d"])
    outlet = lsl.StreamOutlet(info)
    if not lsl.resolve_byprop("name", name, 1, 10):
        pytest.skip("LSL cannot find streams on this computer")
    with collected(f"lsl://{name}") as found:
        assert outlet.wait_for_consumers(LONGEST_S)
        for i, row in enumerate(ROWS):
            outlet.push_sample(row.tolist(), 1000 + i)
        found.wait_for_rows()
    assert Names(("a", "b", "c", "d")) in found.items
    np.testing.assert_allclose(found.times, 1000 + np.arange(20))


@pytest.mark.parametrize(
    ("address", "library", "extra"),
    [("serial:///dev/ttyNONE", "serial", "serial"), ("lsl://skin", "pylsl", "lsl")],
)
def test_a_missing_library_is_named_with_its_command(address, library, extra, monkeypatch):
    for name in [name for name in sys.modules if name.partition(".")[0] == library]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(MissingExtraError, match=rf"pip install .*\[{extra}\]"):
        open_source(address)
