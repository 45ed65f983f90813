"""``anisomap map --min-quality``: the exit code follows the verdict; ellipses are in all files."""

import json

import numpy as np
import pytest

import anisomap
from skins import flat_skin


def test_a_usable_map_passes_and_all_files_carry_its_ellipses(run, skin_npz, tmp_path):
    outputs = ["m.csv", "m.json", "m.npz"]
    written = [word for name in outputs for word in ("-o", name)]
    done = run("map", skin_npz, "-d", 2, "--min-quality", "usable", "--json", *written)
    assert done.code == 0
    told = json.loads(done.out)["map"]["verdict"]
    assert told["level"] == "usable"
    maps = [anisomap.read_map(tmp_path / name) for name in outputs]
    for made in maps:
        assert made.verdict.level == "usable"
        assert made.verdict.expected_error == pytest.approx(told["expected_error"])
        assert np.isfinite(made.covariances).all()
        np.testing.assert_array_equal(made.covariances, maps[0].covariances)
    header = (tmp_path / "m.csv").read_text().split('"name"')[1].splitlines()[0]
    assert header.endswith('"cov_xx","cov_xy","cov_yy"')
    again = json.loads((tmp_path / "m.json").read_text())
    assert len(again["sensors"][0]["covariance"]) == 2


def test_maps_that_are_not_usable_or_not_judged_fail_but_are_written(run, tmp_path):
    short = flat_skin(n_frames=120)
    noise = np.random.default_rng(0).normal(0, 0.5, short.readings.shape)
    anisomap.write(anisomap.Recording(short.readings + noise), tmp_path / "short.npz")
    for method, level in (("covariogram", "usable"), ("r-anisomap", "usable-locally")):
        output = f"{method}.csv"
        done = run(
            *("map", "short.npz", "-d", 2, "-m", method, "-o", output, "-q"),
            *("--min-quality", level),
        )
        assert done.code == 1
        assert f"below --min-quality {level}" in done.err
        assert (tmp_path / output).exists()


def test_min_quality_needs_a_verdict_and_a_known_level(run, skin_npz, tmp_path):
    for wrong in (["usable", "--no-verdict"], ["excellent"]):
        done = run("map", skin_npz, "-d", 2, "-o", "m.csv", "--min-quality", *wrong)
        assert done.code == 2
        assert "verdict" in done.err or "usable" in done.err
        assert not (tmp_path / "m.csv").exists()


def test_pictures_and_reports_show_ellipses(run, skin_npz, tmp_path):
    done = run(
        *(
            "map",
            skin_npz,
            "-d",
            2,
            "-o",
            "m.csv",
            "--picture",
            "m.svg",
            "--report",
            "m.html",
            "-q",
        ),
        *("--permutations", 0),
    )
    assert done.code == 0
    assert "Ellipses hold 95" in (tmp_path / "m.html").read_text(encoding="utf-8")
    bare = run(
        *("map", skin_npz, "-d", 2, "-o", "b.csv", "--report", "b.html", "-q", "--no-verdict"),
        *("--permutations", 0),
    )
    assert bare.code == 0
    assert "Ellipses hold 95" not in (tmp_path / "b.html").read_text(encoding="utf-8")
