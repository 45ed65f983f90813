"""Reproducing the paper: quick runs of the experiments, and the promises of the runner."""

import csv
import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap import io
from anisomap.cli.app import main
from anisomap.errors import FileError, InputError, MissingExtraError
from anisomap.paper import (
    EXPERIMENTS,
    Document,
    Experiment,
    Outcome,
    Settings,
    Table,
    claim_evidence,
    measures,
    numbers,
    reproduce,
    result_cache,
)
from anisomap.paper.experiments import stimuli
from anisomap.paper.runs import BOMBARDED
from anisomap.simulation import find_body

pytest.importorskip("mujoco")
pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")

ROOT = Path(__file__).parents[1]
QUICK = Settings(quick=True)


CHEAP = ("data-s1-s6", "data-s7-s11", "text-s3", "figure-s3")
"""Experiments that take about a second each."""


@pytest.fixture(
    scope="module", params=[CHEAP, pytest.param((), marks=pytest.mark.slow)], ids=["cheap", "all"]
)
def quick(tmp_path_factory, request):
    """Give the folder of a run of ``anisomap paper --quick``."""
    folder = tmp_path_factory.mktemp("paper") / "out"
    chosen = [word for name in request.param for word in ("--only", name)]
    workers = "1" if chosen else "2"
    with pytest.raises(SystemExit) as end:
        main(["paper", "-o", str(folder), "--quick", "--workers", workers, *chosen])
    assert not end.value.code
    return folder


def made_in(folder):
    """Give the names of the experiments that were run."""
    return {path.parent.name for path in folder.glob("*/done.json")}


def test_every_experiment_leaves_what_its_record_tells(quick, request):
    chosen = request.node.callspec.params["quick"]
    assert made_in(quick) >= set(chosen or (e.name for e in EXPERIMENTS.values() if not e.files))
    for name in made_in(quick):
        experiment = EXPERIMENTS[name]
        kept = result_cache.load(quick, experiment.name)
        assert kept is not None, experiment.name
        assert kept.pictures or kept.tables or kept.documents
        for table in kept.tables:
            path = quick / experiment.name / f"{table.name}.csv"
            with path.open(newline="") as file:
                assert next(csv.reader(file)) == list(table.columns)
            assert all(table.columns.values()), "every column is explained"
            assert table.rows
        for picture in kept.pictures:
            for kind in result_cache.KINDS:
                assert (quick / experiment.name / f"{picture['name']}.{kind}").stat().st_size > 5000


def test_the_page_shows_all_and_needs_nothing_from_elsewhere(quick):
    page = (quick / "index.html").read_text()
    links = re.findall(r'(?:href|src)="([^"]+)"', page)
    assert not [link for link in links if "//" in link]
    for link in links:
        assert link.startswith("#") or (quick / link).is_file(), link
    for name, experiment in EXPERIMENTS.items():
        shown = bool(experiment.title) and (name in made_in(quick) or bool(experiment.files))
        assert (f'id="{name}"' in page) == shown
    assert "matejhof/robotic-homunculus-supporting-materials" in page, "how to get real skin"
    pictures = {path.relative_to(quick).as_posix() for path in quick.glob("*/*.png")}
    assert pictures <= set(links)


def test_what_is_finished_is_not_run_again(quick):
    before = {path: path.stat().st_mtime_ns for path in quick.glob("*/*")}
    told = reproduce(quick, QUICK, only=[*made_in(quick), "real-skin"], workers=2)
    assert {done.name for done in told if done.how == "kept"} == made_in(quick)
    assert {done.name for done in told if done.how != "kept"} == {"real-skin"}
    assert before == {path: path.stat().st_mtime_ns for path in quick.glob("*/*")}


@pytest.mark.parametrize("quick", [pytest.param((), marks=pytest.mark.slow)], indirect=True)
def test_every_claim_gets_a_verdict(quick):
    rows = result_cache.load(quick, "claims").tables[0].records()
    for row in rows:
        assert row["verdict"].startswith(
            (claim_evidence.HOLDS, claim_evidence.FAILS, claim_evidence.PARTLY)
        )
        held, of = map(int, row["cases"].split(" of "))
        assert (row["verdict"] == claim_evidence.HOLDS) == (held == of)
        assert (row["verdict"] == claim_evidence.FAILS) == (held == 0)


def test_sample_data_can_be_read_and_says_how_it_was_made(quick):
    path = quick / "data-s1-s6" / "data-s2.txt"
    case = next(case for case in BOMBARDED if case.body == "sphere")
    recording = case.record(QUICK, QUICK.picked_seed(case.name))
    found = io.read(path)
    assert found.names == recording.names
    np.testing.assert_allclose(found.readings, recording.readings, rtol=1e-4)
    text = path.read_text()
    places = np.array(
        [line.split()[3:6] for line in text.splitlines() if line.startswith("# sensor")], float
    )
    np.testing.assert_allclose(places, find_body("sphere").positions, atol=1e-5)
    words = (quick / "data-s1-s6" / "text-s1.txt").read_text()
    for name in re.findall(r"^# (\w+): ", text, flags=re.MULTILINE):
        known = {"frames", "rate_hz", "body", "scenario", "seed", "anisomap", "mujoco"}
        measured = {"energy_drift", "deepest_overlap"}
        assert name in known | measured or f"{name} = " in words, name


