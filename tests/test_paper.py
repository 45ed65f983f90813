"""Reproduction of the paper: quick runs of the experiments, and the runner."""

import csv
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_info, threadpool_limits

from anisomap import io
from anisomap.cli.app import main
from anisomap.errors import FileError, InputError
from anisomap.paper import (
    EXPERIMENTS,
    Document,
    Experiment,
    Outcome,
    Settings,
    Table,
    numbers,
    reproduce,
    results,
    shape_statistics,
)
from anisomap.paper.cases import CASES, METHODS, PATCH_RUNS, find_case
from anisomap.paper.claim_checks import NOT_REPRODUCED, PARTLY, REPRODUCED, ClaimCheck
from anisomap.paper.claims import CLAIMS
from anisomap.paper.experiments.unlike_responses import radial_basis
from anisomap.paper.map_scores import SCORE_COLUMNS, map_and_score, null_box, score_rows
from anisomap.simulation import find_body

pytest.importorskip("mujoco")
cbook = pytest.importorskip("matplotlib.cbook")
pytest.importorskip("jinja2")

ROOT = Path(__file__).parents[1]
QUICK = Settings(quick=True)
CHEAP = ("data-s1-s6", "data-s7-s11", "text-s3", "figure-s3", "figure-s10")


@pytest.fixture(
    scope="module", params=[CHEAP, pytest.param((), marks=pytest.mark.slow)], ids=["cheap", "all"]
)
def quick(tmp_path_factory, request):
    """Return the folder of a run of ``anisomap paper --quick``."""
    folder = tmp_path_factory.mktemp("paper") / "out"
    chosen = [word for name in request.param for word in ("--only", name)]
    workers = "1" if chosen else "2"
    with pytest.raises(SystemExit) as end:
        main(["paper", "-o", str(folder), "--quick", "--workers", workers, *chosen])
    assert not end.value.code
    return folder


def computed_in(folder):
    return {path.parent.name for path in folder.glob(f"*/{results.RECORD}")}


