"""Recordings: accepted input, refused input, conversions, and what notebooks show of them."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from anisomap import Recording, SensorMap
from anisomap.errors import InputError


@pytest.mark.parametrize(
    ("dtype", "kept"),
    [(bool, np.float32), (np.uint8, np.float32), (np.int16, np.float32), (np.float32, np.float32),
     (np.int32, np.float64), (np.int64, np.float64), (np.float64, np.float64)],
)  # fmt: skip
def test_readings_are_stored_losslessly_in_the_smallest_float_type(dtype, kept):
    readings = np.array([[0, 1], [1, 0]], dtype=dtype)
    recording = Recording(readings)
    assert recording.readings.dtype == kept
    np.testing.assert_array_equal(recording.readings, readings)


def test_recordings_are_immutable():
    given = np.zeros((3, 2))
    recording = Recording(given, positions=np.zeros((2, 2)), times=[0, 1, 2])
    given[:] = 9
    assert not recording.readings.any()
    arrays = (recording.readings, recording.positions, recording.times, *recording.extremes)
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(TypeError):
        recording.metadata["seed"] = 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"readings": [1, 2, 3]}, r"\(T, N\).*got shape \(3,\)"),
        ({"readings": np.zeros((0, 3))}, "must not be empty"),
        ({"readings": np.array([["a"]])}, "real numbers"),
        ({"readings": np.zeros((2, 2), complex)}, "complex"),
        ({"readings": np.zeros((2, 2), object)}, "object"),
        ({"names": ["a"]}, "2 sensors need 2 names, got 1"),
        ({"names": ["a", "a"]}, "several sensors have the name a"),
        ({"times": [0, 1, 2]}, r"\(2,\)"),
        ({"times": [1, 1]}, "frame 1"),
        ({"times": [0, np.inf]}, "frame 1 is not finite"),
        ({"rate_hz": 0}, "positive"),
        ({"positions": np.zeros((3, 2))}, r"\(2, 2\) or \(2, 3\)"),
        ({"positions": np.zeros((2, 4))}, r"\(2, 2\) or \(2, 3\)"),
    ],
)
def test_invalid_recordings_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        Recording(**{"readings": np.zeros((2, 2)), **arguments})


def test_rate_comes_from_times():
    recording = Recording(np.zeros((5, 1)), times=np.arange(5) * 0.02)
    assert recording.rate_hz == pytest.approx(50)
    assert recording.duration == pytest.approx(0.08)


def test_sensors_are_found_by_name_first_and_then_by_index():
    recording = Recording(np.zeros((1, 4)), names=["2", "b", "c", "d"])
    np.testing.assert_array_equal(recording.indices(["2"]), [0])
    np.testing.assert_array_equal(recording.indices([2, "d", "3", "b"]), [1, 2, 3])
    for missing in ("x", "4", -1):
        with pytest.raises(InputError, match="there is no sensor"):
            recording.indices([missing])


def test_selection_applies_to_all_fields():
    recording = Recording(np.arange(6).reshape(2, 3), positions=np.eye(3), names="abc")
    part = recording.select([2, 0])
    assert part.names == ("c", "a")
    np.testing.assert_array_equal(part.readings, [[2, 0], [5, 3]])
    np.testing.assert_array_equal(part.positions, np.eye(3)[[2, 0]])


few = settings(max_examples=25)
HOLES = arrays(
    np.float64, (8, 3), elements=st.one_of(st.floats(-9, 9), st.just(np.nan), st.just(np.inf))
)


@given(HOLES)
@few
def test_interpolation_fills_only_holes_and_stays_in_range(readings):
    filled = Recording(readings).complete(missing="interpolate").readings
    known = np.isfinite(readings)
    np.testing.assert_array_equal(filled[known], readings[known])
    assert np.isfinite(filled).all()
    some = known.any(axis=0)
    low, high = (limit(np.where(known, readings, np.nan)[:, some], axis=0)
                 for limit in (np.nanmin, np.nanmax))  # fmt: skip
    assert ((filled[:, some] >= low) & (filled[:, some] <= high)).all()
    assert not filled[:, ~some].any()


@given(HOLES)
@few
def test_dropping_frames_keeps_whole_frames_only(readings):
    known = np.isfinite(readings)
    sound = known[:, known.any(axis=0)].all(axis=1)
    if sound.any():
        kept = Recording(readings, times=np.arange(8.0)).complete(missing="drop-frames")
        np.testing.assert_array_equal(kept.times, np.flatnonzero(sound))
        assert np.isfinite(kept.readings).all()
    else:
        with pytest.raises(InputError, match="leaves none"):
            Recording(readings).complete(missing="drop-frames")


def test_missing_readings_are_named():
    readings = np.zeros((4, 3))
    readings[2, 1] = readings[3, 1] = np.nan
    with pytest.raises(InputError, match=r"2 readings .* sensor s1, frames 2, 3; .*drop-frames"):
        Recording(readings).complete()


def test_recordings_can_be_pickled():
    recording = Recording(np.eye(3), names="abc", metadata={"seed": 1})
    recording.extremes  # noqa: B018, statistics that were computed are not part of it
    again = pickle.loads(pickle.dumps(recording))
    assert again.names == recording.names
    assert again.metadata == recording.metadata
    assert not again.readings.flags.writeable


@given(HOLES)
@few
def test_extremes_show_which_sensors_miss_readings(readings):
    recording = Recording(readings)
    lowest, highest = recording.extremes
    complete = np.isfinite(readings).all(axis=0)
    np.testing.assert_array_equal(np.isfinite(lowest) & np.isfinite(highest), complete)
    np.testing.assert_array_equal(lowest[complete], readings.min(axis=0)[complete])
    assert (recording.complete("interpolate") is recording) == complete.all()
    several = [len(np.unique(column[np.isfinite(column)])) > 1 for column in readings.T]
    np.testing.assert_array_equal(recording.varying(), several)


HOSTILE = "<script>alert(1)</script>"


def test_the_repr_of_a_recording_tells_its_size():
    shown = repr(Recording(np.zeros((400, 300)), rate_hz=50))
    assert len(shown) < 200
    assert "400 frames, 300 sensors, 50 Hz" in shown


def test_the_repr_of_a_map_tells_its_size_method_and_components():
    positions = np.vstack([np.eye(3), 9 + np.eye(3)[:2], np.full((1, 3), np.nan)])
    made = SensorMap(positions, component=[0, 0, 0, 1, 1, -1], method="isomap", stress=0.25)
    shown = repr(made)
    assert len(shown) < 200
    for part in ("5 of 6 sensors placed", "3D", "2 components", "isomap", "Stress-1=0.250"):
        assert part in shown


def test_notebooks_show_escaped_tables():
    recording = Recording(np.eye(4), source=HOSTILE)
    made = SensorMap(np.eye(3), notes=[HOSTILE], method=HOSTILE)
    for table in (recording._repr_html_(), made._repr_html_()):
        assert table.startswith("<table>")
        assert "<script>" not in table
        assert "&lt;script&gt;" in table
