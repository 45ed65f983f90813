"""Contract of all readers and writers, tested over the whole registry."""

import logging
import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap import io
from anisomap.errors import FileError, InputError
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap
from example_files import MAPS, RECORDINGS, example_map

TIMELESS = {"mat.asf": 50, "skin.npy": None, "printed.txt": None, "labels.txt": None}
"""Files without times, and their rates."""


def test_every_format_has_an_example() -> None:
    recordings, maps = ({form for form, _ in each.values()} for each in (RECORDINGS, MAPS))
    assert recordings == {f.name for f in io.FORMATS if f.open_recording}
    assert maps == {f.name for f in io.FORMATS if f.read_map}


ONLY_TRIANGLES = ("icub-display",)
"""Formats that hold no other maps."""


def test_names_and_suffixes_of_formats_are_unique() -> None:
    names = [form.name for form in io.FORMATS]
    suffixes = [suffix for form in io.FORMATS for suffix in form.suffixes]
    assert len(set(names)) == len(names)
    assert len(set(suffixes)) == len(suffixes)
    assert all(suffix.startswith(".") and suffix == suffix.lower() for suffix in suffixes)


def test_recordings_keep_the_contract(
    recording_file: Path, recording: Recording, capfd: pytest.CaptureFixture[str]
) -> None:
    shares: list[float] = []
    found = io.read(recording_file, progress=shares.append)
    assert capfd.readouterr() == ("", "")
    assert not logging.getLogger("anisomap").handlers
    assert sorted(shares) == shares, "progress increases"
    assert 0 <= shares[0] <= shares[-1] <= 1
    assert shares[-1] == pytest.approx(1, abs=0.01)
    assert found.readings.shape == recording.readings.shape
    assert found.readings.dtype in (np.float32, np.float64)
    assert not found.readings.flags.writeable
    precise = found.readings.dtype == np.float64
    expected = recording.readings if precise else recording.readings.astype(np.float32)
    np.testing.assert_array_equal(found.readings, expected)
    assert len(set(found.names)) == found.n_sensors
    assert str(recording_file.parent) not in found.source, "the source must not contain the folder"
    if recording_file.name in TIMELESS:
        assert found.times is None
        assert found.rate_hz == TIMELESS[recording_file.name]
        return
    assert found.times is not None
    assert (np.diff(found.times) > 0).all()
    assert found.times[0] == 0
    assert found.rate_hz in [pytest.approx(rate) for rate in (10, 50, 100)]


def test_recordings_are_recognised_by_content(recording_file: Path, recording: Recording) -> None:
    found = io.read(recording_file.rename(recording_file.with_name("data.bin"))).readings
    np.testing.assert_array_equal(found, recording.readings.astype(found.dtype))


def test_maps_are_recognised_by_content(map_file: Path) -> None:
    expected = io.read_map(map_file)
    disguised = map_file.rename(map_file.with_name("data.bin"))
    np.testing.assert_array_equal(io.read_map(disguised).positions, expected.positions)


def test_equal_input_gives_equal_bytes(
    tmp_path: Path, sensor_map: SensorMap, recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    scaled = example_map(in_metres=True)
    files = [
        (scaled if form.in_metres else thing, suffix)
        for form in io.FORMATS
        for thing, writer in ((sensor_map, form.write_map), (recording, form.write_recording))
        if writer and form.name not in ONLY_TRIANGLES
        for suffix in form.suffixes
    ]
    before = []
    for thing, suffix in files:
        io.write(thing, tmp_path / f"file{suffix}")
        before.append((tmp_path / f"file{suffix}").read_bytes())
    a_year_on = time.time() + 366 * 86400
    monkeypatch.setattr(time, "time", lambda: a_year_on)
    (tmp_path / "elsewhere").mkdir()
    for (thing, suffix), expected in zip(files, before, strict=True):
        io.write(thing, tmp_path / "elsewhere" / f"other{suffix}")
        assert (tmp_path / "elsewhere" / f"other{suffix}").read_bytes() == expected


@given(head=st.binary(max_size=200), name=st.sampled_from(["data.log", "x.csv", "x"]))
def test_recognising_never_raises(head: bytes, name: str) -> None:
    for form in io.FORMATS:
        assert form.matches(Path(name), head) in (True, False)


@pytest.mark.parametrize("name", ["map.xyz", "map", "map.csv.gz", "data.log.bak"])
def test_unknown_suffixes_list_known_ones(tmp_path: Path, sensor_map: SensorMap, name: str) -> None:
    with pytest.raises(FileError, match=r"known suffixes: .*\.npz.*\.json.*\.ply.*\.csv"):
        io.write(sensor_map, tmp_path / name)
    with pytest.raises(FileError, match=r"\.npz.*\.csv"):
        io.check_writable(tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".csv", ".json", ".npz"])
