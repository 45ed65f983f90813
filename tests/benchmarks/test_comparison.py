"""Stock methods as baselines, and comparisons of methods on the same sensors."""

import csv
import re

import numpy as np
import pytest
from benchmarks.accuracy.compare import compare_methods, spanned_dimensions, to_csv, to_markdown
from benchmarks.accuracy.rivals import RIVALS, map_by_rival
from scipy.spatial.distance import pdist

import anisomap
from anisomap.evaluation import mantel
from skins import flat_skin, lattice, rubbed

NAMES = [
    pytest.param(name, marks=pytest.mark.slow if name == "umap-on-r" else ()) for name in RIVALS
]  # compiling UMAP takes some 10 s


def relative(positions):
    return pdist(positions) / pdist(positions).max()


@pytest.mark.parametrize("name", NAMES)
def test_rivals_map_a_flat_skin_and_depend_on_their_seed_alone(name):
    if name == "umap-on-r":
        pytest.importorskip("umap")
    recording = flat_skin()
    made = map_by_rival(recording, name, 2, seed=3)
    assert made.positions.shape == (42, 2)
    assert made.method == name
    assert mantel(made, recording.positions, permutations=0).r > 0.4
    again = map_by_rival(recording, name, 2, seed=3)
    np.testing.assert_array_equal(made.positions, again.positions)


def test_rivals_see_correlations_only():
    """They ignore gains, offsets and the order of frames and sensors."""
    recording = flat_skin()
    rng = np.random.default_rng(0)
    order = rng.permutation(42)
    changed = recording.readings[rng.permutation(1500)] * rng.uniform(1, 5, 42) - 3
    for name in ("isomap-on-r", "pca-on-r", "laplacian-on-r", "phate-on-r"):
        first = map_by_rival(recording, name, 3).positions
        second = map_by_rival(anisomap.Recording(changed[:, order]), name, 3).positions
        np.testing.assert_allclose(relative(first[order]), relative(second), atol=1e-5)


def test_tables_state_the_scores_and_the_losses():
    chosen = ("information-distance", "isomap", "isomap-on-r", "pca-on-r")
    found = [
        compare_methods(flat_skin(seed=seed), chosen, name=name)
        for seed, name in enumerate(("skin", "other"))
    ]
    table = to_markdown(found).splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table[2:4]]
    for one, row, values in zip(
        found, rows, csv.DictReader(to_csv(found).splitlines()), strict=True
    ):
        assert row[:4] == [one.name, "42 x 1500", "2D", "42"]
        best = {one.best(stock=False).method, one.best(stock=True).method}
        for s, cell in zip(one.scores, row[4:], strict=True):
            assert ("**" in cell) == (s.method in best)
            r, error = map(float, re.findall(r"\d\.\d+", cell))
            assert (r, error) == pytest.approx((s.mantel_r, s.rms_in_spacings), abs=0.006)
            assert float(values[s.method]) == pytest.approx(s.mantel_r, abs=6e-5)
        assert float(values["margin"]) == pytest.approx(one.margin, abs=6e-4)
    losses = sum(one.margin < -0.0005 for one in found)
    assert f"on {losses} of 2 maps" in to_markdown(found)


def two_pieces():
    """A skin of 30 sensors, one of 12 that is touched on its own, and one touched three times."""
    places = np.vstack([lattice(5, 6), lattice(3, 4) + 20, [[9.0, 9.0]]])
    readings = np.zeros((3000, 43))
    readings[:1500, :30] = rubbed(places[:30], 1500)
    readings[1500:, 30:42] = rubbed(places[30:42], 1500)
    readings[[5, 50, 500], 42] = 1
    return anisomap.Recording(readings, positions=places, source="two pieces")


def test_all_methods_are_scored_on_the_sensors_that_all_of_them_place():
    recording = two_pieces()
    found = compare_methods(recording, ["covariogram", "r-anisomap", "isomap-on-r"])
    assert found.sensors.tolist() == list(range(30))
    assert (found.name, found.n_sensors, found.dimensions) == ("two pieces", 43, 2)
    for s in found.scores:
        positions = s.sensor_map.positions[:30]
        expected = mantel(positions, recording.positions[:30], permutations=0).r
        assert s.mantel_r == pytest.approx(expected)
    assert [s.n_placed for s in found.scores] == [30, 42, 42]
    own, paper, stock = found.scores
    assert found.judged is own
    assert found.best(stock=True) is stock
    assert found.best(stock=False) is max(own, paper, key=lambda s: s.mantel_r)
    assert found.margin == own.mantel_r - stock.mantel_r


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_dimensions_that_positions_span(dimensions):
    rng = np.random.default_rng(dimensions)
    basis = np.linalg.qr(rng.normal(size=(3, 3)))[0][:dimensions]
    points = 100 + 30 * rng.normal(size=(20, dimensions)) @ basis
    points[3] = np.nan
    assert spanned_dimensions(points) == dimensions
