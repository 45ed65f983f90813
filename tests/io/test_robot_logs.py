"""What is read from logs of robots: of YARP, with sessions of several ports, and of CySkin."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import FileError
from texts import COUNT, NAN, READINGS, check, hold

SENT = 1_379_926_523.125 + COUNT / 64


def log(*stamps: Any, brackets: bool = False, end: str = "\n", first: int = 0) -> str:
    lines = []
    for i, values in enumerate(READINGS.tolist()):
        shown = " ".join(map(str, values))
        stamped = " ".join(f"{stamp[i]:.6f}" for stamp in stamps)
        lines.append(f"{first + i} {stamped} {f'({shown})' if brackets else shown}{end}")
    return "".join(lines)


LOGGED = {"readings": READINGS, "times": COUNT / 64, "rate_hz": 64}
HANDLE = (38135, 38136, 38433, 38140, 38433)
"""One address is in two places, as in a published recording of a gripped handle."""
GRIPPED = "1\n5\n" + "".join(
    f"{i} {26.82 + i / 10:f} 5 " + " ".join(f"{a} {i * k}" for k, a in enumerate(HANDLE)) + "\n"
    for i in range(30)
)
LOGS = [
    *(
        hold(
            log(*stamps, brackets=brackets, end=end, first=first),
            **LOGGED,
            metadata={"stamps": len(stamps)},
        )
        for brackets, first in ((False, 0), (True, 4711))
        for end in ("\n", " \n", "\r\n")
        for stamps in ((SENT,), (SENT, SENT + 0.001), (SENT, SENT - 3e8))
    ),
    *(
        hold(log(*stamps), **LOGGED, metadata={"stamps": len(stamps)})
        for stamps in ((COUNT / 64,), (COUNT / 64, COUNT / 64 + 0.002))
    ),
    hold(log(np.full(30, SENT[0]), SENT), **LOGGED),
    # The sender's stamps are valid in the rows that are inspected before reading.
    hold(
        "".join(
            f"{i} {1.3e9 + i / 50 - (i == 1500):.2f} {1.3e9 + i / 50 + 0.01:.2f} {i % 9} 2\n"
            for i in range(2000)
        ),
        times=np.arange(2000) / 50,
    ),
    hold(
        log(np.where(COUNT == 7, SENT[6], SENT)),
        readings=READINGS,
        times=None,
        warns="data\\.log.*frame 7 \\(line 8\\)",
    ),
    hold("".join((f"{i} {t:.6f} {1e6 + i} {i}\n" for i, t in enumerate(SENT))), n_sensors=2),
    hold("".join((f"{i} {t:.6f} {t:.6f}\n" for i, t in enumerate(SENT))), n_sensors=1),
    hold("time,a,b\n0.1,1,2\n0.2,3,4\n", names=("a", "b")),
    hold(log(SENT).rstrip("\n"), readings=READINGS),
    hold(
        "".join(f"{i} {1.3e9 + i / 50:.2f} 1 2 3\n" for i in range(3000)) + "3000 13",
        n_frames=3000,
        warns="truncated and dropped",
    ),
    hold(
        "7 8 9 \n0 0.600000 1 43000 2\n1 0.700000 3 4 65535\n",
        names=("7", "8", "9"),
        readings=[[1, NAN, 2], [3, 4, NAN]],
    ),
    hold(
        GRIPPED,
        names=("38135", "38136", "38433", "38140", "38433_2"),
        readings=COUNT[:, None] * np.arange(5),
        times=COUNT / 10,
        warns="names of several sensors: 38433",
    ),
]
"""Logs of YARP and CySkin."""


@pytest.mark.parametrize(("text", "facts"), LOGS, ids=range(len(LOGS)))
def test_what_a_log_holds(put, text: str, facts: dict[str, Any]) -> None:
    check(put("data.log", text), facts)


def calibration(**changes: object) -> str:
    taxels = [
        {"id": address, "x": [k / 100, 0.0, k % 2], "n": [0, 0, 1], "type": "pressure"}
        for k, address in enumerate(HANDLE)
    ]
    taxels[1].update(changes)
    return json.dumps({"info": {"file_version": "2"}, "skin": {"taxels": taxels, "faces": []}})


@pytest.mark.filterwarnings("ignore:.*names of several sensors")
def test_a_recording_with_its_calibration(put) -> None:
    truth = put("handle.json", calibration())
    found = io.read(put("hand.txt", GRIPPED), options=io.ReadOptions(positions=truth))
    np.testing.assert_array_equal(found.positions[:, 0], np.arange(5) / 100)
    assert found.units == "m"
    for normal, expected in (([0, 3, 4], [0, 0.6, 0.8]), ([0, 0, 0], [NAN] * 3), ("up", None)):
        normals = io.read_map(put("handle.json", calibration(n=normal))).normals
        np.testing.assert_array_equal(normals[0], [0, 0, 1])
        np.testing.assert_allclose(normals[1], expected or [NAN] * 3)


def session(put, tmp_path: Path, **ports: str) -> Path:
    for port, text in ports.items():
        (tmp_path / "run" / port).mkdir(parents=True)
        put(f"run/{port}/data.log", text)
        put(f"run/{port}/info.log", f"Type: Bottle;\n[1.5] /icub/skin/{port} [connected]\n")
    return tmp_path / "run"


def test_a_session_with_one_port(put, tmp_path: Path) -> None:
    found = io.read(session(put, tmp_path, left_hand=log(SENT)))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.metadata["port"] == "/icub/skin/left_hand"
    assert found.source == "run/left_hand"


@pytest.mark.parametrize("select", ["left_arm", "/icub/skin/left_arm"])
def test_a_session_with_several_ports(put, tmp_path: Path, select: str) -> None:
    folder = session(put, tmp_path, left_arm=log(SENT), left_hand=log(SENT))
    with pytest.raises(io.ChoiceError, match=r"2 possible.*left_arm \(/icub/skin/left_arm\)"):
        io.read(folder)
    assert [content.name for content in io.contents(folder)] == ["left_arm", "left_hand"]
    found = io.read(folder, options=io.ReadOptions(select=select))
    assert found.metadata["port"] == "/icub/skin/left_arm"
    with pytest.raises(FileError, match=r"there is no port 'torso'; it holds left_arm"):
        io.read(folder, options=io.ReadOptions(select="torso"))


@pytest.mark.parametrize("late", [-0.4, -0.004, 0.0, 0.004, 0.31])
def test_ports_are_joined_by_latest_readings(put, tmp_path: Path, late: float) -> None:
    folder = session(put, tmp_path, torso=log(SENT), arm=log(SENT + late), leg=log(SENT + 100))
    options = io.ReadOptions(select="torso, arm")
    found = io.read(folder, options=options)
    assert found.names == tuple(f"{port}/s{i}" for port in ("torso", "arm") for i in range(4))
    pairs = [
        (i, max(j for j in range(30) if SENT[j] + late <= SENT[i]))
        for i in range(30)
        if SENT[0] + late <= SENT[i] <= SENT[-1] + late
    ]
    expected = [np.hstack([READINGS[i], READINGS[j]]) for i, j in pairs]
    np.testing.assert_array_equal(found.readings, expected)
    with io.open_stream(folder, frames=3, options=options) as stream:
        in_blocks = np.vstack([block.readings for block in stream.blocks])
    np.testing.assert_array_equal(in_blocks, expected)
    with pytest.raises(FileError, match="the recordings torso, leg do not overlap in time"):
        io.read(folder, options=io.ReadOptions(select="torso,leg"))
