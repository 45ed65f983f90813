"""Logs of yarpdatadumper and of CySkin, and calibrations of CySkin with the positions."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import AnisomapWarning, FileError

READINGS = np.random.default_rng(7).integers(0, 256, (40, 6)).astype(float)
CLOCK = np.arange(40) / 64  # of a simulator
SENT = 1_379_926_523.125 + CLOCK
Put = Callable[[str, str | bytes], Path]


def log(*stamps: np.ndarray, brackets: bool = False, end: str = "\n", first: int = 0) -> str:
    lines = []
    for i, values in enumerate(READINGS):
        shown = " ".join(f"{value:.1f}" for value in values)
        stamped = " ".join(f"{stamp[i]:.6f}" for stamp in stamps)
        lines.append(f"{first + i} {stamped} {f'({shown})' if brackets else shown}{end}")
    return "".join(lines)


@pytest.mark.parametrize("brackets", [False, True])
@pytest.mark.parametrize("stamps", [(SENT,), (SENT, SENT + 0.001), (SENT, SENT - 3e8)])
@pytest.mark.parametrize("end", ["\n", " \n", "\r\n"])
def test_stamps_and_brackets(put: Put, brackets: bool, stamps, end: str) -> None:
    for name, first in (("data.log", 0), ("left_hand.txt", 4711)):
        found = io.read(put(name, log(*stamps, brackets=brackets, end=end, first=first)))
        np.testing.assert_array_equal(found.readings, READINGS)
        np.testing.assert_array_equal(found.times, CLOCK)
        assert found.rate_hz == 64
        assert found.metadata["stamps"] == len(stamps)


@pytest.mark.parametrize("stamps", [(CLOCK,), (CLOCK, CLOCK + 0.002)])
def test_stamps_of_a_simulator(put: Put, stamps) -> None:
    found = io.read(put("data.log", log(*stamps)))
    np.testing.assert_array_equal(found.readings, READINGS)
    np.testing.assert_array_equal(found.times, CLOCK)
    assert found.metadata["stamps"] == len(stamps)


def test_receiver_stamps_replace_constant_sender_stamps(put: Put) -> None:
    found = io.read(put("data.log", log(np.full(40, SENT[0]), SENT)))
    np.testing.assert_array_equal(found.times, np.arange(40) / 64)


def test_stamps_that_do_not_increase(put: Put) -> None:
    stamps = SENT.copy()
    stamps[7] = stamps[6]
    with pytest.warns(AnisomapWarning, match=r"data\.log.*frame 7 \(line 8\)"):
        found = io.read(put("data.log", log(stamps)))
    assert found.times is None
    np.testing.assert_array_equal(found.readings, READINGS)


def test_large_values_are_not_stamps(put: Put) -> None:
    text = "".join(f"{i} {stamp:.6f} {1e6 + i} {i}\n" for i, stamp in enumerate(SENT))
    assert io.read(put("data.log", text)).n_sensors == 2


def test_a_table_named_data_log(put: Put) -> None:
    found = io.read(put("data.log", "time,a,b\n0.1,1,2\n0.2,3,4\n"))
    assert found.names == ("a", "b")
    assert "format" not in found.metadata


def test_a_missing_newline_is_not_damage(put: Put) -> None:
    assert io.read(put("data.log", log(SENT).rstrip("\n"))).n_frames == 40


def test_a_single_value_that_resembles_a_stamp(put: Put) -> None:
    text = "".join(f"{i} {stamp:.6f} {stamp:.6f}\n" for i, stamp in enumerate(SENT))
    assert io.read(put("data.log", text)).n_sensors == 1


def session(put: Put, tmp_path: Path, **ports: str) -> Path:
    for port, text in ports.items():
        (tmp_path / "run" / port).mkdir(parents=True)
        put(f"run/{port}/data.log", text)
        put(f"run/{port}/info.log", f"Type: Bottle;\n[1.5] /icub/skin/{port} [connected]\n")
    return tmp_path / "run"


def test_a_session_with_one_port(put: Put, tmp_path: Path) -> None:
    found = io.read(session(put, tmp_path, left_hand=log(SENT)))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.metadata["port"] == "/icub/skin/left_hand"
    assert found.source == "run/left_hand"


@pytest.mark.parametrize("select", ["left_arm", "/icub/skin/left_arm"])
def test_a_session_with_several_ports(put: Put, tmp_path: Path, select: str) -> None:
    late = log(SENT).replace(" ", " ", 1)
    folder = session(put, tmp_path, left_arm=log(SENT), left_hand=late)
    with pytest.raises(io.ChoiceError, match=r"2 possible.*left_arm \(/icub/skin/left_arm\)"):
        io.read(folder)
    assert [content.name for content in io.contents(folder)] == ["left_arm", "left_hand"]
    found = io.read(folder, options=io.ReadOptions(select=select))
    assert found.metadata["port"] == "/icub/skin/left_arm"
    with pytest.raises(FileError, match=r"there is no port 'torso'; the file holds left_arm"):
        io.read(folder, options=io.ReadOptions(select="torso"))


@pytest.mark.parametrize("late", [-0.5, -0.004, 0.0, 0.004, 0.31])
def test_ports_are_joined_by_latest_readings(put: Put, tmp_path: Path, late: float) -> None:
    folder = session(put, tmp_path, torso=log(SENT), arm=log(SENT + late))
    options = io.ReadOptions(select="torso, arm")
    found = io.read(folder, options=options)
    assert found.names == tuple(f"{port}/s{i}" for port in ("torso", "arm") for i in range(6))
    pairs = [
        (i, max(j for j in range(40) if SENT[j] + late <= SENT[i]))
        for i in range(40)
        if SENT[0] + late <= SENT[i] <= SENT[-1] + late
    ]
    expected = [np.hstack([READINGS[i], READINGS[j]]) for i, j in pairs]
    np.testing.assert_array_equal(found.readings, expected)
    with io.open_stream(folder, frames=3, options=options) as stream:
        in_blocks = np.vstack([block.readings for block in stream.blocks])
    np.testing.assert_array_equal(in_blocks, expected)


def test_ports_that_do_not_overlap(put: Put, tmp_path: Path) -> None:
    folder = session(put, tmp_path, torso=log(SENT), arm=log(SENT + 100))
    with pytest.raises(FileError, match="the recordings torso, arm do not overlap in time"):
        io.read(folder, options=io.ReadOptions(select="torso,arm"))


def test_receiver_stamps_replace_sender_stamps_that_step_back(put: Put) -> None:
    """The sender's stamps are valid in the rows inspected before reading."""
    lines = [
        f"{i} {1.3e9 + t - (i == 1500):.2f} {1.3e9 + t + 0.01:.2f} {i % 9} 2\n"
        for i, t in enumerate(np.arange(2000) / 50)
    ]
    found = io.read(put("data.log", "".join(lines)))
    np.testing.assert_allclose(found.times, np.arange(2000) / 50, atol=1e-5)