def test_the_patch_fails_as_the_papers_did(quick):
    early, late = (io.read(quick / "data-s7-s11" / f"data-s{n}.txt") for n in (9, 11))
    for recording in (early, late):
        silent = np.array([name.startswith("t5") for name in recording.names])
        assert (recording.varying() == ~silent).all()
    at_full = (late.readings == late.readings.max()).sum(axis=0)
    assert late.names[int(np.argmax(at_full))] == "t3p0"
    assert at_full.max() > 10 * np.sort(at_full)[-2]


def test_real_skin_is_mapped_where_it_is_given(recordings_folder, tmp_path):
    settings = replace(QUICK, recordings=recordings_folder)
    reproduce(tmp_path, settings, only=["real-skin"], workers=1)
    (table,) = result_cache.load(tmp_path, "real-skin").tables
    best = {row["method"]: row["mantel_r"] for row in table.records() if row["dimensions"] == 2}
    assert best["r-anisomap"] > 0.98
    assert "was not given" not in (tmp_path / "index.html").read_text()


# The runner, with experiments that cost nothing.


def count_up(settings, tables):
    rows = [(settings.seed + sum(row[0] for table in tables.values() for row in table.rows),)]
    return Outcome(tables=(Table("number", "A number.", {"value": "a number"}, tuple(rows)),))


def write_text(_settings, _tables):
    return Outcome(documents=(Document("text.txt", "A text.", "text\n"),))


def break_off(_settings, _tables):
    raise InputError("this one never works")


def registry(*experiments):
    return {one.name: one for one in experiments}


FIRST = Experiment("first", "First", "Something.", count_up)
SECOND = Experiment("second", "Second", "More.", count_up, needs=("first",))
TEXT = Experiment("text", "Text", "Words.", write_text)
ALL = registry(SECOND, FIRST, TEXT)


def made(folder, settings=QUICK, experiments=ALL, **options):
    told = reproduce(folder, settings, experiments=experiments, workers=1, **options)
    return {done.name for done in told if done.how == "made"}


def test_needs_come_first_and_nothing_is_run_twice(tmp_path):
    assert made(tmp_path) == {"first", "second", "text"}
    assert result_cache.load(tmp_path, "second").tables[0].rows == ((2,),)
    assert made(tmp_path) == set()
    assert made(tmp_path, only=["second"]) == set()


def test_another_seed_runs_all_again(tmp_path):
    made(tmp_path)
    assert made(tmp_path, replace(QUICK, seed=5)) == {"first", "second", "text"}
    assert result_cache.load(tmp_path, "second").tables[0].rows == ((10,),)


@pytest.mark.parametrize("damage", ["text.txt", "done.json"])
@pytest.mark.parametrize("how", ["cut", "gone", "changed"])
def test_a_damaged_result_is_made_again(tmp_path, damage, how):
    made(tmp_path)
    path = tmp_path / "text" / damage
    if how == "gone":
        path.unlink()
    else:
        path.write_text(path.read_text()[:-3] if how == "cut" else "{}")
    assert made(tmp_path) == {"text"}
    assert (tmp_path / "text" / "text.txt").read_text() == "text\n"


@given(st.integers(0, 10_000), st.binary(min_size=1, max_size=4))
def test_a_record_damaged_anywhere_is_never_taken_for_another(tmp_path_factory, place, junk):
    folder = tmp_path_factory.mktemp("damaged")
    made(folder, experiments=registry(FIRST))
    path = folder / "first" / "done.json"
    whole = path.read_bytes()
    place %= len(whole)
    path.write_bytes(whole[:place] + junk + whole[place + len(junk) :])
    kept = result_cache.load(folder, "first", json.loads(whole)["key"])
    assert kept is None or kept.tables[0].rows == ((1,),)


def test_what_fails_leaves_nothing_and_what_was_done_stays(tmp_path):
    broken = Experiment("second", "Second", "More.", break_off, needs=("first",))
    with pytest.raises(InputError, match="never works"):
        made(tmp_path, experiments=registry(FIRST, broken))
    assert [path.name for path in tmp_path.iterdir()] == ["first"]
    assert made(tmp_path) == {"second", "text"}


