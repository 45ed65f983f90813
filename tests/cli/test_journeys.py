"""Users' journeys: from a first summary of a recording to a scored map."""

import csv
import json
import re
import subprocess
import sys

import numpy as np
import pytest

import anisomap
from anisomap.methods import METHODS
from anisomap.evidence import SIMILARITIES
from skins import flat_skin


def test_from_a_recording_to_a_scored_map(run, skin_csv, truth_csv, tmp_path):
    looked = run("info", skin_csv)
    assert looked.code == 0
    assert "1500" in looked.out
    assert "42 ok" in looked.out

    made = run("map", skin_csv, "-o", "map.csv", "--report", "report.html", "-d", 2)
    assert made.code == 0
    assert not made.err
    assert "<html" in (tmp_path / "report.html").read_text()

    scored = run("score", "map.csv", truth_csv, "--units", "mm", "--permutations", 200)
    assert scored.code == 0
    for expected in ("Mantel r", "median", "RMS error", "mm", "mirrored", "neighbours kept"):
        assert expected in scored.out

    figures = json.loads(run("score", "map.csv", truth_csv, "--json", "--permutations", 99).out)
    assert figures["score"]["mantel_r"] > 0.95
    assert figures["score"]["p_value"] == pytest.approx(0.01)
    assert figures["score"]["sensors_compared"] == 42
    expected = anisomap.reconstruct(anisomap.read(skin_csv), dimensions=2)
    np.testing.assert_array_equal(anisomap.read_map("map.csv").positions, expected.positions)


def test_a_recording_with_truth_is_scored_on_the_way(run, skin_npz):
    made = run(
        "map", skin_npz, "-d", 2, "--permutations", 100, "--picture", "map.png", "-o", "m.csv"
    )
    assert made.code == 0
    assert "Mantel r" in made.out
    assert "RMS error" in made.out


def test_every_map_format_at_once(run_map, skin_csv, tmp_path):
    names = ["m.csv", "m.npz", "m.json", "m.ply"]
    outputs = [argument for name in names for argument in ("-o", name)]
    assert run_map(skin_csv, "-d", 2, *outputs).code == 0
    first, *others = (anisomap.read_map(tmp_path / name) for name in names)
    for other in others:
        np.testing.assert_array_equal(other.positions, first.positions)


def test_without_an_output_the_map_is_named_after_the_recording(run_map, skin_csv, tmp_path):
    assert run_map(skin_csv).code == 0
    assert (tmp_path / "skin.map.csv").exists()


def test_sensors_can_be_excluded_and_dropped(run_map, skin_csv):
    assert run_map(skin_csv, "-o", "m.json", "--exclude", "s3,s4", "--exclude", 5,
               "--drop", "s7").code == 0  # fmt: skip
    made = anisomap.read_map("m.json")
    np.testing.assert_array_equal(np.flatnonzero(~made.placed), [7])


def test_faults_are_named_and_warned_of(run, tmp_path):
    readings = np.array(flat_skin().readings)
    readings[:, 9] = 0
    anisomap.write(anisomap.Recording(readings), tmp_path / "dead.npz")
    for command in (["info", "dead.npz"], ["map", "dead.npz", "-o", "m.csv"]):
        found = run(*command)
        assert found.code == 0
        assert "dead" in found.out
        assert found.err.count("never vary") == 1


def test_missing_readings_are_refused_until_a_way_is_chosen(run, run_map, skin_csv):
    lines = skin_csv.read_text().splitlines()
    lines[7] = lines[7].replace(lines[7].split(",")[2], "nan", 1)
    skin_csv.write_text("\n".join(lines))
    refused = run_map(skin_csv, "-o", "m.csv")
    assert refused.code == 2
    assert "missing" in refused.err
    for policy in ("drop-frames", "interpolate"):
        assert run_map(skin_csv, "-o", "m.csv", "--missing", policy).code == 0
    assert "1 missing" in run("info", skin_csv).out


