"""Damaged files give a result or a one-line FileError, and nothing else.

Those that have once been found; `fuzzing` damages files of all formats at random.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy

from anisomap import io
from anisomap.errors import AnisomapError, AnisomapWarning
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

pytestmark = pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")


def survives(reader: Callable[[Path], object], path: Path) -> bool:
    """Return whether the file was read; exceptions other than AnisomapError fail the test."""
    try:
        found = reader(path)
    except AnisomapError as error:
        message = str(error)
        assert path.name in message, "a message must name the file"
        assert "\n" not in message, "a message is one line"
        return False
    assert isinstance(found, Recording | SensorMap)
    return True


def test_a_truncated_log_loses_only_the_truncated_line(tmp_path: Path) -> None:
    path = tmp_path / "data.log"
    lines = [f"{i} {1.3e9 + i / 50:.6f} (0.25 {i % 7}.5 0.75)\n" for i in range(20)]
    whole = "".join(lines)
    first, last = len(lines[0]), len(whole)
    # Every place within a line, and some of the later lines.
    for end in [*range(first + 1, 3 * first), *range(3 * first, last, 17)]:
        path.write_text(whole[:end])
        found = io.read(path)
        complete = whole[:end].count(")")
        assert found.n_frames == complete
        np.testing.assert_array_equal(found.readings[:, 1], [i % 7 + 0.5 for i in range(complete)])


@pytest.mark.filterwarnings("error::anisomap.errors.AnisomapWarning")
@pytest.mark.parametrize("suffix", ["csv", "tsv"])
def test_a_cut_number_of_a_written_recording_is_no_reading(tmp_path: Path, suffix: str) -> None:
    path, readings = tmp_path / f"skin.{suffix}", np.arange(60.0).reshape(20, 3) / 7
    io.write(Recording(readings), path)
    whole = path.read_bytes()
    for end in range(whole.rstrip().rindex(b"\n") + 2, len(whole)):
        path.write_bytes(whole[:end])
        with pytest.warns(AnisomapWarning, match="the last line is truncated and dropped"):
            found = io.read(path)
        np.testing.assert_array_equal(found.readings, readings[:-1])


@pytest.mark.parametrize("whole", ["(((" * 50_000, "[" * 100_000, '{"a":' * 100_000, '"' * 300_000])
@pytest.mark.parametrize("name", ["x.csv", "x.json", "x.ply", "data.log", "x.npz"])
def test_pathological_text(put, name: str, whole: str) -> None:
    for reader in (io.read, io.read_map):
        assert not survives(reader, put(name, whole))


@pytest.mark.slow
def test_a_damaged_matlab_file_that_ends_a_library(tmp_path) -> None:
    """scipy looks up the types of numbers, in every eighth byte, without a check."""
    path = tmp_path / "skin.mat"
    rng = np.random.default_rng(5)
    values = {
        "readings": rng.random((2, 2)),
        "sparse": scipy.sparse.eye(2).tocsc(),
        "fields": {"taxels": rng.random((1, 2)), "text": "a"},
    }
    scipy.io.savemat(path, values)
    whole = path.read_bytes()
    for position in range(128, len(whole), 8):
        path.write_bytes(whole[:position] + b"\xc8" + whole[position + 1 :])
        survives(io.read, path)
