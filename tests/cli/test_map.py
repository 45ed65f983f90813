"""Journeys of ``anisomap map``: from a recording to a judged map in files of every kind."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.skins.independent import damaged
from scipy.linalg import block_diag

import anisomap
from command_line import write_layout
from skins import flat_skin, lattice, rubbed


def test_every_file_holds_the_map_and_its_verdict(made):
    said = json.loads((made / "said.json").read_text())
    score, verdict = said["score"], said["verdict"]
    assert score["mantel_r"] > 0.95
    assert score["p_value"] == pytest.approx(0.01)
    assert (score["sensors_compared"], score["units"]) == (42, "mm")
    assert verdict["level"] == "usable"
    expected = anisomap.reconstruct(anisomap.read(made / "skin.npz"), dimensions=2)
    for suffix in ("csv", "json", "npz", "ply"):
        found = anisomap.read_map(made / f"map.{suffix}")
        np.testing.assert_array_equal(found.positions, expected.positions)
        if suffix != "ply":
            assert found.verdict.level == "usable"
            assert found.verdict.expected_error == pytest.approx(verdict["expected_error"])
            assert np.isfinite(found.covariances).all()
    header = (made / "map.csv").read_text().split('"name"')[1].splitlines()[0]
    assert header.endswith('"cov_xx","cov_xy","cov_yy"')
    sensors = json.loads((made / "map.json").read_text())["sensors"]
    stored = anisomap.read_map(made / "map.npz").covariances
    np.testing.assert_array_equal([sensor["covariance"] for sensor in sensors], stored)
    assert (made / "map.png").read_bytes().startswith(b"\x89PNG")
    page = (made / "map.html").read_text(encoding="utf-8")
    assert "Ellipses contain 95" in page
    assert "How the skin was touched" in page


@pytest.mark.parametrize(("factor", "told"), [(1, False), (1000, True)])
def test_a_spacing_that_the_true_positions_contradict_is_warned_of(run_map, skin_npz, factor, told):
    """Such as one in metres that was given in millimetres."""
    truth = anisomap.read(skin_npz)
    spacing = factor * anisomap.evaluation.median_spacing(truth.positions)
    done = run_map(skin_npz, "--spacing", f"{spacing}{truth.units}")
    assert ("check --spacing" in done.err) == told


def test_maps_that_are_not_usable_or_not_judged_fail_but_are_written(run, tmp_path):
    short = flat_skin(n_frames=120).readings
    noise = np.random.default_rng(0).normal(0, 0.5, short.shape)
    anisomap.write(anisomap.Recording(short + noise), tmp_path / "noise.npz")
    for method, level in (("covariogram", "usable"), ("r-anisomap", "usable-for-neighbours")):
        command = f"map noise.npz -d 2 -m {method} -o {method}.csv --min-quality {level}"
        assert f"below --min-quality {level}" in run(command, code=1).err
        assert (tmp_path / f"{method}.csv").exists()


def test_a_map_without_an_output_and_a_verdict(run_map, skin_csv, tmp_path):
    """It is named after the recording, and its dimensions are chosen."""
    done = run_map(skin_csv, "-d", "auto", "--report", "map.html")
    assert "2, chosen: a third dimension explains no more than chance" in done.out
    found = anisomap.read_map("skin.map.csv")
    assert (found.dimensions, found.provenance["chosen_dimensions"]) == (2, 2)
    assert "Ellipses contain 95" not in (tmp_path / "map.html").read_text(encoding="utf-8")
    flat = run_map(skin_csv, "-d", 3, "-m", "covariogram", "-o", "solid.csv")
    assert "the map looks flat" in flat.err
    assert anisomap.read_map("solid.csv").dimensions == 3


def test_sensors_on_a_line_are_listed_in_their_order(run_map):
    rng = np.random.default_rng(0)
    places = rng.permutation(np.arange(24.0))
    touches = rng.uniform(0, 23, (1000, 1))
    recording = anisomap.Recording(np.maximum(0, 3 - abs(touches - places)))
    anisomap.write(recording, "line.npz")
    chosen = run_map("line.npz", "-d", "auto", "-m", "covariogram")
    assert "choose 1 dimension (-d 1)" in chosen.err
    words = ("line.npz", "-d", 1, "-m", "covariogram")
    order = run_map(*words, "--json").values["map"]["order"]
    along = places[[recording.names.index(name) for name in order]]
    assert (np.diff(along if along[0] < along[-1] else along[::-1]) == 1).all()
    assert f"{order[0]}, {order[1]}" in " ".join(run_map(*words).out.split())


def test_sensors_are_dropped_from_the_map_or_excluded_from_the_score(
    run, run_map, skin_csv, truth_csv
):
    """A column of text is skipped with a warning, and may be dropped, too."""
    header, *lines = skin_csv.read_text().splitlines()
    labelled = [f"label,{header}", *(f"press {i // 7 % 3},{line}" for i, line in enumerate(lines))]
    skin_csv.write_text("\n".join(labelled) + "\n")
    done = run_map(skin_csv, "-o", "m.json", "--drop", "label,s7", "--json")
    assert "label" in done.err
    found = anisomap.read_map("m.json")
    assert found.n_sensors == 42
    np.testing.assert_array_equal(np.flatnonzero(~found.placed), [7])
    words = ("--exclude", "s3,s4", "--exclude", 5, "--permutations", 0, "--json")
    scored = run("score", "m.json", truth_csv, *words)
    assert scored.values["score"]["sensors_compared"] == 38


def test_missing_readings_are_handled_in_the_way_that_is_chosen(run, run_map, skin_csv):
    lines = skin_csv.read_text().splitlines()
    lines[7] = lines[7].replace(lines[7].split(",")[2], "nan", 1)
    skin_csv.write_text("\n".join(lines))
    for policy in ("drop-frames", "interpolate"):
        run_map(skin_csv, "-o", "m.csv", "--missing", policy)
    assert "1 missing" in run("info", skin_csv).out


def test_separate_components_are_warned_of(run_map, tmp_path):
    apart = [rubbed(lattice(*size), 2000, seed=i) for i, size in enumerate([(5, 6), (4, 5)])]
    anisomap.write(anisomap.Recording(block_diag(*apart)), tmp_path / "pieces.npz")
    words = ("pieces.npz", "-d", 2, "-m", "covariogram")
    made = run_map(*words, "-o", "m.csv", "--picture", "m.png", "--report", "m.html")
    assert "2 separate components" in made.err
    assert anisomap.read_map("m.csv").component_sizes == (30, 20)
    urdf = ("--spacing", "5mm", "-o", "m.urdf")
    assert "needs one connected component" in run_map(*words, *urdf, code=2).err


def test_a_triangle_that_is_silent_in_one_run_is_still_there(run_map, tmp_path):
    """Under a preset, what never varies is absent: but only if it never does in any run."""
    readings = np.round(flat_skin().readings[:, :36] * 10).astype(int)
    first, second = readings[:700], readings[700:].copy()
    second[:, 24:] = 0
    np.savetxt(tmp_path / "one.csv", first, "%d", ",")
    np.savetxt(tmp_path / "two.csv", second, "%d", ",")
    run_map("one.csv", "two.csv", "--preset", "icub", "-o", "m.csv")
    found = anisomap.read_map("m.csv")
    assert found.n_sensors == 30
    assert "b0.t2.k11" in found.names


def test_a_spoilt_recording_is_named_repaired_and_mapped(run, run_map, skin_npz):
    spoilt = damaged(anisomap.read(skin_npz), "inverted:share=0.2", np.random.default_rng(0))
    anisomap.write(spoilt, "bad.npz")
    told = run("info", "bad.npz").out
    assert "inverted: contacts have the opposite sign in 8 of 42 sensors" in told
    assert "can be mended: anisomap map --repair" in told
    repaired = run("repair", "bad.npz", "-o", "good.npz")
    assert "mended: these sensors were mirrored" in repaired.out
    assert run("info", "good.npz", "--json").values["findings"] == []
    assert "No faults of the recording were found" in run("repair", skin_npz, "-o", "same.npz").out
    same, sound = anisomap.read("same.npz"), anisomap.read(skin_npz)
    np.testing.assert_array_equal(same.readings, sound.readings)
    assert "opposite sign" in run_map("bad.npz", "-o", "plain.csv").err
    mended = run_map("bad.npz", "-o", "mended.json", "--repair")
    assert "opposite sign" not in mended.err
    assert "mended: these sensors were mirrored" in mended.out
    assert anisomap.read_map("mended.json").provenance["repaired"] == "inverted"


def test_a_map_of_few_of_the_sensors_is_not_called_a_perfect_fit(run, tmp_path):
    """Presses on a skin of 64 sensors, most of which no other press reaches."""
    places = np.stack(np.meshgrid(range(8), range(8)), -1).reshape(-1, 2)
    touches = np.random.default_rng(1).uniform(0, 7, (18, 1, 2))
    depth = np.maximum(0, 1.3 - np.linalg.norm(touches - places, axis=2))
    course = np.sin(np.linspace(0, np.pi, 8))
    readings = np.concatenate([course[:, None] * press for press in depth])
    anisomap.write(anisomap.Recording(readings), tmp_path / "short.npz")
    made = run("map", "short.npz", "-d", 2, "-o", "m.csv")
    assert "noise hides how" in made.err
    assert "Not usable: positions are off by about" in " ".join(made.out.split())
    assert "sensors have no significant correlations" in " ".join(made.out.split())


def test_commands_say_where_to_touch_next(run, run_map, tmp_path):
    """A corner was spared by seven of eight touches."""
    places = lattice(7, 7)
    corner = np.array([5, 4.3])
    rng = np.random.default_rng(0)
    touches = rng.uniform(0, 6, (800, 1, 2)) * [1, 3**0.5 / 2]
    spared = np.linalg.norm(touches[:, 0] - corner, axis=1) < 2.2
    touches = touches[~spared | (np.arange(800) % 8 == 0)]
    depth = np.maximum(0, 1.6 - np.linalg.norm(touches - places, axis=2))
    readings = np.zeros((2 * len(depth), 49))
    readings[::2] = depth
    names = [f"s{i}" for i in range(49)]
    write_layout(tmp_path / "truth.csv", places, names)
    anisomap.write(anisomap.Recording(readings), tmp_path / "corner.npz")
    near = {names[i] for i in np.flatnonzero(np.linalg.norm(places - corner, axis=1) < 2.5)}
    told = run("info", "corner.npz").out
    first = re.search(r"touch next +around ([^;\n]*)", told).group(1).replace(" and", ",")
    assert {name.strip() for name in first.split(",")} <= near
    assert re.search(r"contacts +median \d+", told)
    found = run_map("corner.npz", "-o", "m.csv", "--json").values["touches"]
    assert set(found["next"][0]["sensors"]) <= near
    assert found["contacts"].keys() == set(names)


def test_a_warning_is_given_once(run, tmp_path):
    """Two sessions that rest at other levels are joined for each question about them."""
    skin, noise = flat_skin(), np.random.default_rng(1)
    zero = np.ptp(skin.readings) * noise.uniform(-1, 1, skin.n_sensors)
    for name, shift in (("a.npz", 0), ("b.npz", zero)):
        noisy = skin.readings + noise.normal(0, 1e-3, skin.readings.shape)
        anisomap.write(replace(skin, readings=noisy + shift), tmp_path / name)
    said = run("map", "a.npz", "b.npz", "-o", "map.csv", "-d", 2).err
    assert said.count("level at rest differs between recordings") == 1
