"""Files of named arrays and columns: HDF5, MATLAB, Parquet and Arrow."""

from pathlib import Path

import numpy as np
import pytest
import scipy

from anisomap import io
from anisomap.errors import FileError

h5py = pytest.importorskip("h5py")
arrow = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")

READINGS = np.random.default_rng(3).integers(0, 9, (300, 6)).astype(np.float64)
OTHER = np.random.default_rng(4).integers(0, 9, (200, 4))


def select(name: str) -> io.ReadOptions:
    return io.ReadOptions(select=name)


@pytest.fixture
def h5(tmp_path: Path):
    def make(**arrays: object) -> Path:
        with h5py.File(tmp_path / "skin.h5", "w") as file:
            for name, values in arrays.items():
                file[name.replace("__", "/")] = values
        return tmp_path / "skin.h5"

    return make


def test_times_names_and_positions_come_from_the_same_group(h5) -> None:
    path = h5(
        left__readings=READINGS,
        left__time_ms=np.arange(300) * 20,
        left__names=np.array(list("abcdef"), "S"),
        left__positions=np.eye(6)[:, :3],
        times=np.arange(300),
        positions=np.ones((6, 3)),
    )
    found = io.read(path)
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names == tuple("abcdef")
    assert found.rate_hz == pytest.approx(50)
    np.testing.assert_array_equal(found.positions, np.eye(6)[:, :3])
    assert found.source == "skin.h5:left/readings"


def test_several_datasets_are_listed_and_one_is_selected(h5) -> None:
    path = h5(left__skin=READINGS, right__skin=OTHER, note="rubbed by hand", one=np.arange(5))
    with pytest.raises(io.ChoiceError, match=r"2 possible.*left/skin.*300 x 6.*--select"):
        io.read(path)
    usable = {content.name: content.usable for content in io.contents(path)}
    assert usable == {"left/skin": True, "right/skin": True, "note": False, "one": False}
    np.testing.assert_array_equal(io.read(path, options=select("right")).readings, OTHER)


def test_the_selection_must_match_one_recording(h5) -> None:
    path = h5(left__skin=READINGS, right__skin=OTHER, one=np.arange(5))
    np.testing.assert_array_equal(io.read(path, options=select("left/skin")).readings, READINGS)
    with pytest.raises(FileError, match=r"several datasets match 'skin'"):
        io.read(path, options=select("skin"))
    with pytest.raises(FileError, match=r"no dataset 'middle'; the file holds left/skin"):
        io.read(path, options=select("middle"))
    with pytest.raises(FileError, match=r"no dataset that can be a recording; it holds one"):
        io.read(path, options=select("one"))


def test_further_dimensions_are_flattened(h5) -> None:
    found = io.read(h5(film=READINGS.reshape(300, 2, 3)))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names == ("0.0", "0.1", "0.2", "1.0", "1.1", "1.2")


def test_variable_length_names_are_read(h5) -> None:
    names = np.array(list("abcdef"), h5py.string_dtype())
    assert io.read(h5(readings=READINGS, names=names)).names == tuple("abcdef")


def test_datasets_in_other_files_are_not_opened(tmp_path: Path) -> None:
    (tmp_path / "secret").write_bytes(bytes(48))
    with h5py.File(tmp_path / "skin.h5", "w") as file:
        file.create_dataset("a", (3, 2), "f8", external=[(str(tmp_path / "secret"), 0, 48)])
        file["b"] = h5py.ExternalLink("other.h5", "/b")
    with pytest.raises(FileError, match="is stored in other files"):
        io.read(tmp_path / "skin.h5")


@pytest.mark.parametrize("kind", ["f8", "f4", "u1", "i4", "?"])
def test_dtypes_in_matlab(tmp_path: Path, kind: str) -> None:
    readings = READINGS.astype(kind)
    scipy.io.savemat(tmp_path / "skin.mat", {"skin": readings, "fs": 50.0, "note": "by hand"})
    found = io.read(tmp_path / "skin.mat")
    np.testing.assert_array_equal(found.readings, readings)
    assert found.rate_hz == 50


