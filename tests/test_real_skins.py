"""The default method on real skins, beside the methods that users would take instead."""

import warnings
from functools import cache

import pytest

from anisomap import io
from anisomap.comparison import compare_methods
from anisomap.errors import AnisomapWarning

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