def read_table(folder, name):
    with (folder / name / f"{name}.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def contents(folder):
    return {path: path.read_bytes() for path in folder.glob("*/*")}


def test_every_experiment_writes_the_files_in_its_record(quick, request):
    chosen = request.node.callspec.params["quick"]
    assert computed_in(quick) == set(
        chosen or (one.name for one in EXPERIMENTS.values() if not one.files)
    )
    for name in computed_in(quick):
        record = json.loads((quick / name / results.RECORD).read_text())
        assert record["pictures"] or record["tables"] or record["documents"]
        for table in record["tables"]:
            with (quick / name / f"{table['name']}.csv").open(newline="") as file:
                header, *rows = csv.reader(file)
            assert header == list(table["columns"])
            assert rows
            assert all(table["columns"].values()), "every column has a description"
        for picture in record["pictures"]:
            for kind in results.FIGURE_FORMATS:
                assert (quick / name / f"{picture['name']}.{kind}").stat().st_size > 5000


def test_the_page_shows_all_results_without_a_network(quick):
    page = (quick / "index.html").read_text()
    links = re.findall(r'(?:href|src)="([^"]+)"', page)
    assert not [link for link in links if "//" in link]
    for link in links:
        assert link.startswith("#") or (quick / link).is_file(), link
    for name, experiment in EXPERIMENTS.items():
        shown = bool(experiment.title) and (name in computed_in(quick) or bool(experiment.files))
        assert (f'id="{name}"' in page) == shown
    assert "matejhof/robotic-homunculus-supporting-materials" in page, "source of real recordings"
    pictures = {path.relative_to(quick).as_posix() for path in quick.glob("*/*.png")}
    assert pictures <= set(links)


def test_finished_experiments_are_not_repeated(quick):
    before = {path: path.stat().st_mtime_ns for path in quick.glob("*/*")}
    found = reproduce(quick, QUICK, only=[*computed_in(quick), "real-skin"], workers=2)
    assert {one.name for one in found if one.state == "cached"} == computed_in(quick)
    assert {one.name for one in found if one.state == "skipped"} == {"real-skin"}
    assert before == {path: path.stat().st_mtime_ns for path in quick.glob("*/*")}


@pytest.mark.slow
def test_results_do_not_depend_on_the_number_of_workers(quick, tmp_path):
    chosen = ("figure-s10", "data-s7-s11")
    reproduce(tmp_path, QUICK, only=chosen, workers=2)
    for name in chosen:
        for path in (tmp_path / name).iterdir():
            if path.name != results.RECORD:  # holds the duration
                assert path.read_bytes() == (quick / name / path.name).read_bytes(), path.name


@pytest.mark.parametrize("quick", [pytest.param((), marks=pytest.mark.slow)], indirect=True)
def test_every_claim_has_a_verdict_that_agrees_with_its_cases(quick):
    rows = read_table(quick, "claims")
    assert [row["claim"] for row in rows] == [claim.text for claim in CLAIMS]
    for row in rows:
        held, n_cases = map(int, row["cases"].split(" of "))
        assert row["verdict"].startswith((REPRODUCED, NOT_REPRODUCED, PARTLY))
        assert (row["verdict"] == REPRODUCED) == (held == n_cases)
        assert (row["verdict"] == NOT_REPRODUCED) == (held == 0)


def test_sample_data_hold_the_readings_positions_and_parameters(quick):
    path = quick / "data-s1-s6" / "data-s2.txt"
    case = find_case("sphere")
    recording = case.record(QUICK, QUICK.picked_seed(case.name))
    found = io.read(path)
    assert found.names == recording.names
    np.testing.assert_allclose(found.readings, recording.readings, rtol=1e-4)
    text = path.read_text()
    positions = np.array(
        [line.split()[3:6] for line in text.splitlines() if line.startswith("# sensor")], float
    )
    np.testing.assert_allclose(positions, find_body("sphere").positions, atol=1e-5)
    description = (quick / "data-s1-s6" / "text-s1.txt").read_text()
    for name in re.findall(r"^# (\w+): ", text, flags=re.MULTILINE):
        facts = {"frames", "rate_hz", "body", "scenario", "seed", "anisomap", "mujoco"}
        measured = {"energy_drift", "deepest_overlap"}
        assert name in facts | measured or f"{name} = " in description, name


def test_the_simulated_patch_has_the_failures_of_the_paper(quick):
    early, late = (io.read(quick / "data-s7-s11" / f"data-s{n}.txt") for n in (9, 11))
    for recording in (early, late):
        silent = np.array([name.startswith("t5") for name in recording.names])
        assert (recording.varying() == ~silent).all()
    saturated = (late.readings == late.readings.max()).sum(axis=0)
    assert late.names[int(np.argmax(saturated))] == "t3p0"
    assert saturated.max() > 10 * np.sort(saturated)[-2]


@pytest.mark.slow
def test_real_skin_is_mapped_if_its_recording_is_given(recordings_folder, tmp_path):
    settings = replace(QUICK, recordings=recordings_folder)
    reproduce(tmp_path, settings, only=["real-skin"], workers=1)
    found = {row["method"]: float(row["mantel_r"]) for row in read_table(tmp_path, "real-skin")}
    assert found["r-anisomap"] > 0.98
    assert "was not given" not in (tmp_path / "index.html").read_text()


@pytest.mark.slow
def test_missing_extras_are_reported_in_one_sentence(tmp_path):
    code = (
        "import sys; sys.modules.update(dict.fromkeys(('mujoco', 'matplotlib', 'jinja2')));"
        f"from anisomap.cli import main; main(['paper', '-o', {str(tmp_path / 'out')!r}])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        "error: reproducing the paper needs an extra: pip install 'anisomap[paper]'"
    ]
    assert not (tmp_path / "out").exists()


# The runner, with experiments that take no time.


def add_up(settings, tables):
    value = settings.seed + sum(row[0] for table in tables.values() for row in table.rows)
    return Outcome(tables=(Table("number", "A number.", {"value": "a number"}, ((value,),)),))


def write_text(_settings, _tables):
    return Outcome(documents=(Document("text.txt", "A text.", "text\n"),))


def fail(_settings, _tables):
    raise InputError("this experiment fails")


def interrupt(_settings, _tables):
    raise KeyboardInterrupt


def count_threads(_settings, _tables):
    rows = tuple((pool["user_api"], pool["num_threads"]) for pool in threadpool_info())
    columns = {"pool": "kind of thread pool", "threads": "number of threads"}
    return Outcome(tables=(Table("threads", "Threads.", columns, rows),))


def registry(*experiments):
    return {one.name: one for one in experiments}


FIRST = Experiment("first", "First", "A number.", add_up)
SECOND = Experiment("second", "Second", "A sum.", add_up, needs=("first",))
TEXT = Experiment("text", "Text", "A text.", write_text)
ALL = registry(SECOND, FIRST, TEXT)


def compute(folder, settings=QUICK, experiments=ALL, **options):
    """Return the names of the experiments that were computed."""
    found = reproduce(folder, settings, experiments=experiments, workers=1, **options)
    return {one.name for one in found if one.state == "computed"}


def number_of(folder, name):
    return (folder / name / "number.csv").read_text()


def test_needed_experiments_run_first_and_all_run_once(tmp_path):
    assert compute(tmp_path) == {"first", "second", "text"}
    assert number_of(tmp_path, "second") == "value\n2\n"
    assert compute(tmp_path) == set()
    assert compute(tmp_path, only=["second"]) == set()


def test_another_seed_repeats_all_experiments(tmp_path):
    compute(tmp_path)
    assert compute(tmp_path, replace(QUICK, seed=5)) == {"first", "second", "text"}
    assert number_of(tmp_path, "second") == "value\n10\n"


def test_progress_is_reported_up_to_the_end(tmp_path):
    for state in ("computed", "cached"):
        calls = []
        compute(
            tmp_path, report=lambda status, fraction, calls=calls: calls.append((status, fraction))
        )
        assert {status.state for status, _ in calls} == {state}
        assert [fraction for _, fraction in calls] == pytest.approx([1 / 3, 2 / 3, 1])


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


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    compute(folder, experiments=registry(FIRST))
    record = (folder / "first" / results.RECORD).read_bytes()
    return folder, record


@given(st.integers(0, 10_000), st.binary(min_size=1, max_size=4))
def test_a_damaged_record_never_gives_other_rows(finished, position, junk):
    folder, record = finished
    position %= len(record)
    damaged = record[:position] + junk + record[position + len(junk) :]
    (folder / "first" / results.RECORD).write_bytes(damaged)
    found = results.load(folder, "first", json.loads(record)["fingerprint"])
    assert found is None or found.tables[0].rows == ((1,),)


@pytest.mark.parametrize(("broken", "error"), [(fail, InputError), (interrupt, KeyboardInterrupt)])
def test_a_stopped_run_continues_with_the_unfinished_experiments(tmp_path, broken, error):
    with pytest.raises(error):
        compute(tmp_path, experiments=registry(FIRST, replace(SECOND, compute=broken)))
    assert [path.name for path in tmp_path.iterdir()] == ["first"]
    before = contents(tmp_path)
    assert compute(tmp_path) == {"second", "text"}
    assert before.items() <= contents(tmp_path).items()


def test_experiments_use_one_thread_per_worker(tmp_path):
    with threadpool_limits(2):
        compute(tmp_path, experiments=registry(Experiment("threads", "Threads", "", count_threads)))
    rows = read_table(tmp_path, "threads")
    assert rows
    assert {row["threads"] for row in rows} == {"1"}


def test_invalid_arguments_raise_errors(tmp_path):
    with pytest.raises(InputError, match="choose from second, first, text"):
        compute(tmp_path, only=["third"])
    with pytest.raises(InputError, match="workers must be at least 1, got 0"):
        reproduce(tmp_path, QUICK, experiments=ALL, workers=0)
    with pytest.raises(FileError, match="nowhere does not exist"):
        compute(tmp_path, replace(QUICK, recordings=tmp_path / "nowhere"))
    with pytest.raises(InputError, match="seed must be at least 0"):
        Settings(seed=-1)
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="cannot create the folder"):
        compute(tmp_path / "file")
    with pytest.raises(InputError, match="2 values for 1 columns"):
        Table("wrong", "", {"value": "a number"}, ((1, 2),))


