"""Files that once failed, whole and damaged files of every format, and the fuzzer itself."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import InputError

for extra in ("h5py", "pyarrow", "rosbags", "mujoco", "trimesh", "PIL", "defusedxml"):
    pytest.importorskip(extra, reason="the fuzzer needs all extras that read files")
pytest.importorskip("resource", reason="the fuzzer limits the memory of processes as Unix does")

from fuzzing import workers
from fuzzing.checks import Findings
from fuzzing.damage import DAMAGES, inside
from fuzzing.odd import BOMBS, ODD
from fuzzing.subjects import Subject, subjects
from fuzzing.table import Results
from fuzzing.table import main as join_tables
from fuzzing.workers import Tally, run_case, run_cases

CORPUS = Path(__file__).parent / "corpus"
USES = 8
"""Random generators per file, each of which chooses one of the ways to read it."""
LASTING = ("mne-22",)
"""Files that are refused only after seconds, at the limit of memory."""
HANG_S = 60
"""CPU time, and a tenth of the time by the clock: enough for any machine, however busy."""


@pytest.fixture(scope="module")
def formats() -> dict[str, Subject]:
    return {subject.name: subject for subject in subjects()}


def test_the_fuzzer_is_a_command():
    """It finds the files of the tests without the search path of pytest."""
    root = Path(__file__).parents[1]
    subprocess.run([sys.executable, "-m", "fuzzing", "--help"], cwd=root, check=True)


@pytest.fixture
def patiently(monkeypatch):
    monkeypatch.setattr(workers, "MAX_CPU_SECONDS", HANG_S)
    monkeypatch.setattr(workers, "MAX_SECONDS", 10 * HANG_S)


@pytest.fixture
def in_empty_folder(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("ANISOMAP_DEBUG", "1")
    return tmp_path


def problems(subject, tree, folder, capfd, uses=range(USES)):
    """Read files in several ways, by the library and by a command."""
    found = []
    for use in uses:
        by_command = use % 4 == 3
        part = folder / f"use-{use}"
        part.mkdir()
        rng = np.random.default_rng(use)
        result = run_case(subject, tree, part, rng, by_command=by_command)
        printed = capfd.readouterr()
        result.check_printed(printed.err, by_command=by_command)
        found += result.problems
    assert not list(Path().iterdir()), "nothing is left in the working folder"
    return found


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(name, marks=pytest.mark.slow) if name in LASTING else name
        for name in sorted(path.name for path in CORPUS.iterdir())
    ],
)
def test_what_once_failed(formats, in_empty_folder, capfd, case):
    named = {name.replace(" ", "-"): subject for name, subject in formats.items()}
    subject = named[case.rpartition("-")[0]]
    folder = CORPUS / case
    tree = {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
    uses = (0, 3) if case in LASTING else range(USES)
    assert not problems(subject, tree, in_empty_folder, capfd, uses)


def test_every_format_is_tried(formats):
    readable = {f.name for f in io.FORMATS if f.open_recording or f.read_map or f.write_map}
    assert readable <= set(formats)
    assert set(ODD) | set(BOMBS) <= set(formats)


def test_whole_files_are_read(formats, in_empty_folder, capfd):
    for number, subject in enumerate(formats.values()):
        folder = in_empty_folder / str(number)
        folder.mkdir()
        found = run_case(subject, subject.seeds[-1], folder, np.random.default_rng(number))
        found.check_printed(capfd.readouterr().err, by_command=False)
        assert not found.problems, subject.name


@pytest.mark.usefixtures("patiently")
@pytest.mark.slow
def test_some_damaged_files_of_every_format(formats, tmp_path):
    for subject in formats.values():
        tally = run_cases(subject, 99, range(3), tmp_path)
        assert tally.n_cases == 3
        assert not tally.problems, subject.name


@pytest.mark.usefixtures("patiently")
def test_the_same_seed_gives_the_same_cases(formats, tmp_path):
    first, again = (run_cases(formats["text"], 5, range(30), tmp_path) for _ in range(2))
    assert (first.n_accepted, first.damages) == (again.n_accepted, again.damages)


@pytest.mark.parametrize("name", DAMAGES)
@pytest.mark.parametrize("content", [b"", b"a", b"1,2\n3,4\n", b"PK\x03\x04", b"\x1f\x8b\x08"])
def test_damage_accepts_any_content(name, content):
    rng = np.random.default_rng(1)
    changed = {inside(content, rng, DAMAGES[name]) for _ in range(40)}
    assert len(changed) > 1 or not content


class TestTheFuzzerFinds:
    """Each kind of problem, in functions made for it."""

    def found(self, folder, action):
        findings = Findings(folder)
        findings.attempt("read", action)
        return findings.problems

    def test_an_internal_error(self, in_empty_folder):
        assert "KeyError" in self.found(in_empty_folder, lambda: {}["a"])[0]

    def test_an_output_after_a_failure(self, in_empty_folder):
        def fails():
            Path("stray.csv").write_text("half")
            raise InputError("no")

        (problem,) = self.found(in_empty_folder, fails)
        assert "left ['.csv'] after a failure" in problem
        Path("stray.csv").unlink()

    def test_a_message_of_several_lines(self, in_empty_folder):
        def fails():
            raise InputError("a\nb")

        (problem,) = self.found(in_empty_folder, fails)
        assert "several lines" in problem

    def test_printing(self, tmp_path):
        findings = Findings(tmp_path)
        findings.check_printed("error: one line\n", by_command=True)
        assert not findings.problems
        findings.check_printed("Traceback (most recent call last):\n", by_command=True)
        findings.check_printed("noise\n", by_command=False)
        assert len(findings.problems) == 2


def test_the_table_joins_runs_and_counts_each_kind_of_problem(tmp_path):
    for seed, tally in ((4, Tally(9, 3, slowest_s=2, n_failed=2)), (5, Tally(1, 1, memory=10**6))):
        results = Results(tmp_path / f"{seed}.json", seed, first=0, resume=False)
        results.tallies = {"a": tally, "b": Tally(1, 1)}
        tally.problems.update(["hang", "read: memory 900 of 200 MB"] * (seed == 4))
        results.save()
    table = tmp_path / "table.md"
    join_tables([str(tmp_path / "4.json"), str(tmp_path / "5.json"), "-o", str(table)])
    rows = [line.split("|")[1:-1] for line in table.read_text().splitlines()]
    cells = [[cell.strip() for cell in row] for row in rows]
    assert cells[2] == ["a", "10", "4", "4", "0", "1", "1", "0", "2.0", "1"]
    assert cells[4] == ["**all**", "12", "4", "6", "0", "1", "1", "0", "2.0", "1"]
    assert "of seeds 4, 5. Problems:" in table.read_text()
    assert "- a, once: hang" in table.read_text()


def test_a_run_is_continued_with_its_results(tmp_path):
    results = Results(tmp_path / "results.json", seed=4, first=0, resume=False)
    results.tallies["a"] = Tally(9, 3, n_failed=1)
    results.tallies["a"].problems["hang"] = 1
    results.save()
    again = Results(tmp_path / "results.json", seed=4, first=0, resume=True)
    assert again.tallies == results.tallies
    with pytest.raises(ValueError, match="the results of"):
        Results(tmp_path / "results.json", seed=5, first=0, resume=True)
