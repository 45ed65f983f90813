"""ROS 1 and ROS 2 bags and MCAP: all message types of tactile sensors, and files that were cut."""

import sqlite3
from collections.abc import Iterable, Iterator
from itertools import starmap
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import AnisomapWarning, FileError
from bags import DEFINITIONS, Bag

READINGS = np.random.default_rng(8).integers(0, 9, (60, 6)).astype(np.float64)
KINDS = ["bag", "mcap"]  # a db3 holds the same messages as an mcap


def select(name: str, *definitions: Path) -> io.ReadOptions:
    return io.ReadOptions(select=name, definitions=definitions)


@pytest.fixture(params=KINDS)
def bag(request: pytest.FixtureRequest) -> Bag:
    return Bag(request.param)


def written(bag: Bag, folder: Path, topic: str, messages: Iterable[Any]) -> Path:
    """Write one message per frame."""
    for i, message in enumerate(messages):
        bag.add(topic, message, i)
    return bag.write(folder / f"run.{bag.kind}")


def test_arrays(bag: Bag, tmp_path: Path) -> None:
    for i in range(60):
        bag.add("/log", bag.make("std_msgs/String", data="all is well"), i)
    found = io.read(written(bag, tmp_path, "/skin", map(bag.array, READINGS)))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names == ("s0", "s1", "s2", "s3", "s4", "s5")
    assert found.source == f"run.{bag.kind}:/skin"
    # Without a stamp, the time of a message is that of its receipt.
    expected = np.arange(60) / 50 + 1e-3 * (np.arange(60) % 3)
    np.testing.assert_allclose(found.times, expected, atol=1e-8)


def tactile_states(bag: Bag) -> Iterator[Any]:
    for i, row in enumerate(READINGS):
        parts = [
            bag.make("sensor_msgs/ChannelFloat32", name=name, values=values.astype(np.float32))
            for name, values in (("palm", row[:4]), ("thumb", row[4:]))
        ]
        yield bag.make("tactile_msgs/TactileState", header=bag.header(i), sensors=parts)


def test_tactile_state(bag: Bag, tmp_path: Path) -> None:
    found = io.read(written(bag, tmp_path, "/tactile", tactile_states(bag)))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names == ("palm.0", "palm.1", "palm.2", "palm.3", "thumb.0", "thumb.1")
    np.testing.assert_allclose(found.times, np.arange(60) / 50, atol=1e-8)


@pytest.mark.parametrize("start", [10, 32_765, 65_500])
def test_xela_counters_overflow(bag: Bag, tmp_path: Path, start: int) -> None:
    """The server counts from 0 to 65535, and the message declares signed integers."""

    def message(counters: list[int]) -> Any:
        taxels = [bag.make("xela_server_ros2/Taxel", x=0, y=1, z=value) for value in counters]
        sensors = [
            bag.make("xela_server_ros2/SensorFull", sensor_pos=n + 1, taxels=part)
            for n, part in enumerate((taxels[:4], taxels[4:]))
        ]
        return bag.make("xela_server_ros2/SensStream", sensors=sensors)

    counters = (start + 40 * READINGS).astype(np.int64).astype(np.uint16).view(np.int16)
    path = written(bag, tmp_path, "/xServTopic", map(message, counters.tolist()))
    with pytest.warns(AnisomapWarning, match="6 taxels with three axes: z is read"):
        found = io.read(path)
    np.testing.assert_array_equal(found.readings, 40 * (READINGS - READINGS[0]))
    assert found.names == (
        "sensor1.0",
        "sensor1.1",
        "sensor1.2",
        "sensor1.3",
        "sensor2.0",
        "sensor2.1",
    )
    other = io.read(path, options=select("/xServTopic:sensors.taxels.y"))
    assert not other.readings.any()


def test_biotac(bag: Bag, tmp_path: Path) -> None:
    def message(i: int, hand: np.ndarray) -> Any:
        tips = [bag.make("sr_robot_msgs/Biotac", pdc=7, electrodes=tip) for tip in hand]
        return bag.make("sr_robot_msgs/BiotacAll", header=bag.header(i), tactiles=tips)

    electrodes = np.random.default_rng(0).integers(0, 4096, (40, 5, 19)).astype(np.int16)
    path = written(bag, tmp_path, "/rh/tactile", starmap(message, enumerate(electrodes)))
    found = io.read(path)
    np.testing.assert_array_equal(found.readings, electrodes.reshape(40, 95))
    assert found.names[:2] == ("tactile0.0", "tactile0.1")
    assert found.names[-1] == "tactile4.18"
    assert (io.read(path, options=select("/rh/tactile:tactiles.pdc")).readings == 7).all()


