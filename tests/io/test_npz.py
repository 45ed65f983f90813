"""NumPy archives and arrays, and their validation before decompression."""

import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import FileError

READINGS = np.arange(12.0).reshape(4, 3)


@pytest.fixture
def saved(tmp_path: Path) -> Callable[..., Path]:
    def save(**arrays: object) -> Path:
        np.savez(tmp_path / "skin.npz", **arrays)
        return tmp_path / "skin.npz"

    return save


class Trap:
    """An object that creates a folder when it is unpickled."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> tuple[Callable[[str], None], tuple[str]]:
        return __import__("os").mkdir, (str(self.folder),)


def error(path: Path, reader: Callable[[Path], object] = io.read) -> str:
    with pytest.raises(FileError) as caught:
        reader(path)
    assert "skin.npz" in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("dtype", ["f2", "f4", "f8", ">f8", "u1", "i2", "<i8", "?"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_dtypes(saved, tmp_path: Path, dtype: str, order: str) -> None:
    readings = np.array(READINGS, dtype=dtype, order=order)
    np.save(tmp_path / "skin.npy", readings)
    for path in (saved(readings=readings), tmp_path / "skin.npy"):
        found = io.read(path)
        np.testing.assert_array_equal(found.readings, readings)
        exact = readings.dtype.itemsize <= 2 or dtype == "f4"
        assert found.readings.dtype == (np.float32 if exact else np.float64)
        assert found.source == path.name


def test_all_optional_arrays(saved) -> None:
    found = io.read(
        saved(
            readings=READINGS,
            names=np.array([b"a", b"b", b"c"]),
            times=np.array([1, 2, 4, 8]),
            positions=np.zeros((3, 2), "f4"),
            units=np.array(["mm"]),
            licence="MIT",
            seed=7,
            gain=0.5,
            dry=True,
            triangle=np.arange(3),
            objects=np.array([{}, None]),
        )
    )
    assert found.names == ("a", "b", "c")
    assert found.times.tolist() == [1, 2, 4, 8]
    assert found.units == "mm"
    assert found.source == "skin.npz"
    assert dict(found.metadata) == {"licence": "MIT", "seed": 7, "gain": 0.5, "dry": True}
    assert [type(value) for value in found.metadata.values()] == [str, int, float, bool]


WRONG_RECORDINGS = [
    ({"data": READINGS, "labels": [1]}, "no array readings; in Python it is numpy.savez("),
    ({"readings": np.zeros((2, 4, 3))}, "time, its longest axis, first or last"),
    ({"readings": READINGS.astype(object)}, "readings must hold numbers, got dtype object"),
    ({"readings": READINGS, "names": ["a", "b"]}, "sensors: 3, names: 2"),
    ({"readings": READINGS, "names": np.array(["a", 1, None])}, "Object arrays cannot be loaded"),
    ({"readings": READINGS, "positions": np.zeros((3, 2), complex)}, "it must be numbers"),
    ({"readings": READINGS, "times": [0.0, 1.0]}, "times must have shape"),
    ({"readings": READINGS, "rate_hz": [1.0, 2.0]}, "one value"),
    ({"times": [0.5, 1], "ids": [1, 2]}, "holds events; in Python"),
]
WRONG_MAPS = [
    ({"component": [0, 0]}, "component must have 3 entries"),
    ({"component": [0, 0, 3]}, "numbered from 0"),
    ({"component": [0.0, 0.0, 0.0]}, "component is of type"),
    ({"positions": np.zeros(3)}, "must be of shape (N, k)"),
]
CASES = [
    *((io.read, arrays, message) for arrays, message in WRONG_RECORDINGS),
    *((io.read_map, {"positions": np.zeros((3, 2)), **a}, message) for a, message in WRONG_MAPS),
]


@pytest.mark.parametrize(("reader", "arrays", "message"), CASES)
def test_wrong_arrays(saved, reader, arrays: dict[str, object], message: str) -> None:
    assert message in error(saved(**arrays), reader)


def test_nothing_is_unpickled(saved, tmp_path: Path) -> None:
    folder = tmp_path / "sprung"
    trap = np.array([[Trap(folder)]], dtype=object)
    assert "must hold numbers" in error(saved(readings=trap))
    assert "Object arrays cannot be loaded" in error(saved(positions=trap), io.read_map)
    io.read(saved(readings=READINGS, extra=trap, single=trap[0, 0]))
    path = tmp_path / "skin.npz"
    path.write_bytes(pickle.dumps(Trap(folder)))
    error(path)
    assert not folder.exists()
    pickle.loads(path.read_bytes())
    assert folder.exists(), "the trap would have sprung"


def packed(header: str, content: bytes, path: Path) -> Path:
    """Create an archive with an array of any header and content."""
    head = header.encode().ljust(117) + b"\n"
    array = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head + content
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("readings.npy", array)
    return path


@pytest.mark.parametrize(
    ("descr", "shape"),
    [
        ("'<f8'", "(1000000000, 1000000)"),
        ("'<f8'", "(-1, 4)"),
        ("'<f99'", "(4, 1)"),
        ("__import__", "(4, 1)"),
    ],
)
def test_headers_that_cannot_be(tmp_path: Path, descr: str, shape: str) -> None:
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}"
    path = packed(header, bytes(24), tmp_path / "skin.npz")
    assert "readings" in error(path)
    with zipfile.ZipFile(path) as archive:
        content = archive.read("readings.npy")
    np.savez(path, readings=READINGS)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("names.npy", content)
    assert "array names" in error(path)


def test_what_is_no_archive_of_numpy(saved) -> None:
    path = saved(readings=READINGS)
    for content in (path.read_bytes()[:-30], b"<html>not found</html>"):
        path.write_bytes(content)
        assert "File is not a zip file" in error(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "hello")
    assert "it has no array" in error(path)


def test_wrong_single_arrays(tmp_path: Path) -> None:
    path = tmp_path / "skin.npy"
    for array, message in (
        (np.zeros((0, 3)), r"got shape \(0, 3\)"),
        (np.array([["a"]]), "must hold numbers"),
    ):
        np.save(path, array)
        with pytest.raises(FileError, match=message):
            io.read(path)
    np.save(path, np.array([[Trap(tmp_path / "sprung")]], dtype=object), allow_pickle=True)
    with pytest.raises(FileError, match=r"skin\.npy.* must hold numbers, got dtype object"):
        io.read(path)
    assert not (tmp_path / "sprung").exists()
    np.save(path, READINGS)
    path.write_bytes(path.read_bytes()[:-8])
    with pytest.raises(FileError, match="cut short"):
        io.read(path)
