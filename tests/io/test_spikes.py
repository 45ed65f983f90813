"""Recordings of spikes: times of each channel, in several layouts."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap import io
from anisomap.errors import AnisomapWarning, FileError

Put = Callable[[str, str | bytes], Path]
OPTIONS = io.ReadOptions
spike_trains = st.lists(
    st.lists(st.integers(0, 400), min_size=1, max_size=20, unique=True), min_size=2, max_size=4
)


@given(trains=spike_trains, bin_ms=st.sampled_from([20, 50, 1000]))
def test_counts_in_bins(tmp_path_factory, trains: list[list[int]], bin_ms: int) -> None:
    """Every spike is counted once, in the bin of its time."""
    spikes = [(time, channel) for channel, times in enumerate(trains) for time in times]
    path = tmp_path_factory.mktemp("spikes") / "spikes.csv"
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(("time_ms", "channel"))
        rows.writerows((10 * time + 5, channel) for time, channel in spikes)
    found = io.read(path, options=OPTIONS(bin_s=bin_ms / 1000))
    start = min(10 * time for time, _ in spikes)
    expected = np.zeros_like(found.readings)
    for time, channel in spikes:
        expected[(10 * time - start) // bin_ms, channel] += 1
    np.testing.assert_array_equal(found.readings, expected)
    assert found.names == tuple(f"channel{i}" for i in range(len(trains)))
    assert found.rate_hz == pytest.approx(1000 / bin_ms)
    assert found.metadata["bin_s"] == bin_ms / 1000


def test_the_default_width_of_bins_is_said(put: Put) -> None:
    times = np.linspace(0.1, 9.4, 40)
    rows = "".join(f"{time:.4f},{i % 3}\n" for i, time in enumerate(times))
    path = put("spikes.csv", "time,electrode\n" + rows)
    with pytest.warns(AnisomapWarning, match=r"in bins of 1 s, the default width.*--bin-width"):
        found = io.read(path)
    assert found.readings.sum() == 40
    assert found.metadata["bin_s"] == 1
    assert found.n_frames == 10


def test_times_far_away_are_refused(put: Put) -> None:
    rows = "".join(f"{i / 7:.3f},{i % 3}\n" for i in range(60))
    path = put("spikes.csv", "time,channel\n" + rows + "1e12,1\n")
    with pytest.raises(FileError, match=r"61 events from 0 to 1e\+12 s would fill .* bins of 1 s"):
        io.read(path, options=OPTIONS(bin_s=1.0))


class TestSpikeTrains:
    """Times of spikes in HDF5: three layouts, with positions, names and span."""

    TRAINS = ([0.25, 1.5, 1.75], [], [0.5, 2.25])
    COUNTS = ([1, 0, 1], [2, 0, 0], [0, 0, 1])

    @pytest.fixture
    def saved(self, tmp_path: Path) -> Callable[..., Path]:
        h5py = pytest.importorskip("h5py")

        def save(**arrays: object) -> Path:
            with h5py.File(tmp_path / "spikes.h5", "w") as file:
                for name, values in arrays.items():
                    file[name.replace("__", "/")] = values
            return tmp_path / "spikes.h5"

        return save

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
    def test_layouts(self, saved, arrays: dict[str, object], names: tuple[str, ...]) -> None:
        path = saved(**arrays)
        found = io.read(path, options=OPTIONS(bin_s=1.0))
        assert found.names == names
        # The first bin begins with the first spike, at 0.25 s.
        np.testing.assert_array_equal(found.readings, self.COUNTS)
        assert found.rate_hz == 1
        with pytest.warns(AnisomapWarning, match="in bins of 1 s, the default"):
            io.read(path)

    @pytest.mark.parametrize("transposed", [False, True])
    def test_positions_and_span(self, saved, transposed: bool) -> None:
        positions = np.array([[0.0, 42], [42, 42], [84, 0]])
        path = saved(
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
    def test_counts_that_do_not_agree(self, saved, counts: list[float]) -> None:
        path = saved(spikes=np.concatenate(self.TRAINS), sCount=counts)
        with pytest.raises(
            FileError, match=r"spikes\.h5: sCount must divide the 5 times of spikes"
        ):
            io.read(path, options=OPTIONS(bin_s=1.0))

    def test_readings_beside_vectors_are_preferred(self, saved) -> None:
        path = saved(
            skin__readings=np.eye(4), events__ch1=np.array([0.5]), events__ch2=np.array([0.5, 1.5])
        )
        assert io.read(path).n_sensors == 4
        events = io.read(path, options=OPTIONS(select="events", bin_s=1.0))
        np.testing.assert_array_equal(events.readings, [[1, 1], [0, 1]])


class TestSpikeTables:
    """Times of spikes in text, one line or one column per channel, with a width of bins."""

    ROWS = ("0.25,1.5,1.75", "", "0.5,2.25")

    @pytest.mark.parametrize(
        ("text", "names"),
        [
            ("a,0.25,1.5,1.75\nb\nc,0.5,2.25\n", ("a", "b", "c")),
            ("a 0.25 1.5 1.75\nb \nc 0.5 2.25\n", ("a", "b", "c")),
            ("a,b,c\n0.25,,0.5\n1.5,,2.25\n1.75,,\n", ("a", "b", "c")),
            ("0.25;;0.5\n1.5;;2.25\n1.75;;\n", ("channel1", "channel2", "channel3")),
        ],
    )
    def test_layouts(self, put: Put, text: str, names: tuple[str, ...]) -> None:
        found = io.read(put("spikes.txt", text), options=OPTIONS(bin_s=1.0))
        assert found.names == names
        np.testing.assert_array_equal(found.readings, TestSpikeTrains.COUNTS)

    @pytest.mark.parametrize(
        "text",
        ["a,b\n1,2\n3,4\n", "a,b\n1.5,2\n0.5,4\n", "a,b\n0.5,1\n,2\n1.5,3\n", "a,b\n0.5,x\n"],
    )
    def test_readings_are_not_spikes(self, put: Put, text: str) -> None:
        with pytest.raises(FileError, match=r"x\.csv .* holds readings, not events.*--bin-width"):
            io.read(put("x.csv", text), options=OPTIONS(bin_s=1.0))
