"""Binary files: HDF5, MATLAB, and archives of events."""

import warnings
from collections.abc import Callable
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
        ("middle", "no dataset 'middle'; the file holds left/skin"),
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


TOUCHED = np.array([[1, 0, 1], [0, 0, 0], [0, 0, 1], [1, 1, 1]])
OPTIONS = io.ReadOptions


class TestMatlab:
    """Contacts and spikes in structures and cell arrays."""

    CONTACTS = ([3, 17], [], [17], [3, 4, 17])

    @pytest.fixture
    def saved(self, tmp_path: Path) -> Callable[..., Path]:
        def save(**variables: object) -> Path:
            scipy.io.savemat(tmp_path / "touch.mat", variables, do_compression=True)
            return tmp_path / "touch.mat"

        return save

    def cells(self, items: list[object]) -> np.ndarray:
        cells = np.empty((len(items), 1), dtype=object)
        cells[:, 0] = items
        return cells

    @pytest.mark.parametrize("inside", ["row", "column", "points", "cells of structures"])
    def test_contacts(self, saved, inside: str) -> None:
        items: list[object] = []
        for ids in self.CONTACTS:
            listed = np.array(ids, dtype=float).reshape(1, -1)
            if inside == "column":
                listed = listed.T
            if inside == "points":
                listed = np.column_stack([np.full((len(ids), 3), 0.25), listed.ravel()])
            items.append({"taxels": listed} if inside == "cells of structures" else listed)
        found = io.read(saved(torso=self.cells(items)))
        assert found.names == ("taxel3", "taxel4", "taxel17")
        np.testing.assert_array_equal(found.readings, TOUCHED)
        assert found.times is None

    def test_two_skins(self, saved) -> None:
        contacts = np.zeros((4, 1), dtype=[("activatedTaxels", object), ("side", object)])
        for i, ids in enumerate(self.CONTACTS):
            contacts[i, 0] = (np.array([ids], dtype=np.uint16), "left")
        path = saved(torso=contacts, arm=contacts[::-1])
        assert [each.name for each in io.contents(path) if each.usable] == [
            "torso/activatedTaxels",
            "arm/activatedTaxels",
        ]
        with pytest.raises(io.ChoiceError, match="2 possible recordings"):
            io.read(path)
        arm = io.read(path, options=OPTIONS(select="arm"))
        np.testing.assert_array_equal(arm.readings, TOUCHED[::-1])
        assert arm.source == "touch.mat:arm/activatedTaxels"

    def test_spike_trains(self, saved) -> None:
        trains = [np.array(train).reshape(-1, 1) for train in ([0.25, 1.5], [], [0.5, 2.25])]
        path = saved(spikes=self.cells(trains), positions=np.eye(3)[:, :2])
        found = io.read(path, options=OPTIONS(bin_s=1.0))
        np.testing.assert_array_equal(found.positions, np.eye(3)[:, :2])
        # The first bin begins with the first spike, at 0.25 s.
        np.testing.assert_array_equal(found.readings, [[1, 0, 1], [1, 0, 0], [0, 0, 1]])
        assert found.names == ("channel1", "channel2", "channel3")

    def test_readings_beside_cells_are_preferred(self, saved) -> None:
        path = saved(readings=np.eye(4), notes=self.cells([np.array([[1.0, 2.0]])]))
        assert io.read(path).n_sensors == 4


class TestArchives:
    """Events in NumPy archives."""

    def test_names_tell_silent_sensors(self, tmp_path: Path) -> None:
        np.savez(
            tmp_path / "x.npz", times=[0.5, 0.25, 0.5], taxels=[0, 2, 2], names=list("abcd"),
            positions=np.eye(4)[:, :2], units="mm",
        )  # fmt: skip
        found = io.read(tmp_path / "x.npz")
        assert found.names == tuple("abcd")
        np.testing.assert_array_equal(found.readings, [[0, 0, 1, 0], [1, 0, 1, 0]])
        assert found.units == "mm"
        np.testing.assert_array_equal(found.positions, np.eye(4)[:, :2])

    def test_spikes_need_bins(self, tmp_path: Path) -> None:
        np.savez(tmp_path / "x.npz", spike_times=[0.5, 0.25, 2.5], units=[7, 4, 4])
        with pytest.warns(AnisomapWarning, match="in bins of 1 s"):
            found = io.read(tmp_path / "x.npz")
        assert found.names == ("unit4", "unit7")
        np.testing.assert_array_equal(found.readings, [[1, 1], [0, 0], [1, 0]])


