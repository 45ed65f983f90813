"""Maps of path lengths: exact for exact lengths; even spacing where it was declared."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import cdist, pdist

from anisomap.errors import InputError
from anisomap.numerics.geodesic.adjacency import (
    fit_path_lengths,
    refine_by_even_spacing,
)
from skins import lattice, rubbed


def mantel_r(x, y):
    return float(np.corrcoef(pdist(x), pdist(y))[0, 1])


def grid(rows=6, columns=7):
    """A square lattice, which unlike a triangular one offers no detour around a long link."""
    return np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2) * 1.0


def nearest(positions, reach=1.01):
    distances = cdist(positions, positions)
    return (distances < reach) & (distances > 0)


def test_a_straight_chain_is_recovered():
    gaps = np.array([1.0, 0.5, 2.0, 1.0, 1.5])
    lengths = np.diag(gaps, k=1) + np.diag(gaps, k=-1)
    found = fit_path_lengths(lengths, 2)
    np.testing.assert_allclose(np.diag(cdist(found, found), k=1), gaps, rtol=1e-3)
    assert mantel_r(found, np.cumsum(np.append(0, gaps))[:, None]) > 0.9999


def test_a_lattice_is_recovered_from_its_links():
    positions = lattice()
    assert mantel_r(fit_path_lengths(nearest(positions).astype(float), 2), positions) > 0.98


def test_an_even_guide_is_followed_and_an_uneven_one_is_ignored():
    positions = grid()
    links = nearest(positions).astype(float)
    alone, squeezed = fit_path_lengths(links, 2), positions * [1, 0.2]
    followed = fit_path_lengths(links, guide=7 * positions)
    assert 1 - mantel_r(followed, positions) < 0.1 * (1 - mantel_r(alone, positions))
    ignored = fit_path_lengths(links, guide=squeezed)
    np.testing.assert_array_equal(ignored, alone)
    assert mantel_r(squeezed, positions) < 0.9 < mantel_r(ignored, positions)


@given(st.integers(0, 20))
def test_the_fit_is_equivariant_to_labels(seed):
    positions, order = lattice(4, 4), np.random.default_rng(seed).permutation(16)
    links = nearest(positions) * 1.0
    straight = fit_path_lengths(links, guide=positions)
    other = fit_path_lengths(links[np.ix_(order, order)], guide=positions[order])
    np.testing.assert_allclose(cdist(other, other), cdist(straight[order], straight[order]),
                               atol=1e-6)  # fmt: skip


def test_even_spacing_corrects_a_compressed_map_and_keeps_its_unit():
    positions = grid()
    readings = rubbed(positions, 2000)
    squeezed = 30 * positions * [1, 0.2]
    found = refine_by_even_spacing(readings, squeezed)
    assert mantel_r(squeezed, positions) < 0.9
    assert mantel_r(found, positions) > 0.97
    links = nearest(positions)
    before, after = (np.log(cdist(x, x)[links]).mean() for x in (squeezed, found))
    assert after == pytest.approx(before, abs=0.1)


def test_without_agreement_of_halves_an_uneven_map_is_unchanged():
    noise = np.random.default_rng(1).standard_normal((1000, 30))
    places = np.random.default_rng(2).normal(size=(30, 2)) * [1, 0.01]
    assert refine_by_even_spacing(noise, places) is None


def test_disconnected_links_are_refused():
    with pytest.raises(InputError, match="separate"):
        fit_path_lengths(np.zeros((4, 4)), 2)
