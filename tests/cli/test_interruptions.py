"""Processes that are interrupted, killed, or denied what they need: outputs are whole or absent."""

import ctypes
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from functools import partial

import numpy as np
import pytest

import anisomap
from skins import flat_skin

if sys.platform == "win32":
    pytest.skip("signals, limits and permissions are those of Unix", allow_module_level=True)
resource = pytest.importorskip("resource")

OLD = "an earlier result"
LIMIT = 4096
"""Bytes per file after which a process finds its disk full."""

COMMAND = [sys.executable, "-m", "anisomap"]
MAP = ["map", "skin.npz", "-d", "2", "-m", "r-anisomap", "--no-verdict", "-o", "m.csv"]
SIMULATE = ["simulate", "plane", "-s", "rubbing", "--frames", "300", "-o", "m.npz"]
CONVERT = ["convert", "large.json", "m.urdf", "--spacing", "5mm"]
PAPER = ["paper", "--only", "bins", "--quick", "--output-dir", "m"]


@pytest.fixture
def folder(tmp_path):
    anisomap.write(flat_skin(), tmp_path / "skin.npz")
    points = np.random.default_rng(0).random((4000, 3))
    anisomap.write(anisomap.SensorMap(points), tmp_path / "large.json")
    for suffix in ("csv", "npz", "urdf"):
        (tmp_path / f"m.{suffix}").write_text(OLD)
    return tmp_path


def start(folder, command, **options):
    return subprocess.Popen(
        [*COMMAND, *command],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def temporary(folder):
    return [path for path in folder.iterdir() if path.name.startswith(".m-")]


def whole(folder, command):
    """Return whether the output is the earlier result or a complete new one."""
    path = folder / next(word for word in command if word.startswith("m."))
    if path.read_bytes() == OLD.encode():
        return True
    reader = anisomap.read if path.suffix == ".npz" else anisomap.read_map
    return bool(reader(path).names)


def signal_while_writing(folder, command, number):
    """Send a signal once the temporary file of the output exists; skip if it was too brief."""
    process = start(folder, command)
    while process.poll() is None and not temporary(folder):
        pass
    caught = process.poll() is None
    process.send_signal(number)
    _, said = process.communicate()
    if not caught:
        pytest.skip("the process ended before the signal")
    return process.returncode, said


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_a_signal_while_writing_leaves_nothing_half_written(folder, number, code):
    found, said = signal_while_writing(folder, CONVERT, number)
    assert found in (0, code)  # 0: the file was complete
    errors = [line for line in said.splitlines() if not line.startswith("warning")]
    assert errors in ([], ["error: interrupted; no file was left half-written"])
    assert not temporary(folder)
    assert whole(folder, CONVERT)


def test_a_killed_process_leaves_the_old_file_whole(folder):
    found, _ = signal_while_writing(folder, CONVERT, signal.SIGKILL)
    assert found == -signal.SIGKILL
    assert whole(folder, CONVERT)


def interrupted(folder, command, delay):
    """Interrupt a process after a delay in seconds; return its exit code and standard error."""
    process = start(folder, command)
    end = time.monotonic() + delay
    while time.monotonic() < end and process.poll() is None:
        pass
    process.send_signal(signal.SIGINT)
    _, said = process.communicate()
    return process.returncode, said


def check_interruption(code, said):
    """Check the report of a process that was interrupted at any time.

    Before `main` of the command line runs, the interpreter itself reports the interruption.
    """
    assert ", in main" not in said, "a traceback from the command line"
    assert "defect" not in said
    if "error: interrupted" in said:
        assert code in (130, -signal.SIGINT)


@pytest.mark.parametrize(
    "milliseconds", [1, *(pytest.param(ms, marks=pytest.mark.slow) for ms in (150, 400))]
)
def test_interruption_at_the_start(folder, milliseconds):
    check_interruption(*interrupted(folder, ["formats"], milliseconds / 1000))


@pytest.mark.slow
@pytest.mark.parametrize("command", [MAP, CONVERT], ids=lambda words: words[0])
def test_interruption_at_any_time(folder, command):
    for delay in np.geomspace(0.001, 4, 25):
        _, said = interrupted(folder, command, delay)
        assert "defect" not in said
        assert whole(folder, command)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
@pytest.mark.parametrize("command", [MAP, SIMULATE, CONVERT], ids=lambda words: words[0])
def test_killing_at_any_time(folder, command, number):
    for delay in np.linspace(0.2, 4, 8):
        process = start(folder, command)
        with suppress(subprocess.TimeoutExpired):
            process.communicate(timeout=delay)
        process.send_signal(number)
        process.communicate()
        assert whole(folder, command)
        assert number == signal.SIGKILL or not temporary(folder)
    last = start(folder, command)
    last.communicate()
    assert last.returncode == 0, "a run after the killed ones succeeds"


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_killed_reproduction_of_the_paper_continues(folder, number):
    pytest.importorskip("mujoco", reason="needs the extra 'paper'")
    process = start(folder, PAPER, start_new_session=True)
    while process.poll() is None and not list(folder.glob("m/*")):
        pass
    os.killpg(process.pid, number)
    process.communicate()
    done = start(folder, PAPER)
    _, said = done.communicate()
    assert done.returncode == 0, said
    assert (folder / "m" / "index.html").read_text(encoding="utf-8").rstrip().endswith("</html>")


def limited():
    resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT, LIMIT))