def test_one_message_per_skin_cell(bag: Bag, tmp_path: Path) -> None:
    cells = {7: slice(0, 3), 2: slice(3, 6)}
    for i, row in enumerate(READINGS):
        for cell, part in cells.items():
            if (i, cell) in {(0, 2), (31, 7)}:
                continue  # one cell starts late, and another loses a message
            message = bag.make(
                "tum_ics_skin_msgs/SkinCellData",
                cellId=cell,
                prox=np.zeros(1, np.float32),
                force=row[part].astype(np.float32),
            )
            bag.add("/patch1", message, 2 * i + (cell == 2), rate=100.0)
    found = io.read(bag.write(tmp_path / f"run.{bag.kind}"))
    assert found.names == ("cell7.0", "cell7.1", "cell7.2", "cell2.0", "cell2.1", "cell2.2")
    held = READINGS.copy()
    held[31, cells[7]] = held[30, cells[7]]
    assert 57 <= found.n_frames <= 60
    rows = {tuple(row) for row in held.tolist()}
    mixed = [tuple(row) not in rows for row in found.readings.tolist()]
    assert sum(mixed) <= 2, "a round mixes frames only where a message is missing"


def test_taxel_arrays_have_positions(bag: Bag, tmp_path: Path) -> None:
    def message(i: int, row: np.ndarray) -> Any:
        fields = {f"centers_{axis}": centres[n] for n, axis in enumerate("xyz")}
        fields |= {f"values_{axis}": row * normals[n] for n, axis in enumerate("xyz")}
        return bag.make("m3skin_ros/TaxelArray", header=bag.header(i), **fields)

    centres = np.random.default_rng(0).normal(size=(3, 6))
    normals = centres / np.linalg.norm(centres, axis=0)
    found = io.read(written(bag, tmp_path, "/skin", starmap(message, enumerate(READINGS))))
    np.testing.assert_allclose(found.readings, READINGS, atol=1e-12)
    np.testing.assert_array_equal(found.positions, centres.T)
    assert found.units == "m"


@pytest.mark.parametrize(
    "encoded",
    [("mono8", "u1", 1, 0), ("16UC1", "<u2", 1, 5), ("32FC1", "<f4", 1, 0), ("bgr8", "u1", 3, 5)],
)
def test_images_have_one_sensor_per_pixel(
    bag: Bag, tmp_path: Path, encoded: tuple[str, str, int, int]
) -> None:
    encoding, dtype, channels, padding = encoded

    def image(i: int, row: np.ndarray) -> Any:
        pixels = np.repeat(row.astype(dtype).reshape(2, 3, 1), channels, axis=2)
        lines = np.pad(pixels.reshape(2, -1).view(np.uint8), ((0, 0), (0, padding)))
        size = {"height": 2, "width": 3, "step": lines.shape[1], "encoding": encoding}
        data = {"header": bag.header(i), "is_bigendian": 0, "data": lines.ravel()}
        return bag.make("sensor_msgs/Image", **size, **data)

    found = io.read(written(bag, tmp_path, "/camera", starmap(image, enumerate(READINGS))))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names[:4] == ("r0c0", "r0c1", "r0c2", "r1c0")
    assert found.positions.tolist()[3] == [0, 1]


def test_ranges_of_several_topics_are_joined(bag: Bag, tmp_path: Path) -> None:
    for i, row in enumerate(READINGS):
        for n, value in enumerate(row):
            fields = dict.fromkeys(("field_of_view", "min_range", "max_range"), 1.0)
            message = bag.make(
                "sensor_msgs/Range",
                header=bag.header(i),
                radiation_type=0,
                range=float(value),
                **fields,
                **({"variance": 0.0} if "variance" in _fields(bag, "Range") else {}),
            )
            bag.add(f"/range/{n}", message, i)
    path = bag.write(tmp_path / f"run.{bag.kind}")
    with pytest.raises(io.ChoiceError, match="6 possible recordings"):
        io.read(path)
    found = io.read(path, options=select("/range/*"))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names == tuple(f"/range/{n}/range" for n in range(6))
    some = io.read(path, options=select("/range/4,/range/1"))
    np.testing.assert_array_equal(some.readings, READINGS[:, [4, 1]])


def test_types_of_known_names_and_other_fields(bag: Bag, tmp_path: Path) -> None:
    values = {f"values_{axis}": np.ones(3) for axis in "xyz"}
    for i in range(3):
        bag.add("/skin", bag.make("lab_msgs/TaxelArray", **values), i)
        bag.add("/cells", bag.make("lab_msgs/SkinCellData", force=np.ones(2, "f4")), i)
    path = bag.write(tmp_path / f"run.{bag.kind}")
    with pytest.raises(FileError, match=r"/skin lacks a field of its type .*centers_x"):
        io.read(path, options=select("/skin"))
    assert io.read(path, options=select("/cells")).n_sensors == 2