def test_separate_components_are_warned_of_and_written_apart(run, run_map, tmp_path):
    readings = np.zeros((1200, 12))
    rng = np.random.default_rng(0)
    for sensors, frames in ((range(7), slice(0, 600)), (range(7, 12), slice(600, 1200))):
        touch = rng.uniform(sensors.start, sensors.stop, 600)[:, None]
        readings[frames, sensors.start : sensors.stop] = np.maximum(0, 2 - abs(touch - sensors))
    anisomap.write(anisomap.Recording(readings), tmp_path / "pieces.npz")
    made = run_map("pieces.npz", "-m", "r-anisomap", "--mu", 0, "-o", "m.csv", "--picture",
               "m.png", "--report", "m.html")  # fmt: skip
    assert made.code == 0
    assert "2 separate components" in made.err
    assert anisomap.read_map("m.csv").component_sizes == (7, 5)
    refused = run_map(
        "pieces.npz", "-m", "r-anisomap", "--mu", 0, "--spacing", "5mm", "-o", "m.urdf"
    )
    assert refused.code == 2
    made = run_map("pieces.npz", "-m", "r-anisomap", "--mu", 0, "--spacing", "5mm", "-o", "m.urdf",
               "--split-components")  # fmt: skip
    assert made.code == 0
    assert (tmp_path / "m-1.urdf").exists()
    assert (tmp_path / "m-2.urdf").exists()


@pytest.mark.parametrize("method", METHODS)
def test_every_method_runs_from_the_command_line(run_map, method):
    anisomap.write(flat_skin(n_frames=500), "skin.npz")
    assert run_map("skin.npz", "-m", method, "-o", "m.csv", "--permutations", 0).code == 0
    assert anisomap.read_map("m.csv").method == method


def test_lists_name_everything(run):
    listed = run("methods").out
    assert all(name in listed for name in [*METHODS, *SIMILARITIES])
    assert all(suffix in run("formats").out for suffix in (".npz", ".csv", ".ply", ".json"))


def test_methods_are_compared_with_stock_methods_in_tables(run, skin_npz, tmp_path):
    (tmp_path / "skins").mkdir()
    skin_npz.rename(tmp_path / "skins" / "skin.npz")
    anisomap.write(flat_skin(seed=1), "other.npz")
    anisomap.write(anisomap.Recording(flat_skin().readings), tmp_path / "skins" / "unknown.npz")
    chosen = ("-m", "covariogram", "-m", "isomap", "-m", "isomap-on-r", "-m", "pca-on-r")
    found = run("compare", "skins", "other.npz", *chosen, "-o", "t.md", "-o", "t.csv")
    assert found.code == 0
    assert "skipped: " in found.err
    assert "no true positions" in found.err
    table = (tmp_path / "t.md").read_text().splitlines()
    assert table[0] == (
        "| recording | sensors x frames | map | scored | covariogram | isomap | isomap-on-r "
        "| pca-on-r |"
    )
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table[2:4]]
    assert [row[:4] for row in rows] == [
        ["skin", "42 x 1500", "2D", "42"],
        ["other", "42 x 1500", "2D", "42"],
    ]
    numbers = list(csv.DictReader((tmp_path / "t.csv").read_text().splitlines()))
    for row, values in zip(rows, numbers, strict=True):
        assert row[4].startswith("**")
        assert float(values["covariogram"]) > 0.9
        assert [cell.startswith("**") for cell in row[4:]].count(True) == 2
        r, error = re.findall(r"\d\.\d+", row[6])
        assert float(values["isomap-on-r"]) == pytest.approx(float(r), abs=0.0006)
        assert float(values["isomap-on-r: error"]) == pytest.approx(float(error), abs=0.006)
        best = max(("isomap-on-r", "pca-on-r"), key=lambda name: float(values[name]))
        assert values["best stock"] == best
        margin = float(values["covariogram"]) - float(values[best])
        assert float(values["margin"]) == pytest.approx(margin, abs=8e-4)
    losses = sum(float(values["margin"]) < -0.0005 for values in numbers)
    verdict = next(line for line in table if "stock method is better" in line)
    assert f"on {losses} of 2 maps" in verdict
    assert verdict in found.out


def test_a_loss_against_a_stock_method_is_printed(run, skin_npz, tmp_path):
    methods = ("-m", "information-distance", "-m", "isomap-on-r")
    assert run("compare", skin_npz, *methods, "-d", 2, "-d", 3, "-o", "t.md").code == 0
    verdict = next(
        line for line in (tmp_path / "t.md").read_text().splitlines() if "better than" in line
    )
    assert verdict.startswith("A stock method is better than information-distance on 2 of 2 maps:")
    assert (
        len(re.findall(r"skin in [23]D \(0\.\d{3} against 0\.9\d\d of isomap-on-r\)", verdict)) == 2
    )


