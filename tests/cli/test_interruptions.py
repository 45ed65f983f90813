"""Processes that are interrupted, killed, or denied what they need: outputs are whole or absent."""

import ctypes
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import scipy

import anisomap
import example_files
import watched
from anisomap.cli.app import run
from anisomap.errors import AnisomapError, FileError
from anisomap.files import reader_process
from anisomap.files.paths import together
from skins import flat_skin
from watched import COUNT, run_watched

if sys.platform == "win32":
    pytest.skip("signals, limits and permissions are those of Unix", allow_module_level=True)
resource = pytest.importorskip("resource")

OLD = "an earlier result"
REPORT = "error: interrupted; no file was left half-written"
LIMIT = 4096
"""Bytes per file after which a process finds its disk full."""

COMMAND = [sys.executable, "-m", "anisomap"]
MAP = ["map", "skin.npz", "-d", "2", "-m", "r-anisomap", "--no-verdict", "-o", "m.csv"]
SIMULATE = ["simulate", "plane", "-s", "rubbing", "--frames", "300", "-o", "m.npz"]
CONVERT = ["convert", "map.json", "m.urdf", "--spacing", "5mm"]


@pytest.fixture
def folder(tmp_path):
    anisomap.write(flat_skin(), tmp_path / "skin.npz")
    points = np.random.default_rng(0).random((100, 3))
    anisomap.write(anisomap.SensorMap(points), tmp_path / "map.json")
    restore(tmp_path)
    return tmp_path


def restore(folder):
    """Give every output its earlier content."""
    for suffix in ("csv", "npz", "urdf"):
        (folder / f"m.{suffix}").write_text(OLD)


def temporary(folder):
    return [path for path in folder.rglob(".*") if path.is_file()]


def whole(folder, command):
    """Return whether the output is the earlier result or a complete new one."""
    path = folder / next(word for word in command if word.startswith("m."))
    if path.read_bytes() == OLD.encode():
        return True
    reader = anisomap.read if path.suffix == ".npz" else anisomap.read_map
    return bool(reader(path).names)


def errors_in(said):
    return [line for line in said.splitlines() if not line.startswith("warning")]


COMPLETE = r"\d+ os\.rename .*"
"""Event of the temporary file of an output."""

SHARES = 0.05, 0.3, 0.6, 0.9, 0.999  # of the events of a command


CHILDREN = multiprocessing.get_context("forkserver")
"""Forks of a process that has imported the package, which takes a new process a second, but has no
threads: a fork of the process of tests would lack threads whose locks it copies, and could hang."""


def in_a_child(task, *arguments):
    """Call a function in another process; return its exit code, which is 0 unless it fails."""
    CHILDREN.set_forkserver_preload(["anisomap.cli.app", "anisomap.route", "anisomap.io", "pytest"])
    child = CHILDREN.Process(target=task, args=arguments)
    child.start()
    child.join()
    return child.exitcode


def run_in(folder, said, before, *watched):
    """Call `run_watched`, with standard error in a file."""
    if before is not None:
        before()
    os.setsid()
    os.chdir(folder)
    with open(os.devnull, "w") as sys.stdout, said.open("w", buffering=1) as sys.stderr:  # noqa: PTH123
        run_watched(*watched)


def at_event(folder, command, number, event, before=None):
    """Run a command in a child, with a signal at an event; return exit code and standard error.

    before: Called in the child first.
    """
    with tempfile.TemporaryDirectory() as other:
        said = Path(other) / "stderr.txt"
        said.touch()
        code = in_a_child(run_in, folder, said, before, number, event, command)
        return code, said.read_text()


def at_event_of_process(folder, command, number, event):
    """Run a command as `at_event` does, in a new process."""
    process = subprocess.run(
        [sys.executable, "-P", watched.__file__, str(int(number)), event, *command],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        check=False,
    )
    return process.returncode, process.stderr


def test_a_command_outlives_its_terminal_if_it_is_started_by_nohup(folder):
    ignore = partial(signal.signal, signal.SIGHUP, signal.SIG_IGN)  # as nohup does
    code, said = at_event(folder, CONVERT, signal.SIGHUP, COMPLETE, ignore)
    assert (code, errors_in(said)) == (0, [])
    assert anisomap.read_map(folder / "m.urdf").n_sensors == 100


