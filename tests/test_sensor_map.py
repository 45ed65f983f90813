"""Maps in the hands of users of numpy, pandas and matplotlib."""

import numpy as np
import pandas as pd
import pytest

import anisomap
from anisomap import InputError, SensorMap


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


def test_a_map_is_saved_and_read_back(square, tmp_path):
    square.save(tmp_path / "map.json")
    np.testing.assert_array_equal(anisomap.read_map(tmp_path / "map.json"), square)


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
