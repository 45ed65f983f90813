"""Files of libraries are read in another process, of which users notice nothing."""

import os
import select
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import scipy

import crashing
from anisomap import io
from anisomap.base.wording import join_items
from anisomap.errors import AnisomapWarning, DamagedError, FileError, MissingExtraError
from anisomap.files import reader_process
from anisomap.io.stream import assemble, contents_isolated, open_isolated

READINGS = np.random.default_rng(3).random((50, 4)).round(3)
WORKS = "sys.modules['anisomap.files.reader_process']._idle[os.getpid()][0]._process.pid"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    scipy.io.savemat(tmp_path / "skin.mat", {"readings": READINGS})
    return tmp_path / "skin.mat"


@pytest.mark.skipif(sys.platform == "win32", reason="signals do not end processes on Windows")
def test_a_library_that_crashes_costs_the_rest_of_a_file(path: Path) -> None:
    reader = partial(open_isolated, crashing.open_recording, path)
    io.read(path)
    with reader(io.ReadOptions()) as stream, pytest.warns(AnisomapWarning, match="read the 4 fram"):
        np.testing.assert_array_equal(assemble(stream).readings, np.eye(4))
    np.testing.assert_array_equal(io.read(path).readings, READINGS)
    why = r"skin.mat is damaged: the library that reads it stopped \(segmentation fault\)"
    with reader(io.ReadOptions("at once")) as stream, pytest.raises(FileError, match=why):
        assemble(stream)


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit of processor time")
def test_a_library_that_computes_without_end_is_stopped(path: Path, monkeypatch) -> None:
    monkeypatch.setattr(reader_process, "_SECONDS", 1)
    with pytest.raises(FileError, match=r"skin.mat: reading takes more than 1 s; it is damaged"):
        contents_isolated(crashing.contents, path, io.ReadOptions())


def test_exceptions_of_libraries_are_damage_and_others_are_defects(path: Path) -> None:
    with (
        reader_process.opened(crashing.missing_key, path) as parts,
        pytest.raises(DamagedError, match=r"skin\.mat is damaged or cut short: 'b'"),
    ):
        next(parts)
    with (
        reader_process.opened(join_items, path) as parts,
        pytest.raises(RuntimeError, match="TypeError"),
    ):
        next(parts)
    np.testing.assert_array_equal(io.read(path).readings, READINGS)


def test_streams_that_are_open_at_the_same_time(path: Path) -> None:
    with io.open_stream(path, frames=7) as stream, io.open_stream(path, frames=7) as again:
        assert len(next(again.blocks).readings) == len(next(stream.blocks).readings) == 7
        np.testing.assert_array_equal(io.read(path).readings, READINGS)
    with ThreadPoolExecutor(4) as threads:
        for found in threads.map(io.read, [path] * 12):
            np.testing.assert_array_equal(found.readings, READINGS)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked on Unix")
def test_a_forked_process_reads_by_itself(path: Path) -> None:
    """In a process without threads: a fork may hang on the locks of threads that it lacks."""
    code = f"""
import os
from anisomap import io
with io.open_stream({path.name!r}) as stream:
    child = os.fork()
    if child == 0:
        os._exit(int(io.read({path.name!r}).n_frames != {len(READINGS)}))
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert len(next(stream.blocks).readings) == {len(READINGS)}
assert io.read({path.name!r}).n_frames == {len(READINGS)}
"""
    subprocess.run([sys.executable, "-c", code], cwd=path.parent, check=True)


def test_a_script_is_not_run_again_and_leaves_nothing(path: Path) -> None:
    """It has no guard of `__main__`, a module that hides one of Python's, and its own folder."""
    (path.parent / "script.py").write_text(
        "import os, sys, tempfile\n"
        "print('begins')\n"
        "from anisomap import io\n"
        f"print(io.read('{path.name}').n_frames, os.listdir(tempfile.gettempdir())[0][:9])\n"
    )
    (path.parent / "temporary").mkdir()
    done = subprocess.run(
        [sys.executable, "-X", "dev", "script.py"],
        env={**os.environ, "TMPDIR": "temporary", "TEMP": "temporary", "TMP": "temporary"},
        cwd=path.parent,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["begins", "50", "anisomap-"]
    assert "ResourceWarning" not in done.stderr
    assert not list((path.parent / "temporary").iterdir())


@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="needs Linux, to wait for any process")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_it_ends_with_the_process_that_asks(path: Path, number: int) -> None:
    temporary = path.parent / "temporary"
    temporary.mkdir()
    code = (
        "import os, sys; from anisomap import io; io.read(sys.argv[1]);"
        f"print({WORKS}, flush=True); input()"
    )
    asks = subprocess.Popen(
        [sys.executable, "-c", code, path],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(temporary)},
        start_new_session=True,
    )
    with asks:
        assert asks.stdout is not None
        works = os.pidfd_open(int(asks.stdout.readline()))
        kill = os.killpg if number == signal.SIGINT else os.kill  # Ctrl-C reaches both
        kill(asks.pid, number)
        assert select.select([works], [], [], 60)[0]
        os.close(works)
        said = asks.communicate()[1].decode()
        assert said.count("Traceback") == (number == signal.SIGINT)
        assert not list(temporary.iterdir())


def test_missing_libraries_name_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for library in ("h5py", "rosbags"):
        (tmp_path / f"{library}.py").write_text("raise ImportError")
    monkeypatch.syspath_prepend(tmp_path)
    reader_process.stop_all()
    try:
        for extra, name, magic in (
            ("hdf5", "skin.h5", b"\x89HDF\r\n\x1a\n"),
            ("mat", "v73.mat", b"MATLAB 7.3 MAT-file"),
            ("ros", "run.bag", b"#ROSBAG V2.0\n"),
        ):
            (tmp_path / name).write_bytes(magic)
            with pytest.raises(MissingExtraError, match=rf"pip install .*\[{extra}\]") as e:
                io.read(tmp_path / name)
            assert e.value.extra == extra
    finally:
        reader_process.stop_all()
