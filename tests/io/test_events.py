"""Recordings of contacts with the sensors they touch."""

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy

from anisomap import io
from anisomap.errors import AnisomapWarning, FileError

Put = Callable[[str, str | bytes], Path]
CONTACTS = [(0.25, [3, 17]), (0.5, []), (1.0, [17]), (1.5, [3, 4, 17])]
READINGS = np.array([[1, 0, 1], [0, 0, 0], [0, 0, 1], [1, 1, 1]])
NAMES = ("taxel3", "taxel4", "taxel17")
LISTED = {
    "quoted": ("time,taxels", lambda t, ids: f'{t},"{" ".join(map(str, ids))}"'),
    "brackets": ("t;contacts", lambda t, ids: f"{t};{ids}"),
    "python": ("Time [s],active taxels", lambda t, ids: f'{t},"{ids}"'),
    "ragged": ("time,ids", lambda t, ids: ",".join(map(str, [t, *ids]))),
    "tabs": ("time_ms\ttaxel_ids", lambda t, ids: f"{1000 * t:g}\t{' '.join(map(str, ids))}"),
}
OPTIONS = io.ReadOptions


@pytest.mark.parametrize("form", LISTED)
def test_lists_of_contacts(put: Put, form: str) -> None:
    header, row = LISTED[form]
    text = "\n".join([header, *(row(t, ids) for t, ids in CONTACTS)]) + "\n"
    for path in (put("run.csv", text), put("run.txt.gz", gzip.compress(text.encode()))):
        found = io.read(path)
        assert found.names == NAMES
        np.testing.assert_array_equal(found.readings, READINGS)
        np.testing.assert_array_equal(found.times, [0, 0.25, 0.75, 1.25])


@pytest.mark.parametrize("delimiter", [" ", ",", "\t", ";"])
def test_lists_of_contacts_without_a_header(put: Put, delimiter: str) -> None:
    lines = [delimiter.join(map(str, [time, *ids])) for time, ids in CONTACTS]
    found = io.read(put("run.txt", "\n".join(lines) + "\n"))
    assert found.names == NAMES
    np.testing.assert_array_equal(found.readings, READINGS)
    np.testing.assert_array_equal(found.times, [0, 0.25, 0.75, 1.25])


def test_a_single_contact(put: Put) -> None:
    found = io.read(put("run.csv", 'time,taxels\n0.5,"3 17"\n'))
    np.testing.assert_array_equal(found.readings, [[1, 1]])


def test_one_row_per_contact_in_any_order(put: Put) -> None:
    rows = ["1.5,17", "0.25,3", "1.5,3", "0.25,17", "1.0,17", "1.0,", "1.5,4"]
    found = io.read(put("long.csv", "time,taxel\n" + "\n".join(rows) + "\n"))
    assert found.names == NAMES
    np.testing.assert_array_equal(found.readings, READINGS[[0, 2, 3]])
    np.testing.assert_array_equal(found.times, [0, 0.75, 1.25])


def test_values_and_names_of_sensors(put: Put) -> None:
    rows = "event,sensor,pressure\n7,left thumb,2.5\n7,palm,4\n9,palm,1\n"
    found = io.read(put("long.csv", rows))
    assert found.names == ("left thumb", "palm")
    np.testing.assert_array_equal(found.readings, [[2.5, 4], [0, 1]])
    assert found.times is None


def test_numbered_events_are_frames(put: Put) -> None:
    found = io.read(put("long.csv", "event,taxel\n0,3\n0,17\n1,\n2,17\n"))
    np.testing.assert_array_equal(found.readings, [[1, 1], [0, 0], [0, 1]])
    assert found.times is None
    with pytest.raises(FileError, match=r"long\.csv numbers its events without times"):
        io.read(put("long.csv", "event,taxel\n0,3\n0,17\n"), options=OPTIONS(bin_s=1.0))


def test_columns_of_a_padded_table(put: Put) -> None:
    """The layout of a published record of self-touch: two skins, padded to equal length."""
    rows = ["0,0.1,5,0.2,9", "0,0.1,6,NaN,NaN", "1,0.3,6,0.2,8", "2,NaN,NaN,0.2,9"]
    path = put("touch.csv", "\n".join(rows) + "\n")
    first = io.read(path, options=OPTIONS(select="1:3"))
    assert first.names == ("taxel5", "taxel6")
    np.testing.assert_array_equal(first.readings, [[1, 1], [0, 1], [0, 0]])
    second = io.read(path, options=OPTIONS(select="1:5"))
    assert second.names == ("taxel8", "taxel9")
    np.testing.assert_array_equal(second.readings, [[0, 1], [1, 0], [0, 1]])
    with pytest.raises(FileError, match="no column '7'; it has 5 columns"):
        io.read(path, options=OPTIONS(select="1:7"))
    with pytest.raises(FileError, match=r"line 1, column 2: '0\.1' must be the id of a sensor"):
        io.read(path, options=OPTIONS(select="1:2"))


def test_columns_are_selected_by_name(put: Put) -> None:
    path = put("touch.csv", "when,x,pad\n0,1.5,3\n0,2.5,4\n1,3.5,4\n")
    found = io.read(path, options=OPTIONS(select="when:pad"))
    np.testing.assert_array_equal(found.readings, [[1, 1], [0, 1]])


@pytest.mark.parametrize(
    "text",
    [
        "time,sensor\n0.1,0.25\n0.2,0.5\n0.3,0.75\n",
        "time,channel 1,channel 2\n0,1,2\n1,1,3\n",
        "time,id,temperature\n0,1,20\n1,2,21\n",
        "frame,s0,s1\n0,1,2\n1,1,3\n",
        "id,x,y\n1,0,0\n2,1,1\n",
    ],
)
def test_tables_of_readings_are_not_lists_of_contacts(put: Put, text: str) -> None:
    contacts = next(form for form in io.FORMATS if form.name == "contacts")
    assert not contacts.matches(Path("x.csv"), text.encode())


