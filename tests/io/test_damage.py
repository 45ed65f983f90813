"""Damaged files give a result or a one-line FileError, and nothing else."""

import os
import tracemalloc
import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import scipy

from anisomap import io
from anisomap.errors import AnisomapError
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

Reader = Callable[[Path], Recording | SensorMap]
CASES = 40
MANY_CASES = 200
MEASURED = 8
"""Memory is measured in one of this many cases, because tracing is slow."""
BUFFERS = 16 << 20
"""Memory that a reader may allocate for a file of any size."""


@pytest.fixture
def archives(tmp_path: Path, sensor_map: SensorMap, recording: Recording) -> Path:
    io.write(sensor_map, tmp_path / "map.npz")
    io.write(recording, tmp_path / "skin.npz")
    return tmp_path


def survives(reader: Reader, path: Path, tolerantly: Callable[..., object]) -> bool:
    """Return whether the file was read; exceptions other than AnisomapError fail the test."""
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


def damage_recordings(path: Path, damage, tolerantly, *, cases: int, seed: int) -> None:
    whole, rng = path.read_bytes(), np.random.default_rng(seed)
    survives(io.read, path, tolerantly)  # loads the libraries, so that they are not measured
    for case in range(cases):
        path.write_bytes(damage(whole, rng))
        if case % MEASURED:
            survives(io.read, path, tolerantly)
        else:
            assert memory_of(path, tolerantly) < 4 * len(whole) + BUFFERS


@pytest.mark.parametrize("damage", [cut, change])
def test_damaged_recordings(recording_file: Path, damage, tolerantly) -> None:
    damage_recordings(recording_file, damage, tolerantly, cases=CASES, seed=1)


@pytest.mark.slow
@pytest.mark.parametrize("damage", [cut, change])
def test_damaged_recordings_in_quantity(recording_file: Path, damage, tolerantly) -> None:
    damage_recordings(recording_file, damage, tolerantly, cases=MANY_CASES, seed=4)


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
def test_damaged_arrays_in_an_intact_archive(archives: Path, damage, name: str, tolerantly) -> None:
    """With a valid checksum, damage must be found in the array itself."""
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


def test_a_truncated_log_loses_only_the_truncated_line(tmp_path: Path, tolerantly) -> None:
    path = tmp_path / "data.log"
    lines = [f"{i} {1.3e9 + i / 50:.6f} (0.25 {i % 7}.5 0.75)\n" for i in range(20)]
    whole = "".join(lines)
    first, last = len(lines[0]), len(whole)
    # Every place within a line, and some of the later lines.
    for end in [*range(first + 1, 3 * first), *range(3 * first, last, 17)]:
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


@pytest.mark.skipif(not hasattr(os, "fork"), reason="another process may end")
@pytest.mark.parametrize("compressed", [pytest.param(False, marks=pytest.mark.slow), True])
def test_no_byte_of_a_matlab_file_ends_the_process(tmp_path, tolerantly, compressed: bool) -> None:
    """scipy looks up the types of numbers without a check."""
    path = tmp_path / "skin.mat"
    rng = np.random.default_rng(5)
    parts = np.empty(2, dtype=object)
    parts[:] = [rng.random((2, 2)), "text"]
    values = {
        "readings": rng.random((4, 3)),
        "z": rng.random((2, 2)) + 1j,
        "sparse": scipy.sparse.eye(3).tocsc(),
        "cells": parts,
        "fields": {"taxels": rng.random((3, 2)), "inner": {"a": 1.0}},
    }
    scipy.io.savemat(path, values, do_compression=compressed)
    whole = path.read_bytes()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            for position in range(128, len(whole)):
                for value in (0, 14, 200):
                    path.write_bytes(whole[:position] + bytes([value]) + whole[position + 1 :])
                    survives(io.read, path, tolerantly)
            code = 0
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
