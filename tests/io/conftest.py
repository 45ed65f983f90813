"""Fixtures of the tests of files."""

import functools
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap
from example_files import MAPS, RECORDINGS, example_map, example_recording


@functools.cache
def example(name: str) -> bytes:
    """Return the content of an example in `RECORDINGS`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        RECORDINGS[name][1](path)
        return path.read_bytes()


@pytest.fixture
def recording() -> Recording:
    return example_recording()


@pytest.fixture
def sensor_map() -> SensorMap:
    return example_map()


@pytest.fixture(params=RECORDINGS)
def recording_file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / request.param
    path.write_bytes(example(request.param))
    return path


@pytest.fixture(params=MAPS)
def map_file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / request.param
    MAPS[request.param][1](path)
    return path


@pytest.fixture
def put(tmp_path: Path) -> Callable[[str, str | bytes], Path]:
    """Write text or bytes to a named file, and return its path."""

    def write(name: str, content: str | bytes) -> Path:
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write
