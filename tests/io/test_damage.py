"""Damaged files, in quantity: a result, or one sentence; never anything else."""

import tracemalloc
import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import AnisomapError
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

Reader = Callable[[Path], Recording | SensorMap]
CASES = 200
MEASURED = 8
"""Memory is measured in one case of so many, since measuring takes long."""
BUFFERS = 16 << 20
"""What readers may take however small a file is."""


@pytest.fixture
def archives(tmp_path: Path, sensor_map: SensorMap, recording: Recording) -> Path:
    io.write(sensor_map, tmp_path / "map.npz")
    io.write(recording, tmp_path / "skin.npz")
    return tmp_path


def survives(reader: Reader, path: Path, tolerantly: Callable[..., object]) -> bool:
    """Tell whether the file was read; fails by any exception that is none of ours."""
    try:
        found = tolerantly(reader, path)
    except AnisomapError as error:
        message = str(error)
        assert path.name in message, "a message must name the file"
        assert "\n" not in message, "a message is one line"
        return False
    assert isinstance(found, Recording | SensorMap)
    return True


def cut(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: rng.integers(len(content))]


def change(content: bytes, rng: np.random.Generator) -> bytes:
    damaged = bytearray(content)
    damaged[rng.integers(len(damaged))] ^= int(rng.integers(1, 256))
    return bytes(damaged)


@pytest.mark.parametrize("damage", [cut, change])
def test_damaged_recordings(recording_file: Path, damage, tolerantly) -> None:
    whole, rng = recording_file.read_bytes(), np.random.default_rng(1)
    survives(io.read, recording_file, tolerantly)  # what is loaded once is no matter of files
    for case in range(CASES):
        recording_file.write_bytes(damage(whole, rng))
        if case % MEASURED:
            survives(io.read, recording_file, tolerantly)
        else:
            assert memory_of(recording_file, tolerantly) < 4 * len(whole) + BUFFERS


def memory_of(path: Path, tolerantly: Callable[..., object]) -> int:
    tracemalloc.start()
    try:
        survives(io.read, path, tolerantly)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("damage", [cut, change])
def test_damaged_maps(map_file: Path, damage, tolerantly) -> None:
    whole, rng = map_file.read_bytes(), np.random.default_rng(2)
    for _ in range(CASES):
        map_file.write_bytes(damage(whole, rng))
        survives(io.read_map, map_file, tolerantly)


@pytest.mark.parametrize("name", ["skin.npz", "map.npz"])
@pytest.mark.parametrize("damage", [cut, change])
def test_damaged_arrays_in_a_sound_archive(archives: Path, damage, name: str, tolerantly) -> None:
    """The checksum finds most damage; here it is right, and the array is not."""
    path = archives / name
    with zipfile.ZipFile(path) as archive:
        members = {member: archive.read(member) for member in archive.namelist()}
    rng = np.random.default_rng(3)
    for _ in range(CASES):
        chosen = list(members)[rng.integers(len(members))]
        packed = BytesIO()
        with zipfile.ZipFile(packed, "w") as archive:
            for member, content in members.items():
                archive.writestr(member, damage(content, rng) if member == chosen else content)
        path.write_bytes(packed.getvalue())
        survives(io.read_map if name == "map.npz" else io.read, path, tolerantly)


def test_what_was_cut_off_a_log_is_all_that_is_lost(tmp_path: Path, tolerantly) -> None:
    path = tmp_path / "data.log"
    lines = [f"{i} {1.3e9 + i / 50:.6f} (0.25 {i % 7}.5 0.75)\n" for i in range(20)]
    whole = "".join(lines)
    for end in range(len(lines[0]) + 1, len(whole)):
        path.write_text(whole[:end])
        found = tolerantly(io.read, path)
        complete = whole[:end].count(")")
        assert found.n_frames == complete
        np.testing.assert_array_equal(found.readings[:, 1], [i % 7 + 0.5 for i in range(complete)])


@pytest.mark.parametrize("whole", ["(((" * 50_000, "[" * 100_000, '{"a":' * 100_000, '"' * 300_000])
@pytest.mark.parametrize("name", ["x.csv", "x.json", "x.ply", "data.log", "x.npz"])
def test_pathological_text(put, tolerantly, name: str, whole: str) -> None:
    for reader in (io.read, io.read_map):
        assert not survives(reader, put(name, whole), tolerantly)
