"""Files that unpack, or claim to unpack, to far more than their size are refused early."""

import functools
import gzip
import io as streams
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import FileError
from anisomap.files import budget
from anisomap.io.maps import robot_models

MIB = 1 << 20
SMALL = 2 * MIB
"""Bytes of the readings in a small bomb, as float32."""
MAX_PEAK = 200 * MIB


def _npz(path: Path) -> None:
    header = streams.BytesIO()
    form = {"descr": "|u1", "fortran_order": False, "shape": (SMALL // 4096, 1024)}
    np.lib.format.write_array_header_1_0(header, form)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("readings.npy", header.getvalue() + bytes(SMALL // 4))


def _names(path: Path) -> None:
    """Short names, each stored at the length of a long one."""
    size = SMALL // 16
    header = streams.BytesIO()
    form = {"descr": f"<U{size}", "fortran_order": False, "shape": (4,)}
    np.lib.format.write_array_header_1_0(header, form)
    with path.open("wb") as stream:
        np.savez(stream, readings=np.eye(4))
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("names.npy", header.getvalue() + bytes(16 * size))


def _packed(start: bytes, line: bytes) -> Callable[[Path], None]:
    content = start + line * (max(SMALL, 12 * MIB * (start == b"")) // len(line))
    return lambda path: path.write_bytes(gzip.compress(content))


BOMBS: dict[str, Callable[[Path], object]] = {
    "readings.npz": _npz,
    "names.npz": _names,
    "line.csv.gz": _packed(b"", b"11,"),
    "blanks.csv.gz": _packed(b"1,2,3\n" * 9, b" " * 65_535 + b"\n"),
    "blanks.log.gz": _packed(b"0 1300000000.5 0 0\n", b" " * 65_535 + b"\n"),
}


def _bag(path: Path, kind: str, mode: str) -> None:
    bags = pytest.importorskip("bags")
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    bag = bags.Bag("mcap")
    writer = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin[kind])
    writer.set_compression(rosbag2.CompressionMode[mode], rosbag2.CompressionFormat.ZSTD)
    name = "std_msgs/msg/Float64MultiArray"
    message = bytes(bag.store.serialize_cdr(bag.array(np.zeros(1 << 20)), name))
    with writer:
        connection = writer.add_connection("/skin", name, typestore=bag.store)
        for i in range(20):
            writer.write(connection, bags.START + i, message)


READ_ALL = """
import resource, sys
from pathlib import Path
from anisomap import io
from anisomap.errors import FileError

read = getattr(io, sys.argv.pop(1))

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024

for path in map(Path, sys.argv[1:]):
    before = peak()
    try:
        read(path)
        said = "read"
    except FileError as error:
        said = str(error)
    print(path.name, peak() - before, said, sep="|")
"""


def assert_refused_in_little_memory(reader: str, paths: list[Path]) -> None:
    """Read in a process of its own, in which nothing has used memory before."""
    command = [sys.executable, "-c", READ_ALL, reader, *paths]
    ran = subprocess.run(command, check=True, capture_output=True, text=True)
    found = [line.split("|") for line in ran.stdout.splitlines()]
    assert [name for name, _, _ in found] == [path.name for path in paths]
    for name, more, said in found:
        assert said != "read", name
        assert int(more) < MAX_PEAK, name


def is_refusal(said: str) -> bool:
    reasons = ("decompression bomb", "damaged", "not a table")
    return any(reason in said for reason in reasons)


@pytest.mark.parametrize("name", BOMBS)
def test_small_bombs_are_refused(tmp_path: Path, monkeypatch, name: str) -> None:
    monkeypatch.setattr(budget, "FREE_BYTES", MIB)
    monkeypatch.setattr(budget, "MAX_RATIO", 50)
    BOMBS[name](tmp_path / name)
    with pytest.raises(FileError) as caught:
        io.read(tmp_path / name)
    assert is_refusal(str(caught.value)), caught.value


def test_a_library_that_needs_much_memory_is_stopped(tmp_path: Path) -> None:
    odd = pytest.importorskip("fuzzing.odd")
    (tmp_path / "a.h5").write_bytes(odd.BOMBS["hdf5"](np.random.default_rng(1)))
    with pytest.raises(FileError, match="decompression bomb"):
        io.read(tmp_path / "a.h5")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the peak of memory is in KiB on Linux")
def test_bombs_are_refused_in_little_memory(tmp_path: Path) -> None:
    odd, paths = pytest.importorskip("fuzzing.odd"), list[Path]()
    make = functools.cache(lambda maker: maker(np.random.default_rng(0)))
    for kind, maker in odd.BOMBS.items():
        if kind == "npz":  # 230 times as large as the file, as zeros of a real recording may be
            continue
        paths.append(tmp_path / kind)
        paths[-1].write_bytes(make(maker))
    for kind, mode in (("MCAP", "FILE"), ("MCAP", "STORAGE"), ("SQLITE3", "MESSAGE")):
        paths.append(tmp_path / f"{kind}-{mode}")
        _bag(paths[-1], kind, mode)
    assert_refused_in_little_memory("read", paths)


@pytest.mark.parametrize(("name", "root"), [("a.urdf", "robot"), ("a.xml", "mujoco")])
def test_xml_that_takes_much_memory_is_refused(put, monkeypatch, name: str, root: str) -> None:
    monkeypatch.setattr(robot_models, "_MAX_BYTES", MIB)
    for text, reason in (("<a>" * 20_000, "nested"), (" " * MIB, "larger than 1 MiB")):
        with pytest.raises(FileError, match=reason):
            io.read_map(put(name, f'<{root} name="a">{text}</{root}>'))


DOCUMENTS: dict[str, tuple[str, str, str]] = {
    "empty.urdf": ("<robot>", '<a b="">    </a>', "</robot>"),
    "sites.xml": ("<mujoco><body>", "<size/><a/>", "</body></mujoco>"),
    "lists.json": ('{"a":[', "[],", "[]]}"),
    "objects.json": ('{"a":[', '{"b":""},', "1]}"),
    "skin.json": ('{"skin":{"a":[', '{"b":""},', '1],"taxels":[]}}'),
}
"""Start, repeated part and end of documents whose objects take many times their text."""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the peak of memory is in KiB on Linux")
def test_large_documents_take_little_memory(tmp_path: Path) -> None:
    for name, (start, part, end) in DOCUMENTS.items():
        text = start + part * (16 * MIB // len(part)) + end
        (tmp_path / name).write_text(text)
    assert_refused_in_little_memory("read_map", [tmp_path / name for name in DOCUMENTS])


def test_a_skin_that_nothing_touches_is_no_bomb(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "skin.npz", readings=np.zeros((5000, 500), "u1"))
    assert (tmp_path / "skin.npz").stat().st_size < 10_000
    assert io.read(tmp_path / "skin.npz").readings.nbytes == 10_000_000


def test_readings_are_counted_while_they_are_read(tmp_path: Path, monkeypatch) -> None:
    """Whatever a file declares: text declares nothing, and its readings take twice its size."""
    (tmp_path / "skin.csv").write_text("1,2,3\n" * 100_000)
    assert io.read(tmp_path / "skin.csv").n_frames == 100_000
    monkeypatch.setattr(budget, "FREE_BYTES", 0)
    monkeypatch.setattr(budget, "MAX_RATIO", 1)
    with io.open_stream(tmp_path / "skin.csv") as stream:
        assert len(next(stream.blocks).readings) == 8192
        with pytest.raises(FileError, match="its table of readings expands to"):
            list(stream.blocks)


@pytest.mark.parametrize(
    ("name", "unit"),
    [("map.json", '{"position":[1,2,3]},'), ("map.csv", "1\n"), ("map.icub.txt", "\n")],
)
def test_objects_of_text_are_counted(tmp_path: Path, monkeypatch, name: str, unit: str) -> None:
    """A line takes 150 times its text in memory."""
    start = '{"sensors":[' if name == "map.json" else "1\n"
    packed = gzip.compress((start + unit * 100_000).encode())
    (tmp_path / name).write_bytes(packed)
    monkeypatch.setattr(budget, "FREE_BYTES", MIB)
    with pytest.raises(FileError, match=r"its text expands to .* decompression bomb"):
        io.read_map(tmp_path / name)
