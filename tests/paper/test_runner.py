"""The runner of experiments, with experiments that take no time, and numbers in documents."""

import csv
import re
from dataclasses import replace
from pathlib import Path

import pytest
from benchmarks import numbers
from threadpoolctl import threadpool_info, threadpool_limits

from anisomap.errors import FileError, InputError
from anisomap.paper import Document, Experiment, Settings, Table, reproduce, results
from anisomap.paper.claims import CLAIMS, OWN, REPRODUCED

ROOT = Path(__file__).parents[2]
QUICK = Settings(quick=True)


def add_up(settings, tables):
    value = settings.seed + sum(row[0] for table in tables.values() for row in table.rows)
    yield Table("number", "A number.", {"value": "a number"}, [(value,)])


def write_text(_settings, _tables):
    yield Document("text.txt", "A text.", "text\n")


def fail(_settings, _tables):
    raise InputError("this experiment fails")


def interrupt(_settings, _tables):
    raise KeyboardInterrupt


def count_threads(_settings, _tables):
    rows = [(pool["user_api"], pool["num_threads"]) for pool in threadpool_info()]
    columns = {"pool": "kind of thread pool", "threads": "number of threads"}
    yield Table("threads", "Threads.", columns, rows)


@pytest.fixture(autouse=True)
def one_process(monkeypatch):
    """Run experiments in this process: they are functions of this module."""
    monkeypatch.setenv("LOKY_MAX_CPU_COUNT", "1")


def registry(*experiments):
    return {one.name: one for one in experiments}


FIRST = Experiment("first", add_up, "First", "A number.")
SECOND = Experiment("second", add_up, "Second", "A sum.", needs=("first",))
TEXT = Experiment("text", write_text, "Text", "A text.")
ALL = registry(SECOND, FIRST, TEXT)


def compute(folder, settings=QUICK, experiments=ALL, **options):
    """Return the names of the experiments that were computed."""
    found = reproduce(folder, settings, experiments=experiments, **options)
    return {one.name for one in found if one.state == "computed"}


def test_needed_experiments_run_first_and_all_run_once_for_each_seed(tmp_path):
    for seed, expected in ((1, "value\n2\n"), (5, "value\n10\n")):
        settings = replace(QUICK, seed=seed)
        assert compute(tmp_path, settings) == {"first", "second", "text"}
        assert (tmp_path / "second" / "number.csv").read_text() == expected
        assert compute(tmp_path, settings) == set()
        assert compute(tmp_path, settings, only=["second"]) == set()


@pytest.mark.parametrize("name", ["text.txt", results.RECORD])
@pytest.mark.parametrize("damage", ["truncated", "removed", "changed"])
def test_damaged_results_are_computed_again(tmp_path, name, damage):
    compute(tmp_path)
    path = tmp_path / "text" / name
    if damage == "removed":
        path.unlink()
    else:
        path.write_text(path.read_text()[:-3] if damage == "truncated" else "{}")
    assert compute(tmp_path) == {"text"}
    assert (tmp_path / "text" / "text.txt").read_text() == "text\n"


@pytest.mark.parametrize(("broken", "error"), [(fail, InputError), (interrupt, KeyboardInterrupt)])
def test_a_stopped_run_continues_with_the_unfinished_experiments(tmp_path, broken, error):
    with pytest.raises(error):
        compute(tmp_path, experiments=registry(FIRST, replace(SECOND, compute=broken)))
    assert [path.name for path in tmp_path.iterdir()] == ["first"]
    before = {path: path.read_bytes() for path in tmp_path.glob("*/*")}
    assert compute(tmp_path) == {"second", "text"}
    assert {path: path.read_bytes() for path in before} == before


def test_experiments_use_one_thread_per_worker(tmp_path):
    with threadpool_limits(2):
        compute(tmp_path, experiments=registry(Experiment("threads", count_threads)))
    with (tmp_path / "threads" / "threads.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows
    assert {row["threads"] for row in rows} == {"1"}


def test_invalid_arguments_raise_errors(tmp_path):
    with pytest.raises(InputError, match="choose from second, first, text"):
        compute(tmp_path, only=["third"])
    with pytest.raises(FileError, match="nowhere does not exist"):
        compute(tmp_path, replace(QUICK, recordings=tmp_path / "nowhere"))
    with pytest.raises(InputError, match="seed must be at least 0"):
        Settings(seed=-1)
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="cannot create the folder"):
        compute(tmp_path / "file")
    with pytest.raises(InputError, match="2 of 1 values"):
        Table("wrong", "", {"value": "a number"}, ((1, 2),))


def test_seeds_are_picked_at_random_and_reproducibly():
    settings = Settings()
    picked = {purpose: settings.picked_seed(purpose) for purpose in "abcdefghijkl"}
    assert set(picked.values()) <= set(settings.seeds)
    assert len(set(picked.values())) > 3
    assert picked == {purpose: settings.picked_seed(purpose) for purpose in picked}


def test_documents_hold_the_numbers_of_the_tables():
    documents = ("README.md", "paper/paper.md", "docs/explanation/accuracy.md")
    pages = sorted((ROOT / "docs" / "explanation").glob("paper*.md"))
    texts = [path.read_text(encoding="utf-8") for path in (*map(ROOT.joinpath, documents), *pages)]
    for text in texts:
        assert numbers.fill(text, ROOT / "docs" / "results") == text, "run benchmarks.publish"
    assert all(any(f"| {claim.text} |" in text for text in texts) for claim in CLAIMS)
    assert {"claims", "figure-3"} <= {name for text in texts for name in numbers.tables_in(text)}


def test_the_page_gives_a_reason_for_each_claim_that_is_not_reproduced():
    with (ROOT / "docs" / "results" / "claims.csv").open(newline="") as file:
        own = [row for row in csv.DictReader(file) if row["scope"] == OWN]
    assert [row["claim"] for row in own] == [claim.text for claim in CLAIMS]
    page = (ROOT / "docs" / "explanation" / "paper-claims.md").read_text(encoding="utf-8")
    reasons = re.findall(r"^- \*\*([\d, ]+)\*\*:", page, re.MULTILINE)
    explained = {int(number) for numbers in reasons for number in numbers.split(",")}
    assert explained == {int(row["number"]) for row in own if row["verdict"] != REPRODUCED}


def test_documents_are_updated_from_results(tmp_path):
    compute(tmp_path / "out")
    page = tmp_path / "page.md"
    page.write_text("A\n<!-- numbers: number: value -->\nold\n<!-- end of numbers -->\nB\n")
    arguments = [str(tmp_path / "out"), str(tmp_path / "tables"), str(page)]
    numbers.main(arguments)
    assert "| value |\n| --- |\n| 1 |\n" in page.read_text()
    assert page.read_text() == numbers.fill(page.read_text(), tmp_path / "tables")
    page.write_text("<!-- numbers: number: worth -->\n<!-- end of numbers -->")
    with pytest.raises(FileError, match="no column 'worth'"):
        numbers.main(arguments)
    page.write_text("<!-- numbers: absent -->\n<!-- end of numbers -->")
    with pytest.raises(FileError, match="run anisomap paper first"):
        numbers.main(arguments)