def test_matlab_4(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "skin.mat", {"skin": READINGS}, format="4")
    np.testing.assert_array_equal(io.read(tmp_path / "skin.mat").readings, READINGS)


def table(**columns: object) -> object:
    return arrow.table({name.replace("__", "."): values for name, values in columns.items()})


def fixed(values: np.ndarray) -> object:
    return arrow.FixedSizeListArray.from_arrays(arrow.array(values.ravel()), values.shape[1])


def test_episodes_give_a_rate_but_no_times(tmp_path: Path) -> None:
    columns = table(
        observation__tactile=fixed(READINGS),
        observation__state=fixed(READINGS[:, :2]),
        action=[[1.0]] * 300,
        timestamp=np.arange(300) % 100 / 30,
        episode_index=np.arange(300) // 100,
    )
    parquet.write_table(columns, tmp_path / "file-000.parquet", row_group_size=70)
    with pytest.raises(io.ChoiceError, match="3 possible recordings"):
        io.read(tmp_path / "file-000.parquet")
    found = io.read(tmp_path / "file-000.parquet", options=select("observation.tactile"))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.times is None
    assert found.rate_hz == pytest.approx(30)


@pytest.mark.parametrize("suffix", ["parquet", "feather", "arrows"])
def test_one_column_per_sensor(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"skin.{suffix}"
    columns = table(
        frame=np.arange(300),
        time=np.arange(300) / 25,
        **{f"pad {i}": READINGS[:, i] for i in range(6)},
        who=["me"] * 300,
    )
    if suffix == "parquet":
        parquet.write_table(columns, path)
    else:
        writer = arrow.ipc.new_file if suffix == "feather" else arrow.ipc.new_stream
        with arrow.OSFile(str(path), "wb") as sink, writer(sink, columns.schema) as out:
            out.write_table(columns, max_chunksize=64)
    found = io.read(path)
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names == tuple(f"pad {i}" for i in range(6))
    assert found.rate_hz == pytest.approx(25)


def test_nested_and_ragged_lists(tmp_path: Path) -> None:
    path = tmp_path / "skin.parquet"
    parquet.write_table(table(a=READINGS.reshape(300, 3, 2).tolist()), path)
    np.testing.assert_array_equal(io.read(path).readings, READINGS)
    parquet.write_table(table(a=[[1.0, 2.0], [3.0], [4.0, 5.0]]), path)
    with pytest.raises(FileError, match="differ in length"):
        io.read(path)
    parquet.write_table(table(a=[[1.0, 2.0], None, [4.0, 5.0]]), path)
    with pytest.raises(FileError, match="a list in every row, got null"):
        io.read(path)
    parquet.write_table(table(a=[[1.0, 2.0], [None, 3.0], [4.0, 5.0]]), path)
    np.testing.assert_array_equal(io.read(path).readings[1], [np.nan, 3])
    parquet.write_table(table(a=["x", "y"]), path)
    with pytest.raises(FileError, match=r"no column that can be a recording; it holds a"):
        io.read(path)


@pytest.mark.parametrize("suffix", ["parquet", "feather"])
@pytest.mark.parametrize("values", [np.arange(6.0), [[1.0, 2.0]] * 6])
def test_columns_of_the_same_name(tmp_path: Path, suffix: str, values) -> None:
    columns = [arrow.array(values), arrow.array(range(6)), arrow.array(range(6))]
    repeated = arrow.Table.from_arrays(columns, names=["a", "b", "b"])
    path = tmp_path / f"skin.{suffix}"
    if suffix == "parquet":
        parquet.write_table(repeated, path)
    else:
        with arrow.ipc.new_file(str(path), repeated.schema) as writer:
            writer.write_table(repeated)
    with pytest.raises(FileError, match=r"skin\.\w+ has 2 columns with the name 'b'"):
        io.read(path)
