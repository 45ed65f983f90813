"""Electrodes: recordings that mne reads, and montages for it."""

import numpy as np
import pytest

from anisomap import InputError, SensorMap, io
from anisomap.errors import AnisomapWarning, FileError

mne = pytest.importorskip("mne")

SAMPLES = np.random.default_rng(5).integers(-1000, 1000, (300, 3)).astype("<i2")


def write_brainvision(folder):
    """Three channels of 0.5 microvolts per bit at 200 Hz, as the amplifier writes them."""
    head = (
        "Brain Vision Data Exchange Header File Version 1.0\n[Common Infos]\nCodepage=UTF-8\n"
        "DataFile=run.eeg\nMarkerFile=run.vmrk\nDataFormat=BINARY\nDataOrientation=MULTIPLEXED\n"
        "NumberOfChannels=3\nSamplingInterval=5000\n[Binary Infos]\nBinaryFormat=INT_16\n"
        "[Channel Infos]\nCh1=Fp1,,0.5,\u00b5V\nCh2=Fp2,,0.5,\u00b5V\nCh3=Cz,,0.5,\u00b5V\n"
    )
    (folder / "run.vhdr").write_text(head, encoding="utf-8")
    (folder / "run.vmrk").write_text(
        "Brain Vision Data Exchange Marker File, Version 1.0\n[Common Infos]\n"
        "DataFile=run.eeg\n[Marker Infos]\nMk1=New Segment,,1,1,0\n"
    )
    SAMPLES.tofile(folder / "run.eeg")
    return folder / "run.vhdr"


def write_edf(folder):
    """Three channels of 0.5 microvolts per bit at 100 Hz, in records of one second."""
    channels = (("Fp1", 16), ("EEG", 80), ("uV", 8), ("-500", 8), ("500", 8), ("-1000", 8),
                ("1000", 8), ("", 80), ("100", 8), ("", 32))  # fmt: skip
    head = "".join(
        text.ljust(width)
        for text, width in (
            ("0", 8), ("X X X X", 80), ("Startdate X X X X", 80), ("01.01.20", 8), ("00.00.00", 8),
            (str(256 * 4), 8), ("", 44), ("3", 8), ("1", 8), ("3", 4),
        )
    )  # fmt: skip
    names = ("Fp1", "Fp2", "Cz")
    for text, width in channels:
        head += "".join((name if text == "Fp1" else text).ljust(width) for name in names)
    path = folder / "run.edf"
    records = SAMPLES.reshape(3, 100, 3).transpose(0, 2, 1)
    path.write_bytes(head.encode("ascii") + records.tobytes())
    return path


@pytest.mark.parametrize(("write", "rate"), [(write_brainvision, 200), (write_edf, 100)])
def test_recordings_of_electrodes(write, rate, tmp_path):
    path = write(tmp_path)
    found = io.read(path)
    assert found.names == ("Fp1", "Fp2", "Cz")
    assert found.rate_hz == rate
    np.testing.assert_allclose(found.readings, SAMPLES * 0.5e-6, atol=1e-12)
    assert [content.name for content in io.contents(path)] == ["eeg"]


def test_a_header_without_its_data_is_refused(tmp_path):
    path = write_brainvision(tmp_path)
    (tmp_path / "run.eeg").unlink()
    with pytest.raises(FileError, match=r"run\.vhdr"):
        io.read(path)


@pytest.mark.parametrize("name", ["run.edf", "run.eeg"])
def test_recordings_that_were_cut_short(name, tmp_path):
    path = write_edf(tmp_path) if name == "run.edf" else write_brainvision(tmp_path)
    data = tmp_path / name
    data.write_bytes(data.read_bytes()[: -700 if name == "run.edf" else -7])
    with pytest.warns(AnisomapWarning, match="cut short"):
        found = io.read(path)
    n = found.n_frames
    assert 0 < n < len(SAMPLES)
    np.testing.assert_allclose(found.readings, SAMPLES[:n] * 0.5e-6, atol=1e-12)


@pytest.fixture
def cap():
    places = np.random.default_rng(1).standard_normal((6, 3))
    places *= 95 / np.linalg.norm(places, axis=1, keepdims=True)
    places[2] = np.nan
    return SensorMap(places, names=("Fp1", "Fp2", "lost", "C z", "O1", "O2"), units="mm")


@pytest.mark.parametrize("suffix", ["elc", "sfp"])
def test_montages_are_read_by_mne(cap, suffix, tmp_path):
    path = tmp_path / f"cap.{suffix}"
    cap.save(path)
    found = mne.channels.read_custom_montage(path, head_size=None).get_positions()["ch_pos"]
    assert list(found) == ["Fp1", "Fp2", "C_z", "O1", "O2"]
    expected = cap.positions[cap.placed] / 1000
    np.testing.assert_allclose(np.array(list(found.values())), expected, rtol=1e-6)


def test_a_map_is_a_montage(cap):
    found = cap.to_montage().get_positions()
    assert found["coord_frame"] == "unknown"
    np.testing.assert_allclose(found["ch_pos"]["O2"], cap["O2"] / 1000)
    with pytest.raises(InputError, match="scale the map"):
        SensorMap(np.zeros((3, 3))).to_montage()


def test_channels_that_are_marked_as_bad_are_left_out(tmp_path):
    info = mne.create_info(["Fp1", "Fp2", "Cz"], 200, "eeg")
    raw = mne.io.RawArray(SAMPLES.T * 0.5e-6, info, verbose="ERROR")
    raw.info["bads"] = ["Fp2"]
    raw.save(tmp_path / "run_raw.fif", verbose="ERROR")
    with pytest.warns(AnisomapWarning, match="marked as bad are left out: Fp2"):
        found = io.read(tmp_path / "run_raw.fif")
    assert found.names == ("Fp1", "Cz")
    np.testing.assert_allclose(found.readings, SAMPLES[:, [0, 2]] * 0.5e-6, rtol=1e-6)
    raw.info["bads"] = raw.ch_names
    raw.save(tmp_path / "run_raw.fif", overwrite=True, verbose="ERROR")
    with pytest.raises(FileError, match="all channels of type eeg are marked as bad"):
        io.read(tmp_path / "run_raw.fif")