class TestContacts:
    """Logs of the port skin_events: contacts with a skin part and its active taxels."""

    VECTORS = "(0.0 0.0 0.0) (1.5 -2.0 0.0) (0.0 0.0 0.0) (0.0 0.0 0.0) (0.0 0.0 1.0)"

    def contact(self, part: int, *taxels: int, names: str = "") -> str:
        listed = " ".join(map(str, taxels))
        return f"((3 {part // 3 + 1} 2 {part}) {self.VECTORS} ({listed}) 21.5{names})"

    def log(self, *contacts: str) -> str:
        lines = [f"{i} {1.4e9 + i / 8:.6f} {text}".rstrip() for i, text in enumerate(contacts)]
        return "\n".join(lines) + "\n"

    def test_one_skin_part(self, put: Put, tmp_path: Path) -> None:
        text = self.log("", "()", self.contact(5, 97, 4), self.contact(5, 4), "")
        (tmp_path / "skin").mkdir()
        for path in (put("skin_events.log", text), put("skin/data.log", text).parent):
            found = io.read(path)
            assert found.names == ("taxel4", "taxel97")
            np.testing.assert_array_equal(found.readings, [[0, 0], [0, 0], [1, 1], [1, 0], [0, 0]])
            np.testing.assert_array_equal(found.times, np.arange(5) / 8)
            assert found.metadata["skin_parts"] == "r_forearm"

    def test_several_skin_parts(self, put: Put) -> None:
        both = f"{self.contact(5, 4)} {self.contact(2, 8, names=' (l_fore frame)')}"
        path = put("skin_events.log", self.log(both, self.contact(2, 9)))
        listed = [(content.name, content.summary) for content in io.contents(path)]
        assert listed == [
            ("r_forearm", "contacts of 1 taxels"),
            ("l_forearm", "contacts of 2 taxels"),
        ]
        with pytest.raises(io.ChoiceError, match="2 possible recordings"):
            io.read(path)
        left = io.read(path, options=io.ReadOptions(select="l_forearm"))
        assert left.names == ("taxel8", "taxel9")
        np.testing.assert_array_equal(left.readings, np.eye(2))
        joined = io.read(path, options=io.ReadOptions(select="l_forearm, r_forearm"))
        assert joined.names == ("l_forearm/taxel8", "l_forearm/taxel9", "r_forearm/taxel4")
        np.testing.assert_array_equal(joined.readings, [[1, 0, 1], [0, 1, 0]])

    def test_a_truncated_contact_is_dropped(self, put: Put) -> None:
        text = self.log(self.contact(5, 3, 4), self.contact(5, 4), self.contact(5, 8))
        with pytest.warns(AnisomapWarning, match="last line is truncated and dropped"):
            found = io.read(put("skin_events.log", text[:-9]))
        np.testing.assert_array_equal(found.readings, [[1, 1], [0, 1]])