def test_without_umap_the_table_says_how_to_install_it(run, skin_npz, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "umap", None)
    anisomap.write(flat_skin(n_frames=120), skin_npz)
    found = run("compare", skin_npz, "-o", "t.md")
    assert found.code == 0
    for said in (found.out, (tmp_path / "t.md").read_text()):
        assert "umap-on-r: not installed: pip install 'anisomap[umap]'" in said
    header, _, row, *_ = (tmp_path / "t.md").read_text().splitlines()
    column = header.split("|").index(" umap-on-r ")
    assert row.split("|")[column].strip() == "-"
    found = run("compare", skin_npz, "-m", "umap-on-r")
    assert found.code == 2
    assert "pip install 'anisomap[umap]'" in found.err


def test_the_demo_ends_with_a_picture_and_a_report(run, tmp_path):
    pytest.importorskip("mujoco")
    made = run("demo", "-o", "out", "--frames", 600, "--permutations", 100)
    assert made.code == 0
    for name in ("map.csv", "map.png", "report.html", "recording.npz"):
        assert (tmp_path / "out" / name).stat().st_size > 1000
        assert name in made.out


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 6))]
)
def test_the_demos_map_is_good_for_every_seed(seed):
    pytest.importorskip("mujoco")
    recording = anisomap.simulate("sphere", "bombardment", seed=seed)
    found = anisomap.mantel(anisomap.reconstruct(recording), recording.positions, permutations=500)
    assert found.r >= 0.90
    assert abs(found.quantiles()[0.5]) < 0.03


@pytest.mark.slow
def test_two_runs_give_the_same_bytes(run, skin_npz, tmp_path):
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        outputs = [a for s in ("csv", "npz", "json", "ply") for a in ("-o", f"{folder}/m.{s}")]
        assert run("map", skin_npz, *outputs, "--picture", f"{folder}/m.png",
                   "--report", f"{folder}/m.html", "--permutations", 50).code == 0  # fmt: skip
    for first in (tmp_path / "one").iterdir():
        assert first.read_bytes() == (tmp_path / "two" / first.name).read_bytes(), first.name


def test_help_imports_nothing_heavy():
    code = (
        "import sys\n"
        "from anisomap.cli.app import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'scipy', 'sklearn', 'matplotlib', 'plotly', 'mujoco'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "map" in done.stdout


def test_a_map_of_few_sensors_imports_no_more_than_it_needs(tmp_path):
    np.savez(tmp_path / "skin.npz", readings=flat_skin(n_frames=500).readings)
    code = (
        "import sys\n"
        "from anisomap.cli.app import main\n"
        "try: main(['map', 'skin.npz', '-o', 'map.csv', '-q'])\n"
        "except SystemExit as end: assert end.code == 0\n"
        "print(*sys.modules)\n"
    )
    loaded = subprocess.check_output([sys.executable, "-c", code], text=True, cwd=tmp_path).split()
    assert "scipy.optimize" in loaded
    unneeded = {"asyncio", "h5py", "matplotlib", "numba", "pyarrow", "scipy.cluster", "scipy.stats"}
    assert not (unneeded | {"scipy.ndimage", "sklearn", "ssl"}) & set(loaded)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("diff", "The exit code is 0 if no difference is found, and 1 otherwise."),
        ("live", "Ctrl-C ends the session; the final"),
        ("place", "Rigid modules of known shape determine the scale"),
    ],
)
def test_the_help_of_a_command_says_more_than_its_line_in_the_list(run, name, said):
    assert said in " ".join(run(name, "--help").out.split())
    assert said not in " ".join(run("--help").out.split())


def test_several_recordings_are_one_map(run_map, skin_csv, tmp_path):
    header, *lines = skin_csv.read_text().splitlines()
    for name, part in (("one", lines[:700]), ("two", lines[700:])):
        (tmp_path / f"{name}.csv").write_text("\n".join([header, *part]) + "\n")
    assert run_map("skin.csv", "-d", "2", "-o", "whole.csv").code == 0
    assert run_map("one.csv", "two.csv", "-d", "2", "-o", "parts.csv").code == 0
    whole, parts = (anisomap.read_map(f"{name}.csv") for name in ("whole", "parts"))
    np.testing.assert_allclose(parts.positions, whole.positions, atol=1e-6)
    assert run_map("one.csv", "two.csv", "-o", "two.csv").code == 2