@pytest.mark.parametrize(("number", "said"), [(signal.SIGINT, [REPORT]), (signal.SIGTERM, [])])
def test_a_signal_while_writing_leaves_all_outputs_old(folder, number, said):
    outputs = [folder / f"m-{i}.csv" for i in (1, 2, 3)]
    for path in outputs:
        path.write_text(OLD)
    command = ["place", "map.json", "--spacing", "5mm"]
    command += [word for path in outputs for word in ("-o", path.name)]
    code, found = at_event(folder, command, number, COMPLETE)
    assert (code, errors_in(found)) == (128 + number, said)
    assert [path.read_text() for path in outputs] == [OLD] * 3
    assert not temporary(folder)
    assert at_event(folder, command, COUNT, "none")[0] == 0
    assert [anisomap.read_map(path).n_sensors for path in outputs] == [100] * 3


def test_interruption_of_an_import(folder):
    ended = at_event_of_process(folder, ["list", "formats"], signal.SIGINT, r"\d+ import numpy")
    assert ended == (130, REPORT + "\n")


LOST = """
import os, signal, sys, time
from anisomap.cli import main

class Loses:
    def __del__(self):  # as a callback, or the import of an extension module
        os.kill(os.getpid(), signal.SIGINT)

def lose(name, arguments):
    if name == "open" and str(arguments[0]).endswith("skin.npz"):
        Loses()
        time.sleep(600)

sys.addaudithook(lose)
main(["info", "skin.npz"])
"""


def test_an_interruption_that_python_loses_ends_the_process(folder):
    command = [sys.executable, "-c", LOST]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, REPORT + "\n")


def test_a_terminated_command_leaves_no_process(tmp_path):
    scipy.io.savemat(tmp_path / "skin.mat", {"readings": np.ones((9, 4))})
    with subprocess.Popen(
        [*COMMAND, "info", "skin.mat"], cwd=tmp_path, start_new_session=True
    ) as process:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        while not children.read_text():  # of the process that reads the file
            time.sleep(0.01)
        process.terminate()
        assert process.wait() == 128 + signal.SIGTERM
    with suppress(ProcessLookupError):
        while True:  # a process that has just started ends when it finds no request
            os.killpg(process.pid, 0)
            time.sleep(0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "at"),
    [(MAP, at_event), (SIMULATE, at_event), (CONVERT, at_event_of_process)],
    ids=["map", "simulate", "import and convert"],
)
def test_a_signal_at_any_time_leaves_outputs_whole(folder, command, at):
    code, said = at(folder, command, COUNT, "none")
    assert code == 0, said
    n_events = int(said.splitlines()[-1])
    for share in SHARES:
        restore(folder)
        code, said = at(folder, command, signal.SIGINT, rf"{int(share * n_events)} .*")
        assert (code, errors_in(said)) in ((0, []), (130, [REPORT])), share
        assert not temporary(folder)
        assert whole(folder, command)


def limited():
    resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT, LIMIT))


def test_a_full_disk_is_an_error_without_a_half_written_file(folder):
    before = {path.name for path in folder.iterdir()}
    code, said = at_event(folder, CONVERT, COUNT, "none", limited)
    errors = [line for line in said.splitlines() if line.startswith("error:")]
    assert code == 2
    assert len(errors) == 1
    assert "cannot write" in errors[0]
    assert "defect" not in said
    assert whole(folder, CONVERT)
    assert {path.name for path in folder.iterdir()} == before


def write_both(short, path):
    """Write two maps together, of which the second is too long for the limit of the process."""
    points = np.random.default_rng(0).random((500, 3))
    with together():
        anisomap.write(anisomap.SensorMap(points[:4], units="m"), short)
        anisomap.write(anisomap.SensorMap(points, units="m"), path)


def fail_to_write(short, others):
    limited()  # not lifted again
    for path in others:
        with pytest.raises(FileError, match="cannot write"):
            write_both(short, path)


