"""Recordings of grids with dead cells: full, in lists, or with the live cells alone."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import AnisomapWarning, FileError, InputError

Put = Callable[[str, str | bytes], Path]
OPTIONS = io.ReadOptions


def test_some_cells_by_their_numbers(put: Put) -> None:
    for names in ("c1,c4,c5", "r0c1,r1c1,r1c2"):
        path = put("mat.csv", f"{names}\n1,2,3\n4,5,6\n")
        found = io.read(path, options=OPTIONS(grid=(2, 3)))
        np.testing.assert_array_equal(found.positions, [[1, 0], [1, 1], [2, 1]])
        assert found.names == tuple(names.split(","))


@pytest.mark.parametrize("names", ["c1,c4,c6", "c1,c1x,c2", "r0c1,r2c1,r1c2", "a,b,c"])
def test_names_that_give_no_cells(put: Put, names: str) -> None:
    path = put("mat.csv", f"{names}\n1,2,3\n4,5,6\n")
    with pytest.raises(FileError, match=r"2 x 3 grid has 6 sensors.* not give the cells"):
        io.read(path, options=OPTIONS(grid=(2, 3)))


def test_cells_without_a_reading_are_dead(put: Put) -> None:
    path = put("mat.csv", "a,b,c,d\n1,,3,\n4,,6,\n7,nan,8,1\n")
    with pytest.warns(AnisomapWarning, match="1 of 4 cells of the grid have no reading"):
        found = io.read(path, options=OPTIONS(grid=(2, 2)))
    np.testing.assert_array_equal(found.readings[:, 1], 0)
    assert np.isnan(found.readings[:2, 3]).all(), "cells with a reading keep their gaps"


def test_lists_in_cells(put: Put) -> None:
    rows = ['12.5,0,"0,1,2,0","[9 8 7]"', '13.0,1,"0,3,4,0","[6 5 4]"']
    path = put("walk.csv", "Timestamp,Frame,left,right\n" + "\n".join(rows) + "\n")
    assert [content.name for content in io.contents(path)] == ["left", "right"]
    with pytest.raises(io.ChoiceError, match="2 possible recordings"):
        io.read(path)
    left = io.read(path, options=OPTIONS(select="left", grid=(2, 2)))
    np.testing.assert_array_equal(left.readings, [[0, 1, 2, 0], [0, 3, 4, 0]])
    np.testing.assert_array_equal(left.times, [0, 0.5])
    assert left.names == ("r0c0", "r0c1", "r1c0", "r1c1")
    assert not left.varying()[[0, 3]].any()
    right = io.read(path, options=OPTIONS(select="right"))
    np.testing.assert_array_equal(right.readings, [[9, 8, 7], [6, 5, 4]])


def test_lists_of_another_length(put: Put) -> None:
    rows = "".join(f'{i},"1,2,3"\n' for i in range(60))
    with pytest.raises(FileError, match=r"line 62, column 2: the list has 2 numbers"):
        io.read(put("walk.csv", f'frame,cells\n{rows}60,"1,2"\n61,"1,2,3"\n'))
    with pytest.warns(AnisomapWarning, match="last line is truncated"):
        found = io.read(put("walk.csv", f'frame,cells\n{rows}60,"1,2'))
    assert found.n_frames == 60


@pytest.mark.parametrize("grid", [(-1, -2), (0, 3), (1, 2, 3), (2.0, 3), 6, "2x3", ((1, 2), 3)])
def test_a_grid_that_is_none_is_named(grid):
    with pytest.raises(InputError, match=r"^grid must be two whole numbers of at least 1"):
        OPTIONS(grid=grid)
