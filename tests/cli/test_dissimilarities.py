"""Journeys of ``anisomap map`` with dissimilarities, beside the worked examples of R.

Ekman's similarities of colours are those of R's package smacof; road distances those of R; plants
on meadows those of R's package vegan.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

import anisomap
from anisomap import datasets, evaluation
from anisomap.numerics.scaling.multidimensional_scaling import torgerson

RAW_STRESS_OF_EKMAN = 2 * 0.52785281847690113
"""De Leeuw's smacof of 1 - ekman in 2 dimensions, which gives half the sum of squares.

https://github.com/deleeuw/smacofExamples, ekman/ekmanMetric.R.
"""

STRESS_OF_MEADOWS = {1: 0.1192678, 20: 0.1183186}
"""Stress of ``metaMDS(dune)`` by the number of starts, in the documentation of vegan."""

CITIES_OF_R = {"Athens": (2290.27468, 1798.8029), "Barcelona": (-825.38279, 546.8115)}
"""First rows of ``cmdscale(eurodist)``, in the documentation of R."""


@pytest.fixture
def points():
    return np.random.default_rng(4).random((12, 2))


@pytest.fixture
def dist_csv(tmp_path, points):
    names = [f"p{i}" for i in range(len(points))]
    rows = zip(names, squareform(pdist(points)).tolist(), strict=True)
    lines = [",".join(map(str, [name, *row])) for name, row in rows]
    (tmp_path / "dist.csv").write_text("\n".join([",".join(["", *names]), *lines]) + "\n")


@pytest.mark.usefixtures("dist_csv")
def test_a_matrix_is_recognised_mapped_and_examined(run, points, tmp_path):
    files = "--picture stress --report r.html"
    done = run(f"map dist.csv -d 2 {files} --permutations 19 --json")
    found = anisomap.read_map(tmp_path / "dist.map.csv")
    assert found.names == tuple(f"p{i}" for i in range(12))
    assert evaluation.mantel(found, points, permutations=0).r > 0.999999
    fit = done.values["dissimilarities"]
    assert (fit["objects"], fit["pairs"], fit["unknown"]) == (12, 66, 0)
    assert fit["stress"] < 1e-3
    assert fit["p_value"] == pytest.approx(0.05)
    assert sum(fit["stress_per_point"].values()) == pytest.approx(1)
    assert (tmp_path / "dist.stress.png").read_bytes().startswith(b"\x89PNG")
    report = (tmp_path / "r.html").read_text()
    assert "The map fits the dissimilarities with Stress-1" in report
    assert not re.search(">Verdict|<td>unassessed|Mantel r is", report)
    looked = run("info dist.csv --json").values
    assert looked == {"dissimilarities": {"objects": 12, "pairs": 66, "unknown": 0}}
    told = run("info dist.csv").out
    assert "66 known" in told
    assert "Sensor health" not in told
    assert "objects placed  12 of 12" in run("map dist.csv -o again.csv").out


def test_a_matrix_in_a_format_of_recordings_is_asked_about(run, points, tmp_path):
    np.savez(tmp_path / "d.npz", readings=squareform(pdist(points)))
    asked = "symmetric matrix of 12 x 12: give --dissimilarities"
    assert asked in run("map", "d.npz", code=2).err
    assert asked in run("info", "d.npz").err
    assert "objects placed  12 of 12" in run("map", "d.npz", "--dissimilarities").out
    run("map", "d.npz", "--no-dissimilarities", "--no-verdict", "-o", "m.csv")


def test_a_doubtful_matrix_is_refused_with_both_readings(run, tmp_path):
    np.savetxt(tmp_path / "d.csv", 1 - np.eye(6)[::-1] - np.eye(6), delimiter=",")
    told = run("map", "d.csv", code=2).err, run("info", "d.csv").err
    for option in ("--dissimilarities", "--no-dissimilarities", "recording of 6 frames"):
        assert all(option in text for text in told)


def test_a_list_of_numbered_pairs_is_asked_about(run, tmp_path, points):
    distances = squareform(pdist(points))
    pairs = [f"{i},{j},{distances[i, j]}" for i in range(12) for j in range(i)]
    for name, header in (("pairs.csv", "a,b,d"), ("contacts.csv", "frame,taxel,value")):
        (tmp_path / name).write_text("\n".join([header, *pairs]) + "\n")
    assert "--dissimilarities" in run("map", "pairs.csv", code=2).err
    run("map", "pairs.csv", "--dissimilarities", "-d", 2, "-o", "map.csv")
    made, in_order = anisomap.read_map("map.csv"), points[[1, 0, *range(2, 12)]]
    assert evaluation.mantel(made, in_order, permutations=0).r > 0.999
    assert "--dissimilarities" not in run("info", "contacts.csv").err


def test_a_square_recording_can_be_named_as_such(run_map, tmp_path):
    rng = np.random.default_rng(0)
    half = rng.random((8, 8))
    np.savetxt(tmp_path / "d.csv", (half + half.T) * (1 - np.eye(8)), delimiter=",")
    assert "Dissimilarities" in run_map("d.csv", "-m", "mds").out
    assert "frames" in run_map("d.csv", "--no-dissimilarities").out


def test_weights_and_missing_pairs(run, tmp_path, points):
    """A wrong distance of weight 0 does not matter, and neither do unknown ones."""
    true = squareform(pdist(points))
    wrong = true.copy()
    wrong[0, 5] = wrong[5, 0] = 9
    wrong[1, 2] = wrong[2, 1] = np.nan
    np.savetxt(tmp_path / "d.csv", wrong, delimiter=",")
    (tmp_path / "w.csv").write_text("s0,s5,0\n")
    args = ["map", "d.csv", "-d", 2, "-m", "mds", "--dissimilarities", "--permutations", 0]
    run(*args, "-o", "bent.csv")
    done = run(*args, "--weights", "w.csv", "-o", "m.csv", "--json")
    assert done.values["dissimilarities"]["unknown"] == 2
    bent, good = (
        evaluation.mantel(anisomap.read_map(tmp_path / name), true, permutations=0).r
        for name in ("bent.csv", "m.csv")
    )
    assert good > 0.999 > bent


def test_the_choice_of_dimensions_speaks_of_objects(run, tmp_path):
    (tmp_path / "few.csv").write_text("A,B,1\nB,C,1\nA,C,1.5\n")
    values = np.random.default_rng(0).uniform(size=(30, 3))
    np.savetxt(tmp_path / "many.csv", squareform(pdist(values)), delimiter=",")
    for file, k, said in (("few", 2, "do not show"), ("many", 3, "two dimensions do not explain")):
        done = run("map", f"{file}.csv", "--permutations", 0)
        assert f"objects placed  {len(values) if k == 3 else 3} of" in done.out
        assert anisomap.read_map(tmp_path / f"{file}.map.csv").dimensions == k
        text = " ".join((done.out + done.err).split())
        assert said in text
        assert "dissimilarities" in text
        assert not re.search("readings|skin|sensor", text)


def test_ekman_has_the_stress_that_smacof_finds(run, tmp_path):
    ekman = datasets.load_ekman()
    known = np.triu_indices(14, 1)
    np.savetxt(tmp_path / "ekman.csv", ekman.dissimilarities, delimiter=",")
    done = run("map", "ekman.csv", "-d", 2, "-m", "mds", "--json", "--permutations", 0)
    found = anisomap.read_map(tmp_path / "ekman.map.csv")
    missed = pdist(found.positions) - ekman.dissimilarities[known]
    assert (missed**2).sum() == pytest.approx(RAW_STRESS_OF_EKMAN, rel=1e-7)
    fit = done.values["dissimilarities"]
    explicit = np.sqrt(RAW_STRESS_OF_EKMAN / (ekman.dissimilarities[known] ** 2).sum())
    assert fit["explicit_stress"] == pytest.approx(explicit, rel=1e-6)
    ordinal = run("map", "ekman.csv", "-d", 2, "-m", "ordinal", "--json", "--permutations", 19)
    fit = ordinal.values["dissimilarities"]
    assert fit["stress"] == pytest.approx(fit["nonmetric_stress"], rel=1e-6)
    assert fit["p_value"] == pytest.approx(0.05)


def test_meadows_have_the_stress_that_vegan_finds():
    """The first start of `metaMDS` is classical scaling, as ours, and ends in a local minimum."""
    cover = np.loadtxt(Path(__file__).with_name("dune.csv"), delimiter=",")
    distances = squareform(pdist(cover, "braycurtis"))
    for n_init, stress in STRESS_OF_MEADOWS.items():
        made = anisomap.Anisomap(
            metric="precomputed", method="ordinal", n_init=n_init, random_state=0
        )
        assert made.fit(distances).stress_ == pytest.approx(stress, abs=2e-7)


def test_road_distances_have_the_classical_scaling_of_r():
    roads = datasets.load_eurodist()
    found = torgerson(roads.dissimilarities, 2)
    for city, place in CITIES_OF_R.items():
        np.testing.assert_allclose(np.abs(found[roads.names.index(city)]), np.abs(place), rtol=1e-6)