def _fields(bag: Bag, name: str) -> set[str]:
    return {field for field, _ in bag.store.fielddefs[f"sensor_msgs/msg/{name}"][1]}


def test_fields_of_unknown_messages(bag: Bag, tmp_path: Path) -> None:
    messages = (
        bag.make("lab_msgs/Mixed", skin=row, joints=row[:2], temperature=30.0)
        for row in READINGS.astype(np.float32)
    )
    path = written(bag, tmp_path, "/lab", messages)
    with pytest.raises(FileError, match=r"/lab .*needs a field.*fields: skin, joints"):
        io.read(path)
    found = io.read(path, options=select("/lab:skin"))
    np.testing.assert_array_equal(found.readings, READINGS)
    with pytest.raises(FileError, match=r"/lab has no field 'palm'; fields: skin, joints"):
        io.read(path, options=select("/lab:palm"))
    with pytest.raises(FileError, match=r"no topic '/nothing'; it holds /lab \(lab_msgs"):
        io.read(path, options=select("/nothing"))


def test_topics_are_listed(bag: Bag, tmp_path: Path) -> None:
    for i in range(3):
        bag.add("/other", bag.make("lab_msgs/Mixed", np.zeros(2, "f4"), np.zeros(3, "f4"), 1.0), i)
    held = io.contents(written(bag, tmp_path, "/tactile", tactile_states(bag)))
    assert {(each.name, each.usable) for each in held} == {("/tactile", True), ("/other", False)}
    assert "tactile_msgs/msg/TactileState, messages: 60" in {each.summary for each in held}


def test_messages_of_different_length(bag: Bag, tmp_path: Path) -> None:
    rows = (row[: 6 - (i == 40)] for i, row in enumerate(READINGS))
    path = written(bag, tmp_path, "/skin", map(bag.array, rows))
    with pytest.raises(FileError, match="message 40 of /skin has 5 readings instead of 6"):
        io.read(path)


def test_given_message_definitions(tmp_path: Path) -> None:
    """Bags of older ROS 2 versions lack definitions."""
    bag = Bag("db3")
    path = written(bag, tmp_path, "/tactile", tactile_states(bag))
    with sqlite3.connect(path) as database:
        database.execute("DELETE FROM message_definitions")
    database.close()
    with pytest.raises(FileError, match=r"lacks the definition of .*TactileState.*--msg"):
        io.read(path, options=select("/tactile"))
    file = tmp_path / "tactile_msgs" / "msg" / "TactileState.msg"
    file.parent.mkdir(parents=True)
    file.write_text(DEFINITIONS["tactile_msgs/msg/TactileState"])
    loose = tmp_path / "tactile_msgs.TactileState.msg"
    loose.write_text(file.read_text())
    for definition in (file, loose):
        found = io.read(path, options=select("/tactile", definition))
        np.testing.assert_array_equal(found.readings, READINGS)
    (tmp_path / "State.msg").write_text(file.read_text())
    with pytest.raises(FileError, match=r"package of .* is unknown"):
        io.read(path, options=select("/tactile", tmp_path / "State.msg"))


@pytest.mark.parametrize("stamp", ["noon", b"\xff", 1e300])
def test_stamps_of_any_type_in_a_database_are_refused(tmp_path: Path, stamp: object) -> None:
    bag = Bag("db3")
    path = written(bag, tmp_path, "/tactile", tactile_states(bag))
    with sqlite3.connect(path) as database:
        database.execute("UPDATE messages SET timestamp = ?", (stamp,))
    database.close()
    with pytest.raises(FileError, match=r"run\.db3") as refused:
        io.read(path, options=select("/tactile"))
    assert "operand" not in str(refused.value), "the message of an operation of the library"


@pytest.mark.parametrize("kind", KINDS)
def test_bags_that_were_not_closed_name_the_tool_that_repairs(tmp_path: Path, kind: str) -> None:
    path = written(Bag(kind), tmp_path, "/skin", map(Bag(kind).array, READINGS))
    whole = path.read_bytes()
    repair = {"bag": "rosbag reindex run.bag", "mcap": "mcap recover run.mcap"}[kind]
    for share in (0.4, 0.7):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(FileError, match=repair):
            io.read(path)
    if kind == "bag":
        at = whole.index(b"index_pos=") + len("index_pos=")
        path.write_bytes(whole[:at] + bytes(8) + whole[at + 8 :])
        with pytest.raises(FileError, match=repair):
            io.read(path)
