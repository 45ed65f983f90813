"""Binary files: arrays of NumPy, HDF5 and MATLAB."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import scipy

from anisomap import io
from anisomap.errors import AnisomapWarning, FileError
from anisomap.recording import Recording

h5py = pytest.importorskip("h5py")

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
    usable = {content.name: content.usable for content in io.contents(path)}
    assert usable == {"left/skin": True, "right/skin": True, "note": False, "one": False}
    for name, readings in (("right", OTHER), ("left/skin", READINGS)):
        np.testing.assert_array_equal(io.read(path, options=select(name)).readings, readings)
    for name, message in (
        ("", r"2 possible.*left/skin.*300 x 6.*--select"),
        ("skin", "several datasets match 'skin'"),
        ("middle", "no dataset 'middle'; it holds left/skin"),
        ("one", "no dataset that can be a recording; it holds one"),
    ):
        with pytest.raises(FileError, match=message):
            io.read(path, options=select(name))


@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("suffix", ["h5", "mat", "npy", "npz"])
def test_frames_of_rows_and_columns(tmp_path: Path, suffix: str, last: bool) -> None:
    """The longest axis is time, and cells are named by both others."""
    film = READINGS.reshape(300, 3, 2)
    film, path = np.moveaxis(film, 0, 2) if last else film, tmp_path / f"film.{suffix}"
    if suffix == "h5":
        with h5py.File(path, "w") as file:
            file["film"] = film
    elif suffix == "mat":
        scipy.io.savemat(path, {"film": film})
    elif suffix == "npy":
        np.save(path, film)
    else:
        np.savez(path, readings=film)
    said = rf"has 3 axes: the {'last' if last else 'first'} axis is time, and a frame is 3 x 2"
    with pytest.warns(AnisomapWarning, match=said):
        found = io.read(path)
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names == ("r0c0", "r0c1", "r1c0", "r1c1", "r2c0", "r2c1")
    with pytest.warns(AnisomapWarning, match="axis is time"):
        np.testing.assert_array_equal(Recording(film).readings, READINGS)


@pytest.mark.parametrize("axis", ["z", "norm", "y", "all"])
def test_a_last_axis_of_three(tmp_path: Path, axis: str) -> None:
    taxels = np.random.default_rng(0).normal(size=(300, 3, 2, 3))
    np.save(tmp_path / "taxels.npy", taxels)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = io.read(tmp_path / "taxels.npy", options=io.ReadOptions(axis=axis))
    rest = np.median(taxels, axis=0)
    expected = {
        "z": taxels[..., 2],
        "y": taxels[..., 1],
        "norm": np.linalg.norm(taxels - rest, axis=3),
        "all": taxels,
    }
    np.testing.assert_allclose(found.readings, expected[axis].reshape(300, -1))
    assert found.names[-1] == ("r2c1_z" if axis == "all" else "r2c1")
    assert any("three axes" in str(each.message) for each in said) == (axis != "all")


def test_datasets_in_other_files_are_not_opened(tmp_path: Path) -> None:
    (tmp_path / "secret").write_bytes(bytes(48))
    with h5py.File(tmp_path / "skin.h5", "w") as file:
        file.create_dataset("a", (3, 2), "f8", external=[(str(tmp_path / "secret"), 0, 48)])
        file["b"] = h5py.ExternalLink("other.h5", "/b")
    with pytest.raises(FileError, match="is stored in other files"):
        io.read(tmp_path / "skin.h5")


@pytest.mark.parametrize(
    ("kind", "version"), [*((kind, "5") for kind in ("f8", "f4", "u1", "i4", "?")), ("f8", "4")]
)
def test_dtypes_in_matlab(tmp_path: Path, kind: str, version: str) -> None:
    readings = READINGS.astype(kind)
    values = {"skin": readings, "fs": 50.0, "note": "by hand"}
    scipy.io.savemat(tmp_path / "skin.mat", values, format=version)
    found = io.read(tmp_path / "skin.mat")
    np.testing.assert_array_equal(found.readings, readings)
    assert found.rate_hz == 50


@pytest.mark.parametrize("suffix", ["npy", "h5"])
@pytest.mark.parametrize(
    ("clock", "what"), [(np.arange(300) / 50, "a time"), (np.arange(300) % 16, "a counter")]
)
def test_a_time_among_the_readings_is_left_out(tmp_path, suffix: str, clock, what: str) -> None:
    path, values = tmp_path / f"skin.{suffix}", np.column_stack([clock, READINGS])
    if suffix == "npy":
        np.save(path, values)
    else:
        with h5py.File(path, "w") as file:
            file["readings"] = values
    with pytest.warns(AnisomapWarning, match=f"column 1: {what}"):
        found = io.read(path)
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names[0] == "s1", "the names are those of the columns"


def test_fields_of_a_structure_of_matlab(tmp_path) -> None:
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"run": {"skin": READINGS, "time": np.arange(300) / 50, "who": "me"}})
    found = io.read(path)
    np.testing.assert_array_equal(found.readings, READINGS)
    assert (found.rate_hz, found.source) == (pytest.approx(50), "run.mat:run/skin")
