"""Sources, each with a real peer on this computer."""

import itertools
import json
import os
import socket
import sys
import threading
import time
import uuid
from contextlib import contextmanager, suppress

import numpy as np
import pytest

import anisomap
from anisomap.errors import InputError, MissingExtraError
from anisomap.live.batches import Batch, Names, Notice
from anisomap.live.sources import BOUT_FRAMES, SOURCES, SimulatedHand, open_source
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


@pytest.mark.parametrize("scheme", ["tcp-listen", "udp"])
def test_lines_that_are_sent_to_us(scheme):
    """Lines end with a datagram; a line that a connection cuts is dropped."""
    source, is_udp = open_source(f"{scheme}://127.0.0.1:0"), scheme == "udp"
    with pytest.raises(InputError, match="cannot listen"):
        open_source(f"{scheme}://127.0.0.1:{source.port}")
    with Collected(source) as found:
        found.wait(lambda f: f.told(f"port {source.port}"))
        for begin, until in ((0, 5), (5, 20)):
            part = ROWS[begin:until]
            with socket.socket(type=socket.SOCK_DGRAM if is_udp else socket.SOCK_STREAM) as peer:
                peer.connect(("127.0.0.1", source.port))
                peer.sendall(text(part).rstrip() if is_udp else text(part) + b"1,2")
            found.wait(lambda f, until=until: len(f.rows) == until)
        found.wait_for_rows()


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:{}", "rosbridge://127.0.0.1:{}/skin"])
def test_a_peer_that_is_not_there_yet_is_waited_for(address):
    if address.startswith("rosbridge"):
        pytest.importorskip("websockets", reason="needs the extra 'rosbridge'")
    with collected(address.format(free_port())) as found:
        found.wait(lambda f: f.told("still trying"))


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
        assert found.told("no frame")
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


def test_a_topic_of_rosbridge():
    server = pytest.importorskip("websockets.sync.server", reason="needs the extra 'rosbridge'")
    asked = []

    def answer(connection):
        asked.append(json.loads(connection.recv()))
        connection.send("garbage")
        connection.send(json.dumps({"op": "publish", "topic": "/other", "msg": {"data": [1, 2]}}))
        for i, row in enumerate(ROWS[:10] if len(asked) == 1 else ROWS[10:]):
            stamp = {"sec": 100, "nanosec": i * 1000}
            message = {"header": {"stamp": stamp}, "layout": {"dim": []}, "data": row.tolist()}
            packet = {"op": "publish", "topic": "/skin", "msg": message}
            connection.send(json.dumps(packet))
        if len(asked) > 1:
            with suppress(Exception):
                connection.recv()

    with server.serve(answer, "127.0.0.1", 0) as peer:
        threading.Thread(target=peer.serve_forever, daemon=True).start()
        port = peer.socket.getsockname()[1]
        address = f"rosbridge://127.0.0.1:{port}/skin?type=std_msgs/msg/Float32MultiArray"
        with collected(address) as found:
            found.wait_for_rows()
        peer.shutdown()
    assert found.times[1] == pytest.approx(100.000001)
    assert found.told("lost the connection")
    kind = "std_msgs/msg/Float32MultiArray"
    assert asked[0] == {"op": "subscribe", "topic": "/skin", "type": kind}


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.mark.parametrize("key", ["skin", "0/skin/std_msgs::msg::dds_::Float64MultiArray_/RIHS01_x"])
def test_a_topic_of_zenoh(key):
    zenoh = pytest.importorskip("zenoh", reason="needs the extra 'zenoh'")
    typesys = pytest.importorskip("rosbags.typesys", reason="needs the extra 'zenoh'")
    store = typesys.get_typestore(typesys.Stores.LATEST)
    array, layout = (
        store.types[f"std_msgs/msg/{name}"] for name in ("Float64MultiArray", "MultiArrayLayout")
    )
    config, port = zenoh.Config(), free_port()
    config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    kind = "" if "dds_" in key else "&type=std_msgs/msg/Float64MultiArray"
    address = f"zenoh://{key}?connect=tcp/127.0.0.1:{port}{kind}"
    with zenoh.open(config) as peer:
        publisher = peer.declare_publisher(key)
        with collected(address) as found:
            while not publisher.matching_status.matching:
                time.sleep(0.01)
            publisher.put(b"garbage")
            for row in ROWS:
                message = array(layout=layout(dim=[], data_offset=0), data=row)
                publisher.put(store.serialize_cdr(message, array.__msgtype__).tobytes())
            found.wait_for_rows()
    assert found.told("ignored a message")


def test_a_port_of_yarp():
    """The peer speaks as the documentation of YARP shows; there is no YARP here."""
    lines = itertools.count(1)

    def write(connection, row):
        values = " ".join(map(repr, row[:2])) + " (" + " ".join(map(repr, row[2:])) + ")"
        connection.sendall(f"do {next(lines)} {1e9 + row[0]}\n{values}\n".encode())

    def received(connection, end):
        content = b""
        while end not in content:
            content += connection.recv(4096)
        return content

    with (
        listening() as (names, server),
        listening() as (skin, port),
        collected(f"yarp://127.0.0.1:{server}/skin/torso") as found,
    ):
        for part in (ROWS[:5], ROWS[5:]):
            connection, _ = names.accept()
            with connection:
                assert b"query /skin/torso\n" in received(connection, b"torso\n")
                connection.sendall(
                    b"Welcome anisomap\nregistration name /skin/torso ip 127.0.0.1 port "
                    b"%d type tcp\n*** end of message\n" % port
                )
            connection, _ = skin.accept()
            with connection:
                assert received(connection, b"\nr\n").startswith(b"CONNECT ")
                connection.sendall(b"Welcome anisomap\n")
                for row in part.tolist():
                    write(connection, row)
        found.wait_for_rows()
    assert found.times[0] == pytest.approx(1e9 + ROWS[0, 0], abs=1e-3)


@pytest.mark.parametrize(
    ("address", "library", "extra"),
    [
        ("serial:///dev/ttyNONE", "serial", "serial"),
        ("lsl://skin", "pylsl", "lsl"),
        ("rosbridge://127.0.0.1:9090/skin", "websockets", "rosbridge"),
        ("zenoh://skin", "zenoh", "zenoh"),
    ],
)
def test_a_missing_library_is_named_with_its_command(address, library, extra, monkeypatch):
    for name in [name for name in sys.modules if name.partition(".")[0] == library]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(MissingExtraError, match=rf"pip install .*\[{extra}\]"):
        open_source(address)


def test_every_kind_of_source_has_an_example_that_names_it():
    for scheme, entry in SOURCES.items():
        assert entry.example == "-" or entry.example.startswith(f"{scheme}://")