def test_seeds_are_picked_at_random_and_reproducibly():
    settings = Settings()
    picked = {purpose: settings.picked_seed(purpose) for purpose in "abcdefghijkl"}
    assert set(picked.values()) <= set(settings.seeds)
    assert len(set(picked.values())) > 3
    assert picked == {purpose: settings.picked_seed(purpose) for purpose in picked}


# Claims.


def rows_of(score):
    """Return rows of scores; `score` returns Mantel r by group, method and dimensions."""
    runs = [(case.name, case.name, 3) for case in CASES]
    runs.append(("plane-bombardment", "plane-bombardment, 2D", 2))
    runs += [(str(number), f"patch, {k}D", k) for number in PATCH_RUNS for k in (2, 3)]
    return [
        {
            "run": run,
            "group": group,
            "seed": seed,
            "method": method,
            "dimensions": k,
            "mantel_r": score(group, method, k) + 0.001 * seed,
        }
        for run, group, k in runs
        for seed in (1, 2)
        for method in METHODS
    ]


def tables(*, isolation, patch_r, axial_scale, spread, change, identified=(0.5, 1.0)):
    columns = {
        "figure-2": [
            {
                "run": i + 1,
                "method": "r-anisomap",
                "dimensions": 2,
                "isolation": alone,
                "mantel_r": r,
            }
            for i, (alone, r) in enumerate(zip(isolation, patch_r, strict=True))
        ],
        "figure-4": [
            {
                "scenario": "locomotion",
                "method": method,
                "local_axial_scale": axial_scale,
                "axial_scale": axial_scale,
            }
            for method in METHODS
        ],
        "figure-7": [
            {"body": body, "r-anisomap": 1.0, "information-distance": spread}
            for body in ("cylinder", "plane")
        ],
        "bins": [
            {"run": "plane", "method": method, "largest change": change} for method in METHODS[1:]
        ],
        "unlike-responses": [
            {"run": "plane", "method": method, "optimum": 0.5, "identified": share}
            for method, share in zip(METHODS[:2], identified, strict=True)
        ],
    }
    return {
        name: Table(
            name, "", dict.fromkeys(rows[0], ""), tuple(tuple(row.values()) for row in rows)
        )
        for name, rows in columns.items()
    }