def test_every_writer_removes_what_it_could_not_finish(folder):
    short = folder / "m.xml"
    others = [folder / f"n{suffix}" for suffix in (".csv", ".npz", ".json", ".ply", ".urdf")]
    for path in (short, *others):
        path.write_text(OLD)
    before = {file.name for file in folder.iterdir()}
    assert in_a_child(fail_to_write, short, others) == 0
    assert {path.read_text() for path in (short, *others)} == {OLD}
    assert {file.name for file in folder.iterdir()} == before


def without_privileges():
    """Take the right to write anywhere from root, who keeps the rights of an owner."""
    drop_from_bounding_set, override, read_search = 24, 1, 2  # linux/prctl.h, linux/capability.h
    if os.geteuid() == 0:
        library = ctypes.CDLL(None, use_errno=True)
        for capability in (override, read_search):
            if library.prctl(drop_from_bounding_set, capability, 0, 0, 0):
                raise OSError(ctypes.get_errno(), "prctl")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="drops capabilities of Linux")
def test_a_folder_without_write_permission_is_an_error(folder):
    closed = folder / "closed"
    closed.mkdir()
    closed.chmod(0o500)
    words = [*COMMAND, "convert", "map.json", "closed/m.csv"]
    run_it = partial(subprocess.run, words, cwd=folder, capture_output=True, text=True, check=False)
    try:
        done = run_it(preexec_fn=without_privileges)
    except subprocess.SubprocessError:
        pytest.skip("this process may not drop its privileges")
    closed.chmod(0o700)
    assert done.returncode == 2
    assert done.stderr == "error: cannot write closed/m.csv: Permission denied\n"
    assert not list(closed.iterdir())


CHANGES = {
    "grows": lambda path: path.open("ab").write(path.read_bytes()),
    "shrinks": lambda path: os.truncate(path, path.stat().st_size // 3),
    "is emptied": lambda path: os.truncate(path, 0),
    "is overwritten": lambda path: path.write_bytes(b"\xff" * path.stat().st_size),
    "is replaced": lambda path: (path.with_suffix(".new").write_bytes(b"1,2\n"),
                                 path.with_suffix(".new").replace(path)),
    "is removed": lambda path: path.unlink(),
}  # fmt: skip


def read_while_it_changes(path, done):
    """Change a file after its first block, in each way; every reading ends or is refused."""
    content = path.read_bytes()
    for name, change in CHANGES.items():
        path.unlink(missing_ok=True)  # not overwritten, since it may be the file of another reader
        path.write_bytes(content)
        with suppress(AnisomapError), anisomap.io.open_stream(path, frames=100) as stream:
            for number, block in enumerate(stream.blocks):
                assert block.readings.shape[1] == stream.n_sensors
                if not number:
                    change(path)
        (done / name).touch()
    reader_process.stop_all()


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
@pytest.mark.parametrize("name", ["skin.csv", "skin.npy"])
def test_a_file_that_changes_while_it_is_read(tmp_path, monkeypatch, name):
    monkeypatch.setattr(example_files, "N_FRAMES", 10_000)  # readings that no buffer holds
    _, write = example_files.RECORDINGS[name]
    write(tmp_path / name)
    done = tmp_path / "done"
    done.mkdir()
    # In another process, which a bus error would end.
    code = in_a_child(read_while_it_changes, tmp_path / name, done)
    assert {path.name for path in done.iterdir()} == CHANGES.keys()
    assert code == 0


def test_an_interrupted_verdict_leaves_the_map(folder, monkeypatch, capsys):
    def interrupted(sensor_map, runs, with_verdict=True, **options):
        if with_verdict:
            raise KeyboardInterrupt
        return sensor_map

    monkeypatch.setattr("anisomap.route.diagnose", interrupted)
    monkeypatch.chdir(folder)
    assert run(["map", "skin.npz", "-d", "2", "-m", "r-anisomap", "-o", "m.csv"]) == 130
    said = capsys.readouterr()
    assert "Map by r-anisomap" in said.out
    assert said.err == "error: interrupted; m.csv is written, without a verdict\n"
    assert anisomap.read_map(folder / "m.csv").placed.all()