def test_a_grid_is_its_own_truth(run_map, tmp_path):
    np.savetxt(tmp_path / "mat.csv", flat_skin().readings, "%.4g", ",")
    found = run_map("mat.csv", "--grid", "6x7", "-d", "2", "--permutations", "9")
    assert found.code == 0
    assert "Score against the true positions" in found.out
    assert run_map("mat.csv", "--grid", "6x8").code == 2
    assert "rows and columns, as in 32x64" in run_map("mat.csv", "--grid", "six").err


def test_info_lists_what_there_is_to_choose_from(run, run_map, tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "skin.h5", "w") as file:
        file["left"] = file["right"] = flat_skin().readings
        file["note"] = np.arange(3)
    found = run("info", "skin.h5")
    assert found.code == 0
    assert "left" in found.out
    assert "choose one with --select" in found.err
    assert run_map("skin.h5", "-d", "2").code == 2
    assert run_map("skin.h5", "--dataset", "left", "-d", "2").code == 0


def test_a_triangle_that_is_silent_in_one_run_is_still_there(run_map, tmp_path):
    """Under a preset, what never varies is absent: but only if it never does in any run."""
    readings = flat_skin(n_frames=2000).readings[:, :36] * 10
    readings = np.round(readings).astype(int)
    first, second = readings[:1000], readings[1000:].copy()
    second[:, 24:] = 0
    np.savetxt(tmp_path / "one.csv", first, "%d", ",")
    np.savetxt(tmp_path / "two.csv", second, "%d", ",")
    assert run_map("one.csv", "two.csv", "--preset", "icub", "-d", "2", "-o", "m.csv").code == 0
    made = anisomap.read_map("m.csv")
    assert made.n_sensors == 30
    assert "b0.t2.k11" in made.names


def test_a_declared_prior_is_named_in_the_map(run_map, skin_csv):
    made = run_map(skin_csv, "-d", 2, "--even-spacing", "-o", "even.csv")
    assert made.code == 0
    assert "declared, not measured" in " ".join(made.err.split())
    assert anisomap.read_map("even.csv").provenance["even_spacing"] is True

    refused = run_map(skin_csv, "-m", "r-anisomap", "--even-spacing", "-o", "none.csv")
    assert refused.code == 2
    assert "r-anisomap does not support even spacing" in " ".join(refused.err.split())


def test_a_column_of_text_is_skipped_with_a_warning_and_may_be_dropped(run_map, skin_csv):
    header, *lines = skin_csv.read_text().splitlines()
    labelled = [f"label,{header}", *(f"press {i % 3},{line}" for i, line in enumerate(lines))]
    skin_csv.write_text("\n".join(labelled) + "\n")
    made = run_map(skin_csv, "-d", 2, "--drop", "label,s3", "-o", "m.csv")
    assert made.code == 0
    assert "label" in made.err
    found = anisomap.read_map("m.csv")
    assert found.n_sensors == 42
    np.testing.assert_array_equal(np.flatnonzero(~found.placed), [3])


def test_a_map_is_scored_against_any_layout(run, run_map, skin_csv, truth_csv, tmp_path):
    """The true positions may come in a file of their own, while mapping or after."""
    truth = tmp_path / "truth.json"
    assert run("convert", truth_csv, truth).code == 0
    done = run_map(skin_csv, "-d", 2, "-o", "map.csv", "--truth", truth, "--json")
    while_mapping = json.loads(done.out)["score"]
    assert while_mapping["mantel_r"] > 0.98
    files = ("--picture", "score.png", "--report", "score.html")
    done = run("score", "map.csv", "--truth", truth, *files, "--json")
    after = json.loads(done.out)["score"]
    assert after["mantel_r"] == while_mapping["mantel_r"]
    assert (tmp_path / "score.png").stat().st_size > 10_000
    assert "Mantel r" in (tmp_path / "score.html").read_text()
    assert run("score", "map.csv").code == 2
    assert run("score", "map.csv", truth, "--truth", truth).code == 2
    assert run("score", "map.csv", truth, "--picture", truth).code == 2


