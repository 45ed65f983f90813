"""Whole sessions in processes of their own, with real peers, which misbehave."""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import anisomap
from live_processes import LONGEST_S, LiveProcess, wait_until
from skins import flat_skin

if sys.platform == "win32":
    pytest.skip("signals are those of Unix", allow_module_level=True)

FILE = ("--headless", "--recording", "r.csv")
SKIN = flat_skin(n_frames=600)


def lines_of(recording):
    return [",".join(map(repr, row)) for row in recording.readings.astype(float).tolist()]


LINES = lines_of(SKIN)


def text(lines):
    return ("\n".join(lines) + "\n").encode()


@pytest.fixture
def server():
    """Listen for a session, and accept it as often as it connects."""
    with socket.create_server(("127.0.0.1", 0)) as made:
        made.settimeout(LONGEST_S)
        yield made


def address(server):
    return f"tcp://127.0.0.1:{server.getsockname()[1]}"


def accepted(server):
    connection, _ = server.accept()
    connection.settimeout(LONGEST_S)
    return connection


@pytest.fixture
def session(tmp_path):
    started = []

    def start(*arguments, **options):
        started.append(LiveProcess(tmp_path, *arguments, **options))
        return started[-1]

    yield start
    for one in started:
        one.close()


@pytest.mark.slow
def test_a_skin_that_misbehaves_is_recorded_whole_and_mapped(session, server, tmp_path):
    live = session(address(server), *FILE)
    names = [f"taxel {i}" for i in range(42)]
    missing = ",".join(["nan", *LINES[99].split(",")[1:]])
    with accepted(server) as peer:
        peer.sendall(text([",".join(names), *LINES[:99], missing]))
        peer.sendall(b"\xff\xfe garbage\n" + b"x" * 3000 + b"\n1,2,3\n\n[1, 2\n")
        peer.sendall(text(LINES[100:300]) + LINES[0][:30].encode())  # cut in the last line
    with accepted(server) as peer:
        for begin in range(300, 600, 50):
            peer.sendall(text(LINES[begin : begin + 50]))
        found = live.wait_for(lambda event: event["frames"] == 600)
    for told in ("without a frame", "taxel 0 sent no number", "lost the connection"):
        assert any(told in notice for notice in found["notices"])
    code, said = live.end(signal.SIGINT)
    assert code == 0
    assert "Traceback" not in said

    recorded = anisomap.read(tmp_path / "r.csv")
    expected = SKIN.readings.astype(float).copy()
    expected[99, 0] = np.nan
    assert list(recorded.names) == names
    np.testing.assert_array_equal(recorded.readings, expected)
    made = anisomap.read_map(tmp_path / "r.map.csv")
    again = anisomap.reconstruct(recorded.complete("interpolate"))
    np.testing.assert_allclose(made.positions, again.positions, atol=1e-6)
    assert live.result["frames"] == 600


def test_a_killed_session_leaves_its_recording_and_no_process(session, tmp_path):
    live = session("udp://127.0.0.1:0", *FILE)
    port, children = live.port("waiting for datagrams"), live.children()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        for line in LINES[:40]:  # few enough for the buffer of any system
            peer.sendto(line.encode(), ("127.0.0.1", port))
    path = tmp_path / "r.csv"
    wait_until(lambda: path.exists() and path.read_text().endswith(f"{LINES[39]}\n"))
    code, _ = live.end(signal.SIGKILL)
    assert code == -signal.SIGKILL
    np.testing.assert_array_equal(anisomap.read(path).readings, SKIN.readings[:40].astype(float))
    wait_until(lambda: not any(is_alive(pid) for pid in children), "the end of the processes")
    again = session("-", *FILE, stdin=subprocess.DEVNULL)
    assert again.join()[0] == 2
    assert "map both together, as in anisomap map r.csv" in again.lines[0]


def test_the_duration_counts_from_the_first_frame(session, server):
    live = session(address(server), *FILE, "--for", "0.5")
    with accepted(server) as peer:
        live.wait_for(lambda event: event["seconds"] > 2)  # longer than the duration
        peer.sendall(text(LINES[:100]))
        code, said = live.join()
    assert code == 0, said
    assert live.result["frames"] == 100


def is_alive(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


@pytest.mark.slow
def test_a_flood_loses_nothing(session, tmp_path):
    n_frames, skin = 8_000, [line.partition(",")[2] for line in LINES]
    flood = tmp_path / "flood.txt"
    flood.write_bytes(text([f"{500 * i % 977}.0,{skin[i % 600]}" for i in range(n_frames)]))
    with flood.open("rb") as lines:
        live = session("-", *FILE, stdin=lines)
        code, said = live.join()
    assert code == 0, said
    readings = anisomap.read(tmp_path / "r.csv").readings
    assert readings.shape == (n_frames, 42)
    np.testing.assert_array_equal(readings[:, 0], 500 * np.arange(n_frames) % 977)
    assert live.result["final"]
    assert "Traceback" not in said


@pytest.mark.slow
def test_a_session_ends_when_the_map_is_usable(session, server, tmp_path):
    skin = flat_skin(n_frames=6000)
    lines = lines_of(skin)
    anisomap.write(anisomap.SensorMap(skin.positions, names=skin.names), tmp_path / "truth.csv")
    until = ("--until", "usable", "-d", "2", "--truth", "truth.csv")
    live = session(address(server), *until, *FILE)
    with accepted(server) as peer:
        with suppress(ConnectionError):  # when the session has ended
            for begin in range(0, 6000, 200):
                peer.sendall(text(lines[begin : begin + 200]))
                time.sleep(0.2)
        code, said = live.join()  # the peer stays connected
    assert code == 0, said
    assert live.result["final"]
    assert live.result["error_against_truth"] < 0.5


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_a_signal_is_the_ordinary_end(session, server, tmp_path, number):
    live = session(address(server), "--no-browser", "--port", "0", "--recording", "r.csv")
    with accepted(server) as peer:
        peer.sendall(text(LINES[:200]))
        wait_until((tmp_path / "r.csv").exists)
        os.killpg(live.process.pid, number)  # as a terminal or systemd sends it
        code, said = live.join()
    assert (code, "Traceback" in said) == (0, False)
    assert live.result["final"]
    assert {path.name for path in tmp_path.iterdir()} == {"r.csv", "r.html", "r.map.csv"}


def test_a_second_interruption_leaves_out_the_final_map(session, server, tmp_path):
    live = session(address(server), *FILE)
    with accepted(server) as peer:
        peer.sendall(text(LINES[:200]))
        live.wait_for(lambda event: event["frames"] == 200)
        workers = live.children()
        for pid in workers:  # no final map is ready before the second interruption
            os.kill(pid, signal.SIGSTOP)
        live.process.send_signal(signal.SIGINT)
        assert peer.recv(1) == b""  # the session has ended
    live.process.send_signal(signal.SIGINT)
    wait_until(lambda: any("the recording is complete" in line for line in live.said))
    for pid in workers:
        os.kill(pid, signal.SIGCONT)
    code, said = live.join()
    assert code == 0, said
    assert not live.result["final"]
    assert anisomap.read(tmp_path / "r.csv").n_frames == 200
    assert not (tmp_path / "r.map.csv").exists()