@pytest.mark.parametrize(
    "command",
    [
        CONVERT,
        pytest.param(SIMULATE, marks=pytest.mark.slow),
        pytest.param([*MAP, "--report", "r.html"], marks=pytest.mark.slow),
        pytest.param([*MAP, "--picture", "p.png"], marks=pytest.mark.slow),
        pytest.param([*MAP, "--checkpoint", "c.npz"], marks=pytest.mark.slow),
    ],
    ids=lambda words: " ".join([words[0], *words[-2:-1]]),
)
def test_a_full_disk_is_an_error_without_a_half_written_file(folder, command):
    before = {path.name for path in folder.iterdir()}
    process = start(folder, command, preexec_fn=limited)
    _, said = process.communicate()
    errors = [line for line in said.splitlines() if line.startswith("error:")]
    assert process.returncode == 2
    assert len(errors) == 1
    assert "cannot write" in errors[0]
    assert "defect" not in said
    assert whole(folder, command)
    assert {path.name for path in folder.iterdir()} == before


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
@pytest.mark.parametrize("suffix", [".csv", ".tsv", ".npz", ".json", ".ply", ".pcd", ".urdf"])
def test_every_writer_removes_what_it_could_not_finish(folder, suffix):
    path = folder / f"m{suffix}"
    path.write_text(OLD)
    before = {file.name for file in folder.iterdir()}
    made = anisomap.SensorMap(np.random.default_rng(0).random((4000, 3)), units="m")
    child = os.fork()
    if child == 0:  # in another process, since a limit is not lifted again
        limited()
        code = 1
        try:
            anisomap.write(made, path)
        except anisomap.errors.FileError as error:
            code = 0 if "cannot write" in str(error) else 2
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert path.read_text() == OLD
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
    try:
        process = start(
            folder, ["convert", "large.json", "closed/m.csv"], preexec_fn=without_privileges
        )
    except subprocess.SubprocessError:
        pytest.skip("this process may not drop its privileges")
    _, said = process.communicate()
    closed.chmod(0o700)
    assert process.returncode == 2
    assert said == "error: cannot write closed/m.csv: Permission denied\n"
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


def large(path):
    """Write readings that no buffer holds."""
    values = np.random.default_rng(1).random((40_000, 8)).round(6)
    if path.suffix in (".csv", ".npz", ".tsv"):
        anisomap.write(anisomap.Recording(values), path)
    elif path.suffix == ".npy":
        np.save(path, values)
    elif path.suffix == ".log":
        rows = (" ".join(map(str, row)) for row in values.tolist())
        path.write_text("".join(f"{i} {1.3e9 + i / 50:.6f} {row}\n" for i, row in enumerate(rows)))
    elif path.suffix == ".h5":
        with pytest.importorskip("h5py").File(path, "w") as file:
            file.create_dataset("readings", data=values, chunks=(500, 8), compression="gzip")
    else:
        arrow = pytest.importorskip("pyarrow")
        table = arrow.table({f"s{i}": values[:, i] for i in range(8)})
        if path.suffix == ".parquet":
            pytest.importorskip("pyarrow.parquet").write_table(table, path, row_group_size=500)
        else:
            pytest.importorskip("pyarrow.feather").write_feather(table, path, chunksize=500)


def read_while(change, path):
    """Change a file after its first block; exit with 0 for a result or an AnisomapError."""
    with (
        suppress(anisomap.errors.AnisomapError),
        anisomap.io.open_stream(path, frames=100) as stream,
    ):
        for number, block in enumerate(stream.blocks):
            assert block.readings.shape[1] == 8
            if not number:
                change(path)


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
@pytest.mark.parametrize(
    "name",
    ["a.csv", "a.npz", "a.npy", "data.log", "a.h5", "a.parquet", "a.feather"],
)
def test_a_file_that_changes_while_it_is_read(tmp_path, name):
    for name_of_change, change in CHANGES.items():
        path = tmp_path / name
        large(path)
        task = partial(read_while, change, path)
        child = os.fork()
        if child == 0:  # in another process, which a bus error would end
            code = 1
            try:
                task()
                code = 0
            finally:
                os._exit(code)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0, name_of_change
