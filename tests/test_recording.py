"""Recordings and maps in the hands of users: input, conversions, several of one skin, reprs."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import anisomap
from anisomap import Recording, SensorMap, join_runs, reconstruct, reconstruct_from, score
from anisomap.errors import AnisomapWarning, InputError
from anisomap.health import assess
from skins import flat_skin, quietly


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
        ({"readings": [[1, 2], [3]]}, "rows of different lengths"),
        ({"readings": np.zeros((2, 2), complex)}, "complex"),
        ({"names": ["a"]}, "sensors: 2, names: 1"),
        ({"times": [0, 1, 2]}, r"\(2,\)"),
        ({"times": [0, np.inf]}, "frame 1 is not finite"),
        ({"rate_hz": 0}, "positive"),
        ({"positions": np.zeros((3, 2))}, r"\(2, 2\) or \(2, 3\)"),
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
        with pytest.raises(InputError, match="every frame has a missing reading"):
            Recording(readings).complete(missing="drop-frames")


def test_missing_readings_are_named():
    readings = np.zeros((4, 3))
    readings[2, 1] = readings[3, 1] = np.nan
    with pytest.raises(InputError, match=r": 2; sensors: s1; frames: 2, 3; .*drop-frames"):
        Recording(readings).complete()


@pytest.mark.parametrize("dtype", [bool, np.uint8, np.int64, np.float32, float])
def test_masked_readings_are_missing(dtype):
    masked = np.ma.MaskedArray(np.ones((4, 3), dtype), mask=np.eye(4, 3))
    expected = np.where(np.eye(4, 3), np.nan, 1)
    for recording in (Recording(masked), join_runs(masked)):
        np.testing.assert_array_equal(recording.readings, expected)


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


SKIN = flat_skin(n_frames=3000)
NAMED = Recording(
    SKIN.readings, names=[f"pad{i}" for i in range(42)], positions=SKIN.positions, units="mm"
)


def frames(start, stop, sensors=slice(None)):
    kept = NAMED.select(np.arange(42)[sensors])
    return replace(kept, readings=kept.readings[start:stop], rate_hz=50)


@pytest.mark.parametrize("method", ["covariogram", "i-anisomap", "isomap"])
def test_a_recording_split_into_runs_gives_the_same_map(method):
    order = np.random.default_rng(0).permutation(42)
    runs = [frames(0, 700), frames(700, 1900, order), frames(1900, 3000)]
    whole = reconstruct(frames(0, 3000), method, 2)
    parts = reconstruct(runs, method, 2)
    assert parts.names == whole.names
    np.testing.assert_allclose(parts.positions, whole.positions, atol=1e-9)
    assert join_runs(runs).rate_hz == 50


@pytest.mark.parametrize("method", ["r-anisomap", "i-anisomap"])
def test_sensors_may_be_missing_in_a_run(method):
    """The left two thirds of a skin in one run, the right two thirds in the other."""
    x = NAMED.positions[:, 0]
    runs = [frames(0, 1500, x < 4.4), frames(1500, 3000, x > 1.8)]
    with pytest.warns(AnisomapWarning, match="pairs of sensors were never recorded together"):
        found = reconstruct(runs, method, 2)
    joined = join_runs(runs)
    assert joined.n_frames == 3000
    again = quietly(reconstruct, joined, method, 2)
    np.testing.assert_array_equal(again.positions, found.positions)
    assert found.placed.all()
    assert score(found, joined.positions, permutations=0).mantel.r > 0.9
    assert found.provenance["runs"] == 2


def test_pairs_are_compared_over_the_runs_that_contain_both():
    """Dropping what was missing anywhere leaves the map of the sensors that never were."""
    runs = [frames(0, 1500, slice(0, 36)), frames(1500, 3000, slice(6, 42))]
    found = reconstruct(runs, "r-anisomap", 2, drop=[*range(6), *range(36, 42)])
    expected = reconstruct(frames(0, 3000, slice(6, 36)), "r-anisomap", 2)
    placed = found.select(found.placed)
    assert placed.names == expected.names
    np.testing.assert_allclose(placed.positions, expected.positions, atol=1e-6)


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
def test_pairs_are_correlated_as_pandas_does_where_readings_are_missing():
    rng = np.random.default_rng(1)
    runs = [frames(900 * i, 900 * (i + 1), rng.permutation(42)[: 42 - 4 * i]) for i in range(3)]
    joined = join_runs(runs)
    similarity = pd.DataFrame(joined.readings).corr().to_numpy()
    assert np.isfinite(similarity).all(), "all met, though not in all runs"
    found = reconstruct(runs, "r-anisomap", 2)
    expected = reconstruct_from(similarity=similarity, method="r-anisomap", dimensions=2)
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-6)


def test_runs_that_share_no_names_are_matched_by_order_or_refused():
    same = [Recording(SKIN.readings[:900]), Recording(SKIN.readings[900:])]
    np.testing.assert_array_equal(join_runs(same).readings, SKIN.readings)
    with pytest.raises(InputError, match="shares no sensor name"):
        join_runs([frames(0, 900, slice(0, 20)), frames(0, 900, slice(20, 42))])
    first = Recording(SKIN.readings, source="a.csv")
    second = Recording(SKIN.readings[:, :30], source="b.csv")
    with pytest.raises(InputError, match=r"a\.csv has 42, b\.csv has 30; give names"):
        join_runs([first, second])


def test_contradictory_positions_are_discarded():
    moved = Recording(NAMED.readings[:900], names=NAMED.names, positions=SKIN.positions + 1)
    assert join_runs([frames(0, 900), moved]).positions is None
    assert join_runs([frames(0, 900), frames(0, 900)]).units == "mm"


def test_sensors_are_assessed_in_the_run_with_most_contacts():
    silent = np.array(NAMED.readings[:1500])
    silent[:, 5] = 0
    runs = [Recording(silent[:, :40], names=NAMED.names[:40]), frames(1500, 3000)]
    assert assess(runs[0])[5].status == "silent"
    health = assess(runs)
    assert [sensor.name for sensor in health] == list(NAMED.names)
    assert health[5].status == "ok"


@pytest.mark.parametrize("value", [1e300, -1.7e308, 1e31])
def test_readings_out_of_range_are_missing(value):
    readings = np.random.default_rng(0).random((9, 3))
    usual = Recording(np.where(np.arange(9)[:, None] == 4, np.nan, readings)).complete(
        "interpolate"
    )
    readings[4] = value
    recording = Recording(readings)
    with pytest.raises(
        InputError, match=r"NaN or infinite, or above 1e\+30: 3; sensors: .*; frames: 4"
    ):
        recording.complete()
    assert recording.complete("drop-frames").n_frames == 8
    np.testing.assert_array_equal(recording.complete("interpolate").readings, usual.readings)


@pytest.fixture
def square():
    corners = [[0.0, 0], [1, 0], [1, 1], [0, 1], [np.nan, np.nan]]
    return SensorMap(corners, names=("a", "b", "c", "d", "lost"), units="mm")


def test_a_map_is_an_array_of_positions_with_names(square):
    assert len(square) == 5
    assert list(square) == ["a", "b", "c", "d", "lost"]
    assert "c" in square
    np.testing.assert_array_equal(np.asarray(square), square.positions)
    np.testing.assert_array_equal(np.asarray(square, np.float32).dtype, np.float32)
    np.testing.assert_array_equal(square["c"], [1, 1])
    np.testing.assert_array_equal(square[1], square["b"])
    with pytest.raises(InputError, match="no sensor 'e'"):
        square["e"]
    copied = np.array(square)
    copied[0] = 9
    assert square["a"].tolist() == [0, 0]


def test_a_map_is_a_data_frame(square):
    table = square.to_dataframe()
    assert list(table.columns) == ["x", "y", "component", "health", "error"]
    assert table.loc["b", "x"] == 1
    assert table["component"].tolist() == [0, 0, 0, 0, -1]
    assert list(SensorMap(np.zeros((2, 4))).to_dataframe().columns[:4]) == ["x1", "x2", "x3", "x4"]
    assert isinstance(table, pd.DataFrame)


def test_a_map_is_plotted_on_its_truth(square):
    axes = pytest.importorskip("matplotlib.figure").Figure().add_subplot()
    assert square.plot(ax=axes) is axes
    truth = 3 * np.nan_to_num(np.asarray(square)) + 1
    drawn = anisomap.plot(square.select([0, 1, 2, 3]), truth[:4])
    rings = drawn.get_lines()[-1]
    assert (rings.get_marker(), rings.get_markerfacecolor()) == ("o", "none")
    np.testing.assert_allclose(rings.get_xydata(), truth[:4])
    limits = np.array([drawn.get_xlim(), drawn.get_ylim()])
    assert (limits[:, 0] <= 1).all()
    assert (limits[:, 1] >= 4).all()