def test_the_worst_sensors_of_a_map_are_named(run, truth_csv, tmp_path):
    """Two wires swapped: the score stays high, but the two sensors are named."""
    rows = truth_csv.read_text().splitlines()
    fields = [row.split(",") for row in rows]
    fields[3][1:], fields[40][1:] = fields[40][1:], fields[3][1:]
    (tmp_path / "swapped.csv").write_text("\n".join(map(",".join, fields)))
    found = json.loads(run("score", "swapped.csv", truth_csv, "--json").out)["score"]
    assert found["mantel_r"] > 0.7
    assert {worst["sensor"] for worst in found["worst"][:2]} == {fields[3][0], fields[40][0]}
    assert found["worst"][0]["error"] > 10 * found["median_error"]
    assert f"{fields[3][0]} " in run("score", "swapped.csv", truth_csv).out


def test_two_days_are_compared(run, run_map, tmp_path):
    """Tuesday's recording has two wires swapped and a dead sensor."""
    monday, tuesday = flat_skin(seed=1), flat_skin(seed=2)
    readings = tuesday.readings.copy()
    readings[:, [8, 33]] = readings[:, [33, 8]]
    readings[:, 20] = 0
    for day, values in (("monday", monday.readings), ("again", tuesday.readings),
                        ("tuesday", readings)):  # fmt: skip
        anisomap.write(anisomap.Recording(values), f"{day}.csv")
        assert run_map(f"{day}.csv", "-d", 2, "-o", f"{day}.map.csv").code == 0
    same = run("diff", "monday.map.csv", "again.map.csv", "--json")
    assert same.code == 0
    assert json.loads(same.out)["different"] is False
    done = run("diff", "monday.map.csv", "tuesday.map.csv", "--picture", "diff.png", "--json")
    assert done.code == 1
    found = json.loads(done.out)
    assert {moved["sensor"] for moved in found["moved"]} == {"s8", "s33"}
    assert found["lost"] == ["s20"]
    assert (tmp_path / "diff.png").stat().st_size > 10_000
    text = run("diff", "monday.map.csv", "tuesday.map.csv").out
    assert "s33" in text
    assert "lost: s20" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.csv"], "missing.csv"),
        (["truth.csv", "--picture", "truth.csv"], "truth.csv"),
        (["truth.csv", "--picture", "diff.bmp"], ".png, .svg or .pdf"),
        (["truth.csv", "--level", "2"], "level must be between 0 and 1"),
    ],
)
def test_maps_that_cannot_be_compared_are_one_message(run, truth_csv, arguments, message):
    before = truth_csv.read_bytes()
    done = run("diff", truth_csv, *arguments)
    assert done.code == 2
    assert message in done.err
    assert truth_csv.read_bytes() == before


def test_maps_without_a_unit_are_compared_in_units_of_the_first(run, tmp_path):
    before = np.stack(np.meshgrid(range(4), range(4)), -1).reshape(-1, 2).astype(float)
    after = before.copy()
    after[5] += [9, 0]
    for name, places in (("before", before), ("after", after)):
        rows = [f"s{i},{x},{y}" for i, (x, y) in enumerate(places)]
        (tmp_path / f"{name}.csv").write_text("\n".join(["name,x,y", *rows]) + "\n")
    found = run("diff", "before.csv", "after.csv")
    assert found.code == 1
    assert "distance (units of the first map)" in found.out


def test_a_map_of_few_of_the_sensors_is_not_called_a_perfect_fit(run, tmp_path):
    places = np.stack(np.meshgrid(range(8), range(8)), -1).reshape(-1, 2)
    touches = np.random.default_rng(1).uniform(0, 7, (18, 1, 2))
    depth = np.maximum(0, 1.3 - np.linalg.norm(touches - places, axis=2))
    course = np.sin(np.linspace(0, np.pi, 8))
    readings = np.concatenate([course[:, None] * press for press in depth])
    anisomap.write(anisomap.Recording(readings), tmp_path / "short.npz")
    made = run("map", "short.npz", "-d", 2, "-o", "m.csv")
    assert made.code == 0
    assert "most of the skin is not mapped" in made.err
    assert "relative to one another" in made.out
    assert "perfect fit" not in made.out
    found = anisomap.read_map("m.csv")
    assert found.component_sizes[0] < 64 / 3
    assert "verdict not usable" in " ".join(made.out.split())
    assert f"the map shows only {found.component_sizes[0]} sensors" in made.out
