"""What a session writes: every frame, in files that are read at any time; files for viewers."""

import base64
import io
import json
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import anisomap
from anisomap.errors import FileError, MissingExtraError
from anisomap.live.batches import Batch
from anisomap.live.recorder import MAX_WIDTH, JournalTail, JournalWriter, Recorder
from anisomap.live.saving import MAX_RATE_HZ, SESSIONS, save_map, save_session
from skins import flat_skin

SKIN = flat_skin(n_frames=400)  # at 50 Hz
MAP = anisomap.SensorMap(SKIN.positions, names=SKIN.names, units="mm")
READINGS = arrays.arrays(
    float, st.tuples(st.integers(1, 30), st.integers(2, 5)), elements=st.floats(width=64)
)
LETTERS = st.characters(exclude_categories=["Cs", "Cc"])
NAMES = st.lists(st.text(LETTERS, min_size=1, max_size=5), min_size=5, max_size=5, unique=True)


def written(path, readings, names):
    """Write a recording; return the size of its header."""
    writer = JournalWriter(path, names, "test")
    writer.add(np.arange(len(readings)) / 10, readings)
    writer.close()
    return writer.header_bytes


@given(readings=READINGS, names=NAMES, cuts=st.lists(st.integers(1, 200), min_size=1))
@settings(max_examples=50)
def test_frames_are_read_back_equal_by_the_reader_and_by_the_tail(
    tmp_path_factory, readings, names, cuts
):
    path = tmp_path_factory.mktemp("r") / "r.csv"
    names = names[: readings.shape[1]]
    tail = JournalTail(path, len(names), written(path, readings, names))
    parts, more = [], True
    while more:
        part, more = tail.read(cuts[len(parts) % len(cuts)])
        parts.append(part)
    tail.close()
    np.testing.assert_array_equal(np.concatenate(parts), readings)
    found = anisomap.read(path)
    assert list(found.names) == names
    np.testing.assert_array_equal(found.readings, readings)
    np.testing.assert_allclose(found.times, np.arange(len(readings)) / 10, atol=1e-6)


@given(cut=st.integers(0, 400))
@settings(max_examples=40)
@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
def test_a_cut_file_loses_no_whole_frame(tmp_path_factory, cut):
    path = tmp_path_factory.mktemp("r") / "r.csv"
    readings = np.random.default_rng(0).random((40, 2))
    header_bytes = written(path, readings, ["a", "b"])
    content = path.read_bytes()
    end = max(len(content) - cut, header_bytes + 60)
    path.write_bytes(content[:end])
    whole = content[header_bytes:end].count(b"\n")
    found = anisomap.read(path).readings
    assert whole <= len(found) <= whole + 1
    np.testing.assert_array_equal(found[:whole], readings[:whole])