class TestSpikeTrains:
    """Times of spikes in HDF5: three layouts, with positions, names and span."""

    TRAINS = ([0.25, 1.5, 1.75], [], [0.5, 2.25])
    COUNTS = ([1, 0, 1], [2, 0, 0], [0, 0, 1])

    @pytest.mark.parametrize(
        ("arrays", "names"),
        [
            (
                {"spikes": np.concatenate(TRAINS), "sCount": [3.0, 0, 2], "array": b"MEA"},
                ("e0", "e1", "e2"),
            ),
            (
                {
                    "units__spike_times": np.concatenate(TRAINS),
                    "units__spike_times_index": [3, 3, 5],
                    "units__names": np.array(["a", "b", "c"], dtype="S"),
                },
                ("a", "b", "c"),
            ),
            (
                {f"spikes__ch{i}": np.array(train) for i, train in enumerate(TRAINS)},
                ("ch0", "ch1", "ch2"),
            ),
        ],
    )
    def test_layouts(self, h5, arrays: dict[str, object], names: tuple[str, ...]) -> None:
        path = h5(**arrays)
        found = io.read(path, options=OPTIONS(bin_s=1.0))
        assert found.names == names
        # The first bin begins with the first spike, at 0.25 s.
        np.testing.assert_array_equal(found.readings, self.COUNTS)
        assert found.rate_hz == 1
        with pytest.warns(AnisomapWarning, match="in bins of 1 s, the default"):
            io.read(path)

    @pytest.mark.parametrize("transposed", [False, True])
    def test_positions_and_span(self, h5, transposed: bool) -> None:
        positions = np.array([[0.0, 42], [42, 42], [84, 0]])
        path = h5(
            spikes=np.concatenate(self.TRAINS),
            sCount=[3, 0, 2],
            epos=positions.T if transposed else positions,
            recordingtime=[0.0, 4.0],
            summary__N=[3.0],
            summary__frate=[1.0, 0, 0.5],
        )
        found = io.read(path, options=OPTIONS(bin_s=1.0))
        np.testing.assert_array_equal(found.readings, [*self.COUNTS, [0, 0, 0]])
        np.testing.assert_array_equal(found.times, np.arange(4))
        if not transposed:  # three positions of three coordinates would be ambiguous
            np.testing.assert_array_equal(found.positions, positions)
        assert found.units == "um"

    @pytest.mark.parametrize("counts", [[3, 0, 1], [3, -1, 3], [2.5, 0, 2.5], [np.nan, 1, 1]])
    def test_counts_that_do_not_agree(self, h5, tmp_path: Path, counts: list[float]) -> None:
        made = h5(spikes=np.concatenate(self.TRAINS), sCount=counts)
        path = made.rename(tmp_path / "spikes.h5")
        with pytest.raises(
            FileError, match=r"spikes\.h5: sCount must divide the 5 times of spikes"
        ):
            io.read(path, options=OPTIONS(bin_s=1.0))

    def test_readings_beside_vectors_are_preferred(self, h5) -> None:
        path = h5(
            skin__readings=np.eye(4), events__ch1=np.array([0.5]), events__ch2=np.array([0.5, 1.5])
        )
        assert io.read(path).n_sensors == 4
        events = io.read(path, options=OPTIONS(select="events", bin_s=1.0))
        np.testing.assert_array_equal(events.readings, [[1, 1], [0, 1]])


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