def test_what_a_killed_run_left_is_swept_away(tmp_path):
    aside = tmp_path / ".first-4711"
    aside.mkdir()
    (aside / "half.csv").write_text("val")
    made(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {*ALL, "index.html"}


def test_what_makes_no_sense_is_refused_at_once(tmp_path):
    with pytest.raises(InputError, match="choose from second, first, text"):
        made(tmp_path, only=["third"])
    with pytest.raises(InputError, match="at least 1"):
        reproduce(tmp_path, QUICK, experiments=ALL, workers=0)
    with pytest.raises(FileError, match="no folder of recordings"):
        made(tmp_path, replace(QUICK, recordings=tmp_path / "nowhere"))
    with pytest.raises(InputError, match="seed"):
        Settings(seed=-1)
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="cannot make the folder"):
        made(tmp_path / "file")
    with pytest.raises(InputError, match="2 values for 1 columns"):
        Table("wrong", "", {"value": "a number"}, ((1, 2),))


@pytest.mark.parametrize(("module", "extra"), [("mujoco", "simulation"), ("jinja2", "report")])
def test_what_it_needs_is_told_before_anything_runs(tmp_path, monkeypatch, module, extra):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=rf"anisomap\[{extra}\]"):
        made(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_seed_is_picked_at_random_but_always_the_same():
    settings = Settings()
    picked = {purpose: settings.picked_seed(purpose) for purpose in "abcdefghijkl"}
    assert set(picked.values()) <= set(settings.seeds)
    assert len(set(picked.values())) > 3
    assert picked == {purpose: settings.picked_seed(purpose) for purpose in picked}


# What is measured of shapes.


@given(st.floats(0.05, 3), st.integers(0, 100))
def test_a_cylinder_squeezed_along_its_axis_is_found_so(factor, seed):
    truth = find_body("cylinder").positions
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    scale = measures.axial_scale(7 * truth * [1, 1, factor] @ turn + 3, truth)
    assert scale.local == pytest.approx(factor, rel=1e-6)
    if factor > 0.5:  # much flatter ones do not lie along their axis once they are aligned
        assert scale.whole == pytest.approx(factor, rel=1e-3)


def test_a_sphere_has_no_spread_of_radii_and_a_line_has_that_of_a_uniform_density():
    assert measures.spread_of_radii(find_body("sphere").positions) < 0.01
    line = np.linspace(-1, 1, 2001)[:, None]
    assert measures.spread_of_radii(line) == pytest.approx(1 / 3**0.5, abs=1e-3)


def test_a_sensor_alone_is_isolated_and_one_in_a_lattice_is_not():
    grid = np.stack(np.meshgrid(range(5), range(5)), -1).reshape(-1, 2).astype(float)
    assert measures.isolation(grid, 7) == pytest.approx(1)
    grid[0] -= [3, 4]
    assert measures.isolation(grid, 0) == pytest.approx(np.hypot(4, 4))


@pytest.mark.parametrize("dimensions", [1, 2, 3, 5])
def test_distances_in_k_dimensions_have_k_variances(dimensions):
    points = np.random.default_rng(dimensions).normal(size=(400, dimensions))
    distances = np.linalg.norm(points[:, None] - points, axis=2)
    variances = measures.spectrum(distances)
    assert measures.chosen_dimension(variances) == dimensions
    np.testing.assert_allclose(
        variances[:dimensions].sum(), ((points - points.mean(axis=0)) ** 2).sum()
    )
    np.testing.assert_allclose(variances[dimensions:], 0, atol=1e-9)


def test_neighbouring_pixels_and_bands_are_most_alike():
    retina, cochlea = stimuli.retina(400, 1), stimuli.cochlea(400, 1)
    for recording in (retina, cochlea):
        alike = np.corrcoef(recording.readings.T)
        apart = np.linalg.norm(recording.positions[:, None] - recording.positions, axis=2)
        near = (apart > 0) & (apart < 1.5 * np.min(apart[apart > 0]))
        far = apart > np.median(apart)
        assert 1 - alike[near].mean() < (1 - alike[far].mean()) / 3
    again, another = stimuli.cochlea(400, 1), stimuli.cochlea(400, 2)
    np.testing.assert_array_equal(again.readings, cochlea.readings)
    assert (another.readings != cochlea.readings).any()


def test_a_verdict_says_for_which_cases_it_holds():
    def verdict(**held):
        return claim_evidence.Evidence("", held).verdict

    assert verdict(a=True, b=True) == "holds"
    assert verdict(a=False, b=False) == "does not hold"
    assert verdict(a=True, b=False, c=False) == "holds only for a"
    assert verdict(a=True, b=True, c=False) == "holds only for 2 of 3: not for c"


# Numbers in documents.


def test_numbers_of_documents_are_those_of_the_tables():
    for path in (ROOT / "README.md", ROOT / "docs" / "explanation" / "paper.md"):
        text = path.read_text(encoding="utf-8")
        assert numbers.fill(text, ROOT / "docs" / "results") == text, "run make numbers"
    assert numbers.tables_in(
        (ROOT / "docs" / "explanation" / "paper.md").read_text(encoding="utf-8")
    )


def test_documents_are_brought_up_to_date(tmp_path):
    made(tmp_path / "out")
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