def as_in_the_paper(group, method, dimensions):
    r = {"r-anisomap": 0.98, "i-anisomap": 0.97, "information-distance": 0.95, "isomap": 0.95}
    rolling = 0.2 * (group == "cylinder-locomotion")
    spherised = 0.05 * (method == "information-distance" and dimensions == 3)
    return r[method] - rolling - spherised


def contrary_to_the_paper(group, method, _dimensions):
    r = {"r-anisomap": 0.1, "i-anisomap": 0.11, "information-distance": 0.2, "isomap": 0.3}
    return r[method] + 0.2 * (group == "cylinder-locomotion")


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.check.__name__)
def test_every_claim_can_be_reproduced_and_can_fail(claim):
    good = [
        row | {"null_max": 0.2, "neighbours_kept": row["mantel_r"]}
        for row in rows_of(as_in_the_paper)
    ]
    found = tables(
        isolation=(1, 1, 1, 3, 3), patch_r=[0.9] * 5, axial_scale=0.5, spread=0.5, change=0.01
    )
    assert claim.check(good, found).verdict == REPRODUCED
    bad = [
        row | {"null_max": 0.9, "neighbours_kept": -row["mantel_r"]}
        for row in rows_of(contrary_to_the_paper)
    ]
    found = tables(
        isolation=[1] * 5,
        patch_r=(0.9, 0.9, 0.9, 0.5, 0.5),
        axial_scale=1.5,
        spread=1.5,
        change=0.3,
        identified=(1.0, 1.0),
    )
    assert claim.check(bad, found).verdict == NOT_REPRODUCED


def test_a_sensor_that_is_isolated_while_it_works_is_not_isolated_by_its_failure():
    (claim,) = (claim for claim in CLAIMS if "sensor 30" in claim.text)
    found = tables(isolation=(3, 1, 1, 3, 3), patch_r=[0.9] * 5, axial_scale=1, spread=1, change=0)
    assert claim.check([], found).verdict == NOT_REPRODUCED


def test_a_verdict_names_the_smaller_group_of_cases():
    def verdict(**held):
        return ClaimCheck("", held).verdict

    assert verdict(a=True, b=True) == "reproduced"
    assert verdict(a=False, b=False) == "not reproduced"
    assert verdict(a=True, b=False, c=False) == "partly reproduced in 1 of 3 cases: a"
    assert verdict(a=True, b=True, c=True, d=False, e=False) == (
        "partly reproduced in 3 of 5 cases: not d; e"
    )
    with pytest.raises(ValueError, match="at least one case"):
        verdict()


