"""Maps of real skins, beside those of the methods that users would take instead."""

import warnings
from functools import cache

import numpy as np
import pytest
from benchmarks.inputs import tiled_places, tiled_torso

from anisomap import io, reconstruct, reconstruct_from
from anisomap.comparison import compare_methods
from anisomap.errors import AnisomapWarning
from anisomap.evaluation import mantel
from anisomap.numerics.reliability.sampling_noise import sampling_variance
from anisomap.numerics.similarity.correlation import pearson
from anisomap.options import MethodOptions
from skins import mantel_r, stages

PLAIN = ("covariogram", "r-anisomap", "isomap-on-r")
LOSS = 0.01
"""Mantel r by which the default method may be behind the best plain method on any recording."""


@cache  # two tests look at the same comparison
def compared(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)  # maps of these skins carry caveats
        comparison = compare_methods(io.read(path), PLAIN)
    return {score.method: score.mantel_r for score in comparison.scores}


@pytest.mark.parametrize(
    "name",
    [
        "nao_torso",
        "nao_head",
        "insole_L",
        "retina_stacy",
        pytest.param("retina_macc2", marks=pytest.mark.slow),
    ],
)
def test_default_is_not_behind_plain_methods_on_hard_recordings(hard_recordings_folder, name):
    r = compared(hard_recordings_folder / f"{name}.npz")
    assert r["covariogram"] > max(r.values()) - LOSS


@pytest.mark.parametrize("name", ["nao_torso", "nao_head", "retina_stacy"])
def test_default_is_ahead_where_contacts_differ_between_places(hard_recordings_folder, name):
    r = compared(hard_recordings_folder / f"{name}.npz")
    assert r["covariogram"] > max(r["r-anisomap"], r["isomap-on-r"]) + LOSS


@pytest.mark.parametrize(
    "name",
    ["icub_hexagon", "icub_palm", "plantar", pytest.param("icub_torso", marks=pytest.mark.slow)],
)
def test_default_is_not_behind_plain_methods_on_flat_skins(recordings_folder, name):
    r = compared(recordings_folder / f"{name}.npz")
    assert r["covariogram"] > max(r.values()) - LOSS


# Feet roll off: neighbours on the plantar map are uneven, contacts differ, and it says so. Flat
# skins in 3D are noted.
uneven = pytest.mark.filterwarnings(
    "ignore:this looks flat",
    "ignore:the covariogram map has very unequal",
    "ignore:no single function of distance",
)


@uneven
@pytest.mark.parametrize(
    ("name", "dimensions", "least"),
    [
        ("icub_hexagon", 2, 0.985),
        pytest.param("icub_torso", 2, 0.985, marks=pytest.mark.slow),
        ("icub_palm", 3, 0.980),
        ("plantar", 2, 0.950),
    ],
)
def test_flat_skins_are_mapped(recordings_folder, name, dimensions, least):
    recording = io.read(recordings_folder / f"{name}.npz")
    assert mantel_r(reconstruct(recording, dimensions=dimensions), recording) >= least


@uneven
@pytest.mark.parametrize("name", ["icub_hexagon", "icub_palm", "plantar"])
@pytest.mark.parametrize("dimensions", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_isomap_and_information_distance_are_worse_on_real_skins(
    recordings_folder, name, dimensions
):
    recording = io.read(recordings_folder / f"{name}.npz")
    best = mantel_r(reconstruct(recording, dimensions=dimensions), recording)
    for rival in ("information-distance", "isomap"):
        assert mantel_r(reconstruct(recording, rival, dimensions), recording) < best - 0.01


@pytest.mark.parametrize("name", ["icub_hexagon", "icub_palm"])
def test_thresholded_skins_have_two_bins(recordings_folder, name):
    recording = io.read(recordings_folder / f"{name}.npz")
    few, many = (
        stages(recording.readings, "i-anisomap", MethodOptions(bins=bins)).similarity
        for bins in (2, 8)
    )
    assert few.max() > 0.1
    np.testing.assert_allclose(few, many, atol=1e-12)


def test_bins_of_continuous_readings_are_all_used(recordings_folder):
    recording = io.read(recordings_folder / "plantar.npz")
    for bins in (4, 6, 8):
        information = stages(recording.readings, "i-anisomap", MethodOptions(bins=bins)).similarity
        entropy = np.diag(information)
        assert entropy.max() > 0.9 * np.log(bins)
        assert (entropy <= np.log(bins) + 1e-12).all()
        assert mantel_r(reconstruct(recording, "isomap", 2, options=MethodOptions(bins=bins)),
                        recording) > 0.88  # fmt: skip


@pytest.mark.slow
@uneven
def test_copies_of_a_real_skin_side_by_side_are_one_large_skin(recordings_folder):
    # By chance 1,300 sensors make so many links that maps which follow them all reach only .66.
    skin = recordings_folder / "icub_torso.npz"
    truth = tiled_places(skin, 1300, 28_000)
    readings = tiled_torso(skin, 1300, 28_000)
    found = reconstruct_from(
        dimensions=2, similarity=pearson(readings), noise=sampling_variance(readings)
    )
    assert mantel(found.positions, truth, permutations=0).r > 0.985
