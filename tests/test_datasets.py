"""The data sets of the package: complete, described, licensed and small."""

import inspect
from importlib.resources import files

import numpy as np
import pytest

import anisomap
from anisomap import datasets

LOADERS = [name for name, _ in inspect.getmembers(datasets, inspect.isfunction) if "load" in name]
MAX_BYTES = 500_000


@pytest.mark.parametrize("name", LOADERS)
def test_a_data_set_is_described_and_licensed(name):
    found = getattr(datasets, name)()
    assert any(word in found.DESCR for word in ("BSD-3-Clause", "free to use"))
    if "recording" not in found:
        values = found.dissimilarities
        assert values.shape == (len(found.names),) * 2
        np.testing.assert_array_equal(values, values.T)
        return
    recording = found.recording
    assert f"{recording.n_sensors} sensors" in found.DESCR
    assert f"n_frames={recording.n_frames}" in found.DESCR
    made = anisomap.reconstruct(recording)
    assert anisomap.score(made, recording, permutations=0).mantel.r > 0.98


def test_the_data_sets_are_small():
    found = list((files("anisomap.datasets") / "data").iterdir())
    assert len(found) == len(LOADERS)
    assert sum(file.stat().st_size for file in found) < MAX_BYTES
