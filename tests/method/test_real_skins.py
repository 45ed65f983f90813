"""Maps of real skins, beside those of the methods that users would take instead."""

from functools import cache

import numpy as np
import pytest
from benchmarks.accuracy.compare import compare_methods
from benchmarks.skins.inputs import tiled_places, tiled_torso

from anisomap import io, reconstruct, reconstruct_from
from anisomap.evaluation import mantel
from anisomap.method.named import MethodOptions
from anisomap.numerics.reliability.sampling_noise import sampling_variance
from anisomap.numerics.similarity.correlation import pearson
from skins import mantel_r, quietly, stages

PLAIN = ("covariogram", "r-anisomap", "isomap-on-r")
RIVALS = ("information-distance", "isomap")
FLAT = ("icub_hexagon", "icub_palm", "plantar")
UNLIKE = ("nao_torso", "nao_head", "retina_stacy")
"""Recordings whose contacts differ between places."""


@cache  # several tests look at the same maps
def compared(path):
    """Return Mantel r by method; flat skins are also mapped by methods that are far behind."""
    methods = (*PLAIN, *RIVALS) if path.stem in FLAT else PLAIN
    comparison = quietly(compare_methods, io.read(path), methods)
    return {score.method: score.mantel_r for score in comparison.scores}


def plain(r):
    """Return the better of the plain methods."""
    return max(r["r-anisomap"], r["isomap-on-r"])


@pytest.mark.parametrize("name", [*UNLIKE, "insole_L"])
def test_default_is_not_behind_plain_methods_on_hard_recordings(hard_recordings_folder, name):
    r = compared(hard_recordings_folder / f"{name}.npz")
    assert r["covariogram"] > plain(r) - 0.02


def test_default_is_ahead_where_contacts_differ_between_places(hard_recordings_folder):
    found = [compared(hard_recordings_folder / f"{name}.npz") for name in UNLIKE]
    assert np.median([r["covariogram"] - plain(r) for r in found]) > 0.01
    assert all(r["covariogram"] > plain(r) for r in found)


@pytest.mark.parametrize("name", [*FLAT, pytest.param("icub_torso", marks=pytest.mark.slow)])
def test_default_is_not_behind_plain_methods_on_flat_skins(recordings_folder, name):
    r = compared(recordings_folder / f"{name}.npz")
    assert r["covariogram"] > max(0.93, plain(r) - 0.02)
    assert all(r[rival] < r["covariogram"] - 0.01 for rival in RIVALS if rival in r)


def test_flat_skins_are_mapped(recordings_folder):
    r = [compared(recordings_folder / f"{name}.npz")["covariogram"] for name in FLAT]
    assert np.median(r) > 0.97


@pytest.mark.slow
@pytest.mark.parametrize("name", FLAT)
def test_flat_skins_are_mapped_about_as_well_in_space(recordings_folder, name):
    recording = io.read(recordings_folder / f"{name}.npz")
    in_space = mantel_r(quietly(reconstruct, recording, dimensions=3), recording)
    assert in_space > compared(recordings_folder / f"{name}.npz")["covariogram"] - 0.02


@pytest.mark.parametrize("name", ["icub_hexagon", "icub_palm"])
def test_thresholded_skins_have_two_bins(recordings_folder, name):
    recording = io.read(recordings_folder / f"{name}.npz")
    few, many = (
        stages(recording.readings, "i-anisomap", MethodOptions(entropy_bins=bins)).similarity
        for bins in (2, 8)
    )
    assert few.max() > 0.1
    np.testing.assert_allclose(few, many, atol=1e-12)


def test_bins_of_continuous_readings_are_all_used(recordings_folder):
    recording = io.read(recordings_folder / "plantar.npz")
    for bins in (4, 8):
        information = stages(
            recording.readings, "i-anisomap", MethodOptions(entropy_bins=bins)
        ).similarity
        entropy = np.diag(information)
        assert entropy.max() > 0.9 * np.log(bins)
        assert (entropy <= np.log(bins) + 1e-12).all()
        found = reconstruct(recording, "isomap", 2, options=MethodOptions(entropy_bins=bins))
        assert mantel_r(found, recording) > 0.85


@pytest.mark.slow
def test_copies_of_a_real_skin_side_by_side_are_one_large_skin(recordings_folder):
    # By chance 1,300 sensors make so many links that maps which follow them all reach only .66.
    skin = recordings_folder / "icub_torso.npz"
    truth = tiled_places(skin, 1300, 28_000)
    readings = tiled_torso(skin, 1300, 28_000)
    found = quietly(
        reconstruct_from,
        dimensions=2,
        similarity=pearson(readings),
        noise=sampling_variance(readings),
    )
    assert mantel(found.positions, truth, permutations=0).r > 0.95
