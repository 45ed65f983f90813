"""SECURITY.md: each promise names tests that exist; commands do nothing but what is asked."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import anisomap
from skins import flat_skin

ROOT = Path(__file__).parents[1]

# Python reports these events to audit hooks: https://docs.python.org/3/library/audit_events.html
WATCHED = """
import os, sys
allowed = tuple(sys.argv.pop(1).split(os.pathsep))

# When first imported, matplotlib lists fonts, glfw asks for its version, and numpy.testing, which
# SciPy 1.14 imports, asks for the kind of processor.
library = ("fc-list", "lscpu", sys.executable)

def watch(event, arguments):
    if event == "subprocess.Popen" and arguments[0] in library:
        return
    if event in ("socket.connect", "socket.bind", "socket.getaddrinfo", "subprocess.Popen",
                 "os.system", "os.exec", "os.posix_spawn", "os.fork", "os.kill", "ftplib.connect"):
        os.write(2, f"FORBIDDEN {event} {arguments}\\n".encode())
        os._exit(99)
    if event == "open" and isinstance(arguments[0], str | bytes):
        path, flags = os.path.abspath(os.fsdecode(arguments[0])), arguments[2]
        writes = flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        cache = "__pycache__" in path or path == os.devnull
        if writes and not cache and not path.startswith(allowed):
            os.write(2, f"FORBIDDEN write {path}\\n".encode())
            os._exit(99)

sys.addaudithook(watch)
from anisomap.cli import main
main()
"""


@pytest.fixture
def folder(tmp_path):
    skin = flat_skin()
    names = [f"$(touch /tmp/x{i})" for i in range(skin.n_sensors)]
    anisomap.write(
        anisomap.Recording(skin.readings, names=names, positions=skin.positions, units="mm"),
        tmp_path / "skin.npz",
    )
    np.savetxt(tmp_path / "skin.csv", skin.readings, delimiter=",")
    (tmp_path / "cache").mkdir()
    return tmp_path


@pytest.mark.parametrize(
    ("command", "written"),
    [
        (["info", "skin.csv", "--all"], set()),
        (["convert", "skin.npz", "m.xacro", "--spacing", "5mm"], {"m.xacro"}),
        pytest.param(
            ["map", "skin.npz", "-m", "r-anisomap", "-o", "m.csv", "--report", "r.html"],
            {"m.csv", "r.html"},
            marks=pytest.mark.slow,
        ),
        pytest.param(
            ["simulate", "plane", "-s", "bombardment", "--frames", "5", "-o", "s.npz"],
            {"s.npz"},
            marks=pytest.mark.slow,
        ),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_commands_start_nothing_connect_nowhere_and_write_only_what_is_asked(
    folder, command, written, monkeypatch
):
    for variable in ("MPLCONFIGDIR", "NUMBA_CACHE_DIR"):
        monkeypatch.setenv(variable, str(folder / "cache"))
    before = {path.name for path in folder.iterdir()}
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, str(folder), *command],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "FORBIDDEN" not in done.stderr
    assert done.returncode == 0, done.stderr
    assert {path.name for path in folder.iterdir()} - before == written


def test_each_promise_names_tests_that_exist():
    page = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (?!promise|-)(.+?) \| (.+?) \|$", page, re.M)
    assert len(rows) >= 10
    for promise, tests in rows:
        assert "::" in tests, promise
    for file, function in re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", page):
        content = (ROOT / file).read_text(encoding="utf-8")
        assert re.search(rf"^ *(def|class) {function}\b", content, re.M), f"{file}::{function}"
