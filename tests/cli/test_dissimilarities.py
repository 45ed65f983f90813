"""Files of dissimilarities are refused with the Python that maps them; worked examples of R.

Ekman's similarities of colours are those of R's package smacof; road distances those of R; plants
on meadows those of R's package vegan.
"""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

import anisomap
from anisomap import datasets
from anisomap.numerics.scaling.multidimensional_scaling import torgerson

RAW_STRESS_OF_EKMAN = 2 * 0.52785281847690113
"""De Leeuw's smacof of 1 - ekman in 2 dimensions, which gives half the sum of squares.

https://github.com/deleeuw/smacofExamples, ekman/ekmanMetric.R.
"""

STRESS_OF_MEADOWS = {1: 0.1192678, 20: 0.1183186}
"""Stress of ``metaMDS(dune)`` by the number of starts, in the documentation of vegan."""

CITIES_OF_R = {"Athens": (2290.27468, 1798.8029), "Barcelona": (-825.38279, 546.8115)}
"""First rows of ``cmdscale(eurodist)``, in the documentation of R."""


def test_dissimilarities_are_refused_with_the_python_that_maps_them(run, tmp_path):
    """Rounding on the diagonal and a cell that differs from the one across are the same case."""
    points = np.random.default_rng(4).random((12, 2))
    wanted = squareform(pdist(points))
    rounded, one_off = wanted.copy(), wanted.copy()
    rounded[np.diag_indices(12)] = 1e-16
    one_off[3, 5] *= 1.5
    for name, values in (("exact", wanted), ("rounded", rounded), ("one_off", one_off)):
        np.savetxt(tmp_path / f"{name}.csv", values, delimiter=",")
        for command in ("map", "info"):
            told = run(command, f"{name}.csv", code=2).err
            assert f"d = anisomap.read('{name}.csv').readings; anisomap.Anisomap(" in told
            assert 'metric="precomputed").fit_transform((d + d.T) / 2)' in told
        d = anisomap.read(tmp_path / f"{name}.csv").readings
        made = anisomap.Anisomap(metric="precomputed").fit_transform((d + d.T) / 2)
        found = anisomap.mantel(made, points, permutations=0)
        assert found.r > (0.95 if name == "one_off" else 0.999999)


def test_a_square_recording_is_mapped(run_map, tmp_path):
    """Readings that are symmetric by chance have zeros elsewhere or none on the diagonal."""
    rng = np.random.default_rng(0)
    half = rng.random((8, 8)) + np.eye(8)
    np.savetxt(tmp_path / "positive.csv", half + half.T, delimiter=",")
    np.savetxt(tmp_path / "sparse.csv", np.triu(half * (half > 0.5), 1), delimiter=",")
    for name in ("positive", "sparse"):
        assert "frames" in run_map(f"{name}.csv").out


def test_ekman_has_the_stress_that_smacof_finds():
    ekman = datasets.load_ekman()
    made = anisomap.Anisomap(metric="precomputed", method="mds").fit(ekman.dissimilarities)
    missed = pdist(made.embedding_) - squareform(ekman.dissimilarities)
    assert (missed**2).sum() == pytest.approx(RAW_STRESS_OF_EKMAN, rel=1e-7)


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
