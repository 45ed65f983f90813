"""The stages for arrays of any library give what those for numpy's arrays give."""

import sys

import array_api_strict
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.sparse.csgraph import floyd_warshall

from anisomap.errors import InputError, MissingExtraError
from anisomap.large import device as stages
from anisomap.large import reconstruct_on_device
from anisomap.method.named import MethodOptions
from anisomap.method.pipeline import reconstruct
from anisomap.numerics.graph.dissimilarity import regularised_reciprocal
from anisomap.numerics.precision import MIN_FLOAT32_SENSORS
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions, smacof
from anisomap.numerics.similarity.correlation import pearson, spearman
from anisomap.numerics.similarity.information import mutual_information
from skins import flat_skin, mantel_r, rubbed


def _on_gpu(name):
    """Return a function that copies arrays to a GPU by a library; skip without them."""

    def copy(values):
        library = pytest.importorskip(name, reason=f"{name} is not installed")
        if not library.cuda.is_available():
            pytest.skip(f"{name} finds no GPU")
        return library.asarray(values, **({"device": "cuda"} if name == "torch" else {}))

    return copy


LIBRARIES = {
    "numpy": np.asarray,
    "standard": array_api_strict.asarray,  # refuses what is outside the standard
    "cupy": _on_gpu("cupy"),
    "torch": _on_gpu("torch"),
}

SIMILARITIES = [
    (stages.pearson, pearson),
    (stages.spearman, spearman),
    (lambda x: stages.mutual_information(x, 4), lambda x: mutual_information(x, 4)),
]


@pytest.fixture(params=LIBRARIES)
def asarray(request):
    return LIBRARIES[request.param]


@pytest.mark.parametrize(("device", "usual"), SIMILARITIES, ids=["r", "rho", "information"])
@given(
    st.one_of(
        arrays(np.uint8, (9, 5), elements=st.integers(0, 3)),
        arrays(np.float32, (9, 5), elements=st.floats(-1e3, 1e3, width=16)),
        arrays(np.float64, (9, 5), elements=st.floats(-(2.0**99), 2.0**99, width=32)),
    )
)
def test_similarities_of_any_readings_agree(device, usual, readings):
    found = stages.to_numpy(device(array_api_strict.asarray(readings)))
    np.testing.assert_allclose(found, usual(readings), atol=1e-6)


@pytest.mark.parametrize(("device", "usual"), SIMILARITIES, ids=["r", "rho", "information"])
def test_similarities_of_a_skin_agree(asarray, device, usual):
    readings = flat_skin().readings
    found = stages.to_numpy(device(asarray(readings)))
    np.testing.assert_allclose(found, usual(readings), atol=1e-5)


@pytest.mark.parametrize("mu", [0.0, 0.1, 1.0])
def test_reciprocals_agree(asarray, mu):
    similarity = pearson(flat_skin().readings)
    found = stages.regularised_reciprocal(asarray(similarity.copy()), mu)
    expected = regularised_reciprocal(similarity, mu)
    np.testing.assert_allclose(stages.to_numpy(found), expected, rtol=1e-6)


@pytest.mark.parametrize("n_nodes", [1, 31, 32, 33, 64, 130])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_shortest_paths_are_those_of_scipy(asarray, n_nodes, dtype):
    rng = np.random.default_rng(n_nodes)
    lengths = rng.uniform(0.1, 1, (n_nodes, n_nodes)) ** 3
    lengths[rng.random(lengths.shape) < 0.8] = np.inf
    lengths = np.minimum(lengths, lengths.T).astype(dtype)
    np.fill_diagonal(lengths, 0)
    found = stages.to_numpy(stages.metricise(asarray(lengths)))
    expected = floyd_warshall(lengths)
    np.testing.assert_allclose(found, expected, rtol=1e-5 if dtype == np.float32 else 1e-12)
    assert np.array_equal(found, found.T)
    assert not np.diag(found).any()


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_scaling_reaches_the_stress_of_smacof(asarray, dimensions):
    rng = np.random.default_rng(dimensions)
    n_points = stages.MIN_DEVICE_POINTS + 40
    places = rng.uniform(0, 5, (n_points, 3))
    places[1] = places[0]  # coincident points have no direction
    distances = np.linalg.norm(places[:, None] - places, axis=2) * rng.uniform(0.9, 1.1)
    usual = smacof(distances, dimensions=dimensions)
    found = stages.scale(asarray(distances), dimensions, SmacofOptions())
    assert found.stress <= usual.stress * 1.01 + 1e-6
    assert found.positions.shape == (n_points, dimensions)
    assert (np.diff(found.trace) <= 1e-6 * found.trace[0]).all()


@pytest.mark.parametrize("method", ["r-anisomap", "spearman-anisomap", "i-anisomap"])
def test_a_map_is_that_of_reconstruct(asarray, method):
    recording = flat_skin()
    usual = reconstruct(recording, method, 2)
    found = reconstruct_on_device(asarray(recording.readings), method, 2, names=recording.names)
    assert found.names == recording.names
    assert found.method == method
    assert found.similarity == usual.similarity
    assert found.stress == pytest.approx(usual.stress, rel=1e-3)
    assert mantel_r(found, recording) == pytest.approx(mantel_r(usual, recording), abs=1e-3)
    assert set(usual.provenance) - {"dimensions_chosen"} <= {*found.provenance, "source"}


@pytest.mark.parametrize("asarray", ["cupy", "torch"], indirect=True)
def test_many_sensors_are_mapped_in_single_precision(asarray):
    places = np.random.default_rng(5).uniform(0, 40, (MIN_FLOAT32_SENSORS, 2))
    readings = rubbed(places, 600, reach=8).astype(np.float32)
    found = reconstruct_on_device(asarray(readings), dimensions=2)
    usual = reconstruct(readings, "r-anisomap", 2)
    assert found.stress == pytest.approx(usual.stress, rel=0.01)


def test_constant_sensors_are_not_placed(asarray):
    readings = np.array(flat_skin().readings)
    readings[:, 3] = 1
    found = reconstruct_on_device(asarray(readings), dimensions=2)
    assert np.flatnonzero(np.isnan(found.positions).any(axis=1)).tolist() == [3]


def test_readings_that_are_true_or_false_are_mapped(asarray):
    readings = flat_skin().readings > 0.5
    found = reconstruct_on_device(asarray(readings), dimensions=2)
    assert found.stress == pytest.approx(reconstruct(readings, "r-anisomap", 2).stress, rel=1e-3)


HOLED = np.array(flat_skin().readings)
HOLED[5, 2] = np.nan


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"readings": HOLED}, "sensor 2"),
        ({"readings": np.ones((50, 8))}, "vary"),
        ({"readings": np.ones(50)}, "shape"),
        *(({"readings": flat_skin().readings[:n]}, "requires 5 frames") for n in range(4)),
        ({"method": "isomap"}, "does not run on a device"),
        ({"options": MethodOptions(regularisation=0)}, "regularisation"),
        ({"dimensions": 0}, "dimensions"),
        ({"dimensions": "auto"}, "dimensions"),
        ({"names": ["a", "b"]}, "names"),
    ],
)
def test_impossible_requests_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        reconstruct_on_device(**{"readings": flat_skin().readings, **change})


def test_a_missing_library_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "array_api_compat", None)
    with pytest.raises(MissingExtraError, match="gpu"):
        reconstruct_on_device(flat_skin().readings)