# Runs and scores.


def test_box_plots_keep_every_value_beyond_the_whiskers():
    recording = find_case("sphere").record(QUICK, 1)
    settings = replace(QUICK, seed=1)
    row = dict(
        zip(SCORE_COLUMNS, next(score_rows("sphere", recording, 1, [3], settings)), strict=True)
    )
    box = null_box(row)
    truth, made = recording.positions, map_and_score(recording, METHODS[0], 3, permutations=200)
    drawn = cbook.boxplot_stats(made.score.mantel.null)[0]
    assert len(truth) == made.score.mantel.n_sensors
    assert len(box.outliers) == len(drawn["fliers"]) > 2
    np.testing.assert_allclose(box.outliers, np.sort(drawn["fliers"]), atol=1e-4)
    assert (box.whisker_low, box.whisker_high) == (drawn["whislo"], drawn["whishi"])


@pytest.mark.parametrize("quantile", [0.25, 0.5, 1.0])
def test_radial_basis_sensors_respond_most_at_their_optimum(quantile):
    depth = np.concatenate([np.zeros(50), np.linspace(0.01, 1, 100)])[:, None]
    response = radial_basis(depth, quantile)[:, 0]
    assert abs(depth[response.argmax(), 0] - np.quantile(depth[depth > 0], quantile)) < 0.01
    assert response[0] == pytest.approx(np.exp(-2))
    assert (np.diff(response) >= 0).all() == (quantile == 1)


# Shape statistics.


@given(st.floats(0.05, 3), st.integers(0, 100))
def test_axial_scale_recovers_the_compression_of_a_cylinder(factor, seed):
    truth = find_body("cylinder").positions
    rotation = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    scale = shape_statistics.axial_scale(7 * truth * [1, 1, factor] @ rotation + 3, truth)
    assert scale.local == pytest.approx(factor, rel=1e-6)
    if factor > 0.5:  # the axis of a much flatter cylinder is not aligned with the true axis
        assert scale.whole == pytest.approx(factor, rel=1e-3)


def test_spread_of_radii_of_a_sphere_and_of_a_line():
    assert shape_statistics.spread_of_radii(find_body("sphere").positions) < 0.01
    line = np.linspace(-1, 1, 2001)[:, None]
    assert shape_statistics.spread_of_radii(line) == pytest.approx(1 / 3**0.5, abs=1e-3)


def test_isolation_inside_and_outside_a_lattice():
    grid = np.stack(np.meshgrid(range(5), range(5)), -1).reshape(-1, 2).astype(float)
    assert shape_statistics.isolation(grid, 7) == pytest.approx(1)
    grid[0] -= [3, 4]
    assert shape_statistics.isolation(grid, 0) == pytest.approx(np.hypot(4, 4))


@pytest.mark.parametrize("dimensions", [1, 2, 3, 5])
def test_the_spectrum_of_k_dimensional_points_has_k_positive_variances(dimensions):
    points = np.random.default_rng(dimensions).normal(size=(400, dimensions))
    distances = np.linalg.norm(points[:, None] - points, axis=2)
    variances = shape_statistics.spectrum(distances)
    assert shape_statistics.n_dimensions(variances) == dimensions
    np.testing.assert_allclose(
        variances[:dimensions].sum(), ((points - points.mean(axis=0)) ** 2).sum()
    )
    np.testing.assert_allclose(variances[dimensions:], 0, atol=1e-9)


# Numbers in documents.


def test_documents_hold_the_numbers_of_the_tables():
    paper = (ROOT / "docs" / "explanation" / "paper.md").read_text(encoding="utf-8")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for text in (paper, readme):
        assert numbers.fill(text, ROOT / "docs" / "results") == text, "run make numbers"
        assert numbers.tables_in(text)
    assert all(f"| {claim.text} |" in paper for claim in CLAIMS), "run make numbers"


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
    old = "<!-- numbers: old -->\n<!-- end of numbers -->"
    (tmp_path / "tables" / "old.csv").write_text("kept\n2\n")
    page.write_text(old)
    numbers.main(arguments)
    assert "| kept |\n| --- |\n| 2 |\n" in page.read_text()
    page.write_text("<!-- numbers: absent -->\n<!-- end of numbers -->")
    with pytest.raises(FileError, match="run anisomap paper first"):
        numbers.main(arguments)
