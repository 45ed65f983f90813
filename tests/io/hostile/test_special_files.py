"""Pipes, devices and files that change while they are read."""

import os
from pathlib import Path

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import AnisomapWarning, FileError
from anisomap.io import ReadOptions

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes need POSIX")

LOG = "".join(f"{i} {1.3e9 + i / 50:.2f} (1 {i % 7} 3)\n" for i in range(20))


def test_pipes_beside_a_log(tmp_path: Path) -> None:
    for name in ("left", "right"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "data.log").write_text(LOG)
    os.mkfifo(tmp_path / "left" / "info.log")
    assert [content.name for content in io.contents(tmp_path)] == ["left", "right"]
    assert io.read(tmp_path / "left").n_frames == 20
    (tmp_path / "right" / "data.log").unlink()
    os.mkfifo(tmp_path / "right" / "data.log")
    with pytest.raises(FileError, match="not a regular file"):
        io.read(tmp_path, options=ReadOptions(select="right"))


@pytest.mark.parametrize("name", ["pipe.msg", "/dev/zero", "large.msg"])
def test_message_definitions(tmp_path: Path, name: str) -> None:
    bags = pytest.importorskip("bags")
    bag = bags.Bag("mcap")
    bag.add("/skin", bag.array(np.arange(3.0)), 0)
    path = bag.write(tmp_path / "run.mcap")
    os.mkfifo(tmp_path / "pipe.msg")
    (tmp_path / "large.msg").write_bytes(b"#" * (1 << 21))
    definition = tmp_path / name
    if not definition.exists():
        pytest.skip("there is no /dev/zero")
    with pytest.raises(FileError, match=r"not a regular file|larger than 131072 bytes"):
        io.read(path, options=ReadOptions(definitions=(definition,)))


def test_pipes_in_a_bag(tmp_path: Path) -> None:
    bags = pytest.importorskip("bags")
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    bag = bags.Bag("mcap")
    folder = tmp_path / "run"
    with rosbag2.Writer(folder, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        bag.add("/skin", bag.array(np.arange(3.0)), 0)
        bag.fill(writer, bag.store.serialize_cdr)
    assert io.read(folder).n_frames == 1
    (folder / "run.mcap").unlink()
    os.mkfifo(folder / "run.mcap")
    with pytest.raises(FileError, match="not a regular file"):
        io.read(folder)
    (folder / "metadata.yaml").unlink()
    os.mkfifo(folder / "metadata.yaml")
    with pytest.raises(FileError):
        io.read(folder)


def test_a_file_that_is_cut_while_it_is_read(tmp_path: Path) -> None:
    """A process that reads memory mapped from a file beyond its end is killed."""
    path = tmp_path / "skin.npy"
    readings = np.random.default_rng(0).random((60_000, 50))
    np.save(path, readings)
    with io.open_stream(path, frames=1000) as stream:
        first = next(stream.blocks).readings
        np.testing.assert_array_equal(first, readings[:1000])
        os.truncate(path, path.stat().st_size // 3)
        with pytest.warns(AnisomapWarning, match="cut"):
            rest = sum(len(block.readings) for block in stream.blocks)
    assert 0 < rest < 59_000
