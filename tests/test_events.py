"""Contacts and spikes: the recording that they make, and files of them, which are refused."""

from pathlib import Path

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st

from anisomap import InputError, Recording, io
from anisomap.errors import FileError

EVENTS = st.lists(st.tuples(st.integers(0, 400), st.integers(0, 3)), min_size=1, max_size=40)


@given(events=EVENTS, bin_ms=st.sampled_from([20, 50, 1000]))
def test_each_event_is_counted_once_in_the_bin_of_its_time(
    events: list[tuple[int, int]], bin_ms: int
) -> None:
    times = np.array([10 * time for time, _ in events])
    sensors = [sensor for _, sensor in events]
    found = Recording.from_events(times / 1000, sensors, bin_ms / 1000, names="abcd")
    expected = np.zeros_like(found.readings)
    for time, sensor in zip(times - times.min(), sensors, strict=True):
        expected[time // bin_ms, sensor] += 1
    np.testing.assert_array_equal(found.readings, expected)
    assert found.rate_hz == pytest.approx(1000 / bin_ms)


@given(events=EVENTS)
def test_equal_times_are_a_frame(events: list[tuple[int, int]]) -> None:
    times, sensors = zip(*events, strict=True)
    by_index = Recording.from_events(times, sensors, names="abcd")
    by_name = Recording.from_events(times, ["abcd"[sensor] for sensor in sensors], names="abcd")
    np.testing.assert_array_equal(by_index.readings, by_name.readings)
    active = {(by_index.times[frame], k) for frame, k in np.argwhere(by_index.readings)}
    assert active == set(events)
    assert by_index.readings.max() == 1
    without_silent = Recording.from_events(times, sensors)
    assert without_silent.names == tuple(f"s{i}" for i in sorted(set(sensors)))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (([0, 1], [0]), "a list of as many names"),
        (([0.5], [0.5]), "names or indices"),
        (([0, np.inf], [0, 1]), "time of event 1 is not finite"),
        (([0, 1], [0, -1], None, "ab"), "no sensor -1 among the 2 names"),
        (([0, 1], [0, 1], 0), "bin_width must be positive"),
        (([0, 1e12], [0, 1], 1), "2 events would fill 1e.12 bins"),
    ],
)
def test_events_that_make_no_recording(arguments: tuple, said: str) -> None:
    with pytest.raises(InputError, match=said):
        Recording.from_events(*arguments)


TEXTS = {
    "list": 'time,taxels\n0.5,"3 17"\n0.7,\n0.9,"4 17"\n',
    "brackets": "t;contacts\n0.1;[3, 17]\n0.2;[]\n",
    "spikes": "time_ms,electrode\n10,7\n12,8\n",
    "json lines": '{"time": 0.1, "taxels": [3, 4]}\n{"time": 0.2, "taxels": [3]}\n',
}


@pytest.mark.parametrize("name", TEXTS)
def test_lists_in_text_name_the_line_that_reads_them(name: str, tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text(TEXTS[name])
    with pytest.raises(FileError, match=r"anisomap\.Recording\.from_events\("):
        io.read(path)


@pytest.mark.parametrize(
    "text",
    [
        "time,sensor\n0.1,0.25\n0.2,0.5\n0.3,0.75\n",
        "time,channel 1,channel 2\n0,1,2\n1,1,3\n",
        "time,id,temperature\n0,1,20\n1,2,21\n",
    ],
)
def test_tables_of_readings_are_not_lists_of_events(text: str, tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text(text)
    assert io.read(path).n_frames == text.count("\n") - 1


TIMES, COUNTS = np.array([0.25, 1.5, 1.75, 0.5, 2.25]), np.array([3.0, 0, 2])


@pytest.mark.parametrize("layout", ["npz", "mat", "cells", "repository", "nwb", "vectors"])
def test_spikes_in_arrays_name_the_line_that_reads_them(layout: str, tmp_path: Path) -> None:
    path = tmp_path / "spikes.bin"
    if layout == "npz":
        with path.open("wb") as file:
            np.savez(file, spike_times=TIMES, units=[0, 0, 0, 2, 2])
    elif layout in ("mat", "cells"):
        cells = np.empty((2, 1), dtype=object)
        cells[:, 0] = [np.array([[3.0, 17]]), np.array([[17.0]])]
        with path.open("wb") as file:
            spikes = {"spikes": TIMES[:, None], "sCount": COUNTS}
            scipy.io.savemat(file, spikes if layout == "mat" else {"torso": cells})
    else:
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w") as file:
            if layout == "repository":
                file.update({"spikes": TIMES, "sCount": COUNTS, "epos": np.eye(3)[:, :2]})
            elif layout == "nwb":
                file.update({"units/spike_times": TIMES, "units/spike_times_index": [3, 3, 5]})
            else:
                file.update({"spikes/ch0": TIMES[:3], "spikes/ch1": TIMES[3:]})
    with pytest.raises(FileError, match=r"anisomap\.Recording\.from_events\("):
        io.read(path)


def test_readings_beside_spikes_are_read(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "x.mat", {"readings": np.eye(4), "spikes": TIMES[:, None]})
    assert io.read(tmp_path / "x.mat").n_sensors == 4