ADDRESSES = (38135, 38136, 38433, 38140, 38433)
"""One address is in two places, as in a published recording of a gripped handle."""
RESPONSES = np.random.default_rng(4).integers(0, 900, (30, 5)).astype(float)
NAMES = ("38135", "38136", "38433", "38140", "38433_2")


def recorded(addresses=ADDRESSES, readings: np.ndarray = RESPONSES) -> str:
    rows = [
        f"{i} {26.82 + i / 10:f} {len(addresses)} "
        + " ".join(f"{a} {v:.0f}" for a, v in zip(addresses, row, strict=True))
        for i, row in enumerate(readings)
    ]
    return "\n".join(["1", str(len(addresses)), *rows]) + "\n"


def calibration(addresses=ADDRESSES, **changes: object) -> str:
    taxels = [
        {"id": address, "x": [k / 100, 0.0, k % 2], "n": [0, 0, 1], "type": "pressure", "cut": 0}
        for k, address in enumerate(addresses)
    ]
    taxels[1].update(changes)
    return json.dumps({"info": {"file_version": "2"}, "skin": {"taxels": taxels, "faces": []}})


def test_a_recording_with_its_calibration(put: Put) -> None:
    truth = put("handle.json", calibration())
    with pytest.warns(AnisomapWarning, match="several sensors have the name 38433"):
        found = io.read(put("hand.txt", recorded()), options=io.ReadOptions(positions=truth))
    np.testing.assert_array_equal(found.readings, RESPONSES)
    np.testing.assert_allclose(found.times, np.arange(30) / 10, atol=1e-9)
    assert found.names == NAMES
    np.testing.assert_array_equal(found.positions[:, 0], np.arange(5) / 100)
    assert found.units == "m"


def test_errors_of_sensors_are_missing_readings(put: Put) -> None:
    found = io.read(put("skin_data.txt", "7 8 9 \n0 0.600000 1 43000 2\n1 0.700000 3 4 65535\n"))
    assert found.names == ("7", "8", "9")
    np.testing.assert_array_equal(found.readings, [[1, np.nan, 2], [3, 4, np.nan]])


def test_normals_become_unit_vectors(put: Put) -> None:
    for normal, expected in (([0, 3, 4], [0, 0.6, 0.8]), ([0, 0, 0], [np.nan] * 3), ("up", None)):
        found = io.read_map(put("handle.json", calibration((7, 8, 9), n=normal)))
        np.testing.assert_array_equal(found.normals[0], [0, 0, 1])
        np.testing.assert_allclose(found.normals[1], expected or [np.nan] * 3)


def test_a_calibration_is_no_recording(put: Put) -> None:
    with pytest.raises(FileError, match=r"handle\.json .*CySkin calibration.* holds no recording"):
        io.read(put("handle.json", calibration((7, 8, 9))))