def test_rows_without_a_moment_are_left_out(put: Put) -> None:
    body = "".join(f"{i % 3},{i // 3}\n" for i in range(60))
    assert io.read(put("run.csv", f"taxel,time\n{body}2,inf\n1,90\n")).n_frames == 21


def test_a_truncated_list_loses_its_last_line(put: Put) -> None:
    text = "taxel,time\n" + "".join(f"{i % 3},{i // 3}.5\n" for i in range(9))
    with pytest.warns(AnisomapWarning, match=r"run\.csv: the last line is truncated and dropped"):
        found = io.read(put("run.csv", text + "2"))
    assert found.readings.sum() == 9


def test_readings_have_no_bins(tmp_path: Path) -> None:
    np.save(tmp_path / "x.npy", np.eye(3))
    with pytest.raises(
        FileError, match=r"x\.npy .* holds readings, not events; leave out --bin-width"
    ):
        io.read(tmp_path / "x.npy", options=OPTIONS(bin_s=1.0))


def test_sensors_with_a_position_and_no_contact_were_silent(put: Put) -> None:
    truth = put("truth.csv", "name,x,y\ntaxel4,4,0\ntaxel17,17,0\ntaxel18,18,1\n")
    path = put("run.csv", 'time,taxels\n0,"3 17"\n1,"4 17"\n')
    found = io.read(path, options=OPTIONS(positions=truth))
    assert found.names == ("taxel3", "taxel4", "taxel17", "taxel18")
    np.testing.assert_array_equal(found.readings, [[1, 0, 1, 0], [0, 1, 1, 0]])
    np.testing.assert_array_equal(found.positions[:, 0], [np.nan, 4, 17, 18])
    with io.open_stream(path, options=OPTIONS(positions=truth)) as stream:
        assert stream.n_sensors == next(stream.blocks).readings.shape[1] == 4


def test_positions_match_by_number(put: Put) -> None:
    truth = put("truth.csv", "name,x,y\ntaxel2,2,0\ntaxel0,0,0\ntaxel5,5,0\n")
    found = io.read(put("x.csv", "1,2,3\n4,5,6\n"), options=OPTIONS(positions=truth))
    assert found.names == ("s0", "s1", "s2")
    np.testing.assert_array_equal(found.positions, [[0, 0], [np.nan, np.nan], [2, 0]])
    other = put("other.csv", "name,x,y\nleft,2,0\nright,0,0\n")
    with pytest.raises(FileError, match=r"other\.csv has no position for any sensor of .*x\.csv"):
        io.read(put("x.csv", "1,2,3\n4,5,6\n"), options=OPTIONS(positions=other))


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
        assert found.names == NAMES
        np.testing.assert_array_equal(found.readings, READINGS)
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
        np.testing.assert_array_equal(arm.readings, READINGS[::-1])
        assert arm.source == "touch.mat:arm/activatedTaxels"

    def test_spike_trains(self, saved) -> None:
        trains = [np.array(train).reshape(-1, 1) for train in ([0.25, 1.5], [], [0.5, 2.25])]
        found = io.read(saved(spikes=self.cells(trains)), options=OPTIONS(bin_s=1.0))
        # The first bin begins with the first spike, at 0.25 s.
        np.testing.assert_array_equal(found.readings, [[1, 0, 1], [1, 0, 0], [0, 0, 1]])
        assert found.names == ("channel1", "channel2", "channel3")

    def test_readings_beside_cells_are_preferred(self, saved) -> None:
        path = saved(readings=np.eye(4), notes=self.cells([np.array([[1.0, 2.0]])]))
        assert io.read(path).n_sensors == 4


class TestJson:
    """Contacts as a list of objects, or one object per line."""

    @pytest.mark.parametrize("listed", [True, False])
    def test_ids_names_and_values(self, put: Put, listed: bool) -> None:
        rows = [
            '{"t_ms": 500, "sensor": "palm", "pressure": 2.5}',
            '{"t_ms": 250, "sensor": "thumb", "pressure": 1, "where": [1, 2]}',
            '{"t_ms": 500, "sensor": "thumb", "pressure": 4}',
        ]
        text = f"[{', '.join(rows)}]" if listed else "\n".join(rows) + "\n"
        found = io.read(put("x.json", text))
        assert found.names == ("palm", "thumb")
        np.testing.assert_array_equal(found.readings, [[0, 1], [2.5, 4]])
        np.testing.assert_array_equal(found.times, [0, 0.25])

    def test_a_map_is_not_a_list_of_contacts(self, put: Put) -> None:
        text = '{"time": 3, "units": "mm",\n "sensors": [{"position": [1, 2]}]}'
        assert io.read_map(put("x.json", text)).n_sensors == 1


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

    @pytest.mark.parametrize(
        ("arrays", "message"),
        [
            ({"times": [0.5, 1], "ids": [1]}, "must be lists of equal length"),
            ({"times": [0.5, 1], "ids": [1, -1]}, "ids must be numbers of sensors from 0"),
            ({"times": [0.5, 1], "ids": [1, 2], "names": ["a", "b"]}, "holds 2, but there are 2"),
            ({"times": [0.5, 1], "ids": [1, 0.5]}, "it must be integers"),
            ({"times": [0.5, np.nan], "ids": [1, 2]}, "the time of an event is not finite"),
        ],
    )
    def test_wrong_arrays(self, tmp_path: Path, arrays: dict[str, object], message: str) -> None:
        np.savez(tmp_path / "x.npz", **arrays)
        with pytest.raises(FileError, match=message):
            io.read(tmp_path / "x.npz")