def test_a_recording_is_never_overwritten(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("mine")
    with pytest.raises(FileError, match="exists"):
        JournalWriter(path, ["a", "b"], "test")
    assert path.read_text() == "mine"


@pytest.fixture
def recorder(tmp_path):
    told, begun = [], []
    made = Recorder(tmp_path / "r.csv", "test", told.append, begun.append)
    yield SimpleNamespace(put=made.put, close=made.close, made=made, told=told, begun=begun)
    made.close()


def frames(count, width, value=1.0):
    return Batch(np.full((count, width), value))


def test_single_frames_of_another_width_are_set_aside(recorder, tmp_path):
    for value, width in enumerate([3, 3, 2, 3, 5, 5, 3]):
        recorder.put(frames(1, width, value))
    recorder.close()
    np.testing.assert_array_equal(
        anisomap.read(tmp_path / "r.csv").readings, np.tile([[0.0], [1], [3], [6]], 3)
    )
    lines = (tmp_path / "r.odd.txt").read_text().splitlines()
    assert [line.count(",") for line in lines] == [2, 5, 5]
    assert any("set aside in r.odd.txt" in text for text in recorder.told)


def test_frames_that_cannot_be_set_aside_are_an_error(recorder, tmp_path):
    recorder.put(frames(3, 3))
    (tmp_path / "r.csv").rename(tmp_path.with_name(f"{tmp_path.name}.csv"))
    tmp_path.rmdir()
    recorder.put(frames(1, 2))
    with pytest.raises(FileError, match=r"cannot write .*r\.odd\.txt"):
        recorder.put(frames(1, 3))
    tmp_path.mkdir()


def test_files_of_earlier_sessions_are_left_as_they_are(recorder, tmp_path):
    earlier = {name: tmp_path / name for name in ("r.odd.txt", "r-2.csv", "r-3.csv")}
    for name, path in earlier.items():
        path.write_text(name)
    (tmp_path / "r-2.odd.txt").symlink_to(tmp_path / "elsewhere.txt")
    for width in (3, 2, 3, 5, 3):
        recorder.put(frames(1, width))
    recorder.put(frames(10_000, 2))
    recorder.close()
    assert all(path.read_text() == name for name, path in earlier.items())
    assert not (tmp_path / "elsewhere.txt").exists()
    assert (tmp_path / "r-3.odd.txt").read_text().count("\n") == 2
    assert anisomap.read(tmp_path / "r-4.csv").readings.shape == (10_000, 2)


def test_many_frames_of_another_width_begin_a_new_file(recorder, tmp_path):
    recorder.put(frames(4, 3))
    recorder.put(frames(10_000, 2))
    recorder.put(frames(5, 2, 7.0))
    recorder.close()
    assert [segment.path.name for segment in recorder.begun] == ["r.csv", "r-2.csv"]
    assert anisomap.read(tmp_path / "r.csv").readings.shape == (4, 3)
    assert anisomap.read(tmp_path / "r-2.csv").readings.shape == (10_005, 2)
    assert any("now sends 2 readings per frame instead of 3" in text for text in recorder.told)


def test_every_frame_that_is_recorded_can_be_read(recorder, tmp_path):
    recorder.put(frames(1, MAX_WIDTH + 1))
    assert not recorder.begun
    assert "at most 250000" in recorder.told[0]
    longest = -1.2345678901234567e-300
    recorder.put(frames(1, MAX_WIDTH, longest))
    recorder.close()
    with (tmp_path / "r.csv").open() as stream:
        assert max(map(len, stream)) < 1 << 23


def test_frames_that_are_flushed_can_be_read_while_others_arrive(recorder, tmp_path):
    with ThreadPoolExecutor(1) as pool:
        arriving = pool.submit(lambda: [recorder.put(frames(9, 40)) for _ in range(400)])
        while not arriving.done():
            flushed = recorder.made.flush()
            if flushed:
                header = recorder.begun[0].header_bytes
                tail = JournalTail(tmp_path / "r.csv", 40, header)
                assert len(tail.read(1 << 30)[0]) >= flushed
                tail.close()
    assert recorder.made.flush() == 3600


def test_times_increase_whatever_the_clock_of_the_source_does(recorder, tmp_path):
    for start in (100.0, 101.0, 50.0, 50.0, 1e9, np.float64(1e9)):
        recorder.put(Batch(np.ones((3, 2)), start + np.array([0.0, 0.1, 0.2])))
    recorder.put(frames(3, 2))
    recorder.put(frames(3, 2))
    recorder.close()
    times = anisomap.read(tmp_path / "r.csv").times
    assert len(times) == 24
    assert (np.diff(times) > 0).all()
    assert times[0] == 0
    assert times[5] == pytest.approx(1.2)
    assert any("clock of the source went back" in text for text in recorder.told)


def test_missing_readings_are_recorded_and_told(recorder, tmp_path):
    recorder.put(Batch(np.array([[1.0, np.nan], [2.0, 3.0]])))
    recorder.close()
    np.testing.assert_array_equal(anisomap.read(tmp_path / "r.csv").readings, [[1, np.nan], [2, 3]])
    assert recorder.made.has_gaps
    assert any("s1 sent no number" in text for text in recorder.told)


@pytest.fixture(scope="module")
def mcap(tmp_path_factory):
    """Return a reader of the session."""
    reader = pytest.importorskip("mcap.reader", reason="needs the extra 'mcap'")
    path = tmp_path_factory.mktemp("session") / "skin.mcap"
    save_session(MAP, SKIN, path)
    return reader.make_reader(io.BytesIO(path.read_bytes()))


def test_foxglove_shows_the_strongest_reading_of_each_interval_in_metres(mcap):
    found = {"/skin": [], "/names": []}
    for _, channel, message in mcap.iter_messages():
        found[channel.topic].append((message.log_time, json.loads(message.data)))
    assert found["/names"][0][1]["names"] == list(SKIN.names)
    times = np.array([time for time, _ in found["/skin"]]) / 1e9
    assert np.diff(times).min() == pytest.approx(1 / MAX_RATE_HZ)
    clouds = np.array(
        [
            np.frombuffer(base64.b64decode(cloud["data"]), "<f4").reshape(-1, 4)
            for _, cloud in found["/skin"]
        ]
    )
    np.testing.assert_allclose(clouds[0, :, :2] * 1000, MAP.positions, rtol=1e-5, atol=1e-5)
    pairs = SKIN.readings.reshape(-1, 2, SKIN.n_sensors).max(axis=1)
    np.testing.assert_allclose(clouds[..., 3], pairs / pairs.max(axis=0), atol=1e-5)


def described(schema):
    """Return the properties of a schema, as Foxglove reads them."""
    if schema["type"] == "object":
        return {key: described(item) for key, item in schema["properties"].items()}
    if schema["type"] == "array":
        return [described(schema["items"])]
    return schema.get("contentEncoding", schema["type"])


def test_schemas_describe_all_that_foxglove_reads(mcap):
    """The schema of point clouds is that of foxglove.dev, without descriptions and limits."""
    schemas = mcap.get_summary().schemas.values()
    found = {schema.name: described(json.loads(schema.data)) for schema in schemas}
    vector = dict.fromkeys("xyz", "number")
    assert found == {
        "foxglove.PointCloud": {
            "timestamp": {"sec": "integer", "nsec": "integer"},
            "frame_id": "string",
            "pose": {"position": vector, "orientation": vector | {"w": "number"}},
            "point_stride": "integer",
            "fields": [{"name": "string", "offset": "integer", "type": "integer"}],
            "data": "base64",
        },
        "anisomap.Names": {"names": ["string"]},
    }


def test_rerun_reads_the_session(tmp_path):
    pytest.importorskip("rerun", reason="needs the extra 'rerun'")
    save_session(replace(MAP, units="arbitrary"), SKIN, tmp_path / "skin.rrd")
    assert (tmp_path / "skin.rrd").read_bytes().startswith(b"RRF")


@pytest.mark.parametrize("suffix", SESSIONS)
def test_without_the_extra_no_file_is_left(tmp_path, monkeypatch, suffix):
    for module in ("mcap", "mcap.writer", "rerun"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=suffix[1:] if suffix == ".mcap" else "rerun"):
        save_session(MAP, SKIN, tmp_path / f"skin{suffix}")
    assert list(tmp_path.iterdir()) == []


def test_a_session_without_a_map_is_refused(tmp_path):
    with pytest.raises(anisomap.InputError, match="no checked map"):
        save_map(None, tmp_path / "x.mcap", recording=tmp_path / "skin.csv")
