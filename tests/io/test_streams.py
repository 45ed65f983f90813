"""Reading block by block: independence of the block size, and memory."""

import gzip
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from anisomap import io
from example_files import RECORDINGS

MIB = 1 << 20


def test_blocks_of_any_size_make_the_same_recording(recording_file: Path) -> None:
    whole = io.read(recording_file)
    for frames in (1, 7, 1000):
        with io.open_stream(recording_file, frames=frames) as stream:
            blocks = list(stream.blocks)
        assert [len(block.readings) for block in blocks[:-1]] == [frames] * (len(blocks) - 1)
        assert 0 < len(blocks[-1].readings) <= frames
        np.testing.assert_array_equal(np.vstack([b.readings for b in blocks]), whole.readings)
        assert stream.n_sensors == whole.n_sensors
        assert stream.names in ((), whole.names)
        if whole.times is not None:
            times = np.concatenate([block.times for block in blocks])
            np.testing.assert_allclose(times - times[0], whole.times - whole.times[0], atol=1e-6)


@pytest.mark.parametrize("name", ["skin.csv", "skin.h5"])
def test_errors_of_the_caller_are_not_converted(tmp_path: Path, name: str) -> None:
    RECORDINGS[name][1](tmp_path / name)

    def use() -> None:
        with io.open_stream(tmp_path / name) as stream:
            for _ in stream.blocks:
                raise OSError("of the caller")

    with pytest.raises(OSError, match=r"^of the caller$"):
        use()


def peak(call) -> int:
    tracemalloc.start()
    try:
        call()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def exhaust(path: Path) -> None:
    with io.open_stream(path, frames=100) as stream:
        for _ in stream.blocks:
            pass


def _text(readings: np.ndarray, path: Path) -> None:
    lines = (b" ".join(row) for row in readings.astype("u1").astype("S1").tolist())
    text = b"\n".join(lines) + b"\n"
    path.write_bytes(gzip.compress(text, 1))


def _hdf5(readings: np.ndarray, path: Path) -> None:
    with pytest.importorskip("h5py").File(path, "w") as file:
        file.create_dataset("readings", data=readings, chunks=(64, 200), compression=1)


def _mcap(readings: np.ndarray, path: Path) -> None:
    bag = pytest.importorskip("bags").Bag("mcap")
    for i, row in enumerate(readings.astype(np.float64)):
        bag.add("/skin", bag.array(row), i)
    bag.write(path)


LARGE = {
    "skin.csv.gz": _text,
    "skin.npz": lambda readings, path: np.savez(path, readings=readings),
    "skin.npy": lambda readings, path: np.save(path, readings),
    "skin.h5": _hdf5,
    "skin.mcap": _mcap,
}
CHEAP = {"skin.npz", "skin.npy", "skin.h5"}


@pytest.mark.parametrize(
    "name", [n if n in CHEAP else pytest.param(n, marks=pytest.mark.slow) for n in LARGE]
)
def test_memory(tmp_path: Path, name: str) -> None:
    """Reading keeps one copy of the readings, and streaming none; both need some buffers."""
    readings = np.random.default_rng(0).integers(0, 10, (24_000, 200)).astype(np.float32)
    path = tmp_path / name
    LARGE[name](readings, path)
    io.contents(path)  # imports the formats
    result = readings.nbytes
    assert peak(lambda: io.read(path)) < 1.3 * result + 8 * MIB
    assert peak(lambda: exhaust(path)) < 0.1 * result + 12 * MIB


@pytest.mark.slow
def test_a_gibibyte_is_thinned_without_taking_it(tmp_path: Path) -> None:
    path, rows = tmp_path / "skin.npz", 1 << 22
    block = np.tile(np.eye(256, dtype="u1"), (16, 1))
    form = {"descr": "|u1", "fortran_order": False, "shape": (rows, 256)}
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("readings.npy", "w", force_zip64=True) as member,
    ):
        np.lib.format.write_array_header_1_0(member, form)
        for _ in range(rows // len(block)):
            member.write(block.tobytes())
    kept = []
    assert peak(lambda: kept.append(io.read(path, max_readings=1 << 20))) < 64 * MIB
    (thinned,) = kept
    assert thinned.metadata["frames_sampled_every"] == 1 << 10
    np.testing.assert_array_equal(thinned.readings[:4], block[:: 1 << 10])
