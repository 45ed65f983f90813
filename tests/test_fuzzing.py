"""Files that once failed, whole and damaged files of every format."""

from pathlib import Path

import numpy as np
import pytest

from anisomap import io

for extra in ("h5py", "rosbags", "mujoco", "trimesh", "defusedxml"):
    pytest.importorskip(extra, reason="the fuzzer needs all extras that read files")
pytest.importorskip("resource", reason="the fuzzer limits the memory of processes as Unix does")

from fuzzing import workers
from fuzzing.__main__ import main
from fuzzing.odd import BOMBS, ODD
from fuzzing.subjects import subjects
from fuzzing.workers import run_case

CORPUS = Path(__file__).parent / "corpus"


@pytest.fixture(scope="module")
def formats():
    return {subject.name: subject for subject in subjects()}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("ANISOMAP_DEBUG", "1")
    return tmp_path


def problems(subject, tree, folder, capfd, use):
    """Read files in one of several ways, by the library or by a command."""
    part, rng = folder / f"{subject.name}-{use}", np.random.default_rng(use)
    part.mkdir()
    result = run_case(subject, tree, part, rng, by_command=use % 4 == 3)
    result.check_printed(capfd.readouterr().err, by_command=use % 4 == 3)
    return [*result.problems, *Path().iterdir()]


@pytest.mark.parametrize("case", sorted(path.name for path in CORPUS.iterdir()))
def test_what_once_failed(formats, folder, capfd, case):
    named = {name.replace(" ", "-"): subject for name, subject in formats.items()}
    files = sorted(path for path in (CORPUS / case).rglob("*") if path.is_file())
    tree = {str(path.relative_to(CORPUS / case)): path.read_bytes() for path in files}
    for use in range(8):
        assert not problems(named[case.rpartition("-")[0]], tree, folder, capfd, use)


def test_whole_files_of_every_format_are_read(formats, folder, capfd):
    readable = {f.name for f in io.FORMATS if f.open_recording or f.read_map or f.write_map}
    assert readable | set(ODD) | set(BOMBS) <= set(formats)
    for subject in formats.values():
        assert not problems(subject, subject.seeds[-1], folder, capfd, 0)


@pytest.mark.slow
def test_some_damaged_files_of_every_format(tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "MAX_CPU_SECONDS", 60)  # enough for any machine, however busy
    assert main(["--cases", "90", "--seed", "99", "-o", str(tmp_path)]) == 0
    assert "There was no problem." in (tmp_path / "reliability-table.md").read_text("utf-8")
