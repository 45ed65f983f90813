"""Maps of Dask arrays: the sums over blocks equal those over the whole array."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from anisomap import METHODS, mantel, reconstruct
from anisomap.errors import AnisomapWarning, InputError
from anisomap.method.blocks import SUMMED, sum_blocks
from anisomap.method.evidence import SIMILARITIES
from skins import flat_skin

da = pytest.importorskip("dask.array", reason="needs the extra 'cluster'")

BINS = 6
SKIN = flat_skin(n_frames=800)
SUMMABLE = [name for name, method in METHODS.items() if method.similarity in SUMMED]


def in_blocks(readings, frames, sensors=-1):
    return da.from_array(readings, chunks=(frames, sensors))


@pytest.mark.parametrize("method", SUMMABLE)
def test_the_map_is_that_of_the_array_in_memory(method):
    whole = reconstruct(SKIN.readings, method, 2, drop=["s3"])
    summed = reconstruct(in_blocks(SKIN.readings, 170, 11), method, 2, drop=["s3"])
    np.testing.assert_allclose(summed.positions, whole.positions, atol=1e-9, equal_nan=True)
    assert summed.names == whole.names
    assert summed.similarity == whole.similarity
    assert summed.provenance["frames"] == 800


@st.composite
def recordings(draw):
    """Readings with ties, rest and constant sensors, of several types, and cuts into blocks."""
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    kind = draw(st.sampled_from([np.uint8, np.int32, np.float32, np.float64, np.bool_]))
    n_frames, n_sensors = draw(st.integers(2, 60)), draw(st.integers(2, 6))
    values = rng.integers(0, draw(st.integers(1, 12)), (n_frames, n_sensors)).astype(kind)
    values[:, 0] = values[0, 0]
    lengths = draw(st.lists(st.integers(0, 20), max_size=5).filter(lambda it: sum(it) < n_frames))
    return values, (*lengths, n_frames - sum(lengths))


@pytest.mark.parametrize("name", SUMMED)
@given(recordings())
@settings(max_examples=10)
def test_similarities_do_not_depend_on_the_blocks(name, made):
    readings, lengths = made
    found = sum_blocks(in_blocks(readings, lengths), name, BINS)
    expected = SIMILARITIES[name].compute(readings, BINS)
    np.testing.assert_allclose(found.similarity, expected, atol=1e-9)
    assert found.n_frames == len(readings)
    np.testing.assert_array_equal(found.varying, np.ptp(readings.astype(float), axis=0) > 0)


def test_very_many_values_are_rounded_with_a_note(monkeypatch):
    monkeypatch.setattr("anisomap.numerics.similarity.binning.MAX_VALUES", 1)
    readings = SKIN.readings + np.random.default_rng(0).normal(0, 1e-4, SKIN.readings.shape)
    with pytest.warns(AnisomapWarning, match="were rounded"):
        made = reconstruct(in_blocks(readings, 500), "i-anisomap", 2)
    assert any("were rounded" in note for note in made.notes)
    whole = reconstruct(readings, "i-anisomap", 2)
    assert mantel(made, whole, permutations=0).r > 0.99


@pytest.mark.parametrize("method", set(METHODS) - set(SUMMABLE))
def test_methods_that_need_readings_are_refused(method):
    with pytest.raises(InputError, match=r"such as r-anisomap, or sample frames"):
        reconstruct(in_blocks(SKIN.readings, 500), method)


def test_what_cannot_be_summed_is_refused():
    readings = SKIN.readings.astype(float)
    missing = readings.copy()
    missing[700, 5] = np.nan
    for array, told in (
        (in_blocks(missing, 500), "sensor 5 reads NaN or above"),
        (in_blocks(1e200 * readings, 500), "reads NaN or above 1e"),
        (da.from_array(readings[:, 0]), r"\(T, N\) real numbers"),
        (in_blocks(readings.astype(complex), 500), r"\(T, N\) real numbers"),
        (in_blocks(readings[:3], 2), "requires 4 frames"),
    ):
        with pytest.raises(InputError, match=told):
            reconstruct(array, "r-anisomap", 2)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_blocks_are_summed_on_a_cluster():
    distributed = pytest.importorskip("distributed", reason="needs the extra 'cluster'")
    array = in_blocks(SKIN.readings, 200)
    local = reconstruct(array, "i-anisomap", 2)
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster):
        remote = reconstruct(array, "i-anisomap", 2)
    np.testing.assert_allclose(remote.positions, local.positions, atol=1e-9)