def test_failed_writing_keeps_the_existing_file(
    tmp_path: Path, sensor_map: SensorMap, suffix: str
) -> None:
    target = tmp_path / f"map{suffix}"
    target.write_text("existing")
    with pytest.raises(InputError, match="got list"):
        io.write(replace(sensor_map, provenance={"a": [1]}), target)
    assert target.read_text() == "existing"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".json", ".ply"])
@pytest.mark.parametrize("name", ["a\0", "\ud800"])
def test_names_that_are_not_text_are_rejected(tmp_path: Path, suffix: str, name: str) -> None:
    with pytest.raises(FileError, match="not valid text"):
        io.write(SensorMap([[0.0, 1.0]], names=[name]), tmp_path / f"map{suffix}")
    assert not list(tmp_path.iterdir())


def test_missing_file(tmp_path: Path) -> None:
    for reader in (io.read, io.read_map):
        with pytest.raises(FileError, match=r"there is no file .*nowhere\.csv"):
            reader(tmp_path / "nowhere.csv")


def test_folder(tmp_path: Path) -> None:
    for reader in (io.read, io.read_map):
        with pytest.raises(FileError, match=r"is a folder without .*; give a file"):
            reader(tmp_path)
    for i, name in enumerate(("run1.csv.gz", "run2.csv", "run10.csv", "readme.md")):
        (tmp_path / name).write_text(f"a,b\n{i},2\n")
    found = io.read(tmp_path)
    assert found.readings[:, 0].tolist() == [0, 1, 2]
    assert found.names == ("a", "b")


def test_files_without_read_permission(put, monkeypatch: pytest.MonkeyPatch) -> None:
    path = put("x.csv", "1,2\n")

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(FileError, match=r"cannot read .*x\.csv: Permission denied"):
        io.read(path)


@pytest.mark.parametrize("name", ["map.csv", "map.json", "map.ply", "map.npz", "map.tsv"])
def test_maps_are_not_read_as_recordings(tmp_path: Path, sensor_map: SensorMap, name: str) -> None:
    io.write(sensor_map, tmp_path / name)
    with pytest.raises(FileError, match=rf"{name}.* (no recording|not a recording|readings)"):
        io.read(tmp_path / name)


def test_only_recordings_with_positions_are_read_as_maps(recording_file: Path) -> None:
    if recording_file.name == "numpy.npz":
        assert io.read_map(recording_file).n_sensors == 5
        return
    with pytest.raises(FileError, match=r"positions|columns x and y"):
        io.read_map(recording_file)


def test_real_recordings(recordings_folder: Path, tmp_path: Path) -> None:
    for path in (recordings_folder / f"{name}.npz" for name in ("icub_hexagon", "plantar")):
        found = io.read(path)
        assert found.positions is not None
        assert found.units in ("mm", "pixel")
        assert found.metadata["licence"] == "GPL-3.0"
        truth = io.read_map(path)
        np.testing.assert_array_equal(truth.positions, found.positions)
        assert (truth.names, truth.units) == (found.names, found.units)
        io.write(found, tmp_path / "copy.npz")
        copy = io.read(tmp_path / "copy.npz")
        np.testing.assert_array_equal(copy.readings, found.readings)
        assert (copy.source, copy.rate_hz) == (found.source, found.rate_hz)
