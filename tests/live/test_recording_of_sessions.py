"""What a session writes: every frame, in files that are read at any time."""

from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import anisomap
from anisomap.errors import FileError
from anisomap.live.batches import Batch
from anisomap.live.recorder import MAX_WIDTH, JournalTail, JournalWriter, Recorder
from anisomap.names import default_names

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


def test_frames_of_another_width_begin_a_new_recording(recorder):
    recorder.made.names = ("a", "b", "c")
    for value, width in enumerate([3, 3, 5, 5, 5]):
        recorder.put(frames(1, width, value))
    recorder.close()
    found = [anisomap.read(segment.path) for segment in recorder.begun]
    assert [each.names for each in found] == [("a", "b", "c"), default_names(5)]
    assert [each.readings[:, 0].tolist() for each in found] == [[0, 1], [2, 3, 4]]
    assert recorder.told == ["5 readings instead of 3: a new recording begins"]


def test_files_of_earlier_sessions_are_left_as_they_are(recorder, tmp_path):
    (tmp_path / "r-2.csv").write_text("mine")
    (tmp_path / "r-3.csv").symlink_to(tmp_path / "elsewhere.csv")
    recorder.put(frames(1, 3))
    recorder.made.close()
    recorder.put(frames(4, 2))
    recorder.close()
    assert (tmp_path / "r-2.csv").read_text() == "mine"
    assert not (tmp_path / "elsewhere.csv").exists()
    assert [segment.path.name for segment in recorder.begun] == ["r.csv", "r-4.csv"]
    assert anisomap.read(tmp_path / "r-4.csv").readings.shape == (4, 2)


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


def test_other_names_begin_a_new_recording(tmp_path):
    said = []
    recorder = Recorder(tmp_path / "r.csv", "", said.append, lambda _: None)
    for names in ("ab", "ab", "cd"):
        recorder.rename(tuple(names))
        recorder.put(Batch(np.ones((3, 2))))
    recorder.close()
    assert [segment.names for segment in recorder.segments] == [("a", "b"), ("c", "d")]
    assert [anisomap.read(segment.path).n_frames for segment in recorder.segments] == [6, 3]
    assert said == ["the sensors have other names: a new recording begins"]
